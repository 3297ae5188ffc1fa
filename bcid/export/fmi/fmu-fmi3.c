/* The vehicle as a co-simulation FMU of the Functional Mock-up Interface 3.0. */
#include "fmi3-interface.h"
#include "fmu-vehicle.h"

typedef struct {
    Vehicle vehicle;
    char message[MESSAGE_SIZE];
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

/* Logs the instance's message as an error. */
static fmi3Status refuse(const Instance *i)
{
    if (i->log != NULL) i->log(i->environment, fmi3Error, "logStatusError", i->message);
    return fmi3Error;
}

static fmi3Status refuse_because(Instance *i, const char *why)
{
    snprintf(i->message, MESSAGE_SIZE, "%s", why);
    return refuse(i);
}

static fmi3Status answer(const Instance *i, int done) { return done ? fmi3OK : refuse(i); }

FMI3_Export const char *FMI(fmi3GetVersion)(void) { return "3.0"; }

/* There are messages of errors alone, which are always told. */
FUNCTION(fmi3SetDebugLogging)(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    return fmi3OK;
}

FMI3_Export fmi3Instance FMI(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean event_mode, fmi3Boolean early_return, const fmi3ValueReference intermediate[], size_t n_intermediate,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    Instance *i = calloc(1, sizeof *i);
    if (i == NULL) return NULL;
    reset_vehicle(&i->vehicle);
    i->environment = environment;
    i->log = log;
    if (token != NULL && strcmp(token, Model_TOKEN) == 0 && !event_mode) return i;
    refuse_because(i, event_mode ? "this FMU has no event mode" : "the instantiation token is not that of this FMU");
    free(i);
    return NULL;
}

FMI3_Export fmi3Instance FMI(fmi3InstantiateModelExchange)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    return NULL;
}

