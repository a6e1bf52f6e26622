/* FMI 2.0 for Co-Simulation: a communication step is a step of the robot. */
#include "instance.h"

typedef enum { ok, warning, discard, error, fatal, pending } status;
typedef struct {
    void (*logger)(void *, const char *, status, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, status);
    void *environment;
} callbacks;

#define NOT_SUPPORTED(name, ...) EXPORTED status name(__VA_ARGS__) { return error; }

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                               const callbacks *functions, int visible, int logging)
{
    (void)name; (void)resources; (void)functions; (void)visible; (void)logging;
    return type == 1 ? new_instance(token) : NULL;
}

EXPORTED void fmi2FreeInstance(void *c) { free(c); }
EXPORTED status fmi2SetDebugLogging(void *c, int on, size_t count, const char *const categories[])
{
    (void)c; (void)on; (void)count; (void)categories;
    return ok;
}

EXPORTED status fmi2SetupExperiment(void *c, int has_tolerance, double tolerance, double begin, int has_end, double end)
{
    (void)has_tolerance; (void)tolerance; (void)has_end; (void)end;
    ((instance *)c)->time = begin;
    return ok;
}

EXPORTED status fmi2EnterInitializationMode(void *c) { return c ? ok : error; }
EXPORTED status fmi2ExitInitializationMode(void *c) { return c ? ok : error; }
EXPORTED status fmi2Terminate(void *c) { return c ? ok : error; }
EXPORTED status fmi2Reset(void *c) { start(c); return ok; }

EXPORTED status fmi2GetReal(void *c, const unsigned vr[], size_t count, double value[])
{
    return get_reals(c, vr, count, value) ? ok : error;
}

EXPORTED status fmi2SetReal(void *c, const unsigned vr[], size_t count, const double value[])
{
    return set_reals(c, vr, count, value) ? ok : error;
}

EXPORTED status fmi2GetInteger(void *c, const unsigned vr[], size_t count, int value[])
{
    for (size_t i = 0; i < count; i++) {
        if (vr[i] != RESULT) return error;
        value[i] = ((instance *)c)->result;
    }
    return ok;
}

EXPORTED status fmi2GetBoolean(void *c, const unsigned vr[], size_t count, int value[])
{
    for (size_t i = 0; i < count; i++) {
        if (!flag_of(c, vr[i])) return error;
        value[i] = *flag_of(c, vr[i]);
    }
    return ok;
}

EXPORTED status fmi2SetBoolean(void *c, const unsigned vr[], size_t count, const int value[])
{
    for (size_t i = 0; i < count; i++) {
        if (!flag_of(c, vr[i])) return error;
        *flag_of(c, vr[i]) = value[i] != 0;
    }
    return ok;
}

EXPORTED status fmi2DoStep(void *c, double now, double size, int no_return)
{
    (void)no_return;
    plan_step(c);
    ((instance *)c)->time = now + size;
    return ok;
}

EXPORTED status fmi2GetFMUstate(void *c, void **state) { return copy_state(c, state) ? ok : error; }
EXPORTED status fmi2SetFMUstate(void *c, void *state) { memcpy(c, state, sizeof(instance)); return ok; }
EXPORTED status fmi2FreeFMUstate(void *c, void **state) { (void)c; free(*state); *state = NULL; return ok; }
EXPORTED status fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(instance);
    return ok;
}

EXPORTED status fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(instance)) return error;
    memcpy(bytes, state, sizeof(instance));
    return ok;
}

EXPORTED status fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    (void)c;
    if (size != sizeof(instance) || !copy_state((const instance *)(const void *)bytes, state)) return error;
    return ok;
}

EXPORTED status fmi2GetRealStatus(void *c, int kind, double *value)
{
    *value = ((instance *)c)->time;
    return kind == 2 ? ok : discard;
}

EXPORTED status fmi2GetBooleanStatus(void *c, int kind, int *value) { (void)c; *value = 0; return kind == 3 ? ok : discard; }

NOT_SUPPORTED(fmi2GetString, void *c, const unsigned vr[], size_t count, const char *value[])
NOT_SUPPORTED(fmi2SetString, void *c, const unsigned vr[], size_t count, const char *const value[])
NOT_SUPPORTED(fmi2SetInteger, void *c, const unsigned vr[], size_t count, const int value[])
NOT_SUPPORTED(fmi2GetDirectionalDerivative, void *c, const unsigned unknown[], size_t unknowns, const unsigned known[],
              size_t knowns, const double seed[], double value[])
NOT_SUPPORTED(fmi2SetRealInputDerivatives, void *c, const unsigned vr[], size_t count, const int order[], const double value[])
NOT_SUPPORTED(fmi2GetRealOutputDerivatives, void *c, const unsigned vr[], size_t count, const int order[], double value[])
NOT_SUPPORTED(fmi2CancelStep, void *c)
NOT_SUPPORTED(fmi2GetStatus, void *c, int kind, status *value)
NOT_SUPPORTED(fmi2GetIntegerStatus, void *c, int kind, int *value)
NOT_SUPPORTED(fmi2GetStringStatus, void *c, int kind, const char **value)
