"""What is learned from a drive: which velocity each command gives, how sure that is, and how much can be corrected.

The steps of the log are those of `stepgap steps --every`, learned as the steps of an earlier run are. How much can be
corrected is judged on parts of the log that were not learned from.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.control.settings import ControlSettings
from stepgap.cure.drive import AXIS_NAMES, CELL, HandDrive
from stepgap.cure.response import Response, after_lag
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.logs.sections.step_extraction import ExtractedSteps, extract_from
from stepgap.logs.sections.step_means import FEWEST_IN_STEP
from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import VelocityRange, Walk
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array, StepMap, StepSpace

STEPS_NEEDED: Final = 40  # Least number of steps from which something is learned
IMAGINED: Final = 80  # Number of steps that are imagined by delay, lag and gains
PARTS: Final = 4  # Number of parts of the log that are held out in turn
DRIVING_ADVICE: Final = "drive by hand, and hold each command for two seconds or more"
_NARROW: Final = 0.02  # Range of a velocity that was not commanded [m/s, rad/s]
MOST_CHANGE: Final = 0.5  # Largest change of a command from one step to the next, as a share of its range
MOST_SURPRISE: Final = 0.4  # As of `control.surprise`; that of new folders of policies
_T_95: Final = 3.18  # 97.5 % quantile of Student's t with `PARTS` − 1 degrees of freedom


@final
@dataclass(frozen=True, eq=False)
class Held:
    """Errors on parts of the log from which nothing was learned.

    Attributes:
        asked: What the robot did less what it was asked for, of each step; shape (N, 3).
        predicted: What it did less what was predicted, which the correction cannot remove; shape (N, 3).
        first: Whether the command was a new one; shape (N,).
        part: Number of the part of each step; shape (N,).
    """

    asked: Array
    predicted: Array
    first: NDArray[np.bool_]
    part: NDArray[np.intp]

    def rms(self, *, held: bool) -> tuple[Array, Array]:
        """Root mean squares of both errors, each (3,), of all steps or of those with a held command."""
        rows = ~self.first if held else np.ones(len(self.first), bool)
        return _rms(self.asked[rows]), _rms(self.predicted[rows])

    def correctable(self, scale: Array, driven: NDArray[np.bool_]) -> tuple[float, float]:
        """Part of the error at held commands that a correction can remove, and half its 95 % interval.

        Args:
            scale: Unit of each velocity; shape (3,).
            driven: Which velocities count.
        """
        shares = list[float]()
        for part in range(PARTS):
            rows = (self.part == part) & ~self.first
            before, after = (_rms(errors[rows])[driven] / scale[driven] for errors in (self.asked, self.predicted))
            shares.append(1 - float(np.sqrt(np.sum(after**2) / max(np.sum(before**2), 1e-12))))
        values = np.array(shares)
        return float(values.mean()), float(_T_95 * values.std(ddof=1) / np.sqrt(PARTS))


@final
@dataclass(frozen=True, eq=False)
class Lesson:
    """What was learned.

    Attributes:
        drives: The drives.
        response: How the robot follows its commands.
        steps: The steps that were learned from.
        walk: Duration of a step, and ranges.
        learner: Before the first step of the corrected robot.
        held: Errors on parts that were not learned from.
    """

    drives: tuple[HandDrive, ...]
    response: Response
    steps: Steps
    walk: Walk
    learner: Learner
    held: Held

    @property
    def drive(self) -> HandDrive:
        """The first drive."""
        return self.drives[0]

    @property
    def space(self) -> StepSpace:
        """Velocities and commands."""
        return self.learner.nominal.space

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Which velocities were commanded; shape (3,)."""
        return np.array(self.response.driven)

    @property
    def control(self) -> ControlSettings:
        """How commands are planned."""
        return ControlSettings(horizon=1, largest_change=MOST_CHANGE, surprise=MOST_SURPRISE)

    @cached_property
    def step_map(self) -> CorrectedMap:
        """The learned map."""
        return self.learner.step_map()


def lesson_of(drives: Sequence[HandDrive], response: Response) -> Lesson:
    """Learns from the drives of one robot.

    Raises:
        InputError: They have too few steps, or one is refused as `stepgap steps` would do.
    """
    extracted = [_extracted(drive, response) for drive in drives]
    kept = [np.array(of_drive.kept) for of_drive in extracted]
    if (count := sum(map(len, kept))) < STEPS_NEEDED:
        steps = f"{count} steps of {response.step:.3g} s can be used, {STEPS_NEEDED} are needed"
        raise InputError(f"{drives[0].log.source}: {steps}; {DRIVING_ADVICE}")
    # Where a step is left out, and between two logs, the next number does not follow.
    counts = np.cumsum([0, *(len(of_drive.faults) + 1 for of_drive in extracted)])
    number = np.concatenate([rows + 1 + before for rows, before in zip(kept, counts, strict=False)])
    pairs = list(zip(extracted, kept, strict=True))
    commands = np.concatenate([of_drive.values["command"][rows] for of_drive, rows in pairs])
    state = np.concatenate([of_drive.sections.state[rows] for of_drive, rows in pairs])
    next_state = np.concatenate([of_drive.sections.state[rows + 1] for of_drive, rows in pairs])
    walk = _walk(response, commands, next_state)
    space = _weighted(walk.space, response.driven)
    nominal = _lag_map(walk, space)
    steps = Steps.of_columns(
        space,
        number=number,
        state=state,
        command=commands,
        next_state=next_state,
        target=np.where(space.tracked, commands, np.nan),
    )
    first = np.append(True, (np.diff(number) != 1) | (np.diff(commands, axis=0) != 0).any(axis=1))
    imagined = imagined_steps(response, space, walk.seconds)
    held = _held(nominal, imagined, steps, first)
    return Lesson(tuple(drives), response, steps, walk, _learner(nominal, imagined, steps), held)


