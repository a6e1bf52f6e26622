"""The joint control of Sec. 4.1 as a `TickControl`: what a tick of hopping remembers, and its one compiled call."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepgap.base.compiled_record import as_record, from_record
from stepgap.plants.tick_control import NO_COMMAND, FinishedStep, Mode, Order, RobotControl, TickControl, Torques
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, RigLayout
from stepgap.robots.hopper.dynamics import masses_of
from stepgap.robots.hopper.hop_state import Apex, HopState, TickSettings
from stepgap.robots.hopper.hop_tick import broken_off, tick
from stepgap.robots.hopper.joint_control import joint_law
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.safety import Limited
from stepgap.robots.hopper.tick import TICK_UNITS, Tick
from stepgap.step import StepSpace, StepStatus

PHASES = tuple(Phase)


class HopControl(TickControl):
    """Hops, each from apex to apex; a command acts from mid-stance to take-off.

    Args:
        layout: How to read the sensors.
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        limits: What the safety function allows.
    """

    def __init__(self, layout: RigLayout, robot: RobotParameters, gains: Gains, limits: SafetyLimits):
        self._settings = as_record(TickSettings(layout, masses_of(robot), joint_law(robot, gains), limits))
        self._memory, self._row = as_record(HopState()), np.zeros(len(TICK_UNITS))

    def look(self, reading: Reading) -> HopState:
        """The state after a tick in which nothing is asked of the robot."""
        self.tick(0.0, reading, Order(Mode.LIMP, 0.0, NO_COMMAND), (0.0, 0.0))
        return self.state

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return TICK_UNITS

    @property
    def state(self) -> HopState:
        """What the next tick starts from."""
        return from_record(HopState, self._memory)

    def tick(
        self,
        time: float,
        reading: Reading,
        order: Order,
        applied: Torques,
        health: Health = HEALTHY,
        age: float = 0.0,
    ) -> tuple[Torques, int]:
        """Computes a tick."""
        mode, share, command = order
        return tick(
            self._settings, self._memory, self._row, time, age, *reading, *health, int(mode), share, *command, *applied
        )  # fmt: skip

    def row(self, applied: Torques) -> Sequence[float]:
        """The row of the last tick for the log."""
        row = self._row.tolist()
        row[11], row[12] = applied
        return row

    def record(self, applied: Torques) -> Tick:
        """The last tick for whoever looks on."""
        time, m1, m2, bh, bv, force, phase, alpha_1, alpha_2, asked_1, asked_2, _, _, limited = self._row.tolist()
        reading = Reading(m1, m2, bh, bv, force)
        return Tick(
            time, reading, PHASES[int(phase)], alpha_1, alpha_2, (asked_1, asked_2), applied, Limited(int(limited))
        )  # fmt: skip

    def finished_step(self) -> FinishedStep:
        """The hop that ended with the last tick."""
        apex = Apex(*self._memory["apex"][0].item())
        state, lost = np.array([apex.speed, apex.height]), np.array([apex.lost_x, apex.lost_y])
        return FinishedStep(state, np.array([apex.force_x, apex.force_y]), lost, apex.yaw)

    def failed_step(self, applied: Torques | None) -> FinishedStep:
        """The hop that is broken off after the last tick."""
        force_x, force_y, *lost = broken_off(self._settings, self._memory, *(applied or (np.nan, np.nan)))
        return FinishedStep(np.full(2, np.nan), np.array([force_x, force_y]), np.array(lost), np.nan)

    @property
    def status(self) -> StepStatus:
        """OK while the robot hops; why not, else."""
        return StepStatus(int(self._memory["hop"]["status"][0]))

    @property
    def stopped(self) -> str:
        """Why the safety function stopped the robot."""
        stopped = Limited(int(self._memory["watch"]["stopped"][0]))
        return ", ".join(reason.name.lower().replace("_", " ") for reason in stopped if reason.name)


@dataclass(frozen=True)
class HopperControl(RobotControl):
    """How the hopper is controlled.

    Attributes:
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        bounds: Range of the command.
        limits: What the safety function allows; None for what the rig says, or what this robot may in simulation.
    """

    robot: RobotParameters
    gains: Gains
    bounds: CommandBounds
    limits: SafetyLimits | None = None

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self.bounds.space()

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return TICK_UNITS

    def control(self, rig: Rig) -> HopControl:
        """The control of a rig at the beginning of a deployment, compiled."""
        limits = self.limits or rig.limits or SafetyLimits.of(self.robot)
        trial = HopControl(rig.layout, self.robot, self.gains, limits)
        for count in (0, 0.0):  # counts may be whole numbers or not
            trial.look(Reading(count, count, count, count, 0.0))
        trial.failed_step((0.0, 0.0))
        return HopControl(rig.layout, self.robot, self.gains, limits)
