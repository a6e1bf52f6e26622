"""Tunes the gain of the integral and the forgetting factor of recursive least squares, on twins that are not reported.

Prints the geometric mean of the tracking error relative to that without correction, for each value of each method.
The learning benchmark reports twins 0 to 19; these are twins 900 to 907, with seed 0. The result, before the speed at
the apex was estimated by a parabola:

    gain k             0.05    0.1    0.2    0.3    0.5
    integral          0.178  0.175  0.186  0.181  0.173
    integral_plain    0.224  0.207  0.186  0.175  0.173

    forgetting factor   0.8    0.9   0.95   0.98   0.99  0.995
    rls               0.145  0.130  0.122  0.110  0.108  0.111

`rls_plain` was not tuned on its own and has the factor of `rls`. The best gains are at the end of the range, where the
error hardly depends on them.

    ./go python -m benchmarks.tune_baselines [--twins 8] [--methods integral,rls]
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.learning.methods import affine, integral
from benchmarks.learning.tasks import DEFAULT_TASK, tasks
from benchmarks.learning.trial import Method, Trial, hopping_gap
from stepgap import ApexMap
from stepgap.experiment.outcome import summarise
from stepgap.learning.steps import Steps

FIRST_TWIN = 900
"""First of the twins on which is tuned."""

GAINS = (0.05, 0.1, 0.2, 0.3, 0.5)
FACTORS = (0.8, 0.9, 0.95, 0.98, 0.99, 0.995)

TUNED: dict[str, tuple[Callable[..., Sequence[Steps]], str, tuple[float, ...]]] = {
    "integral": (integral.integral, "gain", GAINS),
    "integral_plain": (integral.integral_plain, "gain", GAINS),
    "rls": (affine.rls, "forgetting", FACTORS),
    "rls_plain": (affine.rls_plain, "forgetting", FACTORS),
}
"""Function, name of its parameter and the values that are tried, by the name of the method."""


def error_of(trial: Trial, method: Method) -> float:
    """Tracking error in half ranges; infinite after a fall."""
    steps = method(trial)[-1]
    found = summarise(steps, trial.task.reference, "")
    return np.inf if found.failed_steps else float(np.linalg.norm(found.rmse / steps.space.state_scale))


def main() -> None:
    """Prints a line for each method and value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=8)
    parser.add_argument("--methods", default=",".join(TUNED))
    options = parser.parse_args()
    nominal, task = ApexMap(), tasks()[DEFAULT_TASK]
    trials = [
        Trial(nominal, hopping_gap(nominal, task, twin)[0], task, twin, seed=0)
        for twin in range(FIRST_TWIN, FIRST_TWIN + options.twins)
    ]
    uncorrected = [error_of(trial, lambda trial: [trial.first]) for trial in trials]
    for name in options.methods.split(","):
        method, parameter, values = TUNED[name]
        for value in values:
            chosen = partial(method, **{parameter: value})
            errors = [error_of(trial, chosen) for trial in trials]
            ratio = np.exp(np.mean(np.log(np.divide(errors, uncorrected))))
            print(f"{name:15s} {parameter} {value:<6g} {ratio:.3f}", flush=True)


if __name__ == "__main__":
    main()
