/* The main loop of a robot that is controlled by what StepGap learned.
 *
 *     stepgap export runs/latest --to c --out controller.c
 *     cc -std=c99 -O2 -o robot examples/c_controller/main.c controller.c -I. -lm
 *     echo "0.1 0.56 0.2 0.58 0.0" | ./robot
 *
 * Here, a line of standard input stands for the sensors at a section (for the hopper the apex): the state, the target
 * for the next section, and the phase [rad], or nan if it is unknown, as is a state of nan. The answer is the status of
 * the plan and the command.
 * An empty line ends a deployment, as does a fall: the next line starts a new one.
 *
 * On a robot, replace `read_section` and `write_command`. Nothing else is needed: no memory is allocated, and a call
 * takes the same functions whether it runs in a task of an operating system or in a bare loop. A plan must be finished
 * before the command is needed; measure its longest time on your computer (docs/export_controller.md). The inner
 * controller, with its limits and its safety, remains the task of your program.
 */
#include <stdio.h>
#include <stdlib.h>

#include "controller.h"

enum { STATES = controller_STATES, COMMANDS = controller_COMMANDS };

typedef struct {
    double state[STATES], target[STATES], phase;
} Section;

/* Waits for the next section; 1 if there is one, 0 if the deployment ended, -1 if the robot is switched off. */
static int read_section(Section *section)
{
    static char line[1024];
    double numbers[2 * STATES + 1];
    char *rest = line;
    int count = 0;

    if (!fgets(line, sizeof line, stdin))
        return -1;
    while (count < 2 * STATES + 1) {
        char *end;
        numbers[count] = strtod(rest, &end);
        if (end == rest)
            break;
        rest = end;
        count++;
    }
    if (count < 2 * STATES + 1) {
        if (count > 0)
            fprintf(stderr, "%d numbers; a section needs %d\n", count, 2 * STATES + 1);
        return 0;
    }
    for (int i = 0; i < STATES; i++) {
        section->state[i] = numbers[i];
        section->target[i] = numbers[STATES + i];
    }
    section->phase = numbers[2 * STATES];
    return 1;
}

/* Hands the command of the next step to the inner controller. */
static void write_command(int status, const double *command)
{
    printf("%d", status);
    for (int i = 0; i < COMMANDS; i++)
        printf(" %.17g", (double)command[i]);
    putchar('\n');
    fflush(stdout);
}

int main(void)
{
    static controller_filter filter; /* what is known of the robot; too large for many a stack */
    static Section before, present;
    static double command[COMMANDS];
    int steps = 0, found;

    controller_filter_init(&filter);

    while ((found = read_section(&present)) >= 0) {
        if (found == 0) {
            if (steps > 0)
                controller_filter_restart(&filter); /* what was learned is kept for the next deployment */
            steps = 0;
            continue;
        }
        if (steps > 0) /* the step that ends here: from the section before, with the command given there */
            controller_filter_update(&filter, before.state, command, present.state, before.phase);
        int status = controller_plan(&filter, present.state, present.target, steps ? command : NULL, present.phase, command,
                                     NULL, NULL);
        /* Unless the status is controller_OK, the command is not corrected by what was learned: it is that of the nominal
           model. With status controller_UNCORRECTED the state was nan, or NULL: measured too long ago, or not at all. */
        write_command(status, command);
        before = present;
        steps++;
    }
    return 0;
}
