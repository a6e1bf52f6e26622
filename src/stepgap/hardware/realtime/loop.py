"""The control loop of a rig in real time: sensors, state machine, control law, safety function, motors, log."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from stepgap.hardware.realtime.board import Board, Request, StepEnd
from stepgap.hardware.realtime.pace import Pace, TickClock
from stepgap.plants.tick_control import FinishedStep, Mode, Order, TickControl, TickFlag
from stepgap.plants.ticks.log_description import FieldMeaning
from stepgap.plants.ticks.rig_state import RigState
from stepgap.rigs.rig import DoubtfulSensor, Health, Reading, Rig, RigFault
from stepgap.step import StepSpace, StepStatus

MOVING = frozenset({RigState.STAND, RigState.STEP, RigState.STOP})
"""States in which the control laws' torques are written."""


class Signals(NamedTuple):
    """Signals that determine the next state.

    Attributes:
        connected: The bus is up and the drives accept torque commands.
        calibrated: The limp robot's sensors have been plausible for long enough.
        start_requested: A person has requested that the robot takes steps.
        stop_requested: A person has requested the stop, or the learning process does not respond.
        stood: The posture for the release is held with full torque.
        at_rest: The robot has had the time to land.
        fault: There is a fault.
    """

    connected: bool = False
    calibrated: bool = False
    start_requested: bool = False
    stop_requested: bool = False
    stood: bool = False
    at_rest: bool = False
    fault: bool = False


def next_state(state: RigState, signals: Signals) -> RigState:
    """The next state: one transition per tick; FAULT can follow on any state and is never left."""
    if signals.fault or state == RigState.FAULT:
        return RigState.FAULT
    if state == RigState.OFF:
        return RigState.OFF if signals.stop_requested else RigState.CONNECT
    if state == RigState.STOP:
        return RigState.OFF if signals.at_rest else RigState.STOP
    if signals.stop_requested:
        return RigState.STOP if state in MOVING else RigState.OFF
    may_continue = {
        RigState.CONNECT: signals.connected,
        RigState.CALIBRATE: signals.calibrated,
        RigState.READY: signals.start_requested,
        RigState.STAND: signals.stood,
        RigState.STEP: False,
    }
    return RigState(state + 1) if may_continue[state] else state


LOOP_UNITS: Mapping[str, str] = MappingProxyType({"took": "s", "state": "", "late": "s"})
"""Fields of a row of the tick log after those of the robot's tick, with their units.

`took` is the time from the start of the tick before to the end of its work, `late` the delay of the start of this one.
"""

LOOP_MEANING = FieldMeaning(names={"state": {state.value: state.name for state in RigState}})
"""Meaning of the fields in `LOOP_UNITS`."""

ALIVE_EVERY = 64  # Number of ticks between two checks whether the learning process is alive

_STEP_ENDED, _FAILED, _STOPPED, _BRAKES, _TAKES_COMMAND, _UNREADABLE, _TOUCHDOWN = map(int, TickFlag)
"""Numbers of the flags: of a tick of 12 µs, operations on the enum took 3 µs."""


@dataclass(frozen=True)
class LoopSettings:
    """Durations and limits of the loop.

    Attributes:
        calibrate_time: Time for which the limp robot's sensors must be plausible [s].
        stand_time: Time in which torque increases from zero while the posture for the release is taken [s].
        landing_time: Time in which a robot that is to stop ends its steps softly, until torque is switched off [s].
        missed_commands: Largest number of consecutive steps without a command.
        release_time: Time without a press of the key by which a person consents to torque, after which it counts as
            released [s]; infinite where nobody holds a key, as with a simulated robot.
        tick_silence: Longest time without a tick [s]; then the real-time process is killed, and the watchdog of the
            drives switches torque off.
        connect_time: Longest time before the first tick [s], in which code may be compiled.
    """

    calibrate_time: float = 0.2
    stand_time: float = 0.5
    landing_time: float = 2.0
    missed_commands: int = 1
    release_time: float = 0.5
    tick_silence: float = 3.0
    connect_time: float = 300.0


