"""The seam to what a robot computes in a tick: reading and order in, torques out.

Plants know a robot through its `TickControl` and its `StepSpace` and through nothing else: which sensors there are, how
the state is estimated and what the torques are is the robot's own affair.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, Torques
from stepgap.step import Array, StepSpace, StepStatus


class Mode(IntEnum):
    """What the robot is to do during a tick."""

    LIMP = 0
    """Nothing: the torques of the present step are computed for the log, none is asked for."""
    POSTURE = 1
    """Hold the posture from which it is released, with a share of the torque."""
    STEP = 2
    """Step with the command."""
    LAND = 3
    """End the stepping softly."""


class TickFlag(IntFlag):
    """What a tick has found."""

    NOTHING = 0
    STEP_ENDED = 1
    """The step has just ended, `finished_step` has the result, and the next command is due."""
    FAILED = 2
    """The step has failed; `status` says why."""
    STOPPED = 4
    """The safety function has stopped the robot."""
    BRAKES = 8
    """It has, and the motors brake."""
    TAKES_COMMAND = 16
    """A command that comes with the next tick acts in full."""
    UNREADABLE = 32
    """A sensor value is not finite, so the tick was not computed."""


class Order(NamedTuple):
    """What is asked of the robot during a tick.

    Attributes:
        mode: What to do.
        share: Of the torque in POSTURE; of the time that landing may take that has passed in LAND. From 0 to 1.
        command: Of the step, within bounds; NaN while there is none. The first one that comes in time acts.
    """

    mode: Mode
    share: float
    command: tuple[float, ...]


NO_COMMAND = (float("nan"), float("nan"))
"""A command that is not there yet."""


class FinishedStep(NamedTuple):
    """What is known of a step that has ended.

    Attributes:
        state: At its end; shape (n,), NaN of a step that failed.
        command: The command that acted; shape (m,), NaN where none came in time.
        lost: Part of the command that limits took away on the way there; shape (m,).
        yaw: Of the robot at its end [rad]; NaN of a step that failed.
    """

    state: Array
    command: Array
    lost: Array
    yaw: float


class TickControl(ABC):
    """A robot's estimator, torque laws and safety function, and what they remember from tick to tick."""

    @property
    @abstractmethod
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log, with their units; the first is the time."""

    @abstractmethod
    def tick(
        self,
        time: float,
        reading: Reading,
        order: Order,
        applied: Torques,
        health: Health = HEALTHY,
        age: float = 0.0,
    ) -> tuple[Torques, int]:
        """Computes a tick.

        Args:
            time: When it began, since the start [s].
            reading: The sensor values.
            order: What is asked of the robot.
            applied: Torques that were really applied since the tick before [N·m].
            health: How the tick itself went.
            age: By how much the reading is older than the tick [s]; of no account for one that is stale.

        Returns:
            Torques that may be written [N·m], and the sum of the `TickFlag`s.
        """

    @abstractmethod
    def row(self, applied: Torques) -> Sequence[float]:
        """The row of the last tick for the log, with the torques that were applied [N·m]; fields as in `units`."""

    @abstractmethod
    def record(self, applied: Torques) -> Any:
        """The last tick for whoever looks on, with the torques that were applied [N·m]."""

    @abstractmethod
    def finished_step(self) -> FinishedStep:
        """The step that ended with the last tick."""

    @abstractmethod
    def failed_step(self, applied: Torques | None) -> FinishedStep:
        """The step that is broken off after the last tick.

        Args:
            applied: Torques that were applied after that tick [N·m]; None if none were.
        """

    @property
    @abstractmethod
    def status(self) -> StepStatus:
        """OK while the robot steps; else why it does not."""

    @property
    @abstractmethod
    def stopped(self) -> str:
        """Why the safety function stopped the robot, in words; empty while it has not."""


class RobotControl(ABC):
    """How a robot is controlled, whatever rig it stands on; it can be pickled, for a process of its own."""

    @property
    @abstractmethod
    def space(self) -> StepSpace:
        """Names, units and ranges of state and command."""

    @property
    @abstractmethod
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log, with their units; the first is the time."""

    @abstractmethod
    def control(self, rig: Rig) -> TickControl:
        """The control of a rig at the beginning of a deployment, compiled: no tick takes longer than the others."""

    @abstractmethod
    def limp_limits(self, rig: Rig) -> RigLimits:
        """Limits of a rig whose motors get no torque: its bus stops it, but neither pose nor speed of the robot."""

    @abstractmethod
    def describe(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, str]:
        """What a logged tick says of the robot, for a person to read; fields as in `units`."""
