"""Whether a robot steps as its nominal map says, derivative by derivative, and what explains that it does not.

The error of the map is regressed on state and command. Added to the derivatives of the map, the weights are those of
the robot, with intervals. Where they contradict the map, some simple mistakes are tried, one after the other: with each
of them the map predicts the steps again, and the one that leaves the least error is the cause. What a run learns, such
as a drive that is weaker by a third, is no contradiction.

Numbers are in half ranges: a derivative is the change of the next state by a change of a state or command by half its
range.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from stepgap.learning.steps import Steps
from stepgap.records.text import capitalised, listed
from stepgap.step import Array, Quantity, StepMap, StepSpace

_CONFIDENT: Final = 0.9995  # Of the one-sided quantile of the intervals
_ALLOWED: Final = 0.03  # Added to each interval for curvature, of which the regression knows nothing
_UNSEEN: Final = 3e-3  # Part of the largest singular value below which the steps do not show a direction
_NEAR: Final = 2.0  # Steps from states up to here are compared [half ranges from the middle]
_WEIGHTY: Final = 0.1  # Smallest derivative by the map that a robot can contradict
_WEAKER: Final = 0.45  # Largest ratio of robot to map that contradicts it
_STRONGER: Final = 2.2  # Smallest one
_REVERSED: Final = -0.2  # Largest one that contradicts a derivative by the state, which may be zero in a robot
_UNEXPECTED: Final = 0.5  # Smallest effect of a command that contradicts a map without it
_EXPLAINED: Final = 0.6  # Part of the squared error that a cause has to explain
_EQUAL: Final = 1.5  # Two causes explain the steps equally well up to this ratio of what they leave
_MOST_ENTRIES: Final = 4  # Number of derivatives that are listed
_FEWEST: Final = 6  # Number of steps by which a mistake is judged, at least
_PREDICTED: Final = 0.5  # Part of the steps that a map has to predict


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the next state by the map and by the steps of a robot; shapes (n, n + m).

    Attributes:
        steps: The steps that were used.
        basis: What their error was regressed on; shape (N, 1 + n + m).
        error: Error of the map in these steps; shape (N, n).
        by_map: Median of those of the map.
        by_robot: Those of the robot.
        margin: Half the width of their interval; infinite where the steps show nothing.
    """

    steps: Steps
    basis: Array
    error: Array
    by_map: Array
    by_robot: Array
    margin: Array

    @property
    def space(self) -> StepSpace:
        """Names and ranges."""
        return self.steps.space

    @property
    def residual(self) -> Array:
        """Error that state and command do not explain; shape (N, n)."""
        return _left(self.basis, self.error)

    @property
    def unexplained(self) -> float:
        """Largest deviation that state and command do not explain."""
        return float(np.sqrt(np.mean(self.residual**2, axis=0)).max())

    @property
    def ratio(self) -> tuple[Array, Array]:
        """Least and largest ratio of robot to map, NaN where the map has a small one."""
        base = np.where(np.abs(self.by_map) > _WEIGHTY, self.by_map, np.nan)
        ends = (self.by_robot - self.margin) / base, (self.by_robot + self.margin) / base
        return np.minimum(*ends), np.maximum(*ends)

    @property
    def _reversed(self) -> NDArray[np.bool_]:
        """Derivatives that are of the other sign than by the map, which may be small there; shape (n, n + m)."""
        apart = np.abs(self.by_robot - self.by_map)
        return (self.ratio[1] < _REVERSED) & (apart > 3 * _WEIGHTY)

    @property
    def doubtful(self) -> bool:
        """Whether a derivative by a state is of the other sign, however small it is by the map: it may be curvature."""
        return bool(self._reversed[:, : len(self.space.state)].any())

    @property
    def contradicting(self) -> NDArray[np.bool_]:
        """Which derivatives of the robot contradict those of the map."""
        n = len(self.space.state)
        least, largest = self.ratio
        apart = np.abs(self.by_robot - self.by_map)
        wrong = ((largest < _WEAKER) | (least > _STRONGER)) & (apart > _WEIGHTY)
        wrong |= (np.abs(self.by_map) < _WEIGHTY) & (np.abs(self.by_robot) - self.margin > _UNEXPECTED)
        by_state = self._reversed & (np.abs(self.by_map) > 3 * _WEIGHTY)
        return np.hstack([by_state[:, :n], wrong[:, n:]])

    def gain(self, entries: Any) -> float:
        """Factor of some derivatives of the map that comes nearest to the robot, of what the steps show."""
        seen = np.isfinite(self.margin[entries])
        by_map = self.by_map[entries][seen]
        squares = float(by_map @ by_map)
        return float(by_map @ self.by_robot[entries][seen]) / squares if squares else 0.0

    def in_words(self, row: int, column: int) -> str:
        """One derivative of map and robot."""
        name = f"∂{self.space.state[row].name}/∂{self.space.names[column]}"
        robot = f"{self.by_robot[row, column]:.2f} ± {self.margin[row, column]:.2f}"
        return f"{name} is {self.by_map[row, column]:.2f} by the map, {robot} by the steps"


