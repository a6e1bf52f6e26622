"""What else could be the step command: effects of settings on the next state, and what pairs of them cost."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.box_points import composite_design
from stepgap.control.limit_cycle import fixed_point
from stepgap.experiment.settings import Experiment
from stepgap.robots.knobs import Knob, turned
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepFailed, StepMap, StepSpace

REGION = 0.6
"""Part of the ranges of use over which the gaits are spread."""

_DIFFERENCE = 0.1
"""Step of the differences, as a part of the range of a knob; longer than the effect of a tick of a simulator."""

_WANTED = 0.5
"""Wanted change of each state coordinate for which loads are computed [half ranges of use, by their weights]."""

_TINY = 1e-300
"""Least divisor, where a knob has no effect."""

OnGait = Callable[[int, int], None]
"""Called with the number of gaits that are done, and of all."""


@dataclass(frozen=True, eq=False)
class KnobPair:
    """Two knobs as a step command.

    Attributes:
        first, second: Numbers of the knobs.
        angle: Angle between their effects, in errors that count as one, the mean over the gaits [rad]; π/2 if each
            changes what the other does not.
        condition: Largest ratio of what the pair does in its strongest and in its weakest direction, within the ranges.
        missed: Part of the wanted steps that are out of the ranges, by the linear effects; NaN where other than two
            coordinates are tracked.
        loads: Largest load in the wanted steps within the ranges, by name: the gaits, and a change of each coordinate.
    """

    first: int
    second: int
    angle: float
    condition: float
    missed: float
    loads: dict[str, float]


@dataclass(frozen=True, eq=False)
class KnobStudy:
    """Effects of knobs at gaits all over the region of use, and pairs of them.

    Attributes:
        space: Step space of the robot, with the weights of the experiment.
        knobs: First the coordinates of the command, then the settings.
        failed: Other settings, with a part of whose range the robot is not valid or a step fails.
        states: The gaits; shape (g, n).
        left_out: Number of other states that no command holds, or at which a step fails.
        effects: Change of the next state [state units] by the whole range of a knob; shape (g, n, k).
        pairs: All pairs, that of the least condition number first.
    """

    space: StepSpace
    knobs: tuple[Knob, ...]
    failed: tuple[Knob, ...]
    states: Array
    left_out: int
    effects: Array
    pairs: tuple[KnobPair, ...]


def study_knobs(settings: Experiment, on_gait: OnGait = lambda done, total: None) -> KnobStudy:
    """Compares what could be the step command of a robot, by the nominal map with other settings.

    Args:
        settings: The experiment.
        on_gait: Called as gaits are found.

    Raises:
        InputError: The nominal map is not the robot's, or no gait is held.
    """
    robot, kind = settings.robot, settings.nominal.kind
    if kind not in robot.nominal_maps():
        known = ", ".join(robot.nominal_maps()) or "none"
        raise InputError(
            f"nominal.kind = {kind}: robot '{robot.name}' does not make it from its settings, so they have no "
            f"effect on it; it must be one of {known}"
        )
    space = settings.space
    commands = (Knob(each.name, each.unit, (each.upper - each.lower) / 2) for each in space.command)
    all_knobs = (*commands, *robot.knobs())
    targets, states, commands_there, effects = _targets(space), list[Array](), list[Array](), list[Array]()
    nominal = robot.nominal_maps()[kind]()
    for done, target in enumerate(targets):
        on_gait(done, len(targets))
        try:
            gait = fixed_point(nominal, target)
        except StepFailed:
            continue
        if gait.held:
            states.append(gait.state)
            commands_there.append(gait.command)
            effects.append(
                np.stack([_effect(robot, kind, knob, gait.state, gait.command) for knob in all_knobs], axis=1)
            )
    if not states:
        raise InputError(
            f"robot '{robot.name}': no command holds any of {len(targets)} states in its ranges of use, so there is no "
            "gait at which settings could be compared"
        )
    found = np.array(effects)
    moved = [number for number in range(len(all_knobs)) if np.isfinite(found[:, :, number]).all()]
    knobs = tuple(all_knobs[number] for number in moved)
    failed = tuple(knob for number, knob in enumerate(all_knobs) if number not in moved)
    left_out = len(targets) - len(states)
    study = KnobStudy(space, knobs, failed, np.array(states), left_out, found[:, :, moved], ())
    pairs = sorted(_pairs(robot, study, np.array(commands_there)), key=lambda pair: pair.condition)
    return replace(study, pairs=tuple(pairs))


def _targets(space: StepSpace) -> Array:
    """States spread over the region, NaN where the state is not tracked; shape (g, n)."""
    tracked = np.flatnonzero(space.tracked)
    targets = np.full((len(design := composite_design(len(tracked))), len(space.state)), np.nan)
    targets[:, tracked] = space.state_centre[tracked] + REGION * design * space.state_scale[tracked]
    return targets


def _effect(robot: Robot, kind: str, knob: Knob, state: Array, command: Array) -> Array:
    """Change of the next state by the whole range of a knob; shape (n,), NaN where a step or a setting fails."""

    def moved(change: float) -> Array:
        changed, under = _under(robot, {knob.key: change}, command)
        return _map(changed, kind).evaluate(state, under).next_state

    step = _DIFFERENCE * knob.reach
    try:
        return (moved(step) - moved(-step)) / (2 * _DIFFERENCE)
    except ValueError:  # a setting is out of its range
        return np.full(len(state), np.nan)


def _map(robot: Robot, kind: str) -> StepMap:
    return robot.nominal_maps()[kind]()


def _under(robot: Robot, changes: dict[str, float], command: Array) -> tuple[Robot, Array]:
    """A robot and a command with changes of settings and of coordinates of the command."""
    names = robot.space.command_names
    more = np.array([changes.get(name, 0.0) for name in names])
    return turned(robot, {key: change for key, change in changes.items() if key not in names}), command + more


def _pairs(robot: Robot, study: KnobStudy, commands: Array) -> Iterator[KnobPair]:
    tracked, keys = study.space.tracked, np.array([knob.key for knob in study.knobs])
    scaled = study.effects[:, tracked] / study.space.error_scale[tracked, None]
    for chosen in map(list, combinations(range(len(keys)), 2)):
        two = scaled[:, :, chosen]
        sizes = np.linalg.norm(two, axis=1)
        cosines = np.abs((two[:, :, 0] * two[:, :, 1]).sum(axis=1)) / np.maximum(sizes.prod(axis=1), _TINY)
        moves = (
            _moves(study, scaled, commands, chosen) if tracked.sum() == 2 else np.empty((len(commands), 0, len(keys)))
        )
        hits = np.abs(moves[:, :, chosen]).max(axis=2) <= 1
        loads = [
            _loads(robot, dict(zip(keys, move * [knob.reach for knob in study.knobs], strict=True)), *place)
            for place, there, hit in zip(zip(study.states, commands, strict=True), moves, hits, strict=True)
            for move in there[hit]
        ]
        yield KnobPair(
            *chosen,
            angle=float(np.arccos(np.minimum(cosines, 1)).mean()),
            condition=float(np.linalg.cond(two).max()) if (sizes > 0).all() else np.inf,
            missed=float(1 - hits.mean()) if hits.size else np.nan,
            loads={name: max(each[name] for each in loads) for name in (loads[0] if loads else {})},
        )


def _moves(study: KnobStudy, scaled: Array, commands: Array, pair: list[int]) -> Array:
    """Changes of all knobs [ranges] with which a pair alone, as the command, makes the wanted steps, by linear effects.

    The other coordinates of the command go to the middle of their bounds, so the pair holds the gaits instead of them.

    Returns:
        Shape (gaits, wanted changes, k).
    """
    others = [number for number in range(commands.shape[1]) if number not in pair]
    rest = (study.space.command_centre - commands) / study.space.command_scale
    wanted = _WANTED * np.concatenate([np.zeros((1, 2)), np.eye(2), -np.eye(2)])
    missing = wanted - np.einsum("gnk,gk->gn", scaled[:, :, others], rest[:, others])[:, None]
    moves = np.zeros((len(commands), len(wanted), scaled.shape[2]))
    moves[:, :, pair] = np.swapaxes(np.linalg.pinv(scaled[:, :, pair], rcond=1e-9) @ np.swapaxes(missing, 1, 2), 1, 2)
    moves[:, :, others] = rest[:, None, others]
    return moves


def _loads(robot: Robot, changes: dict[str, float], state: Array, command: Array) -> dict[str, float]:
    try:
        changed, under = _under(robot, changes, command)
    except ValueError:  # a setting is out of its range with so large a change
        return dict.fromkeys(robot.loads(state, command), np.nan)
    return dict(changed.loads(state, under))


def largest_effect(study: KnobStudy) -> Array:
    """Mean size of the effect of each knob over the gaits, in errors that count as one; shape (k,)."""
    tracked = study.space.tracked
    return np.linalg.norm(study.effects[:, tracked] / study.space.error_scale[tracked, None], axis=1).mean(axis=0)
