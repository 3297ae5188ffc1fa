/* One vehicle of a co-simulation, whatever the version of the interface: its values, its steps, its saved states.
 *
 * The model and its sizes are those of fmu-model.h.  Values lie in one array, and where each lies is its value
 * reference: the time, then inputs, outputs, parameters and states.
 */
#ifndef FmuVehicle_h
#define FmuVehicle_h

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu-model.h"

enum {
    TIME = 0,                 /* s */
    INPUTS = 1,               /* the command, which holds for a whole communication step */
    POSE = 3, TWIST = 6,      /* the outputs, of the point that the description names */
    PARAMETERS = 9,           /* pose, twist and steering angle at the start */
    STEERING = 15,
    STATES = 16,              /* of the model */
    VALUES = STATES + Model_STATES
};

enum { MESSAGE_SIZE = 200 };

/* Share of a period by which times may be off a whole number of them: far more than they are rounded by. */
#define ROUNDING 1e-3

typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } Mode;

/* No pointer is in it, so that a copy of its bytes is a saved state; the token tells of which model. */
typedef struct {
    char token[sizeof Model_TOKEN];
    Mode mode;
    double start_s, stop_s;
    double periods; /* whole ones since the start: times are made of them, and do not add up errors */
    double value[VALUES];
} Vehicle;

/* The vehicle as it is instantiated: at rest at the origin, without commands. */
static void reset_vehicle(Vehicle *v)
{
    memset(v, 0, sizeof *v);
    strcpy(v->token, Model_TOKEN);
    v->stop_s = HUGE_VAL;
}

/* Pose, twist and state as they follow from the parameters. */
static void place_at_start(Vehicle *v)
{
    const double *start = v->value + PARAMETERS;
    memcpy(v->value + POSE, start, (STEERING - PARAMETERS) * sizeof *start);
    Model_init(start, start + 3, v->value[STEERING], v->value + STATES);
    v->periods = 0.0;
    v->value[TIME] = v->start_s;
}

/* Changes the mode; 0 with a message where it is another one than `from`. */
static int change_mode(Vehicle *v, Mode from, Mode to, char message[MESSAGE_SIZE])
{
    static const char *const names[] = {"instantiated", "in initialization", "stepping", "terminated"};
    if (v->mode != from) {
        snprintf(message, MESSAGE_SIZE, "this can be called while the vehicle is %s, and it is %s", names[from],
                 names[v->mode]);
        return 0;
    }
    v->mode = to;
    return 1;
}

/* Sets when the simulation begins and ends (s). */
static void set_times(Vehicle *v, double start_s, int stop_is_known, double stop_s)
{
    v->start_s = start_s;
    v->stop_s = stop_is_known ? stop_s : HUGE_VAL;
    place_at_start(v);
}

/* Reads values by their references; 0 with a message where there is no such value. */
static int get_values(const Vehicle *v, const unsigned int at[], size_t n, double values[], char message[MESSAGE_SIZE])
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (at[i] >= VALUES) {
            snprintf(message, MESSAGE_SIZE, "there is no variable with the value reference %u", at[i]);
            return 0;
        }
        values[i] = v->value[at[i]];
    }
    return 1;
}

/* Sets inputs, and until initialization ends parameters; 0 with a message, and nothing set, for any other value. */
static int set_values(Vehicle *v, const unsigned int at[], size_t n, const double values[], char message[MESSAGE_SIZE])
{
    const int starts = v->mode == INSTANTIATED || v->mode == INITIALIZING;
    size_t i;
    for (i = 0; i < n; ++i) {
        const int is_input = at[i] >= INPUTS && at[i] < POSE, is_parameter = at[i] >= PARAMETERS && at[i] < STATES;
        if (!is_input && !(is_parameter && starts)) {
            snprintf(message, MESSAGE_SIZE, "the variable with the value reference %u cannot be set%s", at[i],
                     is_parameter ? " after initialization" : ": it is no input and no parameter");
            return 0;
        }
        if (!isfinite(values[i])) {
            snprintf(message, MESSAGE_SIZE, "the variable with the value reference %u cannot be %g", at[i], values[i]);
            return 0;
        }
    }
    for (i = 0; i < n; ++i) v->value[at[i]] = values[i];
    if (starts) place_at_start(v);
    return 1;
}

