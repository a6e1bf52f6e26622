/* FMI 3.0 for Co-Simulation: a communication step is a step of the robot.

   model.h defines STATES, COMMANDS, TOKEN, STATE_CENTRE and COMMAND_CENTRE, and includes the exported controller with
   the prefix "controller". Variables are numbered: state, target, phase, command, predicted, std, all real, then the
   four below. An instance is plain memory, so that its state is copied as bytes. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#define TARGET STATES
#define PHASE (2 * STATES)
#define COMMAND (PHASE + 1)
#define PREDICTED (COMMAND + COMMANDS)
#define STD (PREDICTED + STATES)
#define REALS (STD + STATES)
#define RESULT REALS             /* integer: what controller_plan returned */
#define COMPLETED (REALS + 1)    /* boolean: the last command was executed, and its step ended in the present state */
#define PHASE_KNOWN (REALS + 2)  /* boolean: the phase is measured */
#define TIME (REALS + 3)

#define UNKNOWN_PHASE 1e30 /* not NaN, which this file could not pass on where it is compiled with -ffast-math */

#define EXPORTED __attribute__((visibility("default")))

typedef uint32_t reference;

typedef struct {
    double reals[REALS];
    int result, completed, phase_known, planned;
    double last_state[STATES], last_phase, time;
    controller_filter filter;
} instance;

static void start(instance *it)
{
    static const double centre[COMMANDS] = COMMAND_CENTRE, state[STATES] = STATE_CENTRE;
    memset(it, 0, sizeof *it);
    memcpy(it->reals, state, sizeof state);
    memcpy(it->reals + TARGET, state, sizeof state);
    memcpy(it->reals + COMMAND, centre, sizeof centre);
    it->completed = 1;
    controller_filter_init(&it->filter);
}

static instance *new_instance(const char *token)
{
    instance *it = token && !strcmp(token, TOKEN) ? malloc(sizeof *it) : NULL;
    if (it) start(it);
    return it;
}

/* One step of the robot: the filter learns from the step that has ended, then the next one is planned. */
static void plan_step(instance *it)
{
    double guess[COMMANDS], *r = it->reals, phase = it->phase_known ? r[PHASE] : UNKNOWN_PHASE;
    memcpy(guess, r + COMMAND, sizeof guess);
    if (it->planned && it->completed)
        controller_filter_update(&it->filter, it->last_state, guess, r, it->last_phase);
    const double *before = it->planned ? guess : NULL;
    it->result = controller_plan(&it->filter, r, r + TARGET, before, phase, r + COMMAND, r + PREDICTED, r + STD);
    if (it->result) memset(r + PREDICTED, 0, 2 * STATES * sizeof *r); /* there is no prediction */
    memcpy(it->last_state, r, sizeof it->last_state);
    it->last_phase = phase;
    it->planned = 1;
}

static int *flag_of(instance *it, reference vr)
{
    if (vr == COMPLETED) return &it->completed;
    return vr == PHASE_KNOWN ? &it->phase_known : NULL;
}

/* Bytes of the state of an instance; 0 if there is no memory. */
static int copy_state(const instance *it, void **state)
{
    if (!*state) *state = malloc(sizeof *it);
    if (*state) memcpy(*state, it, sizeof *it);
    return *state != NULL;
}

typedef enum { ok, warning, discard, error, fatal } status;

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool events, bool early, const reference needed[], size_t count, void *environment, void (*log)(void),
    void (*intermediate)(void))
{
    (void)name; (void)resources; (void)visible; (void)logging; (void)early; (void)needed; (void)environment;
    (void)log; (void)intermediate;
    return events || count ? NULL : new_instance(token);
}

EXPORTED void *fmi3InstantiateModelExchange(void) { return NULL; }
EXPORTED void *fmi3InstantiateScheduledExecution(void) { return NULL; }
EXPORTED void fmi3FreeInstance(void *c) { free(c); }
EXPORTED status fmi3SetDebugLogging(void *c, bool on, size_t count, const char *const categories[])
{
    (void)c; (void)on; (void)count; (void)categories;
    return ok;
}

EXPORTED status fmi3EnterInitializationMode(void *c, bool has_tolerance, double tolerance, double begin, bool has_end,
                                            double end)
{
    (void)has_tolerance; (void)tolerance; (void)has_end; (void)end;
    ((instance *)c)->time = begin;
    return ok;
}

EXPORTED status fmi3ExitInitializationMode(void *c) { return c ? ok : error; }
EXPORTED status fmi3EnterStepMode(void *c) { return c ? ok : error; }
EXPORTED status fmi3Terminate(void *c) { return c ? ok : error; }
EXPORTED status fmi3Reset(void *c) { start(c); return ok; }

EXPORTED status fmi3GetFloat64(void *c, const reference vr[], size_t count, double value[], size_t values)
{
    const instance *it = c;
    for (size_t i = 0; i < count; i++) {
        if (values != count || (vr[i] >= REALS && vr[i] != TIME)) return error;
        value[i] = vr[i] == TIME ? it->time : it->reals[vr[i]];
    }
    return ok;
}

EXPORTED status fmi3SetFloat64(void *c, const reference vr[], size_t count, const double value[], size_t values)
{
    for (size_t i = 0; i < count; i++) {
        if (values != count || vr[i] >= COMMAND) return error; /* only inputs are set */
        ((instance *)c)->reals[vr[i]] = value[i];
    }
    return ok;
}

