"""Which of several robots of one type is unlike the others, and in what.

The steps of each robot are compared with what the others would have done: the median of the next states that the
learned maps of all robots predict for the same state and command. What remains is fitted by least squares in the
command, about one middle for all robots:

    remaining error = offset + gains · (command − middle) + noise

Offset, gains and the standard deviation of the noise are the *traits* of a robot, three kinds of numbers for each state
coordinate. A robot is unlike the others in a trait if Rosner's test says so (generalized extreme Studentized deviate,
Percentage points for a generalized ESD many-outlier procedure, Technometrics 1983): one after the other the value that
is farthest from the mean of the rest is left out, so a second odd robot does not hide the first one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from stepgap.base.errors import InputError
from stepgap.base.normal import INTERVAL_95
from stepgap.learning.residual import HistoryInputs, Residual
from stepgap.step import Array, StepMap, StepSpace

FALSE_ALARMS: Final = 0.05
"""Share of the sets of robots, alike but for a normal spread, in which some robot is named; of ten robots it is 0.07 to
0.09, since Rosner's test is exact for many only."""

LEAST_KNOWN: Final = 20
"""Number of steps of each robot from which its traits can be found."""

LEAST_ROBOTS: Final = 5
"""With fewer robots, the spread among them is not known well enough to name one."""

MOST_ODD: Final = 5
"""Of this number of robots, at most one is odd in a trait; with more, the test names too often."""

LEAST_DRIVEN: Final = 0.05
"""A gain is a trait if the standard deviation of its command is larger than this for every robot [half ranges]."""


@final
@dataclass(frozen=True, eq=False)
class Individual:
    """What was learned of one robot.

    Attributes:
        name: Its name.
        nominal: Its nominal map.
        residual: The learned error of that map.
    """

    name: str
    nominal: StepMap
    residual: Residual


class Trait(NamedTuple):
    """A number in which robots are compared.

    Attributes:
        kind: offset [units of the state], gain [those per unit of the command], or the logarithm of the noise's std.
        state: Number of the state coordinate.
        command: Number of the command of a gain; 0 otherwise.
    """

    kind: Literal["offset", "gain", "noise"]
    state: int
    command: int = 0


