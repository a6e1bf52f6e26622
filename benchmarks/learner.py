"""What does the learner make of robots that are not as it assumes? Analytic ones, each of which breaks one assumption.

A robot has two states and two commands. The nominal map is affine; the error is quadratic with a small wave, and its
noise is normal. That is the kind `plain`; any other kind differs from it in one thing:

- `drift`: both commands lose half of their effect, a little with each step;
- `abrupt`, `ends`, `twice`: the robot changes in mid-run; for good, until it is as before, and once more;
- `modes`, `kink`: each step goes one of two ways by chance; the error bends where it is not smooth;
- `delayed`: a part of each command acts one step later;
- `cut`, `cable`: commands beyond a part of their range are cut; a cable pulls the robot back from a point on;
- `gusts`, `hetero`, `heavy`: noise that lasts, that depends on the state, and with heavy tails;
- `pushes`, `glitches`: some steps are pushed; some states are measured wrongly.

Each robot follows targets that change every 4 to 8 steps. The methods are `none`, the nominal map alone; `online`,
which begins with nothing; `default` and any name of a residual, such as `gp`, after a deployment with the nominal map
alone, in which `ends` and `twice` do not change. All have the same noise. The error is the root of the mean square of
the true state minus its target [half ranges]: mean over the robots with its 95 % interval by Student's t. Within 30
steps of a change an alarm is true; all other steps are healthy, and alarms in them are false. The time is that of the
processor, for learning from a step and planning the next one.

    ./go python -m benchmarks.learner [--kinds plain,abrupt] [--robots 90000-90003] [--methods none,default,online,gp]
        [--out FILE] [--beside FILE]

`--out` receives a line of JSON for each deployment; robots in it are not run again. `--beside` compares the results
with such a file of another version of the project: ratio of the errors, the geometric mean over the robots. So the
script uses only what versions have in common: it can be copied into an earlier one. The rows `all` have the geometric
mean of the errors of all kinds.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from itertools import product
from pathlib import Path
from time import process_time
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.stats import t as student

from benchmarks.disturbed_plant import finished
from stepgap.base.blas import one_blas_thread
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import AdaptiveMap, deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus

STEPS = 150
"""Number of steps of a deployment."""

REACTION = 30
"""Number of steps after a change within which an alarm is true."""

SPACE = StepSpace(
    (Quantity("a", "m/s", -1.0, 1.0), Quantity("b", "m", -1.0, 1.0)),
    (Quantity("u", "N", -2.0, 2.0), Quantity("v", "N", -2.0, 2.0)),
)

NOMINAL = AffineMap(
    SPACE, np.zeros(2), np.zeros(2), np.zeros(2), np.array([[0.5, 0.1, 0.8, 0.0], [0.0, 0.3, 0.0, 0.8]])
)

WEAKER = np.array([[0.0, 0.0, -0.5, 0.0], [0.0, 0.0, 0.0, -0.5]])
"""Change of the error with state and command where the commands have lost half of a range of their effect."""

MOVED, MOVED_AGAIN = np.array([0.25, -0.15]), np.array([0.2, 0.35])
"""Changes of a constant error [half ranges]."""

OTHER_WAY = np.array([1.0, -0.7])
"""Direction in which a mode or a bend of the error differs."""


class Robot(Plant):
    """The plain robot. What happens in it is drawn by its number, noise by the number of the deployment, too.

    Attributes:
        changes: Numbers of the first steps of a robot that has just changed.
        point: State and command of the step in half ranges; shape (4,).
        before: Command of the step before; shape (2,) [half ranges].
        number: Number of the step, from 1.
        rng: Draws the noise.
        border: Direction across which the error of some kinds changes; shape (4,).
    """

    changes: ClassVar[Sequence[int]] = ()

    def __init__(self, number: int, deployment: int):
        drawn = np.random.default_rng([number, 1])
        self._linear, self._constant = drawn.normal(0, 0.12, (2, 4)), drawn.normal(0, 0.15, 2)
        self._quadratic, self._wave = drawn.normal(0, 0.05, (2, 10)), drawn.normal(0, 1.5, (2, 4))
        self.border = drawn.normal(0, 0.5, 4)
        self.rng = np.random.default_rng([number, 2, deployment])
        self.number, self.point, self.before = 0, np.zeros(4), np.zeros(2)
        self._true = self._measured = np.zeros(2)

    @property
    def space(self) -> StepSpace:
        """Two states and two commands."""
        return SPACE

    @property
    def true_state(self) -> Array:
        """The state that was reached; shape (2,)."""
        return self._true

    def start(self) -> Array:
        """Starts in the middle of all ranges."""
        return self._measured

    def stop(self) -> None:
        """Nothing is to be stopped."""

    def take_step(self, command: Array) -> StepRecord:
        """A step from the true state; the record has the measured ones."""
        command = np.clip(command, SPACE.command_lower, SPACE.command_upper)
        self.number, self.point = self.number + 1, np.append(self._true, command / SPACE.command_scale)
        error = self.error()
        start, self._true = self._measured, NOMINAL(self._true, command) + error + self.noise()
        self._measured, self.before = self.measured(self._true), self.point[2:]
        return StepRecord(start, command, command, self._measured, StepStatus.OK, requested=command)

    def error(self) -> Array:
        """Error of the nominal map in this step; shape (2,)."""
        products = np.outer(self.point, self.point)[np.triu_indices(4)]
        smooth = self._constant + self._linear @ self.point + self._quadratic @ products
        return smooth + 0.04 * np.sin(self._wave @ self.point)

    def noise(self) -> Array:
        """Noise of this step; shape (2,)."""
        return self.rng.normal(0, 0.03, 2)

    def measured(self, state: Array) -> Array:
        """What is measured of a state."""
        return state


class Drifting(Robot):
    """Its commands lose their effect little by little."""

    changes = range(1, STEPS + 1)

    def error(self) -> Array:
        """Error of this step."""
        return super().error() + WEAKER @ self.point * self.number / STEPS


class Abrupt(Robot):
    """One of its commands loses half of its effect at once."""

    changes = (76,)

    def error(self) -> Array:
        """Error of this step."""
        changed = np.array([0.2 + WEAKER[0] @ self.point, -0.1])
        return super().error() + (self.number >= self.changes[0]) * changed


class Ending(Robot):
    """A change that ends."""

    changes = (51, 101)

    def error(self) -> Array:
        """Error of this step."""
        return super().error() + (self.changes[0] <= self.number < self.changes[1]) * MOVED


class Twice(Robot):
    """Two changes, of which the second does not undo the first."""

    changes = (51, 101)

    def error(self) -> Array:
        """Error of this step."""
        first, second = (self.number >= each for each in self.changes)
        return super().error() + first * MOVED + second * MOVED_AGAIN


class Modes(Robot):
    """Steps go one of two ways, by chance, which is the more probable the farther they are across a border."""

    def error(self) -> Array:
        """Error of this step."""
        other = self.rng.random() < 1 / (1 + np.exp(-(self.point @ self.border) / 0.1))
        return super().error() + 0.3 * other * OTHER_WAY


class Kink(Robot):
    """The error bends at a border."""

    def error(self) -> Array:
        """Error of this step."""
        return super().error() + 0.4 * max(0.0, self.point @ self.border) * OTHER_WAY


class Delayed(Robot):
    """A part of each command acts one step later."""

    def error(self) -> Array:
        """Error of this step."""
        return super().error() + 0.25 * self.before


class Cut(Robot):
    """Commands beyond 70 % of their range have the effect of those at 70 %."""

    def error(self) -> Array:
        """Error of this step."""
        return super().error() + NOMINAL.matrix[:, 2:] @ (
            (np.clip(self.point[2:], -0.7, 0.7) - self.point[2:]) * SPACE.command_scale
        )


class Cable(Robot):
    """A cable that is tight from a state on pulls the robot back."""

    def error(self) -> Array:
        """Error of this step."""
        return super().error() - np.array([0.6 * max(0.0, self.point[0] - 0.2), 0.0])


class Gusts(Robot):
    """A part of the noise lasts for some ten steps."""

    def __init__(self, number: int, deployment: int):
        super().__init__(number, deployment)
        self._gust = np.zeros(2)

    def error(self) -> Array:
        """Error of this step."""
        self._gust = 0.9 * self._gust + self.rng.normal(0, 0.04, 2)
        return super().error() + self._gust


class Hetero(Robot):
    """The noise is up to five times as large away from the middle."""

    def noise(self) -> Array:
        """Noise of this step."""
        return self.rng.normal(0, 0.02 * (1 + 4 * abs(self.point[0])), 2)


class Heavy(Robot):
    """The noise has heavy tails: Student's t with two degrees of freedom."""

    def noise(self) -> Array:
        """Noise of this step."""
        return 0.03 * self.rng.standard_t(2, 2)


