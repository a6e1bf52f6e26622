"""The proof that controllers switch torque off by themselves when commands end.

In the firmware of moteus (`fw/moteus_controller.cc`, `fw/bldc_servo_control.h`), only a frame that writes the mode
restarts the watchdog, and one that only reads registers does not. The watchdog counts down the time in the last
command; at zero the mode becomes *timeout* until a stop command. With `servo.timeout_mode` = 0, the reported torque is
exactly zero from then on. After `servo.cooldown_cycles` (256 periods with a current of zero, 9 ms at 30 kHz) the motor
driver is off.
"""

from collections.abc import Callable, Collection, Mapping
from math import isfinite
from time import monotonic

import moteus
from moteus import Mode, Register

from stepgap.hardware.bus_rig import HostTime
from stepgap.hardware.moteus.can_bus import CanBus, Registers, stream_of
from stepgap.rigs.rig import RigFault, WatchdogTimes

LONGEST_TIMEOUT = 0.5  # Longest `servo.default_timeout_s` that is not worth a remark [s]
CONFIGURATION_TIMEOUT = 1.0  # Timeout of an answer with one value [s]

TIMEOUT_MODES = {10: "decelerate and hold", 12: "damping", 15: "brake"}
"""Values of `servo.timeout_mode` with which a motor has torque after a timeout."""

_TIMEOUT_MODE = "servo.timeout_mode"
_DEFAULT_TIMEOUT = "servo.default_timeout_s"
_LARGEST_LINE = 1000
_ATTEMPTS = 3


def check_timeout(bus: CanBus, controller: moteus.Controller, timeout: float = CONFIGURATION_TIMEOUT) -> list[str]:
    """Ensures that a controller switches torque off after a timeout; returns remarks about its configuration.

    Args:
        controller: Encoder of its frames.
        timeout: Timeout of each value [s].

    Raises:
        RigFault: It would have torque after a timeout, or does not report its configuration.
    """
    number = controller.id
    mode = int(_read(bus, controller, _TIMEOUT_MODE, timeout, int))
    if mode != 0:
        raise RigFault(
            f"controller {number}: {_TIMEOUT_MODE} is {mode} ({TIMEOUT_MODES.get(mode, 'unknown')}), so its motor has "
            f"torque after its watchdog; in `tview`, type `conf set {_TIMEOUT_MODE} 0` and `conf write`"
        )
    default = _read(bus, controller, _DEFAULT_TIMEOUT, timeout, float)
    if isfinite(default) and default <= LONGEST_TIMEOUT:
        return []
    return [
        f"controller {number}: {_DEFAULT_TIMEOUT} is {default:g}: commands of other programs, which may have no "
        "watchdog of their own, keep their torque for as long"
    ]


def _read(bus: CanBus, controller: moteus.Controller, name: str, timeout: float, kind: Callable[[str], float]) -> float:
    """Reads one value.

    Raises:
        RigFault: There is no answer, or it is not a number.
    """
    for _ in range(_ATTEMPTS):
        line = _asked(bus, controller, name, monotonic() + timeout)
        if line is not None:
            break
    else:
        raise RigFault(f"controller {controller.id} did not report its {name}")
    try:
        return kind(line)
    except ValueError:
        raise RigFault(f"controller {controller.id} reports {line!r} as its {name}, which is not a number") from None


def _asked(bus: CanBus, controller: moteus.Controller, name: str, until: float) -> str | None:
    """Asks for one value after it has discarded older text; returns the line, or None if it does not come in time.

    Raises:
        RigFault: The older text has no end.
    """
    while _poll(bus, controller, until):
        if monotonic() > until:
            raise RigFault(
                f"controller {controller.id} sends text without end: stop its telemetry (`tel stop` in tview)"
            )
    bus.send({controller.id: controller.make_diagnostic_write(f"conf get {name}\n".encode("ascii"))})
    text = b""
    while not text.endswith(b"\n") and len(text) < _LARGEST_LINE and monotonic() < until:
        text += _poll(bus, controller, until) or b""
    return text.decode("ascii", "replace").strip() if text.endswith(b"\n") else None


def _poll(bus: CanBus, controller: moteus.Controller, until: float) -> bytes | None:
    """Asks for text; empty if there is none, None without an answer."""
    bus.send({controller.id: controller.make_diagnostic_read()})
    return bus.receive({controller.id}, max(0.0, until - monotonic()), stream_of).get(controller.id)


PATIENCE = 0.1  # Time in addition to twice the watchdog's until it counts as missing [s]
_ROUNDING = 1e-6  # Rounding error of a time in single precision [s]


def watchdog_query() -> moteus.QueryResolution:
    """Query of mode, torque, fault, and the watchdog's time of the last command."""
    query = moteus.QueryResolution()
    query.position = query.velocity = query.voltage = query.temperature = moteus.IGNORE
    query._extra = {int(Register.COMMAND_TIMEOUT): moteus.F32}
    return query


def measure_watchdogs(
    ask: Callable[[], Mapping[int, Registers]], numbers: Collection[int], setting: float, pause: float, host: HostTime
) -> WatchdogTimes:
    """Measures when controllers report the mode *timeout* without torque, after a last command that was just sent.

    Args:
        ask: Sends queries, without commands, and returns the registers of the controllers that answer.
        numbers: Identifiers of all controllers.
        setting: Time of the watchdog in the last command [s].
        pause: Time between two queries [s].

    Raises:
        RigFault: A controller keeps its mode or torque for twice this time, has taken over another time, or stops for
            another reason, which proves nothing.
    """
    last = host.now()
    measured = {}
    watched = dict.fromkeys(numbers, "did not answer")
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
        mode = registers[Register.MODE]
        torque = registers[Register.TORQUE]
        fault = registers[Register.FAULT]
        time = registers[Register.COMMAND_TIMEOUT]
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
