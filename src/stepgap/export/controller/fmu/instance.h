/* One instance of the controller, in plain memory, so that its state is copied as bytes.

   model.h defines STATES, COMMANDS, TOKEN and COMMAND_CENTRE, and includes the exported controller with the prefix
   "controller". Variables are numbered: state, target, phase, command, predicted, std, all real, then the three below. */
#ifndef INSTANCE_H
#define INSTANCE_H

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

static int is_input(unsigned reference) { return reference < COMMAND; }

static int get_reals(const instance *it, const unsigned *references, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= REALS && references[i] != TIME) return 0;
        values[i] = references[i] == TIME ? it->time : it->reals[references[i]];
    }
    return 1;
}

static int set_reals(instance *it, const unsigned *references, size_t count, const double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (!is_input(references[i])) return 0;
        it->reals[references[i]] = values[i];
    }
    return 1;
}

static int *flag_of(instance *it, unsigned reference)
{
    return reference == COMPLETED ? &it->completed : reference == PHASE_KNOWN ? &it->phase_known : NULL;
}

/* Bytes of the state of an instance; 0 if there is no memory. */
static int copy_state(const instance *it, void **state)
{
    if (!*state) *state = malloc(sizeof *it);
    if (*state) memcpy(*state, it, sizeof *it);
    return *state != NULL;
}

#endif
