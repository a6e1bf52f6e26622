"""What else could be the step command: effects of settings on the next state, and what pairs of them cost."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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

DIFFERENCE = 0.1
"""Step of the differences, as a part of the range of a knob; longer than the effect of a tick of a simulator."""

WANTED = 0.5
"""Wanted change of each state coordinate for which loads are computed [errors that count as one]."""

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
        missed: Part of the wanted changes that are out of the ranges, by the linear effects.
        loads: Largest load over the gaits and wanted changes, by name; NaN without any.
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
        space: Step space of the robot.
        knobs: First the coordinates of the command, then the settings.
        states: The gaits; shape (g, n).
        left_out: Number of other states that no command holds, or at which a step fails.
        effects: Change of the next state [state units] by the whole range of a knob; shape (g, n, k).
        pairs: All pairs, that of the least condition number first.
    """

    space: StepSpace
    knobs: tuple[Knob, ...]
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
        raise InputError(f"nominal.kind = {kind}: only a map that robot '{robot.name}' makes from its settings has ({known})"
                         " effects of settings")
    space = robot.space
    commands = (Knob(each.name, each.unit, (each.upper - each.lower) / 2) for each in space.command)
    knobs = (*commands, *robot.knobs())
    states, bases, effects = [], [], []
    targets = _targets(space)
    nominal = robot.nominal_maps()[kind]()
    for done, target in enumerate(targets):
        on_gait(done, len(targets))
        try:
            gait = fixed_point(nominal, target)
        except StepFailed:
            continue
        effect = np.stack([_effect(robot, kind, knob, gait.state, gait.command) for knob in knobs], axis=1)
        if gait.held and np.isfinite(effect).all():
            states.append(gait.state)
            bases.append(gait.command)
            effects.append(effect)
    if not states:
        raise InputError(
            f"robot '{robot.name}': no command holds any of {len(targets)} states in its ranges of use, so there is no "
            "gait at which settings could be compared"
        )
    study = KnobStudy(space, knobs, np.array(states), len(targets) - len(states), np.array(effects), ())
    pairs = sorted(_pairs(robot, study, np.array(bases)), key=lambda pair: pair.condition)
    return KnobStudy(space, knobs, study.states, study.left_out, study.effects, tuple(pairs))


def _targets(space: StepSpace) -> Array:
    """States spread over the region, NaN where the state is not tracked; shape (g, n)."""
    tracked = np.flatnonzero(space.tracked)
    targets = np.full((len(design := composite_design(len(tracked))), len(space.state)), np.nan)
    targets[:, tracked] = space.state_centre[tracked] + REGION * design * space.state_scale[tracked]
    return targets


def _effect(robot: Robot, kind: str, knob: Knob, state: Array, command: Array) -> Array:
    """Change of the next state by the whole range of a knob; shape (n,), NaN where a step fails."""

    def moved(change: float) -> Array:
        changed, under = _under(robot, {knob.key: change}, command)
        return _map(changed, kind).evaluate(state, under).next_state

    step = DIFFERENCE * knob.reach
    return (moved(step) - moved(-step)) / (2 * DIFFERENCE)


def _map(robot: Robot, kind: str) -> StepMap:
    return robot.nominal_maps()[kind]()


def _under(robot: Robot, changes: dict[str, float], command: Array) -> tuple[Robot, Array]:
    """A robot and a command with changes of settings and of coordinates of the command."""
    names = robot.space.command_names
    more = np.array([changes.get(name, 0.0) for name in names])
    return turned(robot, {key: change for key, change in changes.items() if key not in names}), command + more


def _pairs(robot: Robot, study: KnobStudy, commands: Array) -> Iterator[KnobPair]:
    tracked = study.space.tracked
    scaled = study.effects[:, tracked] / study.space.error_scale[tracked, None]
    wanted = WANTED * np.concatenate([np.eye(tracked.sum()), -np.eye(tracked.sum())])
    for first, second in combinations(range(len(study.knobs)), 2):
        two = scaled[:, :, [first, second]]
        sizes = np.linalg.norm(two, axis=1)
        cosines = np.abs((two[:, :, 0] * two[:, :, 1]).sum(axis=1)) / np.maximum(sizes.prod(axis=1), 1e-300)
        changes = np.linalg.pinv(two, rcond=1e-9) @ wanted.T  # (g, 2, wanted)
        hits = (np.abs(changes) <= 1).all(axis=1) & (np.abs(two @ changes - wanted.T) < 1e-6).all(axis=1)
        keys = [(study.knobs[number].key, study.knobs[number].reach) for number in (first, second)]
        loads = [
            _loads(robot, dict(zip((key for key, _ in keys), change * [reach for _, reach in keys])), *place)
            for place, there, hit in zip(zip(study.states, commands), np.swapaxes(changes, 1, 2), hits)
            for change in there[hit]
        ]
        largest = {name: max(each[name] for each in loads) for name in (loads[0] if loads else {})}
        condition = float(np.linalg.cond(two).max()) if (sizes > 0).all() else np.inf
        angle = float(np.arccos(np.minimum(cosines, 1)).mean())
        yield KnobPair(first, second, angle, condition, float(1 - hits.mean()), largest)


def _loads(robot: Robot, changes: dict[str, float], state: Array, command: Array) -> dict[str, float]:
    try:
        changed, under = _under(robot, changes, command)
    except ValueError:  # a setting is out of its range with so large a change
        return dict.fromkeys(robot.loads(state, command), np.nan)
    return dict(changed.loads(state, under))


def largest_effect(study: KnobStudy) -> Array:
    """Mean size of the effect of each knob over the gaits, in errors that count as one; shape (k,)."""
    tracked: Sequence[bool] = study.space.tracked
    return np.linalg.norm(study.effects[:, tracked] / study.space.error_scale[tracked, None], axis=1).mean(axis=0)