EXPORTED status fmi3GetInt32(void *c, const reference vr[], size_t count, int32_t value[], size_t values)
{
    for (size_t i = 0; i < count; i++) {
        if (values != count || vr[i] != RESULT) return error;
        value[i] = ((instance *)c)->result;
    }
    return ok;
}

EXPORTED status fmi3GetBoolean(void *c, const reference vr[], size_t count, bool value[], size_t values)
{
    for (size_t i = 0; i < count; i++) {
        if (values != count || !flag_of(c, vr[i])) return error;
        value[i] = *flag_of(c, vr[i]) != 0;
    }
    return ok;
}

EXPORTED status fmi3SetBoolean(void *c, const reference vr[], size_t count, const bool value[], size_t values)
{
    for (size_t i = 0; i < count; i++) {
        if (values != count || !flag_of(c, vr[i])) return error;
        *flag_of(c, vr[i]) = value[i];
    }
    return ok;
}

EXPORTED status fmi3DoStep(void *c, double now, double size, bool no_return, bool *event, bool *terminate, bool *early,
                           double *reached)
{
    (void)no_return;
    plan_step(c);
    *event = *terminate = *early = false;
    *reached = ((instance *)c)->time = now + size;
    return ok;
}

EXPORTED status fmi3GetFMUState(void *c, void **state) { return copy_state(c, state) ? ok : error; }
EXPORTED status fmi3SetFMUState(void *c, void *state) { memcpy(c, state, sizeof(instance)); return ok; }
EXPORTED status fmi3FreeFMUState(void *c, void **state) { (void)c; free(*state); *state = NULL; return ok; }
EXPORTED status fmi3SerializedFMUStateSize(void *c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(instance);
    return ok;
}

EXPORTED status fmi3SerializeFMUState(void *c, void *state, uint8_t bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(instance)) return error;
    memcpy(bytes, state, sizeof(instance));
    return ok;
}

EXPORTED status fmi3DeserializeFMUState(void *c, const uint8_t bytes[], size_t size, void **state)
{
    (void)c;
    if (size != sizeof(instance) || !copy_state((const instance *)(const void *)bytes, state)) return error;
    return ok;
}

/* Functions that the standard wants, and that this unit does not support: it has no such variables, clocks, events and
   continuous states. They read no argument, and the caller removes the arguments. */
#define NOT_SUPPORTED(name) EXPORTED status fmi3##name(void) { return error; }
NOT_SUPPORTED(GetFloat32)
NOT_SUPPORTED(GetInt8)
NOT_SUPPORTED(GetUInt8)
NOT_SUPPORTED(GetInt16)
NOT_SUPPORTED(GetUInt16)
NOT_SUPPORTED(GetUInt32)
NOT_SUPPORTED(GetInt64)
NOT_SUPPORTED(GetUInt64)
NOT_SUPPORTED(GetString)
NOT_SUPPORTED(SetFloat32)
NOT_SUPPORTED(SetInt8)
NOT_SUPPORTED(SetUInt8)
NOT_SUPPORTED(SetInt16)
NOT_SUPPORTED(SetUInt16)
NOT_SUPPORTED(SetInt32)
NOT_SUPPORTED(SetUInt32)
NOT_SUPPORTED(SetInt64)
NOT_SUPPORTED(SetUInt64)
NOT_SUPPORTED(SetString)
NOT_SUPPORTED(GetBinary)
NOT_SUPPORTED(SetBinary)
NOT_SUPPORTED(GetClock)
NOT_SUPPORTED(SetClock)
NOT_SUPPORTED(GetNumberOfVariableDependencies)
NOT_SUPPORTED(GetVariableDependencies)
NOT_SUPPORTED(GetDirectionalDerivative)
NOT_SUPPORTED(GetAdjointDerivative)
NOT_SUPPORTED(EnterConfigurationMode)
NOT_SUPPORTED(ExitConfigurationMode)
NOT_SUPPORTED(GetIntervalDecimal)
NOT_SUPPORTED(GetIntervalFraction)
NOT_SUPPORTED(GetShiftDecimal)
NOT_SUPPORTED(GetShiftFraction)
NOT_SUPPORTED(SetIntervalDecimal)
NOT_SUPPORTED(SetIntervalFraction)
NOT_SUPPORTED(SetShiftDecimal)
NOT_SUPPORTED(SetShiftFraction)
NOT_SUPPORTED(EnterEventMode)
NOT_SUPPORTED(EvaluateDiscreteStates)
NOT_SUPPORTED(UpdateDiscreteStates)
NOT_SUPPORTED(EnterContinuousTimeMode)
NOT_SUPPORTED(CompletedIntegratorStep)
NOT_SUPPORTED(SetTime)
NOT_SUPPORTED(SetContinuousStates)
NOT_SUPPORTED(GetContinuousStateDerivatives)
NOT_SUPPORTED(GetEventIndicators)
NOT_SUPPORTED(GetContinuousStates)
NOT_SUPPORTED(GetNominalsOfContinuousStates)
NOT_SUPPORTED(GetNumberOfEventIndicators)
NOT_SUPPORTED(GetNumberOfContinuousStates)
NOT_SUPPORTED(GetOutputDerivatives)
NOT_SUPPORTED(ActivateModelPartition)