def _left(basis: Array, values: Array) -> Array:
    """What a regression of values (N, n) on a basis (N, k) leaves."""
    return values - basis @ np.linalg.lstsq(basis, values, rcond=1e-9)[0]


def measured_derivatives(steps: Steps, nominal: StepMap) -> Derivatives | None:
    """Compares map and robot in some steps; None if they are too few, or the map does not predict them."""
    space = steps.space
    n = len(space.state)
    predicted = nominal.evaluate(steps.state, steps.requested).next_state
    matrices = nominal.jacobian(steps.state, steps.requested)
    usable = np.isfinite(steps.next_state + predicted).all(axis=1) & ~steps.doubtful
    usable &= np.isfinite(matrices).all(axis=(1, 2))
    size = 1 + n + len(space.command)
    # Far outside of its ranges a robot that is about to fall is not linear; a wrong unit is far outside in every step.
    near = usable & (np.abs(space.scaled_state(steps.state)) <= _NEAR).all(axis=1)
    usable = near if near.sum() >= 2 * size else usable
    used = steps.selected(usable)
    if len(used) < 2 * size:
        return None
    error = (used.next_state - predicted[usable]) / space.state_scale
    inputs = space.scaled_state(used.state), space.point_of(used.requested)
    basis = np.hstack([np.ones((len(used), 1)), *inputs])
    _, singular, right = np.linalg.svd(basis - np.mean(basis, axis=0) * (np.arange(size) > 0), full_matrices=False)
    shown = singular > _UNSEEN * singular[0]
    weights = np.linalg.lstsq(basis, error, rcond=1e-9)[0][1:].T
    freedom = len(used) - int(shown.sum())
    scatter = np.sqrt(np.sum(_left(basis, error) ** 2, axis=0) / freedom)
    spread = np.sqrt(np.sum((right[shown] / singular[shown, None]) ** 2, axis=0))[1:]
    hidden = (right[~shown] ** 2).sum(axis=0)[1:] > _WEIGHTY**2
    margin = stdtrit(freedom, _CONFIDENT) * np.outer(scatter, spread) + _ALLOWED
    scale = np.concatenate([space.state_scale, space.command_scale]) / space.state_scale[:, None]
    by_map = np.median(matrices[usable], axis=0) * scale
    return Derivatives(used, basis, error, by_map, by_map + weights, np.where(hidden, np.inf, margin))


def frozen_states(steps: Steps) -> list[str]:
    """Sentences on states that a robot measures, but that never change."""
    ends = steps.space.scaled_state(steps.next_state[np.isfinite(steps.next_state).all(axis=1)])
    if len(ends) < _FEWEST:
        return []
    return [
        f"{capitalised(quantity.name)} is the same after all {len(ends)} steps: look whether the robot's program "
        "measures it anew after each step."
        for quantity, change in zip(steps.space.state, np.ptp(ends, axis=0), strict=True)
        if change < 1e-9
    ]