class Pushed(Robot):
    """Something pushes the robot in 3 % of its steps."""

    def noise(self) -> Array:
        """Noise of this step."""
        usual = super().noise()
        if self.rng.random() >= 0.03:
            return usual
        return usual + self.rng.choice([-1, 1]) * self.rng.uniform(0.4, 1.0, 2)


class Glitches(Robot):
    """One state is measured wrongly after 2 % of its steps."""

    def measured(self, state: Array) -> Array:
        """What is measured of a state."""
        if self.rng.random() >= 0.02:
            return state
        one = np.eye(2)[self.rng.integers(2)]
        return state + self.rng.choice([-1, 1]) * self.rng.uniform(1, 3) * one


KINDS: Mapping[str, type[Robot]] = {
    "plain": Robot,
    "drift": Drifting,
    "abrupt": Abrupt,
    "ends": Ending,
    "twice": Twice,
    "modes": Modes,
    "kink": Kink,
    "delayed": Delayed,
    "cut": Cut,
    "cable": Cable,
    "gusts": Gusts,
    "hetero": Hetero,
    "heavy": Heavy,
    "pushes": Pushed,
    "glitches": Glitches,
}
"""Robots by the names of their kinds."""

NOT_YET = ("ends", "twice")
"""Kinds whose changes are not those of the deployment before, in which they are plain."""

