"""A rig around another one, which observes or changes single ticks."""

# pyright: reportIncompatibleMethodOverride=false
# (Properties that `_passed` makes are no functions to it.)

from typing import Any

from stepgap.rigs.rig import Rig


def _passed(name: str) -> Any:
    return property(lambda wrapped: getattr(wrapped._rig, name))


class WrappedRig(Rig):
    """Passes everything to another rig; a subclass overrides what it observes or changes.

    Args:
        rig: The other rig.
    """

    def __init__(self, rig: Rig):
        self._rig = rig

    sensor_model = _passed("sensor_model")
    limits = _passed("limits")
    clock_limits = _passed("clock_limits")
    diagnostic_units = _passed("diagnostic_units")
    diagnostics = _passed("diagnostics")
    diagnostic_ranges = _passed("diagnostic_ranges")
    diagnostic_names = _passed("diagnostic_names")
    warning = _passed("warning")
    remarks = _passed("remarks")
    truth = _passed("truth")
    released = _passed("released")
    health = _passed("health")
    clock_correction = _passed("clock_correction")
    findings = _passed("findings")
    watchdog_times = _passed("watchdog_times")
    connect = _passed("connect")
    read = _passed("read")
    write = _passed("write")
    close = _passed("close")