def contradictions(derivatives: Derivatives) -> list[str]:
    """Sentences on what contradicts the map, derivative by derivative, the largest differences first."""
    entries = np.argwhere(derivatives.contradicting)
    entries = entries[np.argsort(-np.abs(derivatives.by_robot - derivatives.by_map)[tuple(entries.T)])].tolist()
    listed_ones = "; ".join(derivatives.in_words(*entry) for entry in entries[:_MOST_ENTRIES])
    more = f"; and {len(entries) - _MOST_ENTRIES} others" if len(entries) > _MOST_ENTRIES else ""
    return [f"In half ranges, {listed_ones}{more}."] if entries else []


def causes(steps: Steps, nominal: StepMap, derivatives: Derivatives | None) -> list[str]:
    """The mistake that explains the steps best, and others that do equally well; empty if none explains them.

    Args:
        found: Derivatives of map and robot; None if the map predicts too few of the steps.
    """
    scale = steps.space.state_scale
    ends = steps.next_state / scale
    error = ends - nominal.evaluate(steps.state, steps.requested).next_state / scale
    if np.isfinite(error).all(axis=1).mean() < _PREDICTED:  # a map that predicts nothing leaves all to be explained
        error = ends - steps.space.state_centre / scale
    tried = []
    for sentence, predicted in _mistakes(steps, nominal, derivatives):
        remaining = ends - predicted / scale
        rows = np.isfinite(remaining + error).all(axis=1)
        if rows.sum() < max(_FEWEST, _PREDICTED * np.isfinite(error).all(axis=1).sum()):
            continue
        after = remaining[rows]
        before = error[rows]
        varies = _squares(after - after.mean(axis=0)) / _squares(before - before.mean(axis=0))
        tried.append((varies, _squares(after) / _squares(before), sentence))
    if not tried or min(tried)[0] > 1 - _EXPLAINED:
        return []
    for measure in (0, 1):
        least = min(one[measure] for one in tried)
        tried = [one for one in tried if one[measure] <= _EQUAL * least + 0.002]
    first, *others = [sentence for _, _, sentence in tried]
    return [f"{capitalised(first)}.", *(f"Or, which the steps do not tell apart, {other}." for other in others[:1])]


def _squares(values: Array) -> float:
    return max(float(np.sum(values**2)), 1e-300)


def _mistakes(steps: Steps, nominal: StepMap, derivatives: Derivatives | None) -> Iterator[tuple[str, Array]]:
    """Mistakes that are often made, each with what the map predicts of the steps (N, n) if it was made."""
    space = steps.space
    state = steps.state
    command = steps.requested

    def ends(states: Array, commands: Array) -> Array:
        return nominal.evaluate(states, commands).next_state

    gains = _command_gains(derivatives) if derivatives else {}
    for chosen in [[column] for column in gains] + ([list(gains)] if len(gains) > 1 else []):
        factors = np.ones(len(space.command))
        factors[chosen] = [gains[column] for column in chosen]
        words = [_gain_in_words(derivatives, column, gains[column]) for column in chosen] if derivatives else []
        yield "; ".join(words), ends(state, command * factors)
    for row, gain in _state_gains(space, derivatives):
        factors = np.ones(len(space.state))
        factors[row] = gain
        yield _scale_in_words(space.state[row], gain), factors * ends(state / factors, command)
    for one, other in combinations(range(len(space.command)), 2):
        names = f"{space.command[one].name} and {space.command[other].name}"
        yield (
            f"the commands {names} are exchanged: the robot takes one for the other; correct their order where it "
            "reads them",
            ends(state, command[:, _swapped(len(space.command), one, other)]),
        )
    for one, other in combinations(range(len(space.state)), 2):
        names = f"{space.state[one].name} and {space.state[other].name}"
        swapped = _swapped(len(space.state), one, other)
        yield (
            f"{names} are exchanged in what the robot measures; correct their order where it gives its state",
            ends(state[:, swapped], command)[:, swapped],
        )
    for count in (1, 2):
        before = _earlier(steps, count)
        columns = range(len(space.command))
        for chosen in [[column] for column in columns] + ([list(columns)] if len(space.command) > 1 else []):
            late = command.copy()
            late[:, chosen] = before[:, chosen]
            yield _late_in_words([space.command[column].name for column in chosen], count), ends(state, late)


