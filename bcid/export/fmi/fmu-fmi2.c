/* The vehicle as a co-simulation FMU of the Functional Mock-up Interface 2.0. */
#include "fmi2-interface.h"
#include "fmu-vehicle.h"

typedef struct {
    Vehicle vehicle;
    char name[128], message[MESSAGE_SIZE];
    fmi2CallbackFunctions environment;
} Instance;

/* Logs the instance's message as an error.  It holds no %, so that it can be its own format. */
static fmi2Status refuse(const Instance *i)
{
    if (i->environment.logger != NULL) {
        i->environment.logger(i->environment.componentEnvironment, i->name, fmi2Error, "logStatusError", i->message);
    }
    return fmi2Error;
}

static fmi2Status refuse_because(Instance *i, const char *why)
{
    snprintf(i->message, MESSAGE_SIZE, "%s", why);
    return refuse(i);
}

static fmi2Status answer(const Instance *i, int done) { return done ? fmi2OK : refuse(i); }

FMI2_Export const char *FMI(fmi2GetTypesPlatform)(void) { return "default"; }

FMI2_Export const char *FMI(fmi2GetVersion)(void) { return "2.0"; }

/* There are messages of errors alone, which are always told. */
FUNCTION(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    return fmi2OK;
}

FMI2_Export fmi2Component FMI(fmi2Instantiate)(
    fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions,
    fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *i = calloc(1, sizeof *i);
    if (i == NULL) return NULL;
    reset_vehicle(&i->vehicle);
    snprintf(i->name, sizeof i->name, "%s", name ? name : "");
    if (functions != NULL) i->environment = *functions;
    if (type == fmi2CoSimulation && guid != NULL && strcmp(guid, Model_TOKEN) == 0) return i;
    refuse_because(i, type == fmi2CoSimulation ? "the guid is not that of this FMU" : "this FMU is for co-simulation");
    free(i);
    return NULL;
}

FMI2_Export void FMI(fmi2FreeInstance)(fmi2Component c) { free(c); }

FUNCTION(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_is_known, fmi2Real tolerance, fmi2Real start_s,
                              fmi2Boolean stop_is_known, fmi2Real stop_s)
{
    Instance *i = c;
    if (!change_mode(&i->vehicle, INSTANTIATED, INSTANTIATED, i->message)) return refuse(i);
    set_times(&i->vehicle, start_s, stop_is_known, stop_s);
    return fmi2OK;
}

FUNCTION(fmi2EnterInitializationMode)(fmi2Component c)
{
    Instance *i = c;
    return answer(i, change_mode(&i->vehicle, INSTANTIATED, INITIALIZING, i->message));
}

FUNCTION(fmi2ExitInitializationMode)(fmi2Component c)
{
    Instance *i = c;
    return answer(i, change_mode(&i->vehicle, INITIALIZING, STEPPING, i->message));
}

FUNCTION(fmi2Terminate)(fmi2Component c)
{
    Instance *i = c;
    return answer(i, change_mode(&i->vehicle, STEPPING, TERMINATED, i->message));
}

FUNCTION(fmi2Reset)(fmi2Component c)
{
    reset_vehicle(&((Instance *)c)->vehicle);
    return fmi2OK;
}

FUNCTION(fmi2GetReal)(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Real values[])
{
    Instance *i = c;
    return answer(i, get_values(&i->vehicle, at, n, values, i->message));
}

FUNCTION(fmi2SetReal)(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Real values[])
{
    Instance *i = c;
    return answer(i, set_values(&i->vehicle, at, n, values, i->message));
}

FUNCTION(fmi2DoStep)(fmi2Component c, fmi2Real now_s, fmi2Real step_s, fmi2Boolean never_back)
{
    Instance *i = c;
    return answer(i, advance(&i->vehicle, now_s, step_s, i->message));
}

FUNCTION(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    Instance *i = c;
    return answer(i, keep_state(&i->vehicle, state, i->message));
}

FUNCTION(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    memcpy(&((Instance *)c)->vehicle, state, sizeof(Vehicle));
    return fmi2OK;
}

FUNCTION(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
    return fmi2OK;
}

FUNCTION(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    *size = sizeof(Vehicle);
    return fmi2OK;
}

FUNCTION(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    Instance *i = c;
    return answer(i, serialize_state(state, bytes, size, i->message));
}

FUNCTION(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    Instance *i = c;
    return answer(i, keep_serialized(bytes, size, state, i->message));
}

/* A step is over when it returns: nothing is ever pending, and of the status only the time has something to tell. */
FUNCTION(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->vehicle.value[TIME];
    return fmi2OK;
}

FUNCTION(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = 0;
    return fmi2OK;
}

#define NO_STATUS(name, type) \
    FUNCTION(name)(fmi2Component c, const fmi2StatusKind kind, type *value) { return fmi2Discard; }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

/* Variables of other types, of which there are none. */
static fmi2Status none_of(fmi2Component c, size_t n)
{
    return n == 0 ? fmi2OK : refuse_because(c, "all variables are real numbers");
}

#define REFERENCES fmi2Component c, const fmi2ValueReference at[], size_t n
#define OTHER_TYPE(get, set, type) \
    FUNCTION(get)(REFERENCES, type values[]) { return none_of(c, n); } \
    FUNCTION(set)(REFERENCES, const type values[]) { return none_of(c, n); }
OTHER_TYPE(fmi2GetInteger, fmi2SetInteger, fmi2Integer)
OTHER_TYPE(fmi2GetBoolean, fmi2SetBoolean, fmi2Boolean)
OTHER_TYPE(fmi2GetString, fmi2SetString, fmi2String)

/* What the description says that this FMU has not. */
#define REFUSED(name, why, ...) \
    FUNCTION(name)(__VA_ARGS__) { return refuse_because(c, why); }
REFUSED(fmi2CancelStep, "no step is under way", fmi2Component c)
REFUSED(fmi2SetRealInputDerivatives, "a command holds for a whole communication step", REFERENCES,
        const fmi2Integer order[], const fmi2Real values[])
REFUSED(fmi2GetRealOutputDerivatives, "derivatives of outputs are not known", REFERENCES,
        const fmi2Integer order[], fmi2Real values[])
REFUSED(fmi2GetDirectionalDerivative, "derivatives are not known", fmi2Component c, const fmi2ValueReference of[],
        size_t n_of, const fmi2ValueReference to[], size_t n_to, const fmi2Real change[], fmi2Real derivative[])
