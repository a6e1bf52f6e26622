"""What can be tested of a nominal map alone: whether it keeps to what a map is, its derivatives, and that it is smooth.

All are compared in half ranges: a derivative is the change of the next state, in half ranges, by a change of a state
or command by half its range.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reach import SMALL_PART
from stepgap.control.reference import Reference
from stepgap.control.wrapped_map import MapInSpace
from stepgap.experiment.nominal import check_surrogate
from stepgap.records.text import in_words, listed
from stepgap.report.robot_check import PartResult, half_ranges
from stepgap.robots.nominal_maps.differenced_map import DifferencedMap, has_no_formula
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap
from stepgap.step import Array, Outcome, StepFailed, StepMap, StepSpace, StepStatus, difference_jacobian

_POINTS: Final = 16  # Number of points at which a map is evaluated
_REPEATED: Final = 1e-9  # Largest difference between two evaluations of one step [half ranges]
_SPREAD: Final = 0.8  # Part of the half ranges in which these points lie


def check_map(nominal: StepMap, rng: np.random.Generator) -> Iterator[PartResult]:
    """Whether a surrogate predicts enough, and the map steps from the middle of the ranges, always to one state."""
    space = nominal.space
    text = ""
    if isinstance(nominal, SurrogateMap):
        check_surrogate(nominal)
        status = nominal.samples.status
        text = (
            f" The surrogate of {len(status)} simulated steps, {np.mean(status != StepStatus.OK):.0%} of which failed, "
            f"misses the next state by {half_ranges(space, nominal.error / space.state_scale)} half ranges."
        )
    if fault := _broken_rule(nominal, rng):
        yield PartResult("map", "wrong", fault + text)
        return
    try:
        nominal(space.state_centre, space.command_centre)
    except StepFailed as error:
        failed = np.mean(nominal.evaluate(*_points(space, rng, 10 * _POINTS)).status != StepStatus.OK)
        advice = f"Of random steps within the ranges, {failed:.0%} fail. Choose ranges about a motion of the robot."
        if failed == 1:
            advice = "Nor does it anywhere else: compare the units of the ranges with those of the map."
        fault = f"From the middle of all ranges it makes no step ({error.status.label})."
        yield PartResult("map", "wrong", f"{fault} {advice}{text}")
    else:
        sentence = f"From the middle of all ranges it makes a step; equal steps end in equal states.{text}"
        yield PartResult("map", "ok", sentence)


def _broken_rule(nominal: StepMap, rng: np.random.Generator) -> str:
    """A sentence on the first rule of `StepMap.evaluate` that some random steps break; empty if there is none."""
    space = nominal.space
    states, commands = _points(space, rng, _POINTS)
    given = states.copy(), commands.copy()
    first = nominal.evaluate(*given)
    if np.shape(first.next_state) != states.shape or np.shape(first.status) != states.shape[:1]:
        return (
            f"Of {_POINTS} steps at once, it returns next states of shape {np.shape(first.next_state)} and a status "
            f"of shape {np.shape(first.status)}; they must be {states.shape} and {states.shape[:1]}."
        )
    if not all(np.array_equal(one, other) for one, other in zip(given, (states, commands), strict=True)):
        return "It changes the arrays that it is given: `evaluate` must compute with copies of state and command."
    done = first.status == StepStatus.OK
    if (endless := done & ~np.isfinite(first.next_state).all(axis=1)).any():
        names = [space.state[row].name for row in np.flatnonzero(~np.isfinite(first.next_state[endless]).all(axis=0))]
        where = _step_in_words(space, states[endless][0], commands[endless][0])
        return (
            f"{np.count_nonzero(endless)} of {_POINTS} steps have status OK, but no finite {listed(names)}, for "
            f"example that {where}. Give such steps a status that says how they failed."
        )
    return _changing(nominal, states, commands, first)


def _changing(nominal: StepMap, states: Array, commands: Array, first: Outcome) -> str:
    """A sentence if steps end otherwise when they are evaluated again, in another order, or alone; else empty."""
    space = nominal.space
    again = nominal.evaluate(states, commands)
    backwards = nominal.evaluate(states[::-1], commands[::-1])
    alone = [nominal.evaluate(*point) for point in zip(states, commands, strict=True)]
    of_others = Outcome(backwards.next_state[::-1], backwards.status[::-1])
    by_itself = Outcome(np.array([one.next_state for one in alone]), np.array([one.status for one in alone]))
    for other, fault, advice in (
        (again, "It is not deterministic: evaluated twice, a step", _RANDOM_ADVICE),
        (of_others, "It mixes up steps: evaluated with others in another order, a step", _MIXED_ADVICE),
        (by_itself, "It mixes up steps: evaluated alone, and together with others, a step", _MIXED_ADVICE),
    ):
        change = np.nanmax(np.abs(other.next_state - first.next_state) / space.state_scale, axis=0, initial=0)
        if (change > _REPEATED).any() or (other.status != first.status).any():
            return f"{fault} ends in states that differ by up to {half_ranges(space, change)} half ranges. {advice}"
    return ""


_RANDOM_ADVICE: Final = "Take random numbers and memory of earlier calls out of it; noise belongs to the plant."
_MIXED_ADVICE: Final = "Compute each step from its own state and command: index them as `state[..., 0]`."


def _points(space: StepSpace, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Random states (k, n) and commands (k, m) within the ranges."""
    states = space.state_centre + _SPREAD * space.state_scale * rng.uniform(-1, 1, (count, len(space.state)))
    return states, space.command_at(_SPREAD * rng.uniform(-1, 1, (count, len(space.command))))