def _swapped(size: int, one: int, other: int) -> list[int]:
    """Numbers from 0, two of which are exchanged."""
    numbers = list(range(size))
    numbers[one], numbers[other] = other, one
    return numbers


def _earlier(steps: Steps, count: int) -> Array:
    """Commands of the steps some steps before, NaN where these are not among them; shape (N, m)."""
    earlier = steps.requested
    for _ in range(count):
        earlier = np.where(steps.follows[:, None], np.roll(earlier, 1, axis=0), np.nan)
    return earlier


def _command_gains(derivatives: Derivatives) -> dict[int, float]:
    """Ratio of robot to map of the commands some effects of which contradict the map, by their numbers."""
    n = len(derivatives.space.state)
    return {
        column: derivatives.gain(np.s_[:, n + column])
        for column in range(len(derivatives.space.command))
        if derivatives.contradicting[:, n + column].any()
    }


def _state_gains(space: StepSpace, derivatives: Derivatives | None) -> Iterator[tuple[int, float]]:
    """Factors with which each state may be measured: −1, those of other units, and what its responses say."""
    n = len(space.state)
    for row, quantity in enumerate(space.state):
        usual = [-1.0, *_UNITS.get(quantity.unit, {})]
        yield from ((row, factor) for factor in usual)
        if derivatives and derivatives.contradicting[row].any():
            gain = derivatives.gain(np.s_[row, n:])
            if abs(gain) > _SMALLEST_GAIN and not any(1 / _ALIKE < gain / factor < _ALIKE for factor in usual):
                yield row, gain


_SMALLEST_GAIN: Final = 0.12  # Factor of an effect below which there is none
_ALIKE: Final = 1.4  # Two factors are alike up to this ratio

_UNITS: Final = {
    "m": {100.0: "cm", 1000.0: "mm"},
    "m/s": {3.6: "km/h", 100.0: "cm/s", 1000.0: "mm/s"},
    "rad": {180 / np.pi: "degrees"},
    "rad/s": {180 / np.pi: "degrees per second"},
    "s": {1000.0: "ms"},
}
"""Factors and names of other units in which a quantity is often measured, by its unit."""

_GAINS: Final = {180 / np.pi: "degrees and radians", 1000.0: "a thousand", 100.0: "a hundred", 9.81: "gravity"}
"""Factors of commands that have a usual reason."""


def _gain_in_words(derivatives: Derivatives, column: int, gain: float) -> str:
    """What a factor of a command means, and what to do."""
    n = len(derivatives.space.state)
    command = derivatives.space.command[column].name
    effects = np.maximum(np.abs(derivatives.by_map), np.abs(derivatives.by_robot))[:, n + column] > _WEIGHTY
    moved = listed([quantity.name for quantity, moves in zip(derivatives.space.state, effects, strict=True) if moves])
    if abs(gain) < _SMALLEST_GAIN:
        return (
            f"{command} has no effect on {moved} in the robot; look whether the robot's program takes this command, "
            "and whether its drive receives it"
        )
    size = f"{abs(gain):.2g} times as strongly as by the map"
    if gain < 0:
        also = "" if 1 / _ALIKE < -gain < _ALIKE else f", {size}"
        return (
            f"{command} acts on {moved} with the opposite sign{also}; reverse its sign, either in the robot's program "
            "or in the map"
        )
    usual = [f" (is it {name}?)" for factor, name in _GAINS.items() if abs(max(gain, 1 / gain) / factor - 1) < 0.1]
    return (
        f"{command} acts on {moved} {size}{''.join(usual)}; compare the unit of the command, its gain in the robot's "
        "program, and limits of the drive with the map"
    )


