/* The program of a robot in C, for `stepgap run --plant process`: a hopper that differs from StepGap's model.
 *
 *     cc -O2 -o hopper examples/process/hopper.c -lm
 *     stepgap run --plant process --iterations 2 --out runs/c -- ./hopper
 *
 * For your robot, replace the body of `hop`: give the command to your controller, wait until the robot is at the next
 * apex, and return the state there. docs/process.md describes the lines that are exchanged.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double speed, height; /* at the apex [m/s, m] */
} State;

static double noise(void) { return rand() / (double)RAND_MAX - 0.5; }

/* One hop, from apex to apex; returns 0 if the robot fell. */
static int hop(State *state, double fx, double fy) {
    double speed = state->speed, height = state->height;
    state->speed = 0.66 * speed + 0.017 * fx - 1.5e-4 * fy * speed + 0.34 * (height - 0.58) + 0.115 + 0.01 * noise();
    state->height = 0.9 * height + 0.0036 * fy + 2e-5 * fy * fy + 0.05 * speed * speed + 0.0755 + 0.002 * noise();
    return state->height > 0.45 && state->height < 0.9;
}

/* The number after "name": in a line; the lines of StepGap contain every name at most once. */
static double number(const char *line, const char *name) {
    char key[32];
    snprintf(key, sizeof key, "\"%s\":", name);
    const char *found = strstr(line, key);
    return found ? strtod(found + strlen(key), NULL) : 0.0;
}

int main(void) {
    static char line[65536];
    State state = {0.0, 0.55};
    while (fgets(line, sizeof line, stdin)) {
        if (strstr(line, "\"stepgap\":")) {
            puts("{\"ready\": {\"state\": {\"speed\": \"m/s\", \"height\": \"m\"}, \"command\": {\"fx\": \"N\", \"fy\": \"N\"}}}");
        } else if (strstr(line, "\"start\":")) {
            printf("{\"state\": {\"speed\": %.17g, \"height\": %.17g}}\n", state.speed, state.height);
        } else if (strstr(line, "\"step\":")) {
            int step = (int)number(line, "step");
            if (hop(&state, number(line, "fx"), number(line, "fy")))
                printf("{\"step\": %d, \"next\": {\"speed\": %.17g, \"height\": %.17g}, \"status\": \"ok\"}\n", step,
                       state.speed, state.height);
            else
                printf("{\"step\": %d, \"status\": \"fell\"}\n", step);
        } else if (strstr(line, "\"stop\":")) {
            break; /* here a real robot comes to rest, and also after the loop if the input just ends */
        }
        fflush(stdout);
    }
    return 0;
}