/* Whether pose and twist are finite. */
static int is_finite(const Vehicle *v)
{
    int i;
    for (i = POSE; i < PARAMETERS; ++i) {
        if (!isfinite(v->value[i])) return 0;
    }
    return 1;
}

/* One period of the model. */
static void advance_period(Vehicle *v)
{
    double twist[3], *value = v->value;
    Model_step(value + STATES, value + INPUTS, value + STATES, twist);
    Model_pose(value + POSE, value + TWIST, twist, value + POSE);
    memcpy(value + TWIST, twist, sizeof twist);
    v->periods += 1.0;
    v->value[TIME] = v->start_s + v->periods * Model_PERIOD_S;
}

/* A communication step from `now_s` (s) that lasts `step_s` (s), a whole number of periods; 0 with a message, and the
 * vehicle as it was, where it cannot be made. */
static int advance(Vehicle *v, double now_s, double step_s, char message[MESSAGE_SIZE])
{
    const Vehicle before = *v;
    const double begin = (now_s - v->start_s) / Model_PERIOD_S, end = (now_s + step_s - v->start_s) / Model_PERIOD_S;
    const double last = floor(end + 0.5);
    if (!change_mode(v, STEPPING, STEPPING, message)) return 0;
    if (!(fabs(begin - v->periods) <= ROUNDING)) {
        snprintf(message, MESSAGE_SIZE, "the communication point is %.12g s, where the vehicle is at %.12g s", now_s,
                 v->value[TIME]);
        return 0;
    }
    if (!(fabs(end - last) <= ROUNDING) || last <= v->periods) {
        snprintf(message, MESSAGE_SIZE,
                 "a communication step lasts a whole number of periods of %.12g s, and this one would last %.12g s",
                 Model_PERIOD_S, step_s);
        return 0;
    }
    if (now_s + step_s > v->stop_s + ROUNDING * Model_PERIOD_S) {
        snprintf(message, MESSAGE_SIZE, "the communication step ends at %.12g s, after the stop time of %.12g s",
                 now_s + step_s, v->stop_s);
        return 0;
    }
    while (v->periods < last) {
        advance_period(v);
        if (!is_finite(v)) {
            snprintf(message, MESSAGE_SIZE, "the model leaves the finite numbers at %.12g s", v->value[TIME]);
            *v = before;
            return 0;
        }
    }
    return 1;
}

/* Copies the vehicle into `*state`, which is allocated where it is NULL; 0 with a message without memory for it. */
static int keep_state(const Vehicle *v, void **state, char message[MESSAGE_SIZE])
{
    if (*state == NULL) *state = malloc(sizeof *v);
    if (*state == NULL) {
        snprintf(message, MESSAGE_SIZE, "there is no memory for a state of the vehicle");
        return 0;
    }
    memcpy(*state, v, sizeof *v);
    return 1;
}

/* Copies a kept state into the `size` bytes of `serialized`; 0 with a message where these are not as many as it has. */
static int serialize_state(const void *state, void *serialized, size_t size, char message[MESSAGE_SIZE])
{
    if (size != sizeof(Vehicle)) {
        snprintf(message, MESSAGE_SIZE, "a serialized state has %u bytes", (unsigned int)sizeof(Vehicle));
        return 0;
    }
    memcpy(serialized, state, size);
    return 1;
}

/* Keeps the state that was serialized; 0 with a message where it is none of this model. */
static int keep_serialized(const void *serialized, size_t size, void **state, char message[MESSAGE_SIZE])
{
    Vehicle v;
    if (!serialize_state(serialized, &v, size, message)) return 0;
    if (memcmp(v.token, Model_TOKEN, sizeof v.token) != 0) {
        snprintf(message, MESSAGE_SIZE, "the serialized state is of another model or another computer");
        return 0;
    }
    return keep_state(&v, state, message);
}

#endif
