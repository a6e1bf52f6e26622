"""The interface of a robot's control in a tick: reading and order in, torques out.

Plants know a robot only by its `TickControl` and its `StepSpace`: its sensors, state estimation and control laws are
hidden behind them.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple, Self

import numpy as np

from stepgap.plants.ticks.log_description import FieldMeaning
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, Torques
from stepgap.step import Array, StepSpace, StepStatus


class Mode(IntEnum):
    """Task of the robot during a tick."""

    LIMP = 0
    """No task: the torques of the present step are computed for the log only."""
    POSTURE = 1
    """Hold the posture from which it is released, with a fraction of the torque."""
    STEP = 2
    """Step with the command."""
    LAND = 3
    """End the stepping softly."""
    TORQUE = 4
    """Give the motors the command as torques [N·m], to try them."""


class TickFlag(IntFlag):
    """Events of a tick."""

    NOTHING = 0
    STEP_ENDED = 1
    """The step has just ended, `finished_step` has the result, and the next command is due."""
    FAILED = 2
    """The step has failed; `status` is the reason."""
    STOPPED = 4
    """The safety function has stopped the robot."""
    BRAKES = 8
    """The safety function has stopped the robot, and the motors brake."""
    TAKES_COMMAND = 16
    """A command in the next tick's order will act in full."""
    UNREADABLE = 32
    """A sensor value is not finite, so the tick was not computed."""
    TOUCHDOWN = 64
    """A foot has just touched down; `touchdown` has what was measured there, and a new command may be given."""


class Order(NamedTuple):
    """Order for the robot during a tick.

    Attributes:
        mode: Task of the robot.
        share: Fraction of the torque in POSTURE; fraction of the landing time that has passed in LAND. From 0 to 1.
        command: Command of the step within bounds, m numbers; NaN while there is none. The last one in time acts.
    """

    mode: Mode
    share: float
    command: tuple[float, ...]


class FinishedStep(NamedTuple):
    """Result of a step that has ended.

    Attributes:
        state: State at its end; shape (n,), NaN for a failed step.
        command: Command that acted; shape (m,), NaN if none came in time.
        lost: Part of the command that limits removed during the step; shape (m,).
        context: Context of the step, in the order of `StepSpace.context`; empty if it is unknown, as of a failed step,
            or NaN where it is.
    """

    state: Array
    command: Array
    lost: Array
    context: tuple[float, ...] = ()

    @classmethod
    def stopped(cls, space: StepSpace) -> Self:
        """Result of a step that was stopped before its end, without a command."""
        no_command = np.full(len(space.command), np.nan)
        return cls(np.full(len(space.state), np.nan), no_command, np.zeros(len(space.command)))

    @property
    def requested(self) -> Array:
        """Command that was requested of the control laws, zero if none came in time; shape (m,)."""
        return np.nan_to_num(self.command)

    @property
    def applied(self) -> Array:
        """Command that was actually applied; shape (m,)."""
        return self.requested - self.lost


class TickControl(ABC):
    """A robot's state estimator, control laws and safety function, with their state from tick to tick."""

    @property
    @abstractmethod
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log, with their units; the first is the time."""

    @property
    @abstractmethod
    def motors(self) -> int:
        """Number of torques that a tick returns."""

    @abstractmethod
    def tick(
        self, time: float, reading: Reading, order: Order, applied: Torques, health: Health = HEALTHY, age: float = 0.0
    ) -> tuple[Torques, int]:
        """Computes a tick.

        Args:
            time: Time at which it began, since the start [s].
            applied: Torques that were actually applied since the tick before [N·m].
            health: Errors of communication and timing in the tick.
            age: Age of the reading at the start of the tick [s]; not used for a stale one.

        Returns:
            Torques that may be written [N·m], and the sum of the `TickFlag`s.
        """

    @property
    def evidence(self) -> tuple[float, ...]:
        """Evidence against its sensors, for the control of the next deployment, which `resume` takes; empty if none."""
        return ()

    def resume(self, evidence: Sequence[float]) -> None:  # noqa: B027
        """Continues, before the first tick, with the evidence of the deployment before; empty if there is none."""

    @abstractmethod
    def row(self, applied: Torques) -> Sequence[float]:
        """Log row of the last tick, with the torques that were applied [N·m]; fields as in `units`."""

    @abstractmethod
    def finished_step(self) -> FinishedStep:
        """Result of the step that ended with the last tick."""

    def touchdown(self) -> tuple[float, ...]:
        """Context that was measured at the last touchdown, in the order of `StepSpace.context`; NaN where unknown.

        Called after a tick with `TOUCHDOWN`, which a control without that event never has.
        """
        return ()

    @abstractmethod
    def failed_step(self, applied: Torques | None) -> FinishedStep:
        """Result of the step that is aborted after the last tick.

        Args:
            applied: Torques that were applied after that tick [N·m]; None if none were.
        """

    @property
    @abstractmethod
    def status(self) -> StepStatus:
        """OK while the robot steps; else the reason why it does not."""

    @property
    @abstractmethod
    def stopped(self) -> str:
        """Reason why the safety function stopped the robot; empty if it has not."""


class RobotControl(ABC):
    """Control of a robot, independent of its rig; it can be pickled, for use in another process."""

    @property
    @abstractmethod
    def space(self) -> StepSpace:
        """Names, units and ranges of state and command."""

    @property
    @abstractmethod
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log, with their units; the first is the time."""

    @property
    @abstractmethod
    def consent_request(self) -> str:
        """What a person is asked before the motors get torque: where the robot must be, and what it is going to do."""

    @abstractmethod
    def meaning(self, rig: Rig) -> FieldMeaning:
        """Meaning of the numbers in a row: names of enums and bits, and the limits of a rig."""

    @abstractmethod
    def control(self, rig: Rig) -> TickControl:
        """Creates the control of a rig for a deployment; all its code is compiled before the first tick."""

    @abstractmethod
    def limp_limits(self, rig: Rig) -> RigLimits:
        """Limits of a rig whose motors get no torque: those of its bus, but neither those of pose nor of speed."""

    @abstractmethod
    def step_ends(self, ticks: TickTable) -> np.ndarray:
        """Indices of the ticks of a log with which a step ended, in ascending order; shape (k,)."""

    @abstractmethod
    def describe(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, str]:
        """Describes the robot in a logged tick, as texts by name; fields as in `units`."""

    def travels(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, float]:  # noqa: ARG002
        """Distances by name that different sensors measured in a logged tick, in pairs [m].

        The two of a pair change equally as long as a person moves the body over a foot at rest. It is empty while no
        foot is on the ground, and for a robot that has no such sensors.
        """
        return {}
