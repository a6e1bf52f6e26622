"""The procedure of `stepgap rig jog`: what a person is asked for each motor, and what is found."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from math import degrees, isnan
from typing import Any

from stepgap.hardware.commissioning.jog import limp_robot, ticks_of_step
from stepgap.hardware.commissioning.limp import limp_setup
from stepgap.hardware.commissioning.limp_rig import FrameCount
from stepgap.hardware.hopper.jog import HopperJog, link_angles
from stepgap.hardware.hopper.jog_findings import answer_of, hand_failure
from stepgap.hardware.realtime.consent import supervised
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.tick.hop_control import HopperControl

MOTORS = (1, 2)


def try_motors(make_rig: Callable[[], Rig], control: HopperControl, simulated: bool, settings: str) -> dict[str, Any]:
    """Tries both motors, prints what is found, and returns it as the content of a proof.

    Args:
        make_rig: Creates the rig; it must be possible to pickle it.
        control: Control with which the robot will hop.
        simulated: Whether the robot is a simulation, of which nobody can turn a link by hand.
        settings: Text of the file that describes the rig.

    Raises:
        RigFault: The rig failed, or there is no consent.
    """
    findings, failures = list[dict[str, Any]](), list[str]()
    for motor in MOTORS:
        found: dict[str, Any] = {"motor": motor}
        if not simulated:
            found["by_hand"] = turned = _turn_by_hand(make_rig, control, motor)
            if failure := hand_failure(motor, turned):
                failures.append(failure)
                print(f"motor {motor}  not passed: {failure}")
                return {"passed": False, "failures": failures, "motors": [*findings, found]}
        found |= _try_motor(make_rig, control, motor, simulated, settings)
        findings.append(found)
        failures += [found["failure"]] if found["failure"] else []
        if failures:
            break
    return {"passed": not failures, "failures": failures, "motors": findings}


def _turn_by_hand(make_rig: Callable[[], Rig], control: HopperControl, motor: int) -> tuple[float, float]:
    """Angles by which the links turned while a person turned that of a motor forward by 45° [rad]."""
    with limp_robot(limp_setup(make_rig, control, FrameCount())) as look:
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
    jog = HopperJog(control, motor)
    loop, consent = supervised(LoopSettings(stand_time=0.01, landing_time=0.01), jog.consent_request, simulated)
    try:
        log, ticks = ticks_of_step(RealtimeSetup(make_rig, jog, loop), consent, settings)
        answer = answer_of(ticks, motor)
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
