"""A plant with a rig in the calling process: it reads, computes the tick and writes, as fast as the rig can."""

from collections.abc import Callable

import numpy as np

from stepgap.base.ranges import require
from stepgap.plants.compiled_rig import CompiledRig, TickRun
from stepgap.plants.plant import AtTouchdown, Plant, StepCommands, Touchdown
from stepgap.plants.tick_control import FinishedStep, Mode, Order, RobotControl, TickFlag
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import Rig, RigFault, Torques
from stepgap.step import Array, StepRecord, StepSpace, StepStatus

STEP_ENDED, FAILED, _UNREADABLE, _TOUCHDOWN = (
    int(flag) for flag in (TickFlag.STEP_ENDED, TickFlag.FAILED, TickFlag.UNREADABLE, TickFlag.TOUCHDOWN)
)  # fmt: skip

TICKS_AT_ONCE = 32  # Ticks of a compiled rig between two looks at Ctrl-C: about a millisecond of computing


class RigPlant(Plant):
    """Executes steps on a rig with the control of its robot; the rig's time must stop between two ticks.

    The robot's control determines when a step ends and the next command is due. For a hopper that is when the apex has
    just been passed, and the command acts after the following mid-stance. The applied command is the one within bounds,
    less the part that the drives and the safety limits took from the torques while it acted.

    Args:
        on_ticks: Called with the log rows of every tick; their fields are those of `RobotControl.units`.
        at_once: Largest number of ticks that a `CompiledRig` runs before `on_ticks` is called.
    """

    def __init__(
        self, rig: Rig, robot_control: RobotControl, on_ticks: OnTicks | None = None, at_once: int = TICKS_AT_ONCE
    ):
        self._rig = rig
        self._robot_control = robot_control
        self._space = robot_control.space
        require(at_once >= 1, "at_once", at_once, "be at least 1")
        self._on_ticks = on_ticks
        self._at_once = at_once
        self._tick_time = rig.sensor_model.tick
        self._measured = np.full(len(self._space.state), np.nan)  # from fixed zeros
        self._begin()

    def _begin(self) -> None:
        """Resets control and time for a new deployment."""
        self._control = self._robot_control.control(self._rig)
        self._time = 0.0
        self._status = StepStatus.OK
        self._fault = ""
        self._number = 0
        self._first_step: StepRecord | None = None
        self._no_torques = (0.0,) * self._control.motors
        self._applied: Torques | None = self._no_torques

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of its robot."""
        return self._space

    @property
    def fault(self) -> str:
        """Message of the rig's fault; empty if there was none."""
        return self._fault

    @property
    def first_step(self) -> StepRecord | None:
        """The step of `start`, without a command, if the rig knows at which section the robot was released."""
        return self._first_step

    def start(self) -> Array:
        """Connects, holds the posture until the robot is released, and takes a step without a command.

        Raises:
            RigFault: The rig cannot be connected, or the first step failed.
        """
        self._rig.connect()
        evidence = self._control.evidence
        self._begin()
        self._control.resume(evidence)
        released = self._rig.released
        nothing = np.zeros(len(self._space.command))
        self._measured = np.full(len(self._space.state), np.nan)
        self._measured[: len(released)] = released
        first = self._taken(StepCommands(self._space, nothing), nothing, None)
        if self._status != StepStatus.OK:
            detail = f" ({self._fault})" if self._fault else ""
            raise RigFault(
                f"the first step failed: {self._status.label}{detail}: {self._space.advice_on(self._status)}; "
                "on a simulated robot, check whether it can step with the differences in [gap]"
            )
        self._first_step = first if np.isfinite(first.state).all() else None
        return first.next_state

    def take_step(self, command: Array) -> StepRecord:
        """Takes a step; after a fall, a fault or a safety stop the record has no next state, and torque is off."""
        return self.take_replanned_step(command, lambda _: command)

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """Takes a step whose command is chosen anew at its touchdown; the time of the rig stands still meanwhile."""
        self._number += 1
        commands = StepCommands(self._space, command)
        if np.isnan(commands.within).any():
            self._status = StepStatus.INVALID
        return self._taken(commands, commands.within, at_touchdown)

    def stop(self) -> None:
        """Switches torque off."""
        self._rig.close()

    def _taken(self, commands: StepCommands, within: Array, at_touchdown: AtTouchdown | None) -> StepRecord:
        """Takes a step with a command, which is limited to `within`, from the present state to the next."""
        space = self._space
        before = self._measured
        true_state = np.full(len(self._measured), np.nan)

        def chosen() -> tuple[float, ...]:
            context = self._control.touchdown()
            if at_touchdown and context:
                touchdown = Touchdown(space.start(before, context), space.named_context(context))
                return tuple(commands.replace(at_touchdown, touchdown).tolist())
            return tuple(within.tolist())

        self._measured, acted, lost, context = self._step(tuple(within.tolist()), chosen)
        if self._status == StepStatus.OK and self._rig.truth:
            true_state[: len(self._rig.truth)] = self._rig.truth
        command = commands.acted(acted)
        if command is not commands.first:
            within = commands.within
        state = space.start(before, context)
        return StepRecord(
            state=state,
            command=command,
            applied=within - lost,
            next_state=space.above(self._measured, context),
            status=self._status,
            context=space.named_context(context),
            requested=within,
            true_next_state=space.above(true_state, context),
        )

    def _step(self, command: tuple[float, ...], chosen: Callable[[], tuple[float, ...]]) -> FinishedStep:
        """Runs the ticks of one step with a command, which is chosen anew at a touchdown; its result."""
        control = self._control
        order = Order(Mode.STEP, 1.0, command)
        while self._status == StepStatus.OK:
            run = self._run(order, self._applied or self._no_torques)
            self._time = run.time
            self._applied = run.applied
            if self._on_ticks and len(run.rows):
                self._on_ticks(run.rows, self._number)
            if run.applied is None:
                self._status = StepStatus.STOPPED
                self._fault = run.fault
            elif run.flags & STEP_ENDED:
                return control.finished_step()
            elif run.flags & FAILED:
                self._status = control.status
            elif run.flags & _TOUCHDOWN:
                order = order._replace(command=chosen())
        self._rig.close()
        return control.failed_step(self._applied)

    def _run(self, order: Order, applied: Torques) -> TickRun:
        """Runs one tick, or some ticks of a rig that runs them in compiled code, after torques that were applied."""
        rig = self._rig
        if isinstance(rig, CompiledRig):
            return rig.run(self._control, self._time, order, applied, self._at_once)
        try:
            reading = rig.read()
            torques, flags = self._control.tick(self._time, reading, order, applied, rig.health)
            if flags & _UNREADABLE:
                raise RigFault(f"a sensor value is not finite: {reading}")
            applied = rig.write(torques)
        except RigFault as fault:
            return TickRun(rows=(), time=self._time, applied=None, flags=0, fault=str(fault))
        row = [self._control.row(applied)] if self._on_ticks else ()
        return TickRun(row, self._time + self._tick_time, applied, flags, fault="")