METHODS = ("none", "default", "online", "gp")

Case = tuple[str, int]
"""Kind and number of a robot."""


class Found(NamedTuple):
    """A deployment.

    Attributes:
        error: Root of the mean square of its errors [half ranges].
        alarms: Number of its alarms.
        false: Number of those in healthy steps.
        healthy: Number of healthy steps.
        milliseconds: Mean time of the processor for learning and planning [ms].
    """

    error: float
    alarms: int
    false: int
    healthy: int
    milliseconds: float


def targets(number: int) -> Reference:
    """Random targets, each for 4 to 8 steps."""
    rng, rows = np.random.default_rng([number, 9]), list[Array]()
    while len(rows) < STEPS:
        rows += [rng.uniform(-0.8, 0.8, 2)] * int(rng.integers(4, 9))
    return Reference(SPACE.state_names, np.array(rows[:STEPS]))


def deployed(learner: Learner, robot: Robot, reference: Reference, deployment: int) -> tuple[Steps, Found]:
    """A deployment: its steps, and what was found of it."""
    log, errors, latest, begin = Steps(SPACE), list[Array](), list[AdaptiveMap]([learner]), process_time()
    with closing(deploy(learner, robot, reference.of(SPACE), deployment, on_learner=latest.append)) as steps:
        for logged in steps:
            log += [logged]
            errors.append((robot.true_state - logged.target) / SPACE.state_scale)
    milliseconds = 1e3 * (process_time() - begin) / len(errors)
    changing = {step + later for step in robot.changes for later in range(REACTION)}
    false = sum(alarm.step not in changing for alarm in latest[-1].alarms)
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    healthy = len(set(range(1, len(errors) + 1)) - changing)
    return log, Found(rmse, len(latest[-1].alarms), false, healthy, milliseconds)


def measure(case: Case, methods: Sequence[str]) -> dict[str, Found]:
    """The deployments of a robot by method."""
    (kind, number), reference, alone = case, targets(case[1]), LearningSettings(residual="none")
    nothing, found = Steps(SPACE), dict[str, Found]()
    with one_blas_thread():
        before = Robot if kind in NOT_YET else KINDS[kind]
        known, _ = deployed(Learner.start(NOMINAL, nothing, alone, 0), before(number, 0), reference, 0)
        for method in methods:
            if method in ("none", "online"):
                settings = alone if method == "none" else LearningSettings(online=True)
                learner, deployment = Learner.start(NOMINAL, nothing, settings, 0), 0
            else:
                settings = LearningSettings() if method == "default" else LearningSettings(residual=method)
                learner, deployment = Learner.start(NOMINAL, known, settings, 1), 1
            found[method] = deployed(learner, KINDS[kind](number, 1), reference, deployment)[1]
    return found