class ControlLoop:
    """The states of a deployment, tick by tick.

    Args:
        rig: The rig, connected.
        space: Step space with the bounds of the command.
        board: Gives requests and commands, and takes the results of steps.
        log: Takes the row of every tick: the fields of the control, the rig's diagnostics, and those in `LOOP_UNITS`.
        alive: Returns whether the learning process is alive.
    """

    def __init__(
        self,
        rig: Rig,
        control: TickControl,
        space: StepSpace,
        board: Board,
        log: Callable[[Sequence[float]], None],
        settings: LoopSettings = LoopSettings(),
        alive: Callable[[], bool] = lambda: True,
    ):
        self._rig = rig
        self._control = control
        self._board = board
        self._log = log
        self._settings = settings
        self._alive = alive
        self._tick_time = rig.sensor_model.tick
        self._space = space
        self._no_command = (nan,) * len(space.command)
        self._lower = space.command_lower.tolist()
        self._upper = space.command_upper.tolist()
        self._no_torques = self._applied = (0.0,) * control.motors
        self._clock = TickClock(self._tick_time)
        self._written = 0.0
        self._flags = 0
        self._state = RigState.CALIBRATE
        self._entered = 0.0
        self._powered = False
        self._presses = 0
        self._pressed = -inf
        self._step = 0
        self._missed = 0
        self._count = 0
        self._stop_requested = False
        self._took = 0.0

    @property
    def state(self) -> RigState:
        """State in the present tick."""
        return self._state

    def run(self, pace: Pace) -> None:
        """Runs ticks until the robot is off, in every case.

        Late frames between two ticks are sent at once, so that only ticks can be late.
        """
        frames = self._rig.sensor_model.frames_per_tick
        try:
            late = self._wait(pace)
            while self.tick(late):
                worked = pace(0.0)
                self._took = worked - self._clock.time
                for due in self._clock.frame_times(frames, worked):
                    if not self._repeat(pace(due)):
                        return
                late = self._wait(pace)
        finally:
            self._rig.close()

    def _wait(self, pace: Pace) -> float:
        """Waits for the next tick, which the rig may shift; returns how late it begins [s]."""
        self._clock.shift(self._rig.clock_correction(self._clock.slip))
        return pace(self._clock.due) - self._clock.due

    def request_stop(self) -> None:
        """Requests that the robot lands and the loop ends, as a request on the board does."""
        self._stop_requested = True

    def tick(self, late: float = 0.0) -> bool:
        """Runs one tick that began late by a time [s]; returns False when the robot is off."""
        missed = int(late / self._tick_time)
        self._board.count_tick(missed)
        time = self._clock.begin(late)
        try:
            reading = self._read()
            health = self._rig.health._replace(late=missed, emergency_stop=self._board.emergency_stop)
            return self._act(reading, health, late)
        except RigFault as fault:
            return self._end_with(fault, time, late)

    def _read(self) -> Reading:
        """Reads the rig and counts a lost frame."""
        try:
            return self._rig.read()
        finally:
            if self._rig.health.frame_lost:
                self._board.lost_frames += 1

    def _act(self, reading: Reading, health: Health, late: float) -> bool:
        """Computes and writes the torques; returns False when the robot is off."""
        time = self._clock.time
        control = self._control
        # What stops the robot is judged before the state, and the state before the torques, so it acts in this tick. A
        # limp robot writes zeros, whatever the control computes; the next tick gets what was really written.
        self._watch_key()
        self._watch_rig()
        self._enter(next_state(self._state, self._signals()))
        age = time - self._written if self._rig.sensor_model.sampled_at_write else 0.0
        torques, self._flags = control.tick(time, reading, self._order(), self._applied, health, age)
        if self._flags & _UNREADABLE:
            raise RigFault(f"a sensor value is not finite: {reading}")
        self._applied = self._rig.write(torques if self._powered else self._no_torques)
        self._written = time
        self._log((*control.row(self._applied), *self._rig.diagnostics, self._took, self._state, late))
        if self._flags & _STOPPED:
            self._fail(f"the safety function stopped the robot: {control.stopped}", control.status)
            return self._powered and bool(self._flags & _BRAKES)
        if self._state == RigState.STEP:
            self._judge_step()
        return self._state != RigState.OFF

    def _signals(self) -> Signals:
        board = self._board
        since = self._clock.time - self._entered
        self._count += 1
        if self._count % ALIVE_EVERY == 0 and not self._alive():
            self._stop_requested = True
        request = board.request
        return Signals(
            connected=True,
            calibrated=since >= self._settings.calibrate_time,
            start_requested=request == Request.START and self._key_is_held(),
            stop_requested=self._stop_requested or request == Request.STOP,
            stood=since >= self._settings.stand_time,
            at_rest=since >= self._settings.landing_time,
        )

    def _key_is_held(self) -> bool:
        """Whether the key by which a person consents to torque was pressed recently."""
        presses = self._board.presses
        time = self._clock.time
        if presses != self._presses:
            self._presses = presses
            self._pressed = time
        return time - self._pressed <= self._settings.release_time

    def _watch_key(self) -> None:
        """After the release of the key, lands a stepping robot, and switches torque off before its first step."""
        if self._state not in (RigState.STAND, RigState.STEP) or self._key_is_held() or self._stop_requested:
            return
        if self._state == RigState.STAND:
            raise RigFault("the key was released before the first step: torque is off")
        self._board.message = "the key was released: the robot lands"
        self._stop_requested = True

    def _watch_rig(self) -> None:
        """After a warning of the rig, lands a moving robot; one that is limp gets no torque."""
        if self._stop_requested or not (warning := self._rig.warning):
            return
        if self._state <= RigState.READY:
            raise RigFault(f"{warning}: no torque is given")
        if self._state in MOVING:
            self._board.message = f"{warning}: the robot lands"
            self._stop_requested = True

    def _enter(self, state: RigState) -> None:
        if state == self._state:
            return
        if state in (RigState.STAND, RigState.OFF) and self._state <= RigState.READY:
            self._board.message = ""  # the refused requests have been read by now, and are no fault
        self._state = state
        self._entered = self._clock.time
        self._powered = state in MOVING or (self._powered and state == RigState.FAULT)  # a limp robot does not brake
        self._board.state = state

    def _order(self) -> Order:
        """Order for the robot in the present state; outside of `MOVING` its torques are only for the log."""
        since = self._clock.time - self._entered
        if self._state == RigState.STAND:
            return Order(Mode.POSTURE, min(1.0, since / self._settings.stand_time), self._no_command)
        if self._state == RigState.STOP:
            return Order(Mode.LAND, since / self._settings.landing_time, self._no_command)
        if self._state == RigState.STEP:
            return Order(Mode.STEP, 1.0, self._command() if self._flags & _TAKES_COMMAND else self._no_command)
        return Order(Mode.LIMP, 0.0, self._no_command)

    def _command(self) -> tuple[float, ...]:
        """Command of this step within its bounds, or NaN if there is none; m numbers."""
        command = self._board.command(self._step)
        if command is None:
            return self._no_command
        if not all(map(isfinite, command)):
            raise RigFault(f"the command must be finite, not {', '.join(map(str, command))}")
        limited = zip(self._lower, command, self._upper, strict=True)
        return tuple(min(upper, max(lower, value)) for lower, value, upper in limited)

    def _judge_step(self) -> None:
        """Posts a touchdown, and a step that has ended; a failed one, or too many without a command, stop the robot."""
        if self._flags & _TOUCHDOWN:
            self._board.post_touchdown(self._step, self._control.touchdown())
        if self._flags & _STEP_ENDED:
            finished = self._control.finished_step()
        elif self._flags & _FAILED:
            finished = self._control.failed_step(self._applied)
            self._stop_requested = True
        else:
            return
        self._board.evidence = self._control.evidence
        self._board.post_step(self._step, StepEnd(finished, self._control.status))
        self._missed = self._missed + 1 if np.isnan(finished.command).any() and self._step > 0 else 0
        if self._missed > self._settings.missed_commands:
            self._board.message = f"{self._missed} steps in a row had no command: the learning process does not respond"
            self._stop_requested = True
        self._step += 1

    def _repeat(self, now: float) -> bool:
        """Exchanges a frame between two ticks, at a time [s]; returns False if the rig fails."""
        try:
            self._read()
            self._rig.write(self._applied)
        except RigFault as fault:
            return self._end_with(fault, now, 0.0)
        self._written = now
        return True

    def _end_with(self, fault: RigFault, now: float, late: float) -> bool:
        """Latches a fault of the rig and logs a last row without values; returns False."""
        self._fail(str(fault), StepStatus.DOUBTFUL if isinstance(fault, DoubtfulSensor) else StepStatus.STOPPED)
        unread = [nan] * (len(self._control.units) - 1)
        self._log((now, *unread, *self._rig.diagnostics, self._took, self._state, late))
        return False

    def _fail(self, message: str, status: StepStatus) -> None:
        """Latches the fault; the message of the first one is kept, and the present step is posted with the status."""
        if self._state == RigState.FAULT:
            return
        self._board.evidence = self._control.evidence
        if self._state == RigState.STEP:
            self._board.post_step(self._step, StepEnd(FinishedStep.stopped(self._space), status))
        self._board.message = message
        self._enter(next_state(self._state, Signals(fault=True)))