FMI3_Export fmi3Instance FMI(fmi3InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

FMI3_Export void FMI(fmi3FreeInstance)(fmi3Instance c) { free(c); }

FUNCTION(fmi3EnterInitializationMode)(fmi3Instance c, fmi3Boolean tolerance_is_known, fmi3Float64 tolerance,
                                      fmi3Float64 start_s, fmi3Boolean stop_is_known, fmi3Float64 stop_s)
{
    Instance *i = c;
    if (!change_mode(&i->vehicle, INSTANTIATED, INITIALIZING, i->message)) return refuse(i);
    set_times(&i->vehicle, start_s, stop_is_known, stop_s);
    return fmi3OK;
}

FUNCTION(fmi3ExitInitializationMode)(fmi3Instance c)
{
    Instance *i = c;
    return answer(i, change_mode(&i->vehicle, INITIALIZING, STEPPING, i->message));
}

FUNCTION(fmi3Terminate)(fmi3Instance c)
{
    Instance *i = c;
    return answer(i, change_mode(&i->vehicle, STEPPING, TERMINATED, i->message));
}

FUNCTION(fmi3Reset)(fmi3Instance c)
{
    reset_vehicle(&((Instance *)c)->vehicle);
    return fmi3OK;
}

FUNCTION(fmi3GetFloat64)(fmi3Instance c, const fmi3ValueReference at[], size_t n, fmi3Float64 values[], size_t n_values)
{
    Instance *i = c;
    if (n_values != n) return refuse_because(i, "every variable has one value");
    return answer(i, get_values(&i->vehicle, at, n, values, i->message));
}

FUNCTION(fmi3SetFloat64)(fmi3Instance c, const fmi3ValueReference at[], size_t n, const fmi3Float64 values[],
                         size_t n_values)
{
    Instance *i = c;
    if (n_values != n) return refuse_because(i, "every variable has one value");
    return answer(i, set_values(&i->vehicle, at, n, values, i->message));
}

FUNCTION(fmi3DoStep)(fmi3Instance c, fmi3Float64 now_s, fmi3Float64 step_s, fmi3Boolean never_back,
                     fmi3Boolean *needs_event, fmi3Boolean *terminate, fmi3Boolean *returns_early, fmi3Float64 *time_s)
{
    Instance *i = c;
    const int done = advance(&i->vehicle, now_s, step_s, i->message);
    *needs_event = *terminate = *returns_early = false;
    *time_s = i->vehicle.value[TIME];
    return answer(i, done);
}

FUNCTION(fmi3GetFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    Instance *i = c;
    return answer(i, keep_state(&i->vehicle, state, i->message));
}

FUNCTION(fmi3SetFMUState)(fmi3Instance c, fmi3FMUState state)
{
    memcpy(&((Instance *)c)->vehicle, state, sizeof(Vehicle));
    return fmi3OK;
}

FUNCTION(fmi3FreeFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FUNCTION(fmi3SerializedFMUStateSize)(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    *size = sizeof(Vehicle);
    return fmi3OK;
}

FUNCTION(fmi3SerializeFMUState)(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    Instance *i = c;
    return answer(i, serialize_state(state, bytes, size, i->message));
}

FUNCTION(fmi3DeserializeFMUState)(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    Instance *i = c;
    return answer(i, keep_serialized(bytes, size, state, i->message));
}

/* Variables of other types, of which there are none. */
static fmi3Status none_of(fmi3Instance c, size_t n)
{
    return n == 0 ? fmi3OK : refuse_because(c, "all variables are Float64");
}

#define REFERENCES fmi3Instance c, const fmi3ValueReference at[], size_t n
#define OTHER_TYPE(type) \
    FUNCTION(fmi3Get##type)(REFERENCES, fmi3##type values[], size_t n_values) { return none_of(c, n); } \
    FUNCTION(fmi3Set##type)(REFERENCES, const fmi3##type values[], size_t n_values) { return none_of(c, n); }
OTHER_TYPE(Float32)
OTHER_TYPE(Int8)
OTHER_TYPE(UInt8)
OTHER_TYPE(Int16)
OTHER_TYPE(UInt16)
OTHER_TYPE(Int32)
OTHER_TYPE(UInt32)
OTHER_TYPE(Int64)
OTHER_TYPE(UInt64)
OTHER_TYPE(Boolean)
OTHER_TYPE(String)

#define OTHER_FUNCTION(name, ...) \
    FUNCTION(name)(REFERENCES, __VA_ARGS__) { return none_of(c, n); }
OTHER_FUNCTION(fmi3GetBinary, size_t sizes[], fmi3Binary values[], size_t n_values)
OTHER_FUNCTION(fmi3SetBinary, const size_t sizes[], const fmi3Binary values[], size_t n_values)
OTHER_FUNCTION(fmi3GetClock, fmi3Clock values[])
OTHER_FUNCTION(fmi3SetClock, const fmi3Clock values[])
OTHER_FUNCTION(fmi3GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
OTHER_FUNCTION(fmi3SetIntervalDecimal, const fmi3Float64 intervals[])
OTHER_FUNCTION(fmi3GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 per[], fmi3IntervalQualifier qualifiers[])
OTHER_FUNCTION(fmi3SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 per[])
OTHER_FUNCTION(fmi3GetShiftDecimal, fmi3Float64 shifts[])
OTHER_FUNCTION(fmi3SetShiftDecimal, const fmi3Float64 shifts[])
OTHER_FUNCTION(fmi3GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 per[])
OTHER_FUNCTION(fmi3SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 per[])

/* What the description says that this FMU has not. */
#define REFUSED(name, why, ...) \
    FUNCTION(name)(__VA_ARGS__) { return refuse_because(c, why); }
#define DERIVATIVE_ARGUMENTS \
    fmi3Instance c, const fmi3ValueReference of[], size_t n_of, const fmi3ValueReference to[], size_t n_to, \
        const fmi3Float64 seed[], size_t n_seed, fmi3Float64 derivative[], size_t n_derivative
REFUSED(fmi3GetDirectionalDerivative, "derivatives are not known", DERIVATIVE_ARGUMENTS)
REFUSED(fmi3GetAdjointDerivative, "derivatives are not known", DERIVATIVE_ARGUMENTS)
REFUSED(fmi3GetOutputDerivatives, "derivatives of outputs are not known", REFERENCES, const fmi3Int32 orders[],
        fmi3Float64 values[], size_t n_values)
REFUSED(fmi3GetNumberOfVariableDependencies, "dependencies are those of the description", fmi3Instance c,
        fmi3ValueReference at, size_t *n)
REFUSED(fmi3GetVariableDependencies, "dependencies are those of the description", fmi3Instance c,
        fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
        size_t elements_of_independents[], fmi3DependencyKind kinds[], size_t n)
REFUSED(fmi3EnterEventMode, "this FMU has no event mode", fmi3Instance c)
REFUSED(fmi3EnterStepMode, "this FMU has no event mode", fmi3Instance c)
REFUSED(fmi3EvaluateDiscreteStates, "this FMU has no event mode", fmi3Instance c)
REFUSED(fmi3UpdateDiscreteStates, "this FMU has no event mode", fmi3Instance c, fmi3Boolean *needs_update,
        fmi3Boolean *terminate, fmi3Boolean *nominals_changed, fmi3Boolean *values_changed, fmi3Boolean *event_is_known,
        fmi3Float64 *event_s)
REFUSED(fmi3EnterConfigurationMode, "this FMU has no structural parameters", fmi3Instance c)
REFUSED(fmi3ExitConfigurationMode, "this FMU has no structural parameters", fmi3Instance c)

/* Of the other types of FMUs, which importers look for in every one of them. */
#define OF_OTHERS(name, ...) REFUSED(name, "this FMU is for co-simulation", fmi3Instance c, __VA_ARGS__)
REFUSED(fmi3EnterContinuousTimeMode, "this FMU is for co-simulation", fmi3Instance c)
OF_OTHERS(fmi3CompletedIntegratorStep, fmi3Boolean never_back, fmi3Boolean *enter_event, fmi3Boolean *terminate)
OF_OTHERS(fmi3SetTime, fmi3Float64 time_s)
OF_OTHERS(fmi3SetContinuousStates, const fmi3Float64 x[], size_t n)
OF_OTHERS(fmi3GetContinuousStates, fmi3Float64 x[], size_t n)
OF_OTHERS(fmi3GetContinuousStateDerivatives, fmi3Float64 x_dot[], size_t n)
OF_OTHERS(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominal[], size_t n)
OF_OTHERS(fmi3GetNumberOfContinuousStates, size_t *n)
OF_OTHERS(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
OF_OTHERS(fmi3GetNumberOfEventIndicators, size_t *n)
OF_OTHERS(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time_s)
