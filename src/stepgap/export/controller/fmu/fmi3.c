/* FMI 3.0 for Co-Simulation: a communication step is a step of the robot. */
#include "instance.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum { ok, warning, discard, error, fatal } status;
typedef uint32_t reference;

#define NOT_SUPPORTED(name, ...) EXPORTED status name(__VA_ARGS__) { return error; }
/* The standard wants access to variables of every type; this unit has three. */
#define NO_GET(name, type) NOT_SUPPORTED(name, void *c, const reference vr[], size_t count, type value[], size_t values)
#define NO_SET(name, type) NO_GET(name, const type)

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
    return values == count && get_reals(c, vr, count, value) ? ok : error;
}

EXPORTED status fmi3SetFloat64(void *c, const reference vr[], size_t count, const double value[], size_t values)
{
    return values == count && set_reals(c, vr, count, value) ? ok : error;
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

NO_GET(fmi3GetFloat32, float)
NO_GET(fmi3GetInt8, int8_t)
NO_GET(fmi3GetUInt8, uint8_t)
NO_GET(fmi3GetInt16, int16_t)
NO_GET(fmi3GetUInt16, uint16_t)
NO_GET(fmi3GetUInt32, uint32_t)
NO_GET(fmi3GetInt64, int64_t)
NO_GET(fmi3GetUInt64, uint64_t)
NO_GET(fmi3GetString, const char *)
NO_SET(fmi3SetFloat32, float)
NO_SET(fmi3SetInt8, int8_t)
NO_SET(fmi3SetUInt8, uint8_t)
NO_SET(fmi3SetInt16, int16_t)
NO_SET(fmi3SetUInt16, uint16_t)
NO_SET(fmi3SetInt32, int32_t)
NO_SET(fmi3SetUInt32, uint32_t)
NO_SET(fmi3SetInt64, int64_t)
NO_SET(fmi3SetUInt64, uint64_t)
NO_SET(fmi3SetString, char *const)
NOT_SUPPORTED(fmi3GetBinary, void *c, const reference vr[], size_t count, size_t sizes[], const uint8_t *value[], size_t values)
NOT_SUPPORTED(fmi3SetBinary, void *c, const reference vr[], size_t count, const size_t sizes[], const uint8_t *const value[],
              size_t values)
NOT_SUPPORTED(fmi3GetClock, void *c, const reference vr[], size_t count, bool value[])
NOT_SUPPORTED(fmi3SetClock, void *c, const reference vr[], size_t count, const bool value[])
NOT_SUPPORTED(fmi3GetNumberOfVariableDependencies, void *c, reference vr, size_t *count)
NOT_SUPPORTED(fmi3GetVariableDependencies, void *c, reference vr, size_t elements[], reference independents[],
              size_t others[], int kinds[], size_t count)
NOT_SUPPORTED(fmi3GetDirectionalDerivative, void *c, const reference unknown[], size_t unknowns, const reference known[],
              size_t knowns, const double seed[], size_t seeds, double value[], size_t values)
NOT_SUPPORTED(fmi3GetAdjointDerivative, void *c, const reference unknown[], size_t unknowns, const reference known[],
              size_t knowns, const double seed[], size_t seeds, double value[], size_t values)
NOT_SUPPORTED(fmi3EnterConfigurationMode, void *c)
NOT_SUPPORTED(fmi3ExitConfigurationMode, void *c)
NOT_SUPPORTED(fmi3GetIntervalDecimal, void *c, const reference vr[], size_t count, double value[], int qualifiers[])
NOT_SUPPORTED(fmi3GetIntervalFraction, void *c, const reference vr[], size_t count, uint64_t counters[],
              uint64_t resolutions[], int qualifiers[])
NOT_SUPPORTED(fmi3GetShiftDecimal, void *c, const reference vr[], size_t count, double value[])
NOT_SUPPORTED(fmi3GetShiftFraction, void *c, const reference vr[], size_t count, uint64_t counters[], uint64_t resolutions[])
NOT_SUPPORTED(fmi3SetIntervalDecimal, void *c, const reference vr[], size_t count, const double value[])
NOT_SUPPORTED(fmi3SetIntervalFraction, void *c, const reference vr[], size_t count, const uint64_t counters[],
              const uint64_t resolutions[])
NOT_SUPPORTED(fmi3SetShiftDecimal, void *c, const reference vr[], size_t count, const double value[])
NOT_SUPPORTED(fmi3SetShiftFraction, void *c, const reference vr[], size_t count, const uint64_t counters[],
              const uint64_t resolutions[])
NOT_SUPPORTED(fmi3EnterEventMode, void *c)
NOT_SUPPORTED(fmi3EvaluateDiscreteStates, void *c)
NOT_SUPPORTED(fmi3UpdateDiscreteStates, void *c, bool *needed, bool *terminate, bool *nominals, bool *changed, bool *defined,
              double *next)
NOT_SUPPORTED(fmi3EnterContinuousTimeMode, void *c)
NOT_SUPPORTED(fmi3CompletedIntegratorStep, void *c, bool no_return, bool *enter, bool *terminate)
NOT_SUPPORTED(fmi3SetTime, void *c, double time)
NOT_SUPPORTED(fmi3SetContinuousStates, void *c, const double value[], size_t count)
NOT_SUPPORTED(fmi3GetContinuousStateDerivatives, void *c, double value[], size_t count)
NOT_SUPPORTED(fmi3GetEventIndicators, void *c, double value[], size_t count)
NOT_SUPPORTED(fmi3GetContinuousStates, void *c, double value[], size_t count)
NOT_SUPPORTED(fmi3GetNominalsOfContinuousStates, void *c, double value[], size_t count)
NOT_SUPPORTED(fmi3GetNumberOfEventIndicators, void *c, size_t *count)
NOT_SUPPORTED(fmi3GetNumberOfContinuousStates, void *c, size_t *count)
NOT_SUPPORTED(fmi3GetOutputDerivatives, void *c, const reference vr[], size_t count, const int32_t orders[], double value[],
              size_t values)
NOT_SUPPORTED(fmi3ActivateModelPartition, void *c, reference clock, double time)
