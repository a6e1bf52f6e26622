"""Limits of what a drive reports beside its motion: temperature, bus voltage, STO and enable inputs."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, isfinite

from stepgap.base.ranges import require
from stepgap.hardware.ethercat.pdo import SIGNED_VALUES, Entry

# Names of the values in the PDOs.
TEMPERATURE = "temperature"
BUS_VOLTAGE = "bus_voltage"
DIGITAL_INPUTS = "digital_inputs"

TEMPERATURES = (-40.0, 200.0)  # Range of plausible temperatures [°C], within which limits must lie
VOLTAGES = (0.0, 1000.0)  # Range of plausible voltages of a bus [V], likewise

_MOST_BITS = 32

JUDGED_BITS = (7, 11, 12)  # Numbers of the bits of a status word that are judged, besides those of the state


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """Keys in the table of a motor that limit what its drive may report; each needs a value in the PDOs of the drive.

    Attributes:
        temperature_unit: Temperature of one count [°C].
        temperature_warning: Temperature above which the robot lands [°C].
        temperature_limit: Temperature above which torque goes off [°C]; it needs a lower `temperature_warning`.
        temperature_frozen_time: Time for which the temperature may stay exactly the same, until it is doubted [s].
        bus_voltage_unit: Voltage of one count [V]; 0x6079 counts millivolts.
        bus_voltage: Lowest and highest voltage, beyond which torque goes off [V]; empty if there is no limit.
        bus_voltage_frozen_time: Time for which the voltage may stay exactly the same, until it is doubted [s].
        sto_bits: Numbers of the bits of `digital_inputs` that show the channels of the STO input; empty if none does.
        sto_open: Value of these bits while the input is open, so that it removes the torque.
        enable_bits: Numbers of the bits that show an enable input.
        enable_open: Value of these bits while the input is open.
        torque_tolerance: Largest distance of the torque that the drive reports (0x6077) from the commands of the last
            `torque_delay`, as a part of the rated torque; infinite for a drive that reports something else.
        torque_delay: Time that delay, lag and filter take from a command to the reported torque, at most [s].
        ignored_status_bits: Of the bits 7 (warning), 11 (internal limit) and 12 (follows the command) of the status
            word, those that are not judged, since the drive uses them in another way.
    """

    temperature_unit: float = 1.0
    temperature_warning: float = inf
    temperature_limit: float = inf
    temperature_frozen_time: float = inf
    bus_voltage_unit: float = 1e-3
    bus_voltage: tuple[float, ...] = ()
    bus_voltage_frozen_time: float = inf
    sto_bits: tuple[int, ...] = ()
    sto_open: int = 0
    enable_bits: tuple[int, ...] = ()
    enable_open: int = 0
    torque_tolerance: float = 0.06
    torque_delay: float = 0.005
    ignored_status_bits: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        require(self.torque_tolerance >= 0.01, "torque_tolerance", self.torque_tolerance, "be at least 0.01")
        require(0.001 <= self.torque_delay <= 0.05, "torque_delay", self.torque_delay, "lie between 0.001 and 0.05")
        ignored = list(self.ignored_status_bits)
        require(set(ignored) <= {*JUDGED_BITS}, "ignored_status_bits", ignored, f"be some of {[*JUDGED_BITS]}")
        for name in ("temperature_unit", "bus_voltage_unit"):
            unit = getattr(self, name)
            require(isfinite(unit) and 1e-4 <= unit <= 10, name, unit, "lie between 0.0001 and 10")
        least, most = TEMPERATURES
        for name in ("temperature_warning", "temperature_limit"):
            value = getattr(self, name)
            require(value == inf or least < value < most, name, value, f"lie between {least:g} and {most:g}")
        warning = self.temperature_warning
        limit = self.temperature_limit
        rule = f"be below temperature_limit = {limit:g}, so that the robot lands before torque goes off"
        require(warning < limit or limit == inf, "temperature_warning", warning, rule)
        for name in ("temperature_frozen_time", "bus_voltage_frozen_time"):
            require(getattr(self, name) >= 0.1, name, getattr(self, name), "be at least 0.1")
        _require_voltages(self.bus_voltage)
        self._require_bits()

    def _require_bits(self) -> None:
        for name in ("sto_bits", "enable_bits"):
            bits = getattr(self, name)
            is_valid = all(0 <= bit < _MOST_BITS for bit in bits) and len(set(bits)) == len(bits)
            require(is_valid, name, list(bits), "be different numbers of bits from 0 to 31")
        both = set(self.sto_bits) & set(self.enable_bits)
        require(not both, "enable_bits", list(self.enable_bits), f"differ from sto_bits = {list(self.sto_bits)}")
        for name in ("sto_open", "enable_open"):
            require(getattr(self, name) in (0, 1), name, getattr(self, name), "be 0 or 1")

    def require_values(self, table: str, slave: str, entries: Mapping[str, Entry]) -> None:
        """Raises ValueError if a key needs a value that the drive does not send, or that cannot reach its limit."""
        for field in fields(DriveLimits):
            wanted = _NEEDS.get(field.name, "")
            value = getattr(self, field.name)
            is_met = not wanted or wanted in entries or value == field.default
            rule = f"be left out, or the PDOs of '{slave}' must have an entry named {wanted}"
            require(is_met, f"{table}.{field.name}", list(value) if isinstance(value, tuple) else value, rule)
        for name, value, unit in self._largest():
            entry = entries.get(_NEEDS[name])
            most = inf if entry is None else unit * largest_number(entry)
            shown = list(self.bus_voltage) if name == BUS_VOLTAGE else value
            require(value < most, f"{table}.{name}", shown, f"be below the largest value of {entry}, {most:g}")
        for name in ("sto_bits", "enable_bits"):
            bits = getattr(self, name)
            entry = entries.get(DIGITAL_INPUTS)
            fits = entry is None or all(bit < entry.bits for bit in bits)
            require(fits, f"{table}.{name}", list(bits), f"be bits of {entry}")

    def _largest(self) -> list[tuple[str, float, float]]:
        """Name, largest number and unit of each finite limit."""
        limits = [(name, getattr(self, name), self.temperature_unit) for name in _TEMPERATURE_LIMITS]
        limits += [(BUS_VOLTAGE, max(self.bus_voltage), self.bus_voltage_unit)] if self.bus_voltage else []
        return [limit for limit in limits if limit[1] < inf]

    def remarks(self, label: str, mapped: Mapping[str, object]) -> list[str]:
        """What a drive, of which these values are mapped, reports without a limit, one line each."""
        limits = (
            (TEMPERATURE, self.temperature_limit < inf, "temperature_limit is not set"),
            (BUS_VOLTAGE, bool(self.bus_voltage), "bus_voltage has no limits"),
            (DIGITAL_INPUTS, bool(self.sto_bits), "sto_bits do not say which bit is its STO input"),
        )
        return [f"{label} reports {name}, but {what}" for name, is_set, what in limits if name in mapped and not is_set]


_TEMPERATURE_LIMITS = ("temperature_warning", "temperature_limit")

_NEEDS = {
    **dict.fromkeys((*_TEMPERATURE_LIMITS, "temperature_frozen_time"), TEMPERATURE),
    **dict.fromkeys((BUS_VOLTAGE, "bus_voltage_frozen_time"), BUS_VOLTAGE),
    **dict.fromkeys(("sto_bits", "enable_bits"), DIGITAL_INPUTS),
}
"""Value that a key needs in the PDOs."""


def largest_number(entry: Entry) -> int:
    """Largest number of an entry; drives use it, and the least one if it is signed, where they have no value."""
    return 2 ** (entry.bits - 1) - 1 if SIGNED_VALUES[entry.name] else 2**entry.bits - 1


def _require_voltages(limits: tuple[float, ...]) -> None:
    rule = f"be two voltages, [lowest, highest], above 0 and below {VOLTAGES[1]:g}"
    is_pair = len(limits) == 2 and 0 < limits[0] < limits[1] < VOLTAGES[1]
    require(not limits or is_pair, BUS_VOLTAGE, list(limits), rule)
