"""What does a wrong prior over robots cost? Analytic robots of one family, online, with priors of five kinds.

The robots are those of `benchmarks/learner.py`, with errors that have a part in common. A prior is fitted to twenty of
them, from steps as they were recorded (`right`), or with commands inverted or swapped, a state 0.42 half ranges too
large, or a state in km/h. Sixteen other robots then follow random targets for sixty steps. The table has the error of
the true state relative to the same robot without a prior: geometric mean with its 95 % interval, and the largest.

    ./go python -m benchmarks.wrong_prior
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from itertools import islice

import numpy as np

from benchmarks.learner import NOMINAL, SPACE, Robot, deployed, ratio, targets
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, observe
from stepgap.learning.prior import Prior, fit_prior
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepRecord

FAMILY, ROBOTS = range(500, 520), range(93000, 93016)
"""Numbers of the robots of which the prior is fitted, and of those that are measured."""

LENGTH = 60  # Steps of a robot
PARTS = {"2–5": slice(1, 5), "1–20": slice(0, 20), "11–60": slice(10, LENGTH)}
"""Steps that are compared."""

NOTHING = LearningSettings(residual="none")
Change = Callable[[Array], Array]


def unchanged(values: Array) -> Array:
    """As recorded."""
    return values


KINDS: Mapping[str, tuple[Change, Change]] = {
    "right": (unchanged, unchanged),
    "inverted": (unchanged, lambda command: -command),
    "swapped": (unchanged, lambda command: command[::-1]),
    "offset": (lambda state: state + np.array([0.0, 0.42]), unchanged),
    "km/h": (lambda state: state * np.array([3.6, 1.0]), unchanged),
}
"""Changes of the recorded states and commands from which a prior is fitted."""

COMMON = np.random.default_rng(77)
LINEAR, CONSTANT = COMMON.normal(0, 0.2, (2, 4)), COMMON.normal(0, 0.2, 2)


class Relative(Robot):
    """A robot of the family: a common error, and half of that of any robot."""

    def __init__(self, number: int, deployment: int):
        super().__init__(number, deployment)
        self._linear = LINEAR + 0.5 * self._linear
        self._constant = CONSTANT + 0.5 * self._constant


def observed(steps: Steps, of_state: Change, of_command: Change) -> Observations:
    """Errors of the nominal map in steps whose states and commands are changed."""
    log = list[LoggedStep]()
    for number, logged in enumerate(steps, 1):
        record = logged.record
        command = of_command(record.command)
        after = of_state(record.next_state)
        changed = StepRecord(of_state(record.state), command, command, after, record.status, requested=command)
        log.append(LoggedStep(0, number, after, after, np.zeros(2), changed))
    return observe(Steps(SPACE, log), NOMINAL)


def squares(number: int, priors: Sequence[Prior]) -> Array:
    """Squared errors of the steps of a robot that learns online, beginning with priors; shape (`LENGTH`,)."""
    robot = Relative(number, 1)
    learner = Learner.start(NOMINAL, Steps(SPACE), LearningSettings(online=True), 0, priors)
    errors = list[float]()
    with closing(deploy(learner, robot, targets(number).of(SPACE), 0)) as steps:
        for logged in islice(steps, LENGTH):
            errors.append(float(np.sum(((robot.true_state - logged.target) / SPACE.state_scale) ** 2)))
    return np.array(errors)


def main() -> None:
    """Prints the table."""
    start = Learner.start(NOMINAL, Steps(SPACE), NOTHING, 0)
    family = [deployed(start, Relative(number, 0), targets(number), 0)[0] for number in FAMILY]
    alone = [squares(number, ()) for number in ROBOTS]
    print(f"{'prior':10}" + "".join(f"{part:>28}" for part in PARTS))
    for kind, changes in KINDS.items():
        prior = fit_prior([observed(steps, *changes) for steps in family])
        errors = [squares(number, [prior]) for number in ROBOTS]
        line = f"{kind:10}"
        for part in PARTS.values():
            with_prior = [float(np.sqrt(one[part].mean())) for one in errors]
            without = [float(np.sqrt(one[part].mean())) for one in alone]
            largest = np.max(np.divide(with_prior, without))
            line += f"{ratio(with_prior, without):>20}, {largest:6.2f}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
