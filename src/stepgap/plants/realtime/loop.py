"""A tick of a rig that can break things: sensors, states, the control law of the state, safety, motors, log."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from types import MappingProxyType

from stepgap.plants.hop_control import HopControl, Torques
from stepgap.plants.realtime.board import Board, Hop, Request
from stepgap.plants.realtime.pace import Pace
from stepgap.plants.realtime.states import MOVING, RigState, Signals, next_state
from stepgap.plants.safety import Limited
from stepgap.plants.tick import TICK_UNITS
from stepgap.rigs.rig import Health, Rig, RigFault
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import StepStatus

LOOP_UNITS = MappingProxyType({**TICK_UNITS, "state": "", "late": "s"})
"""Fields of a row of the tick log, with their units."""

UNKNOWN = (nan,) * (len(TICK_UNITS) - 1)
"""What is logged of a tick in which the rig failed, between its time and its state."""

ALIVE_EVERY = 64
"""Ticks between two looks whether the process that learns is alive."""


@dataclass(frozen=True)
class LoopSettings:
    """Times and budgets.

    Attributes:
        calibrate_time: How long the limp robot's sensors must be plausible [s].
        stand_time: Time in which torque grows from nothing while the landing posture is taken [s].
        landing_time: Time in which a robot that is to stop lands, and its leg sinks down, until torque goes off [s].
        missed_commands: Hops in a row that may go without a command; such a hop has none.
    """

    calibrate_time: float = 0.2
    stand_time: float = 0.5
    landing_time: float = 2.0
    missed_commands: int = 1


class ControlLoop:
    """The states of a deployment, tick by tick.

    Args:
        rig: What moves, connected.
        control: The joint control.
        bounds: Range of the command.
        board: Where requests and commands are, and where hops are told.
        log: Takes the row of every tick, fields as in `LOOP_UNITS`.
        settings: Times and budgets.
        alive: Whether the process that learns is alive.
    """

    def __init__(
        self,
        rig: Rig,
        control: HopControl,
        bounds: CommandBounds,
        board: Board,
        log: Callable[[Sequence[float]], None],
        settings: LoopSettings = LoopSettings(),
        alive: Callable[[], bool] = lambda: True,
    ):
        self._rig, self._control, self._board, self._log = rig, control, board, log
        self._settings, self._alive, self._tick_time = settings, alive, rig.layout.tick
        self._lower, self._upper = (bounds.fx_lower, bounds.fy_lower), (bounds.fx_upper, bounds.fy_upper)
        self._state, self._entered, self._powered = RigState.CALIBRATE, 0.0, False
        self._hop, self._command, self._missed = 0, None, 0
        self._applied, self._written, self._count, self._stop_asked = (0.0, 0.0), 0.0, 0, False

    @property
    def state(self) -> RigState:
        """Of the present tick."""
        return self._state

    def run(self, pace: Pace) -> None:
        """Ticks until the robot is off, whatever happens.

        Frames between two ticks that come late are made up for, so that only ticks can be late.
        """
        late, frames = 0.0, self._rig.layout.frames_per_tick
        try:
            while self.tick(late):
                due = self._control.due
                for left in range(frames - 1, 0, -1):
                    if not self._repeat(pace(due - self._tick_time * left / frames)):
                        return
                late = pace(due) - due
        finally:
            self._rig.close()

    def ask_to_stop(self) -> None:
        """Lands the robot and ends, as a request on the board does."""
        self._stop_asked = True

    def tick(self, late: float = 0.0) -> bool:
        """One tick, begun late by so much [s]; False when the robot is off."""
        control = self._control
        missed = int(late / self._tick_time)
        self._board.count_tick(late, missed)
        control.begin_tick(late)
        try:
            reading = self._rig.read()
            health = self._rig.health._replace(late=missed, emergency_stop=self._board.emergency_stop)
            age = control.time - self._written if self._rig.layout.sampled_at_write else 0.0
            control.sense(reading, stale=health.stale, age=age)
            return self._act(health, late)
        except RigFault as fault:
            return self._give_up(fault, control.time, late)

    def _act(self, health: Health, late: float) -> bool:
        control = self._control
        self._enter(next_state(self._state, self._signals()))
        asked = self._torque()
        wanted = asked if self._state in MOVING else (0.0, 0.0)
        checked = control.check(wanted, health)
        self._applied = self._rig.write(*(checked[:2] if self._powered else (0.0, 0.0)))
        self._written = control.time
        tick = control.close_tick(asked, self._applied, checked)
        self._log((*tick.row(), self._state, late))
        if checked.limited.stops:
            self._fail(_words(checked.limited))
            return self._powered and control.brakes
        if self._state == RigState.HOP:
            self._judge_hop()
        return self._state != RigState.OFF

    def _signals(self) -> Signals:
        board, since = self._board, self._control.time - self._entered
        self._count += 1
        if self._count % ALIVE_EVERY == 0 and not self._alive():
            self._stop_asked = True
        request = board.request
        return Signals(
            connected=True,
            calibrated=since >= self._settings.calibrate_time,
            hop_asked=request == Request.HOP,
            stop_asked=self._stop_asked or request == Request.STOP,
            stood=since >= self._settings.stand_time,
            at_rest=since >= self._settings.landing_time,
        )

    def _enter(self, state: RigState) -> None:
        if state == self._state:
            return
        if state in (RigState.STAND, RigState.OFF) and self._state <= RigState.READY:
            self._board.words = ""  # what the kernel refused is known by now, and no fault
        self._state, self._entered = state, self._control.time
        self._powered = state in MOVING or (self._powered and state == RigState.FAULT)  # a limp robot does not brake
        if state == RigState.HOP:
            self._control.await_release()
        self._board.state = state

    def _torque(self) -> Torques:
        """What the state's law wants; outside of `MOVING` it is only for the log."""
        control, since = self._control, self._control.time - self._entered
        if self._state == RigState.STAND:
            share = min(1.0, since / self._settings.stand_time)
            torque_1, torque_2 = control.posture_torque()
            return share * torque_1, share * torque_2
        if self._state == RigState.STOP:
            return control.landing_torque(since / self._settings.landing_time)
        if self._state == RigState.HOP and control.takes_command:
            self._command = self._command_of_hop()
        return control.hop_torque(self._command or (0.0, 0.0))

    def _command_of_hop(self) -> tuple[float, float] | None:
        """This hop's command within bounds, if it is there."""
        command = self._board.command(self._hop)
        if command is None:
            return None
        if not (isfinite(command[0]) and isfinite(command[1])):
            raise RigFault(f"the command must be finite, not {command[0]}, {command[1]}")
        fx, fy = (
            min(upper, max(lower, force)) for force, lower, upper in zip(command, self._lower, self._upper, strict=True)
        )
        return fx, fy

    def _judge_hop(self) -> None:
        """Tells of a hop that has ended; a failed one, or too many without a command, stop the robot."""
        finished, status = self._control.finished_hop(), self._control.status
        if finished is None and status == StepStatus.OK:
            return
        fx, fy = self._command or (0.0, 0.0)
        if finished:
            (speed, height), (lost_x, lost_y), place = finished
        else:
            speed, height, (lost_x, lost_y), place = nan, nan, self._control.lost_command(), nan
            self._stop_asked = True
        self._board.post_hop(Hop(self._hop, speed, height, fx - lost_x, fy - lost_y, place, status))
        self._missed = self._missed + 1 if self._command is None and self._hop > 0 else 0
        if self._missed > self._settings.missed_commands:
            self._board.words = f"{self._missed} hops in a row had no command: the process that learns is missed"
            self._stop_asked = True
        self._hop, self._command = self._hop + 1, None

    def _repeat(self, now: float) -> bool:
        """A frame between two ticks [s]; False where the rig fails."""
        try:
            self._rig.read()
            self._rig.write(*self._applied)
        except RigFault as fault:
            return self._give_up(fault, now, 0.0)
        self._written = now
        return True

    def _give_up(self, fault: RigFault, now: float, late: float) -> bool:
        """The rig has failed, so that there is no more to do than to tell of it [s]; False."""
        self._fail(str(fault))
        self._log((now, *UNKNOWN, self._state, late))
        return False

    def _fail(self, words: str) -> None:
        """The latched fault; the first one's words are kept, and a hop under way is told to have been stopped."""
        if self._state == RigState.FAULT:
            return
        if self._state == RigState.HOP:
            self._board.post_hop(Hop.stopped(self._hop))
        self._board.words = words
        self._enter(next_state(self._state, Signals(fault=True)))


def _words(limited: Limited) -> str:
    """Why the safety function stopped the robot."""
    reasons = ", ".join(
        reason.name.lower().replace("_", " ") for reason in limited if Limited(reason).stops and reason.name
    )
    return f"the safety function stopped the robot: {reasons}"
