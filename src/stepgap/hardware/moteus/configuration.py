"""Configuration of controllers, read as text over the diagnostic channel, and whether a timeout ends their torque."""

from collections.abc import Callable
from math import isfinite
from time import monotonic

import moteus

from stepgap.hardware.moteus.can_bus import CanBus, stream_of
from stepgap.rigs.rig import RigFault

LONGEST_TIMEOUT = 0.5
"""Longest `servo.default_timeout_s` that is not worth a remark [s]."""

CONFIGURATION_TIMEOUT = 1.0
"""Timeout of an answer with one value [s]."""

TIMEOUT_MODES = {10: "decelerate and hold", 12: "damping", 15: "brake"}
"""Values of `servo.timeout_mode` with which a motor has torque after a timeout."""

_TIMEOUT_MODE, _DEFAULT_TIMEOUT = "servo.timeout_mode", "servo.default_timeout_s"
_LARGEST_LINE, _ATTEMPTS = 1000, 3


def check_timeout(bus: CanBus, controller: moteus.Controller, timeout: float = CONFIGURATION_TIMEOUT) -> list[str]:
    """Ensures that a controller switches torque off after a timeout; returns remarks about its configuration.

    Args:
        bus: The bus.
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