def _scale_in_words(quantity: Quantity, gain: float) -> str:
    """What a factor of a measured state means, and what to do."""
    name = quantity.name
    if unit := _UNITS.get(quantity.unit, {}).get(gain):
        return (
            f"{name} is measured in {unit} instead of {quantity.unit}; divide it by {gain:.4g} where the robot gives it"
        )
    if 1 / _ALIKE < -gain < _ALIKE:
        return f"{name} is measured with the opposite sign (mirrored); reverse its sign where the robot gives its state"
    sign = " with the opposite sign and" if gain < 0 else ""
    return f"{name} is measured{sign} {abs(gain):.2g} times too large; check its unit and its sensor"


def _late_in_words(commands: Sequence[str], steps: int) -> str:
    """What a delay means, and what to do."""
    acts = "acts" if len(commands) == 1 else "act"
    delay, follows = ("one step", "the step") if steps == 1 else (f"{steps} steps", f"{steps} steps")
    return (
        f"{listed(commands)} {acts} {delay} too late in the robot: steps follow the command of {follows} before; give "
        "it to the robot before the step begins, or make the command before a coordinate of the state"
    )


_BREAK_EXPLAINS: Final = 0.75  # Part of the unexplained squares that a jump has to explain
_SMALLEST_BREAK: Final = 0.1  # Smallest jump that is a finding [half ranges]
_SMOOTHER: Final = 0.6  # Part of what kinks and cubics leave that a jump may leave at most
_RAMPS: Final = (0.1, 0.2)  # Half widths of ramps, such as of a dead band, that are tried [half ranges]
_KINKS: Final = 15  # Number of places at which a kink is tried
_BESIDE: Final = 4  # Number of steps on each side of a jump, at least


def break_of(derivatives: Derivatives) -> str:
    """A sentence on a jump of the robot's next state; empty if there is none.

    Args:
        found: Derivatives of map and robot.
    """
    residual = derivatives.residual
    squares = np.sum(residual**2, axis=0)
    best = (0.0, 0, 0, 0.0)
    for column in range(1, derivatives.basis.shape[1]):
        values = np.sort(derivatives.basis[:, column])
        for place in 0.5 * (values[_BESIDE - 1 : -_BESIDE] + values[_BESIDE : len(values) - _BESIDE + 1]):
            side = (derivatives.basis[:, column] > place).astype(float)
            shares = _explained(derivatives, side[:, None], residual) / np.maximum(squares, 1e-300)
            row = int(np.argmax(np.where(squares > len(residual) * (0.2 * _SMALLEST_BREAK) ** 2, shares, 0)))
            best = max(best, (float(shares[row]), row, column, float(place)))
    share, row, column, place = best
    if share < _BREAK_EXPLAINS:
        return ""
    z = derivatives.basis[:, column]
    side = (z > place).astype(float)
    weights = np.linalg.lstsq(np.column_stack([derivatives.basis, side]), derivatives.error[:, row], rcond=1e-9)[0]
    places = np.quantile(z, np.linspace(0.1, 0.9, _KINKS))
    shapes = [np.maximum(z - at, 0)[:, None] for at in places]
    shapes += [np.clip((z - at) / width, -1, 1)[:, None] for width in _RAMPS for at in (*places, place)]
    shapes.append(np.column_stack([z**2, z**3]))
    smooth = max(_explained(derivatives, shape, residual)[row] for shape in shapes) / squares[row]
    if abs(weights[-1]) < _SMALLEST_BREAK or 1 - share > _SMOOTHER * (1 - smooth):
        return ""
    space = derivatives.space
    name = space.names[column - 1]
    quantity = (*space.state, *space.command)[column - 1]
    middle = 0.5 * (quantity.lower + quantity.upper)
    at = middle + place * 0.5 * (quantity.upper - quantity.lower)
    text = (
        f"In the robot, {space.state[row].name} jumps by {abs(weights[-1]):.2g} half ranges where {name} passes about "
        f"{at:.3g} {quantity.unit}".rstrip()
    )
    advice = "look for a switch, a stop or a case distinction there, or keep the ranges on one side of it"
    return f"{text}: {advice}."


