/* The learned controller as a function of Octave or MATLAB.
 *
 *     stepgap export runs/latest --to c --out controller.c
 *     mkoctfile --mex -I. examples/c_controller/octave/step_controller.c controller.c -lm     (in MATLAB: mex …)
 *
 *     step_controller()                                        % before each deployment
 *     [command, status] = step_controller(state, target, phase)  % once per section; phase [rad] may be NaN
 *
 * From the second section of a deployment on, the online filter is updated by the step that ends there.
 */
#include "mex.h"

#include "controller.h"

enum { STATES = controller_STATES, COMMANDS = controller_COMMANDS };

static void read_numbers(const mxArray *given, const char *name, int count, double *numbers)
{
    if (!mxIsDouble(given) || mxIsComplex(given) || (int)mxGetNumberOfElements(given) != count)
        mexErrMsgIdAndTxt("step_controller:size", "%s must have %d real numbers", name, count);
    for (int i = 0; i < count; i++)
        numbers[i] = mxGetPr(given)[i];
}

void mexFunction(int results, mxArray *result[], int arguments, const mxArray *argument[])
{
    static controller_filter filter;
    static double before[STATES], command[COMMANDS], phase_before;
    static int steps = 0;
    double state[STATES], target[STATES], phase;
    int status;

    if (arguments == 0) {
        steps = 0;
        return;
    }
    if (arguments != 3)
        mexErrMsgIdAndTxt("step_controller:arguments", "it takes state, target and phase; or nothing, to start");
    read_numbers(argument[0], "state", STATES, state);
    read_numbers(argument[1], "target", STATES, target);
    read_numbers(argument[2], "phase", 1, &phase);
    if (steps == 0)
        controller_filter_init(&filter);
    else
        controller_filter_update(&filter, before, command, state, phase_before);
    status = controller_plan(&filter, state, target, steps ? command : NULL, phase, command, NULL, NULL);
    for (int i = 0; i < STATES; i++)
        before[i] = state[i];
    phase_before = phase;
    steps++;
    result[0] = mxCreateDoubleMatrix(1, COMMANDS, mxREAL);
    for (int i = 0; i < COMMANDS; i++)
        mxGetPr(result[0])[i] = (double)command[i];
    if (results > 1)
        result[1] = mxCreateDoubleScalar(status);
}
