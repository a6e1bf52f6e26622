"""What a robot does with which command, in sentences, and which commands would make that surer."""

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.control.box_points import box_points
from stepgap.control.command_before import MapWithCommand, StandingMap, space_with_command
from stepgap.control.reach import whole_state
from stepgap.cure.drive import AXIS_NAMES
from stepgap.cure.lesson import Lesson
from stepgap.learning.residual import join_points
from stepgap.records.text import listed
from stepgap.step import Array

_STEPS: Final = 20  # Steps after which a held command has its velocity
_NEAR: Final = 0.35  # A command was driven if it lies so near to one of the log [half ranges]
_SAME: Final = 0.02  # Commands are the same if they differ by less [half ranges]
_FEWEST: Final = 3  # Number of steps of which a mean is taken
_SMALL: Final = (0.02, 0.02, 0.03)  # Velocities that are not worth a word [m/s, m/s, rad/s]
_STILL: Final = 3.0  # It stands if nothing is sure, and its velocity with its deviation is at most so many times that
_SURE: Final = 2.0  # Standard deviations from which on a velocity is not by chance
NEXT: Final = 10  # Number of commands that are proposed
_TRIED: Final = 81  # Number of commands that are compared for that
_DIRECTIONS_TRIED: Final = 300  # Number of directions in which velocities are compared
_UNDRIVEN: Final = (0.2, 0.15, 0.4)  # Commands that are proposed where none was driven [m/s, m/s, rad/s]
_DIRECTIONS: Final = (("forward", "backward"), ("to the left", "to the right"), ("to the left", "to the right"))


@final
@dataclass(frozen=True, eq=False)
class Habit:
    """What the robot does while a command is held.

    Attributes:
        asked: The command; shape (3,).
        does: Velocity that it has then; shape (3,).
        std: Its standard deviation, as far as the log says; shape (3,).
        was_driven: Whether a command near it is in the log.
        corrected: The command that makes it do what is asked; shape (3,).
    """

    asked: Array
    does: Array
    std: Array
    was_driven: bool
    corrected: Array

    def in_words(self) -> str:
        """A sentence on what was asked and what is done."""
        asked = _asked_in_words(self.asked)
        does = _done_in_words(self.does, self.std, self.asked)
        unsure = "" if self.was_driven else " (no such command is in the log)"
        return f"{asked}, it {does}{unsure}."


def _asked_in_words(command: Array) -> str:
    if not command.any():
        return "Asked to stand"
    if command[0] > 0 and not command[1:].any():
        return f"Asked for {command[0]:.2f} m/s straight on"
    units = ("m/s", "m/s", "rad/s of turning")
    parts = [f"{abs(value):.2f} {units[axis]} {_direction(axis, value)}" for axis, value in enumerate(command) if value]
    return f"Asked for {listed(parts)}"


def _done_in_words(velocity: Array, std: Array, asked: Array) -> str:
    sure = (np.abs(velocity) > np.maximum(_SMALL, _SURE * std)).tolist()
    if not any(sure):
        is_still = (np.abs(velocity) + std <= _STILL * np.array(_SMALL)).all()
        return "stands" if is_still else "has no velocity that is sure"
    verbs = ["walks ", "drifts "]
    if velocity[1] * asked[1] > 0:  # to the side that was asked for
        verbs[1] = "" if sure[0] else "walks "
    axis_words = [
        f"{verbs[axis]}{abs(velocity[axis]):.2f} m/s {_direction(axis, velocity[axis])}"
        for axis in (0, 1)
        if sure[axis]
    ]
    if sure[2]:
        degrees = np.degrees(abs(velocity[2]))
        axis_words.append(f"turns {abs(velocity[2]):.2f} rad/s ({degrees:.0f}°/s) {_direction(2, velocity[2])}")
    return listed(axis_words)


def _direction(axis: int, value: float) -> str:
    return _DIRECTIONS[axis][int(value < 0)]


def habits_of(lesson: Lesson) -> list[Habit]:
    """What the robot does with the usual commands of the log, from standing to turning."""
    return [_habit(lesson, command) for command in _usual(lesson)]


def _usual(lesson: Lesson) -> list[Array]:
    """Standing, and the median of each direction that was commanded."""
    commands = lesson.steps.command
    usual = [np.zeros(3)]
    for axis, step in enumerate((0.05, 0.05, 0.1)):
        for sign in (1, -1):
            values = sign * commands[:, axis]
            given = values[values > max(step, 0.1 * values.max(initial=0.0))]
            if lesson.driven[axis] and len(given) > 2:
                command = np.zeros(3)
                command[axis] = sign * round(float(np.median(given)) / step) * step
                usual.append(command)
    return usual


def _habit(lesson: Lesson, asked: Array) -> Habit:
    space = lesson.space
    does, std = measured(lesson, asked) or steady(lesson, asked)
    away = np.abs(lesson.steps.command - asked) / space.command_scale
    was_driven = bool((away[:, lesson.driven].max(axis=1) < _NEAR).any())
    return Habit(asked, does, std, was_driven, lesson_command(lesson, asked))