def _explained(derivatives: Derivatives, columns: Array, residual: Array) -> Array:
    """By how much further columns (N, k) of the regression reduce the squares of the residual (N, n); shape (n,)."""
    added = _left(derivatives.basis, columns)
    after = residual - added @ np.linalg.lstsq(added, residual, rcond=1e-9)[0]
    return np.asarray(np.sum(residual**2, axis=0) - np.sum(after**2, axis=0), float)


REMEMBERED: Final = 0.15  # Smallest deviation due to the steps before that is a finding [half ranges]
LEAST_REMEMBERED: Final = 0.05  # The same, where the effects of state and command contradict the map
_MOST_OF_IT: Final = 0.5  # Part of the unexplained squares that the steps before have to explain
_UNEXPLAINED: Final = 0.3  # Smallest deviation that nothing explains and that is a finding [half ranges]
_ABOVE_NOISE: Final = 3.0  # It is more than this number of deviations of a repeated step


def unmeasured_state(derivatives: Derivatives, noise: Array, least: float = REMEMBERED) -> Iterator[str]:
    """Sentences on states whose errors depend on more than state and command.

    Args:
        found: Derivatives of map and robot.
        noise: Deviation of a repeated step [half ranges], NaN if it is not known; shape (n,).
        least: Smallest deviation due to the steps before that is a finding [half ranges].
    """
    basis = derivatives.basis
    steps = derivatives.steps
    residual = _left(basis, derivatives.error)
    rows = np.flatnonzero(steps.follows & np.roll(steps.follows, 1))
    explaining = basis[rows]
    if len(rows) < 2 * explaining.shape[1]:
        return
    for row, quantity in enumerate(derivatives.space.state):
        before = np.column_stack([residual[rows - 1, row], residual[rows - 2, row], derivatives.basis[rows - 1, 1:]])
        error = derivatives.error[rows, row]
        total = _squares(_left(explaining, error)) / max(len(rows) - explaining.shape[1], 1)
        both = np.column_stack([explaining, before])
        left = _squares(_left(both, error)) / max(len(rows) - both.shape[1], 1)
        part = 1 - left / total
        unexplained = float(np.sqrt(total))
        noisy = max(_UNEXPLAINED, _ABOVE_NOISE * float(np.nan_to_num(noise[row])))
        # Curvature looks like memory, since states of neighbouring steps are alike.
        curved = _explained(derivatives, basis[:, 1:] ** 2, residual)[row] / _squares(residual[:, row])
        if curved >= _MOST_OF_IT:
            continue
        if part > _MOST_OF_IT and np.sqrt(part) * unexplained > least:
            yield (
                f"The robot remembers: {part:.0%} of the squared error of {quantity.name} that state and command do "
                f"not explain ({unexplained:.2g} half ranges) follows from the steps before. Something that lasts is "
                "not measured, such as a velocity, a spring, or which leg stands: make it a state, or take two steps "
                "as one."
            )
        elif unexplained > noisy:
            yield (
                f"State and command do not explain {unexplained:.2g} half ranges of {quantity.name}. A state is not "
                "measured, or the robot is not smooth: look for what else differs between two steps from one state "
                "with one command."
            )