def imagined_steps(response: Response, space: StepSpace, seconds: float) -> Steps:
    """Steps of a robot that follows its commands with the delay, the lag and the gains that were found.

    Somebody who drives by hand holds each command for some steps. So the velocity before a step says the same as the
    command before it, and nothing says which of both acts on: plans would then let the command alternate. These steps
    say it, since the commands change with every one or two of them: the error of ten random trots after the cure was
    0.91 times that without them (95 % interval 0.86 to 0.97).
    """
    rng = np.random.default_rng(0)
    lengths = rng.integers(1, 3, IMAGINED)
    levels = space.command_at(rng.uniform(-1, 1, (IMAGINED, len(AXIS_NAMES)))) * response.driven
    commands = np.repeat(levels, lengths, axis=0)[:IMAGINED]
    cells = max(1, round(seconds / CELL))
    given = np.repeat(commands, cells, axis=0)
    late = max(0, round(response.delay / CELL))
    arrived = np.vstack([np.repeat(given[:1], late, axis=0), given])[: len(given)]
    followed = after_lag(arrived, response.lag)
    means = followed.reshape(IMAGINED, cells, len(AXIS_NAMES)).mean(axis=1)
    velocity = means @ response.gains.T + response.drift
    velocity = velocity + response.noise * rng.standard_normal(velocity.shape)
    return Steps.of_columns(
        space,
        number=np.arange(1, IMAGINED),
        state=velocity[:-1],
        command=commands[1:],
        next_state=velocity[1:],
        target=np.where(space.tracked, commands[1:], np.nan),
    )


def _extracted(drive: HandDrive, response: Response) -> ExtractedSteps:
    if FEWEST_IN_STEP * drive.interval > response.step:
        raise InputError(
            f"{drive.log.source}: its odometry has a sample every {drive.interval:.2g} s, and a step of "
            f"{response.step:.2g} s needs {FEWEST_IN_STEP}; record odometry at 20 Hz or more"
        )
    try:
        extracted = extract_from(drive.log, None, drive.section_settings(response.step))
    except RecordError as error:
        raise InputError(f"{error}; {DRIVING_ADVICE}") from None
    if extracted.refusal:
        raise InputError(f"{extracted.refusal}; {DRIVING_ADVICE}")
    return extracted


def _walk(response: Response, commands: Array, states: Array) -> Walk:
    """Ranges: what the robot did is the range of use, what it was told is what it may be told."""
    ranges = dict[str, Any]()
    for axis, name in enumerate(AXIS_NAMES):
        if response.driven[axis]:
            ends = commands[:, axis].min(), commands[:, axis].max()
            done = np.quantile(states[:, axis], [0.02, 0.98])
        else:
            ends = -_NARROW / 2, _NARROW / 2
            done = np.array([min(-0.1, states[:, axis].min()), max(0.1, states[:, axis].max())])
        lower, upper = (round(float(end), 4) for end in done)
        ranges[name] = VelocityRange(lower, upper, round(float(ends[0]), 4), round(float(ends[1]), 4))
    return Walk(seconds=round(response.step, 4), time_constant=round(response.lag, 3), **ranges)


def _weighted(space: StepSpace, driven: tuple[bool, ...]) -> StepSpace:
    """The space in which a velocity that was not commanded is not tracked."""
    pairs = zip(space.state, driven, strict=True)
    return replace(space, state=tuple(replace(quantity, weight=float(is_driven)) for quantity, is_driven in pairs))


def _lag_map(walk: Walk, space: StepSpace) -> StepMap:
    """The nominal map of a walking robot, with other weights."""
    nominal: Any = TrottingRobot(walk=walk).nominal_maps()["lag"]()
    return replace(nominal, quantities=space)


def _learner(nominal: StepMap, imagined: Steps, steps: Steps) -> Learner:
    """The learner before the first corrected step; imagined steps are as an earlier deployment of the same robot."""
    known = imagined + steps.with_columns(iteration=1)
    return Learner.start(nominal, known, LearningSettings(), 2)


def _held(nominal: StepMap, imagined: Steps, steps: Steps, first: NDArray[np.bool_]) -> Held:
    """Each part predicted by what is learned from the others, step by step as in a deployment."""
    part = np.arange(len(steps)) * PARTS // len(steps)
    predicted = np.full((len(steps), len(AXIS_NAMES)), np.nan)
    for number in range(PARTS):
        learner = _learner(nominal, imagined, steps[part != number])
        for row in np.flatnonzero(part == number).tolist():
            logged = steps[row]
            step_map = learner.step_map()
            predicted[row] = step_map.evaluate(logged.record.state, logged.record.requested).next_state
            learner = learner.after(replace(logged, iteration=2, step=1 + row))
    return Held(steps.next_state - steps.command, steps.next_state - predicted, first, part)


def _rms(errors: Array) -> Array:
    return np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(errors.shape[1], np.nan)
