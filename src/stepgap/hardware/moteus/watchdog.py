"""The proof that controllers switch torque off by themselves when commands end.

In the firmware of moteus (`fw/moteus_controller.cc`, `fw/bldc_servo_control.h`), only a frame that writes the mode
restarts the watchdog, and one that only reads registers does not. The watchdog counts down the time in the last
command; at zero the mode becomes *timeout* until a stop command. With `servo.timeout_mode` = 0, the reported torque is
exactly zero from then on. After `servo.cooldown_cycles` (256 periods with a current of zero, 9 ms at 30 kHz) the motor
driver is off.
"""

from collections.abc import Callable, Collection, Mapping

import moteus
from moteus import Mode, Register

from stepgap.hardware.host_time import HostTime
from stepgap.hardware.moteus.can_bus import Registers
from stepgap.rigs.rig import RigFault, WatchdogTimes

PATIENCE = 0.1
"""Time in addition to twice the watchdog's until it counts as missing [s]."""

_ROUNDING = 1e-6
"""Rounding error of a time in single precision [s]."""


def watchdog_query() -> moteus.QueryResolution:
    """Query of mode, torque, fault, and the watchdog's time of the last command."""
    query = moteus.QueryResolution()
    query.position = query.velocity = query.voltage = query.temperature = moteus.IGNORE
    query._extra = {int(Register.COMMAND_TIMEOUT): moteus.F32}
    return query


def measure_watchdogs(
    ask: Callable[[], Mapping[int, Registers]],
    numbers: Collection[int],
    setting: float,
    pause: float,
    host: HostTime,
) -> WatchdogTimes:
    """Measures when controllers report the mode *timeout* without torque, after a last command that was just sent.

    Args:
        ask: Sends queries, without commands, and returns the registers of the controllers that answer.
        numbers: Identifiers of all controllers.
        setting: Time of the watchdog in the last command [s].
        pause: Time between two queries [s].
        host: The computer's clock.

    Raises:
        RigFault: A controller keeps its mode or torque for twice this time, has taken over another time, or stops for
            another reason, which proves nothing.
    """
    last, measured, watched = host.now(), {}, dict.fromkeys(numbers, "did not answer")
    while host.now() < last + 2 * setting + PATIENCE:
        for number, registers in ask().items():
            if number not in watched:
                continue
            watched[number] = _seen(number, registers, setting)
            if not watched[number]:
                del watched[number]
                measured[f"controller {number}"] = host.now() - last
        if not watched:
            return WatchdogTimes(setting, measured)
        host.pause(pause)
    number = min(watched)
    raise RigFault(
        f"controller {number} {watched[number]} {host.now() - last:.2f} s after the last command: "
        f"its watchdog of {setting:g} s is not proven"
    )


def _seen(number: int, registers: Registers, setting: float) -> str:
    """Why the watchdog of a controller is not proven yet; empty if it is.

    Raises:
        RigFault: It will not be.
    """
    try:
        mode, torque = registers[Register.MODE], registers[Register.TORQUE]
        fault, time = registers[Register.FAULT], registers[Register.COMMAND_TIMEOUT]
    except KeyError as missing:
        raise RigFault(f"controller {number} does not report register 0x{missing.args[0]:03X}") from None
    if mode not in (Mode.POSITION, Mode.TIMEOUT):
        raise RigFault(
            f"controller {number} went to mode {mode:g} (fault {fault:g}) while its watchdog was measured, "
            "which proves nothing about it; remove the cause and check again"
        )
    if not abs(time - setting) <= _ROUNDING:
        raise RigFault(f"controller {number} has a watchdog of {time:g} s, but the settings have {setting:g}")
    if mode == Mode.POSITION:
        return "accepts torque"
    return "" if torque == 0 else f"gives {torque:g} N·m in mode timeout"
