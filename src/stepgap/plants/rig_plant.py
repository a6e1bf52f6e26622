"""Hops a rig in the calling process: read → estimate → phase → torque → limit → write, as fast as the rig goes."""

from collections.abc import Callable

import numpy as np

from stepgap.plants.hop_control import FinishedHop, HopControl
from stepgap.plants.plant import Plant
from stepgap.plants.tick import Tick
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.step import ADVICE, Array, StepRecord, StepSpace, StepStatus


class RigPlant(Plant):
    """Hops a rig with the joint control of Sec. 4.1; time must be able to stand still between its ticks.

    A step ends, and the next command is due, when the apex has just been passed; the command acts
    after the following mid-stance. The applied command is the one within bounds, less what the
    drives and the safety limits took from the torques while it acted.

    Args:
        rig: What moves.
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        bounds: Range of the command.
        on_tick: Called with every `Tick`, for logs.
        limits: What the safety function allows; without, what the rig says, or what this robot may in simulation.
    """

    def __init__(
        self,
        rig: Rig,
        robot: RobotParameters,
        gains: Gains,
        bounds: CommandBounds,
        on_tick: Callable[[Tick], None] | None = None,
        limits: SafetyLimits | None = None,
    ):
        self._rig, self._space, self._on_tick = rig, bounds.space(), on_tick
        self._robot, self._gains, self._limits = robot, gains, limits or rig.limits or SafetyLimits.of(robot)
        self._control = self._new_control()
        self._state, self._status, self._fault = np.full(2, np.nan), StepStatus.OK, ""

    def _new_control(self) -> HopControl:
        return HopControl(self._rig.layout, self._robot, self._gains, self._limits)

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self._space

    @property
    def fault(self) -> str:
        """What the rig said when it stopped; empty while it has not."""
        return self._fault

    def start(self) -> Array:
        """Connects, holds the landing posture until the robot is let go, and hops once without command.

        Raises:
            RigFault: The rig cannot be had, or the first hop failed.
        """
        self._rig.connect()
        self._control, self._status, self._fault = self._new_control(), StepStatus.OK, ""
        self._state = self._hop((0.0, 0.0)).state
        if self._status != StepStatus.OK:
            said = f" ({self._fault})" if self._fault else ""
            raise RigFault(
                f"the first hop failed: {self._status.label}{said}: {ADVICE[self._status]}; "
                "on the twin, see whether the differences in [gap] leave a robot that can hop"
            )
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Hops once; a fall, a fault or a safety stop is a record without a next state, and torque is off."""
        asked = np.asarray(command, float)
        within = np.clip(asked, self._space.command_lower, self._space.command_upper)
        state = self._state
        if np.isnan(within).any():
            self._status = StepStatus.INVALID
        self._state, lost, place = self._hop((float(within[0]), float(within[1])))
        return StepRecord(state, asked, within - lost, self._state, self._status, place)

    def stop(self) -> None:
        """Torque off."""
        self._rig.close()

    def _hop(self, command: tuple[float, float]) -> FinishedHop:
        """Ticks from just after an apex to just after the next; NaN where there is none."""
        control = self._control
        while self._status == StepStatus.OK:
            try:
                self._tick(command)
            except RigFault as fault:
                self._status, self._fault = StepStatus.STOPPED, str(fault)
                break
            if finished := control.finished_hop():
                return finished
            self._status = control.status
        self._rig.close()
        return FinishedHop(np.full(2, np.nan), control.lost_command(), np.nan)

    def _tick(self, command: tuple[float, float]) -> None:
        control, rig = self._control, self._rig
        control.begin_tick()
        control.sense(rig.read(), stale=rig.health.stale)
        asked = control.hop_torque(command)
        checked = control.check(asked, rig.health)
        applied = rig.write(checked.torque_1, checked.torque_2)
        tick = control.close_tick(asked, applied, checked)
        if self._on_tick:
            self._on_tick(tick)