def interval(values: Sequence[float]) -> str:
    """Mean with half the width of its 95 % interval."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return f"{mean:.3f}"
    return f"{mean:.3f} ± {student.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count):.3f}"


def ratio(errors: Sequence[float], others: Sequence[float]) -> str:
    """Geometric mean of ratios with its 95 % interval."""
    logs = np.log(np.divide(errors, others))
    mean, half = logs.mean(), student.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs))
    return f"{np.exp(mean):.2f} ({np.exp(mean - half):.2f}–{np.exp(mean + half):.2f})"


Results = Mapping[tuple[str, str, int], Found]
"""Deployments by kind, method and number of the robot."""


def by_robot(found: Results, keys: Sequence[tuple[str, str, int]]) -> list[float]:
    """Error of each robot, the geometric mean over the kinds."""
    robots = dict.fromkeys(key[2] for key in keys)
    return [float(np.exp(np.mean([np.log(found[key].error) for key in keys if key[2] == each]))) for each in robots]


def print_row(kind: str, method: str, found: Results, beside: Results) -> None:
    """Prints the row of a method on robots of a kind."""
    some, both = list(found.values()), [key for key in found if key in beside]
    alarms, false, healthy = (sum(column) for column in zip(*(each[1:4] for each in some), strict=True))
    rate = f"{false} of {healthy}, {1e3 * false / healthy:.1f}" if healthy else "–"
    time = np.mean([each.milliseconds for each in some])
    error = interval(by_robot(found, list(found)))
    print(f"{kind:10}{method:9}{error:16}{alarms:7}{rate:>30}{time:7.1f}", end="")
    if len({robot for *_, robot in both}) > 1:
        errors = [by_robot(results, both) for results in (found, beside)]
        print(f"   {interval(errors[1])}, {ratio(*errors)}", end="")
    print()


def print_table(found: Results, beside: Results) -> None:
    """Prints a row for each kind and method, and one for each method on all kinds."""
    print(f"{'kind':10}{'method':9}{'error':16}{'alarms':>7}{'false per 1000 healthy steps':>30}{'ms':>7}", end="")
    print("   error beside, ratio to it" if beside else "")
    methods = list(dict.fromkeys(method for _, method, _ in found))
    for kind, method in product(dict.fromkeys(kind for kind, *_ in found), methods):
        print_row(kind, method, {key: each for key, each in found.items() if key[:2] == (kind, method)}, beside)
    for method in methods:
        print_row("all", method, {key: each for key, each in found.items() if key[1] == method}, beside)


def read(path: Path) -> dict[tuple[str, str, int], Found]:
    """The results in a file."""
    with path.open(encoding="utf-8") as lines:
        rows = [json.loads(line) for line in lines]
    return {(row.pop("kind"), row.pop("method"), row.pop("robot")): Found(**row) for row in rows}


def append(path: Path, kind: str, robot: int, results: Mapping[str, Found]) -> None:
    """Adds the results of a robot to a file."""
    with path.open("a", encoding="utf-8") as out:
        for method, each in results.items():
            print(json.dumps({"kind": kind, "method": method, "robot": robot} | each._asdict()), file=out)


def main() -> None:
    """Runs all robots, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--robots", default="90000-90003")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--beside", type=Path)
    given = parser.parse_args()
    first, _, last = given.robots.partition("-")
    methods: list[str] = given.methods.split(",")
    cases: list[Case] = list(product(given.kinds.split(","), range(int(first), int(last or first) + 1)))
    keys = [(kind, method, robot) for method in methods for kind, robot in cases]
    found = read(given.out) if given.out and given.out.exists() else {}
    waiting = list(dict.fromkeys((kind, robot) for kind, method, robot in keys if (kind, method, robot) not in found))
    for (kind, robot), results in finished(partial(measure, methods=methods), waiting):
        found |= {(kind, method, robot): each for method, each in results.items()}
        if given.out:
            append(given.out, kind, robot, results)
    print_table({key: found[key] for key in keys}, read(given.beside) if given.beside else {})


if __name__ == "__main__":
    main()