def measured(lesson: Lesson, command: Array) -> tuple[Array, Array] | None:
    """Mean velocity of the steps that went on with a command, and its standard error; None for too few of them.

    A map without jumps does not know that a robot stands at the command zero.
    """
    near = np.abs(lesson.steps.command - command) <= _SAME * lesson.space.command_scale
    rows = near.all(axis=1) & ~lesson.held.first
    if np.count_nonzero(rows) < _FEWEST:
        return None
    velocities = lesson.steps.next_state[rows]
    return velocities.mean(axis=0), velocities.std(axis=0, ddof=1) / np.sqrt(len(velocities))


def stands_at_zero(lesson: Lesson) -> bool:
    """Whether the robot was seen to stand at the command zero, which is then passed on as it is."""
    found = measured(lesson, np.zeros(len(AXIS_NAMES)))
    return found is not None and bool((np.abs(found[0]) <= _SMALL).all())


def steady(lesson: Lesson, command: Array) -> tuple[Array, Array]:
    """Velocity that a held command gives, and its standard deviation; shapes (3,)."""
    step_map = lesson.step_map
    velocity = np.array(command, float)
    for _ in range(_STEPS):
        whole = _with_command(lesson, velocity)
        velocity = whole.evaluate(np.append(velocity, command), command).next_state[: len(AXIS_NAMES)]
    return velocity, step_map.std(velocity, command)


def _with_command(lesson: Lesson, velocity: Array) -> MapWithCommand:
    """The learned map with the command before as a state, near a velocity that is held."""
    step_map = lesson.step_map
    before = step_map.command_before
    assert before is not None  # of a walking robot it is always learned
    start = lesson.learner.nominal.evaluate(velocity, before.command).next_state
    return MapWithCommand(step_map, space_with_command(step_map.space), before, start)


def lesson_command(lesson: Lesson, target: Array) -> Array:
    """The command that holds a velocity, by what was learned; where a velocity was not commanded, the target itself."""
    wanted = np.where(lesson.driven, target, np.nan)
    whole = _with_command(lesson, np.asarray(target, float))
    _, command = whole_state(StandingMap(whole, lesson.space), wanted)
    return np.where(lesson.driven, command, target)


def within_reach(lesson: Lesson) -> tuple[int, int]:
    """How many of the commands of the log are velocities that some command gives, and how many there are.

    Some command does if the learned map says so, or if the robot itself had velocities around it. The map has no jumps,
    so by itself it takes slow velocities for unreachable where a robot stands at small commands.
    """
    asked = np.unique(lesson.steps.command, axis=0)[:: max(1, len(lesson.steps) // 100)]
    ends = np.array([steady(lesson, lesson_command(lesson, target))[0] for target in asked])
    near = np.abs(ends - asked) <= np.maximum(0.1 * lesson.space.state_scale, lesson.step_map.noise_std)
    reached = near[:, lesson.driven].all(axis=1) | _is_between(lesson, asked)
    return int(np.count_nonzero(reached)), len(asked)


def _is_between(lesson: Lesson, velocities: Array) -> NDArray[np.bool_]:
    """Whether the robot had velocities on all sides of each: a farther one in any direction; (K, 3) to (K,)."""
    directions = np.random.default_rng(0).standard_normal((_DIRECTIONS_TRIED, len(AXIS_NAMES))) * lesson.driven
    scaled = directions / lesson.space.state_scale
    farthest = (lesson.steps.next_state @ scaled.T).max(axis=0)
    return (velocities @ scaled.T <= farthest).all(axis=1)


def commands_to_drive(lesson: Lesson) -> Array:
    """Commands of which the log says least, the most informative first; shape (`NEXT`, 3).

    Each is chosen as if the one before had been driven: the variance of a map hardly depends on what was measured.
    """
    space = lesson.space
    undriven = np.flatnonzero(~lesson.driven).tolist()
    first = [sign * _UNDRIVEN[axis] * np.eye(3)[axis] for axis in undriven for sign in (1, -1)][:NEXT]
    points = box_points(_TRIED, len(AXIS_NAMES))
    candidates = 0.9 * space.command_at(points) * lesson.driven
    candidates = np.unique(np.round(candidates, 2), axis=0)
    residual = lesson.step_map.residual
    ends = np.array([steady(lesson, command)[0] for command in candidates])
    chosen = list[Array](first)
    inputs = join_points(ends, candidates)
    left = list(range(len(candidates)))
    while len(chosen) < NEXT and left:
        spread = np.sum((residual.std(inputs[left]) / space.state_scale) ** 2, axis=-1)
        best = left.pop(int(np.argmax(spread)))
        chosen.append(candidates[best])
        for _ in range(4):  # held for about four steps
            residual = residual.append(inputs[best], residual.mean(inputs[best]))
    return np.array(chosen)