def _step_in_words(space: StepSpace, state: Array, command: Array) -> str:
    return f"from {in_words(space.state, state)} with {in_words(space.command, command)}"


_DIFFERENCES: Final = (1e-4, 1e-3, 1e-2)
"""Sizes of the differences with which a formula is compared [half ranges]; what they disagree about is not judged."""
_WRONG_PART: Final = 0.1  # Part of a derivative by which its formula may be wrong
_WRONG_LEAST: Final = 0.005  # Error of a derivative that is never wrong [half ranges]
_OFTEN: Final = 0.25  # Part of the points at which a derivative is wrong from which on its formula is


def check_jacobian(nominal: StepMap, rng: np.random.Generator) -> Iterator[PartResult]:
    """Whether the formula of the derivatives agrees with differences, entry by entry."""
    inner = nominal.inner if isinstance(nominal, MapInSpace) else nominal
    if has_no_formula(inner) or isinstance(inner, DifferencedMap):
        yield PartResult("jacobian", "ok", "It has no formula: differences of the map are used.")
        return
    space = nominal.space
    states, commands = _points(space, rng, _POINTS)
    scale = np.concatenate([space.state_scale, space.command_scale]) / space.state_scale[:, None]
    given = nominal.jacobian(states, commands)
    if np.shape(given) != (_POINTS, *scale.shape):
        text = f"At {_POINTS} points it has the shape {np.shape(given)}; it must be {(_POINTS, *scale.shape)}."
        yield PartResult("jacobian", "wrong", text)
        return
    differences = np.array([difference_jacobian(nominal, states, commands, step) for step in _DIFFERENCES])
    doubt = np.ptp(differences, axis=0)
    numeric = np.median(differences, axis=0)
    off = np.abs(given - numeric) > _WRONG_PART * np.abs(numeric) + _WRONG_LEAST / scale + 2 * doubt
    off |= ~np.isfinite(given) & np.isfinite(numeric)
    judged = np.maximum(np.isfinite(numeric + doubt).sum(axis=0), 1)
    wrong = np.argwhere(off.sum(axis=0) > _OFTEN * judged)
    if not len(wrong):
        yield PartResult("jacobian", "ok", "Its formula agrees with differences of the map.")
        return
    sentences = []
    for row, column in wrong.tolist():
        example = _example(off[:, row, column], given[:, row, column], numeric[:, row, column])
        sentences.append(_entry_in_words(space, row, column, *example))
    advice = "Correct the formula, or write `jacobian = difference_jacobian`"
    yield PartResult("jacobian", "wrong", f"{'; '.join(sentences)}. {advice}.")


def _example(off: NDArray[np.bool_], given: Array, numeric: Array) -> tuple[float, float]:
    """The formula and the difference at the point where a wrong derivative (k,) is largest."""
    point = np.argmax(off * (np.nan_to_num(np.abs(numeric)) + 1e-300))
    return float(given[point]), float(numeric[point])


def _entry_in_words(space: StepSpace, row: int, column: int, formula: float, exact: float) -> str:
    """A wrong derivative, and what is probably wrong with it."""
    name = f"∂{space.state[row].name}/∂{space.names[column]}"
    return f"{name} is {formula:.3g} by the formula, but {exact:.3g} by differences{_kind(formula, exact)}"


def _kind(formula: float, exact: float) -> str:
    """What is probably wrong with a derivative, as the end of a clause."""
    if not np.isfinite(formula):
        return ""
    if abs(formula) < _WRONG_PART * abs(exact):
        return ": this effect is missing"
    if abs(formula + exact) < _WRONG_PART * abs(exact):
        return ": its sign is wrong"
    return f": it is {formula / exact:.3g} times as large" if abs(exact) > 1e-9 else ""