@final
@dataclass(frozen=True, eq=False)
class ComparedRobots:
    """The traits of R robots.

    Attributes:
        names: Names of the robots.
        space: Names, units and ranges.
        traits: The T traits.
        middle: Command about which gains are taken; shape (m,).
        values: Shape (R, T).
        stds: Standard deviations of these estimates; shape (R, T).
        steps: Number of steps of each robot that were compared; shape (R,).
    """

    names: tuple[str, ...]
    space: StepSpace
    traits: tuple[Trait, ...]
    middle: Array
    values: Array
    stds: Array
    steps: NDArray[np.int64]

    @cached_property
    def unlike(self) -> NDArray[np.bool_]:
        """Which robots are unlike the others, and in which traits; shape (R, T)."""
        return self._outlying & (np.abs(self.difference) > 2 * INTERVAL_95 * self.stds)

    @cached_property
    def _outlying(self) -> NDArray[np.bool_]:
        """The same by the test alone, with which the false alarms are shared equally by the three kinds of traits."""
        kinds = [each.kind for each in self.traits]
        shares = [FALSE_ALARMS / len(set(kinds)) / kinds.count(each) for each in kinds]
        return np.array([outlying(*each) for each in zip(self.values.T, shares, strict=True)]).T

    @cached_property
    def difference(self) -> Array:
        """Each robot's trait minus the mean of the others that are alike; shape (R, T)."""
        return self.values - self._of_others[0]

    @cached_property
    def interval(self) -> Array:
        """Half of the 95 % interval of the differences; shape (R, T)."""
        return INTERVAL_95 * np.hypot(self.stds, self._of_others[1])

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of each trait among the robots that are alike; shape (T,)."""
        return np.nanstd(np.where(self._outlying, np.nan, self.values), axis=0, ddof=1)

    @cached_property
    def _of_others(self) -> tuple[Array, Array]:
        """Mean of the others that are alike, and the standard deviation of that; shapes (R, T)."""
        means, stds = [], []
        for row in range(len(self.names)):
            kept = ~self._outlying
            kept[row] = False
            count = np.maximum(kept.sum(axis=0), 1)
            mean = np.where(kept, self.values, 0.0).sum(axis=0) / count
            squares = np.where(kept, (self.values - mean) ** 2, 0.0).sum(axis=0)
            own = np.where(kept, self.stds**2, 0.0).sum(axis=0)
            means.append(mean)
            stds.append(np.sqrt(np.maximum(squares / np.maximum(count - 1, 1) / count, own / count**2)))
        return np.array(means), np.array(stds)


def compare_individuals(individuals: Sequence[Individual]) -> ComparedRobots:
    """Compares robots by the steps from which their residuals were learned.

    Args:
        individuals: At least two robots of one type.

    Raises:
        InputError: Their states or commands differ, one has too few steps, or they have none in common.
    """
    first = individuals[0]
    _check(individuals)
    space, n = first.nominal.space, len(first.nominal.space.state)
    data = [_steps_of(each) for each in individuals]
    remaining = []
    for each, (points, ends) in zip(individuals, data, strict=True):
        usual, common = _usual_step(individuals, points)
        if np.count_nonzero(common) < LEAST_KNOWN:
            raise InputError(
                f"{each.name}: only {np.count_nonzero(common)} of its steps are at states and commands that the others "
                f"know; {LEAST_KNOWN} are needed: let all robots track the same reference"
            )
        remaining.append((points[common, n:], (ends - usual)[common]))
    scale, commands = space.command_scale, [command for command, _ in remaining]
    middle = np.median(np.vstack(commands), axis=0)
    driven = np.flatnonzero(np.min([each.std(axis=0) for each in commands], axis=0) > LEAST_DRIVEN * scale)
    traits = [
        *(Trait("offset", row) for row in range(n)),
        *(Trait("gain", row, int(column)) for row in range(n) for column in driven),
        *(Trait("noise", row) for row in range(n)),
    ]
    found = [_traits(command[:, driven] - middle[driven], error) for command, error in remaining]
    values, stds = (np.array(part) for part in zip(*found, strict=True))
    steps = np.array([len(error) for _, error in remaining])
    names = tuple(each.name for each in individuals)
    return ComparedRobots(names, space, tuple(traits), middle, values, stds, steps)


def outlying(values: Array, probability: float) -> NDArray[np.bool_]:
    """Which values (R,) do not belong to the normal distribution of the others, by Rosner's test.

    Args:
        values: The values.
        probability: That some value is named although all are of one normal distribution.
    """
    size, left, removed, last = len(values), np.ones(len(values), bool), list[int](), 0
    if size < LEAST_ROBOTS:
        return ~left
    for _ in range(size // MOST_ODD):
        count = int(left.sum())
        spread = values[left].std(ddof=1)
        if not spread > 0:
            break
        distance = np.where(left, np.abs(values - values[left].mean()) / spread, -1.0)
        farthest = int(np.argmax(distance))
        removed.append(farthest)
        left[farthest] = False
        t = stdtrit(count - 2, 1 - probability / (2 * count))
        if distance[farthest] > (count - 1) * t / np.sqrt((count - 2 + t**2) * count):
            last = len(removed)
    found = np.zeros(size, bool)
    found[removed[:last]] = True
    return found


def _check(individuals: Sequence[Individual]) -> None:
    first = individuals[0].nominal.space
    for each in individuals:
        space = each.nominal.space
        if (space.state_names, space.command_names) != (first.state_names, first.command_names):
            raise InputError(
                f"{each.name}: its state and command are {', '.join(space.names)}, those of {individuals[0].name} "
                f"{', '.join(first.names)}; only robots of one type can be compared"
            )
        if each.residual.kind == "none" or each.residual.history_inputs != HistoryInputs():
            raise InputError(
                f"{each.name}: residual '{each.residual.name}' is no function of state and command that was learned; "
                "run with another learning.residual, and without inputs from before or of a touchdown"
            )


def _steps_of(individual: Individual) -> tuple[Array, Array]:
    """States and commands (N, n + m) and measured next states (N, n) of the steps that were learned from."""
    points, n = individual.residual.regressions[0].points, len(individual.nominal.space.state)
    errors = np.stack([each.values for each in individual.residual.regressions], axis=1)
    return points, individual.nominal.evaluate(points[:, :n], points[:, n:]).next_state + errors


def _usual_step(individuals: Sequence[Individual], points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Median next state (N, n) of the robots that know a point, and which points (N,) more than half of them know."""
    n, predicted, known = len(individuals[0].nominal.space.state), list[Array](), list[NDArray[np.bool_]]()
    for each in individuals:
        mean = each.nominal.evaluate(points[:, :n], points[:, n:]).next_state + each.residual.mean(points)
        certain = each.residual.std(points) <= each.residual.noise_std
        sure = np.all(certain & np.isfinite(mean), axis=1)
        predicted.append(np.where(sure[:, None], mean, np.nan))
        known.append(sure)
    common = np.mean(np.array(known), axis=0) > 0.5
    usual = np.full((len(points), n), np.nan)
    usual[common] = np.nanmedian(np.array(predicted)[:, common], axis=0)
    return usual, common


def _traits(commands: Array, errors: Array) -> tuple[Array, Array]:
    """Offsets, gains and noise of one robot, and their standard deviations, from commands about the middle (N, k)."""
    features = np.column_stack([np.ones(len(commands)), commands])
    weights = np.linalg.lstsq(features, errors, rcond=None)[0]
    freedom = max(len(features) - features.shape[1], 1)
    variance = np.maximum(np.sum((errors - features @ weights) ** 2, axis=0) / freedom, np.finfo(float).tiny)
    shape = np.sqrt(np.diag(np.linalg.pinv(features.T @ features)))
    stds = shape[:, None] * np.sqrt(variance)
    of_noise = np.full(errors.shape[1], np.sqrt(0.5 / freedom))
    parts = [(weights[0], stds[0]), (weights[1:].T.ravel(), stds[1:].T.ravel()), (np.log(variance) / 2, of_noise)]
    values, deviations = zip(*parts, strict=True)
    return np.concatenate(values), np.concatenate(deviations)
