"""The procedure of `stepgap rig jog`: what a person is asked for each motor, and what is found."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from math import atan2, cos, degrees, hypot, isnan, nan, pi, radians, tau
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.commissioning.limp import ended, limp_robot, limp_setup
from stepgap.hardware.commissioning.proof import JOG
from stepgap.hardware.hopper.jog import FREQUENCY, MEASURED_TIME, HopperJog, link_angles
from stepgap.hardware.realtime.board import Request
from stepgap.hardware.realtime.consent import Consent, supervised
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.session import Session
from stepgap.plants.ticks.tick_log import TickLog, next_path, read_intact_ticks
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.step import Array

LEAST_ANSWER = radians(0.08)  # Smallest amplitude that is an answer of a link [rad]

EXPECTED_LAG = radians(145.0)
"""Lag of the link behind the torque [rad]: 180° for an inertia, 90° for viscous friction, some 20° more with delays."""

LARGEST_ERROR = radians(70.0)
"""Largest difference of the lag from that [rad]; with a wrong sign, the lag is 0° to 20°, or 270° to 290°."""

MOST_DELAY = 0.0025
"""Largest time by which a link may answer later than an inertia that friction cannot delay [s].

Healthy twins of the family have −1.7 to 1.2 ms: friction makes the lag smaller, delays and lags of frame, drive and
encoder, 1 to 4 ms together, make it larger. With 2 to 3 ms more, the loop that holds the leg in flight is unstable.
"""

AGAINST = radians(260.0)  # Lag from which the link moves against the torque rather than too late [rad]

MOST_DRIVE_DELAY = 0.0035
"""Largest delay of the torque that the drive reports after the command [s]; the frame takes 1 to 2 ms of it."""

QUARTER = radians(45.0)  # Angle by which a person turns each link by hand [rad]
HAND_ERROR = radians(15.0)  # Largest error of that [rad]


@dataclass(frozen=True)
class LinkAnswer:
    """Answer of the two top links to the torque of one motor.

    Attributes:
        motor: Number of the motor.
        torque: Amplitude of its torque [N·m].
        amplitude: Amplitude of its own link [rad].
        lag: Lag of its own link behind the torque, from 0 to 2π [rad].
        other: Amplitude of the other link [rad].
        largest_torque: Largest torque that was applied [N·m].
        largest_speed: Largest measured speed of a top link [rad/s].
        drive_delay: Delay of the torque that the drive reports after the command [s]; NaN if it reports none.
    """

    motor: int
    torque: float
    amplitude: float
    lag: float
    other: float
    largest_torque: float
    largest_speed: float
    drive_delay: float = nan

    @property
    def delay(self) -> float:
        """Time by which the link answers later than an inertia without friction and delay, which lags by 180° [s]."""
        return (self.lag - pi) / (tau * FREQUENCY)

    @property
    def inertia(self) -> float:
        """Apparent inertia of the link, larger where there is friction [kg·m²]."""
        return self.torque / (self.amplitude * (tau * FREQUENCY) ** 2)

    def failure(self) -> str:
        """What is wrong; empty if the right link answered in the right direction."""
        motor = f"motor {self.motor}"
        other = f"motor {3 - self.motor}"
        if max(self.amplitude, self.other) < LEAST_ANSWER:
            return (
                f"{motor}: no link moves under {self.torque:.2f} N·m; the motor is blocked or not connected, "
                "its encoder gives no values, or its friction is larger"
            )
        if self.other > self.amplitude:
            return (
                f"{motor}: the encoder of {other} moves instead of its own; drives or encoders are exchanged, "
                "or its own stands still"
            )
        if cos(self.lag - EXPECTED_LAG) < cos(LARGEST_ERROR):
            return (
                f"{motor}: its link moves against the torque (lag {degrees(self.lag):.0f}°, not 90° to 200°); "
                "the sign of the drive's torque and that of its encoder contradict each other"
            )
        return ""

    def lateness(self) -> str:
        """What is late; empty if the link, and the torque that the drive reports, answer soon enough."""
        motor = f"motor {self.motor}"
        answers = self.amplitude >= max(LEAST_ANSWER, self.other)
        if answers and pi + tau * FREQUENCY * MOST_DELAY < self.lag < AGAINST:
            return (
                f"{motor}: its link answers {1e3 * self.delay:.1f} ms or more too late, but at most "
                f"{1e3 * MOST_DELAY:.1f} ms are allowed; look for a filter or a delay in the drive or its encoder"
            )
        if self.drive_delay > MOST_DRIVE_DELAY:
            return (
                f"{motor}: its drive reports the commanded torque {1e3 * self.drive_delay:.1f} ms later, but at most "
                f"{1e3 * MOST_DRIVE_DELAY:.1f} ms are allowed; look for a filter or a ramp of its torque"
            )
        return ""


def jog_answer(ticks: TickTable, motor: int) -> LinkAnswer:
    """Measures the answer in the last part of the trial, in which the amplitude of the torque is constant.

    The angle of each link and the torque are fitted by a cubic polynomial of time, for all slow motion, plus a sine and
    a cosine.

    Raises:
        ValueError: There are not enough ticks with torque.
    """
    applied = np.nan_to_num(ticks[f"applied_{motor}"])
    given = np.flatnonzero(applied)
    time = ticks["time"]
    if not len(given) or time[given[-1]] - time[given[0]] < 0.9 * MEASURED_TIME:
        raise ValueError(f"motor {motor} got no torque for long enough")
    last = time[given[-1]]
    chosen = (time > last - MEASURED_TIME) & (time <= last) & np.isfinite(ticks["alpha_1"])
    links = link_angles(ticks["alpha_1"][chosen], ticks["alpha_2"][chosen])
    signals = (applied[chosen], links[motor - 1], links[2 - motor])
    torque, own, other = (_oscillation(time[chosen], signal) for signal in signals)
    lag = (atan2(*torque[::-1]) - atan2(*own[::-1])) % tau
    speed = np.nan_to_num(ticks["joint_speed"])
    return LinkAnswer(
        motor, hypot(*torque), hypot(*own), lag, hypot(*other), float(np.abs(applied).max()), float(speed.max()),
        _drive_delay(ticks, chosen, motor, torque),
    )  # fmt: skip


def _drive_delay(ticks: TickTable, chosen: NDArray[np.bool_], motor: int, torque: tuple[float, float]) -> float:
    """Delay of the torque that the drive reports after that which was applied [s]; NaN if it reports none.

    It is known up to half a period, since the drive may count in the other direction.
    """
    name = f"motor_{motor}_torque"
    if name not in ticks.units or not ticks[name][chosen].any():
        return nan
    reported = _oscillation(ticks["time"][chosen], np.nan_to_num(ticks[name][chosen]))
    behind = (atan2(*torque[::-1]) - atan2(*reported[::-1])) % pi
    return behind / (tau * FREQUENCY)


def _oscillation(time: Array, signal: Array) -> tuple[float, float]:
    """Parts of a signal in phase with sin ωt and cos ωt."""
    since = time - time.mean()
    angle = tau * FREQUENCY * time
    columns = [since**power for power in range(4)] + [np.sin(angle), np.cos(angle)]
    amplitudes = np.linalg.lstsq(np.column_stack(columns), signal, rcond=None)[0]
    return float(amplitudes[4]), float(amplitudes[5])


def hand_failure(motor: int, turned: tuple[float, float]) -> str:
    """What is wrong if a person turned the link of a motor forward by 45°; empty if nothing is.

    The links of motor 1 and 2 `turned` by these angles, by their encoders [rad].
    """
    own = turned[motor - 1]
    other = turned[2 - motor]
    if abs(own - QUARTER) <= HAND_ERROR:
        return ""
    fault = f"motor {motor}: its encoder measured {degrees(own):+.1f}° instead of +45° ± 15°"
    if abs(abs(other) - QUARTER) <= HAND_ERROR and abs(own) < HAND_ERROR:
        return f"{fault}, that of motor {3 - motor} {degrees(other):+.1f}°: the two are exchanged"
    if abs(own) < radians(1.0):
        return f"{fault}: it is not connected, or stands still"
    if abs(own + QUARTER) <= HAND_ERROR:
        return f"{fault}: its sign is wrong"
    return f"{fault}: check counts_per_turn and gear"


MOTORS = (1, 2)
_LOOK_EVERY = 0.02  # Time between two looks whether the trial of a motor has ended [s]


def try_motors(make_rig: Callable[[], Rig], control: HopperControl, simulated: bool, settings: str) -> dict[str, Any]:
    """Tries both motors, prints what is found, and returns it as the content of a proof.

    Args:
        make_rig: Creates the rig; it must be possible to pickle it.
        simulated: Whether the robot is a simulation, of which nobody can turn a link by hand.
        settings: Text of the file that describes the rig.

    Raises:
        RigFault: The rig failed, or there is no consent.
    """
    findings = list[dict[str, Any]]()
    failures = list[str]()
    for motor in MOTORS:
        result: dict[str, Any] = {"motor": motor}
        if not simulated:
            result["by_hand"] = turned = _turn_by_hand(make_rig, control, motor)
            if failure := hand_failure(motor, turned):
                failures.append(failure)
                print(f"motor {motor}  not passed: {failure}")
                return {"passed": False, "failures": failures, "motors": [*findings, result]}
        result |= _try_motor(make_rig, control, motor, simulated, settings)
        findings.append(result)
        failures += [result["failure"]] if result["failure"] else []
        if failures:
            break
    return {"passed": not failures, "failures": failures, "motors": findings}


def _turn_by_hand(make_rig: Callable[[], Rig], control: HopperControl, motor: int) -> tuple[float, float]:
    """Angles by which the links turned while a person turned that of a motor forward by 45° [rad]."""
    with limp_robot(limp_setup(make_rig, control)) as look:
        _ask(f"Motor {motor}, without torque: hold its top link still and press Enter.")
        before = _links(look())
        _ask("Turn it forward by 45°, half a right angle, hold it there and press Enter.")
        after = _links(look())
    turned = after[0] - before[0], after[1] - before[1]
    print(f"motor {motor}  by hand    link {motor} turned {degrees(turned[motor - 1]):+.1f}°")
    return turned


def _ask(text: str) -> None:
    print(text, file=sys.stderr)
    if not sys.stdin.readline():
        raise RigFault("the terminal was closed")


def _links(tick: Mapping[str, float]) -> tuple[float, float]:
    return link_angles(tick["alpha_1"], tick["alpha_2"])


def _try_motor(
    make_rig: Callable[[], Rig], control: HopperControl, motor: int, simulated: bool, settings: str
) -> dict[str, Any]:
    """Answer of the links to the torque of a motor, and what is wrong with it."""
    print(f"Motor {motor}, with torque.", file=sys.stderr)
    jog = HopperJog.of(control, motor)
    loop, consent = supervised(LoopSettings(stand_time=0.01, landing_time=0.01), jog.consent_request, simulated)
    try:
        log, ticks = _ticks_of_step(RealtimeSetup(make_rig, jog, loop), consent, settings)
        answer = jog_answer(ticks, motor)
    except (RigFault, ValueError) as fault:
        print(f"motor {motor}  not passed: {fault}")
        return {"failure": f"motor {motor}: {fault}"}
    failure = answer.lateness() or answer.failure()
    print(
        f"motor {motor}  torque     {answer.torque:.2f} N·m at most; link {motor} answers by "
        f"{degrees(answer.amplitude):.2f}° with a lag of {degrees(answer.lag):.0f}°, the other one by "
        f"{degrees(answer.other):.2f}°; apparent inertia {1e3 * answer.inertia:.2f} g·m²"
        + ("" if isnan(answer.drive_delay) else f"; the drive follows after {1e3 * answer.drive_delay:.1f} ms")
    )
    print(f"motor {motor}  {f'not passed: {failure}' if failure else 'passed'}  ({log})")
    return {**asdict(answer), "failure": failure, "log": str(log)}


def _ticks_of_step(setup: RealtimeSetup, consent: Consent, settings: str) -> tuple[Path, TickTable]:
    """Runs a robot until the end of its first step, with the consent of a person; returns the log and its ticks."""
    path = next_path(Path(JOG))
    log = TickLog(path, setup.units, setup.described(settings))
    with Session(setup, log) as session, terminated_as_interrupted():
        session.await_ready()
        with consent(session.board):
            session.board.request = Request.START
            while session.board.finished(0) is None and not ended(session):
                session.check_sink()
                sleep(_LOOK_EVERY)
    if fault := session.message():
        raise RigFault(f"{fault} ({path})")
    units, rows, _ = read_intact_ticks(path)
    return path, TickTable(units, rows)