_LINES: Final = 16  # Number of lines across the ranges along which a map is followed
_ALONG: Final = 33  # Number of points on a line
_ZOOMS: Final = 6  # Number of times that the interval with the largest change is divided
_PARTS: Final = 8  # Number of parts into which it is divided
_JUMP: Final = 0.02  # Change within the last interval that is a jump [half ranges]


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines across the ranges of a map, in half ranges.

    Attributes:
        nominal: The map.
        middle: A point of each line; shape (lines, n + m).
        direction: Its direction; shape (lines, n + m).
    """

    nominal: StepMap
    middle: Array
    direction: Array

    @classmethod
    def drawn(cls, nominal: StepMap, rng: np.random.Generator) -> Self:
        """Random lines."""
        size = len(nominal.space.names)
        direction = rng.normal(size=(_LINES, size))
        middle = 0.5 * rng.uniform(-1, 1, (_LINES, size))
        return cls(nominal, middle, direction / np.abs(direction).max(axis=1, keepdims=True))

    def inputs(self, places: Array) -> tuple[Array, Array]:
        """States (lines, k, n) and commands (lines, k, m) at places (lines, k) on the lines."""
        space = self.nominal.space
        n = len(space.state)
        points = np.clip(self.middle[:, None] + places[..., None] * self.direction[:, None], -1, 1)
        return space.state_centre + space.state_scale * points[..., :n], space.command_at(points[..., n:])

    def changes(self, places: Array) -> Array:
        """Changes of the next state between places; shape (lines, k − 1, n)."""
        return np.diff(self.nominal.evaluate(*self.inputs(places)).next_state, axis=1) / self.nominal.space.state_scale


def check_smooth(nominal: StepMap, rng: np.random.Generator) -> Iterator[PartResult]:
    """Whether the next state changes without jumps along some lines across the ranges.

    Along each line, the interval whose change differs most from those beside it is divided again and again. What
    changes smoothly changes eight times less within each part; a jump stays as it is.
    """
    lines = _Lines.drawn(nominal, rng)
    rows = np.arange(_LINES)
    places = np.tile(np.linspace(-1.5, 1.5, _ALONG), (_LINES, 1))
    change = lines.changes(places)
    beside = 0.5 * (np.roll(change, 1, axis=1) + np.roll(change, -1, axis=1))
    odd = np.nan_to_num(np.abs(change - beside)).max(axis=2)
    for _ in range(_ZOOMS):
        chosen = np.argmax(odd, axis=1)
        places = np.linspace(places[rows, chosen], places[rows, chosen + 1], _PARTS + 1, axis=1)
        change = np.nan_to_num(np.abs(lines.changes(places)))
        odd = change.max(axis=2)
    line, part = np.unravel_index(np.argmax(odd), odd.shape)
    if not odd[line, part] > _JUMP:
        yield PartResult("smooth", "ok", f"Along {_LINES} lines across the ranges, the next state has no jumps.")
        return
    state, command = (values[line, part] for values in lines.inputs(places))
    name = nominal.space.state[int(np.argmax(change[line, part]))].name
    yield PartResult(
        "smooth",
        "wrong",
        f"{name} jumps by {odd[line, part]:.2g} half ranges {_step_in_words(nominal.space, state, command)}. Look for "
        "a case distinction or an event that is located too coarsely there; controllers and learning need a map "
        "without jumps.",
    )


def check_authority(nominal: StepMap, held: Reference) -> Iterator[PartResult]:
    """How far each command moves each state within its bounds, about the first target."""
    space = nominal.space
    point = fixed_point(nominal, held.targets[0])
    sentences = []
    idle = []
    for column, quantity in enumerate(space.command):
        commands = np.tile(point.command, (_ALONG, 1))
        commands[:, column] = np.linspace(quantity.lower, quantity.upper, _ALONG)
        reached = nominal.evaluate(point.state, commands)
        done = reached.status == StepStatus.OK
        if not done.any():
            continue
        moved = np.ptp(reached.next_state[done], axis=0) / space.state_scale
        sizes = zip(space.state_names, moved, strict=True)
        parts = [f"{name} by {size:.2g}" for name, size in sizes if size >= SMALL_PART]
        if parts:
            failed = f" ({np.mean(~done):.0%} of its range fails)" if not done.all() else ""
            sentences.append(f"{quantity.name} moves {listed(parts)}{failed}")
        else:
            idle.append(quantity.name)
    text = f"Between their bounds, in half ranges: {'; '.join(sentences)}." if sentences else ""
    if idle:
        text = (
            f"By the map, {listed(idle, 'or')} moves no state. Add the effect to the map, or leave the command out of "
            f"the space. {text}"
        )
    yield PartResult("authority", "wrong" if idle else "ok", text.strip())
