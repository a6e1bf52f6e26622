"""A plant with a rig in the calling process: it reads, computes the tick and writes, as fast as the rig can."""

from collections.abc import Callable
from typing import Any

import numpy as np

from stepgap.plants.plant import Plant
from stepgap.plants.tick_control import FinishedStep, Mode, Order, RobotControl, TickFlag
from stepgap.rigs.rig import Rig, RigFault
from stepgap.step import ADVICE, Array, StepRecord, StepSpace, StepStatus

STEP_ENDED, FAILED, _UNREADABLE = (
    int(flag) for flag in (TickFlag.STEP_ENDED, TickFlag.FAILED, TickFlag.UNREADABLE)
)  # fmt: skip


class RigPlant(Plant):
    """Executes steps on a rig with the control of its robot; the rig's time must stop between two ticks.

    The robot's control determines when a step ends and the next command is due. For a hopper that is when the apex has
    just been passed, and the command acts after the following mid-stance. The applied command is the one within bounds,
    less the part that the drives and the safety limits took from the torques while it acted.

    Args:
        rig: The rig.
        robot_control: Control of its robot.
        on_tick: Called with every tick as the control records it, for logs.
    """

    def __init__(self, rig: Rig, robot_control: RobotControl, on_tick: Callable[[Any], None] | None = None):
        self._rig, self._robot_control, self._space, self._on_tick = rig, robot_control, robot_control.space, on_tick
        self._tick_time = rig.sensor_model.tick
        self._state = np.full(len(self._space.state), np.nan)
        self._begin()

    def _begin(self) -> None:
        """Resets control and time for a new deployment."""
        self._control = self._robot_control.control(self._rig)
        self._time, self._applied, self._status, self._fault = 0.0, (0.0, 0.0), StepStatus.OK, ""

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of its robot."""
        return self._space

    @property
    def fault(self) -> str:
        """Message of the rig's fault; empty if there was none."""
        return self._fault

    def start(self) -> Array:
        """Connects, holds the landing posture until the robot is released, and hops once without command.

        Raises:
            RigFault: The rig cannot be connected, or the first hop failed.
        """
        self._rig.connect()
        self._begin()
        self._state = self._step((0.0,) * len(self._space.command)).state
        if self._status != StepStatus.OK:
            detail = f" ({self._fault})" if self._fault else ""
            raise RigFault(
                f"the first hop failed: {self._status.label}{detail}: {ADVICE[self._status]}; "
                "on the twin, check whether a robot with the differences in [gap] can hop"
            )
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Hops once; after a fall, a fault or a safety stop the record has no next state, and torque is off."""
        command = np.asarray(command, float)
        within = np.clip(command, self._space.command_lower, self._space.command_upper)
        state = self._state
        if np.isnan(within).any():
            self._status = StepStatus.INVALID
        self._state, _, lost, yaw = self._step(tuple(within.tolist()))
        return StepRecord(state, command, within - lost, self._state, self._status, yaw)

    def stop(self) -> None:
        """Switches torque off."""
        self._rig.close()

    def _step(self, command: tuple[float, ...]) -> FinishedStep:
        """Runs the ticks of one step, from just after an apex to just after the next; its result."""
        rig, control, on_tick = self._rig, self._control, self._on_tick
        order, applied = Order(Mode.STEP, 1.0, command), self._applied
        try:
            while self._status == StepStatus.OK:
                reading = rig.read()
                torques, flags = control.tick(self._time, reading, order, applied, rig.health)
                if flags & _UNREADABLE:
                    raise RigFault(f"a sensor value is not finite: {reading}")
                applied = rig.write(torques)
                self._time += self._tick_time
                if on_tick:
                    on_tick(control.record(applied))
                if flags & STEP_ENDED:
                    self._applied = applied
                    return control.finished_step()
                if flags & FAILED:
                    self._status = control.status
        except RigFault as fault:
            self._status, self._fault, applied = StepStatus.STOPPED, str(fault), None
        rig.close()
        return control.failed_step(applied)
