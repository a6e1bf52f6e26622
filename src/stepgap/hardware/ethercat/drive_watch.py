"""What a drive reports beside its motion, reading by reading: is it within its limits, and can it be believed?"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, inf, nan
from typing import NamedTuple, Self, TypeVar

from stepgap.hardware.bus_rig import MOST_WRONG, TorqueWatch
from stepgap.hardware.ethercat.cia402 import FOLLOWS_COMMAND, INTERNAL_LIMIT, STATUSWORD_UNIT, WARNING
from stepgap.hardware.ethercat.drive_limits import (
    BUS_VOLTAGE,
    DIGITAL_INPUTS,
    TEMPERATURE,
    TEMPERATURES,
    VOLTAGES,
    DriveLimits,
    largest_number,
)
from stepgap.hardware.ethercat.pdo import SIGNED_VALUES, Entry
from stepgap.hardware.ethercat.rig_settings import BusSettings, Motor

MOTION_UNITS = {"statusword": STATUSWORD_UNIT, "velocity": "drive counts/s", "torque": "rated torque / 1000"}
"""Values of a drive that are logged as they are, with their units."""

BEYOND = 3  # Number of plausible readings in a row beyond a limit, after which it counts as exceeded: one may be noise
MOST_DOUBTS = 20  # Number by which implausible readings must exceed plausible ones, until a value counts as invalid
LARGEST_JUMP = 5.0  # Largest plausible change of a temperature from one reading to the next [°C]; at least two counts

MOST_WARNED = 20
"""Number of readings in a row with a bit of the status word that warns, after which the robot shall land."""

MOST_SAME = 8  # Number of readings in a row in which no value of a drive may change, although the commands do

ONLY_STO = "it may keep its torque, and then only its STO input stops it"
"""What a person must know of a drive that no longer follows its commands."""

WARNED_BITS = {WARNING: "warns (bit 7 of its status word)", INTERNAL_LIMIT: "is at an internal limit (bit 11)"}
"""Bits that warn, and what the drive does then."""

INPUT_STATES = {0: "closed", 1: "open"}  # Names of the logged numbers of an STO or enable input


@dataclass(frozen=True)
class ReportedValue:
    """A value that a drive reports as a number, and its limits.

    Attributes:
        name: Name of the value in the PDOs.
        unit: Unit of the limits.
        scale: Value of one count.
        plausible: Least and largest plausible value.
        jump: Largest plausible change from one reading to the next.
        limits: Least and largest value that is allowed.
        warning: Value above which the robot shall land.
        frozen: Number of readings for which the value may stay exactly the same.
        without_value: Numbers by which the drive indicates that it has no value.
    """

    name: str
    unit: str
    scale: float
    plausible: tuple[float, float]
    jump: float = inf
    limits: tuple[float, float] = (-inf, inf)
    warning: float = inf
    frozen: float = inf
    without_value: tuple[int, ...] = ()

    @property
    def is_limited(self) -> bool:
        """Whether anything depends on the value."""
        return self.limits != (-inf, inf) or self.warning < inf or self.frozen < inf

    def value(self, raw: int) -> float:
        """Value of a number in the process data; NaN if the drive has none."""
        return nan if raw in self.without_value else raw * self.scale


class Track(NamedTuple):
    """What was seen of a value.

    Attributes:
        value: Last plausible value; NaN before the first.
        doubts: Number of implausible readings that were not outweighed by plausible ones.
        beyond: Number of plausible readings in a row beyond the limits.
        warned: Number of plausible readings in a row above the warning level.
        same: Number of readings since the value changed.
    """

    value: float = nan
    doubts: int = 0
    beyond: int = 0
    warned: int = 0
    same: int = 0


def with_value(reported: ReportedValue, track: Track, value: float) -> Track:
    """Track with another reading; an implausible one, such as NaN, changes the doubts only."""
    least, most = reported.plausible
    if not least <= value <= most or abs(value - track.value) > reported.jump:
        return track._replace(doubts=track.doubts + 1)
    low, high = reported.limits
    return Track(
        value=value,
        doubts=track.doubts - 1 if track.doubts else 0,
        beyond=track.beyond + 1 if not low <= value <= high else 0,
        warned=track.warned + 1 if value > reported.warning else 0,
        same=track.same + 1 if value == track.value else 0,
    )


def excess_of(reported: ReportedValue, track: Track) -> str:
    """Describes a value beyond its limits, after which torque must go off; empty if it is within them."""
    if track.beyond < BEYOND:
        return ""
    low, high = reported.limits
    rule = f"at most {high:g}" if low == -inf else f"{low:g} to {high:g}"
    return f"its {_words(reported)} is {track.value:.1f} {reported.unit}, allowed is {rule}"


def warning_of(reported: ReportedValue, track: Track) -> str:
    """Describes why the robot should land: the warning level, or a value that cannot be relied upon; or empty."""
    if not reported.is_limited:
        return ""
    if track.doubts >= MOST_DOUBTS:
        return f"its {_words(reported)} is not plausible"
    if track.same >= reported.frozen:
        return f"its {_words(reported)} is frozen at {track.value:.1f} {reported.unit}"
    if track.warned >= BEYOND:
        return f"its {_words(reported)} is {track.value:.1f} {reported.unit}, more than {reported.warning:g}"
    return ""


def _words(reported: ReportedValue) -> str:
    return reported.name.replace("_", " ")


def reported_values(limits: DriveLimits, entries: Mapping[str, Entry], cycle: float) -> list[ReportedValue]:
    """Temperature and bus voltage, as far as a drive sends them; arguments as of `DriveWatch`."""
    pair = limits.bus_voltage
    wanted = (
        ReportedValue(
            TEMPERATURE,
            "°C",
            limits.temperature_unit,
            TEMPERATURES,
            max(LARGEST_JUMP, 2 * limits.temperature_unit),
            (-inf, limits.temperature_limit),
            limits.temperature_warning,
            limits.temperature_frozen_time / cycle,
            _without_value(entries.get(TEMPERATURE)),
        ),
        ReportedValue(
            BUS_VOLTAGE,
            "V",
            limits.bus_voltage_unit,
            VOLTAGES,
            limits=(pair[0], pair[1]) if pair else (-inf, inf),
            frozen=limits.bus_voltage_frozen_time / cycle,
            without_value=_without_value(entries.get(BUS_VOLTAGE)),
        ),
    )
    return [reported for reported in wanted if reported.name in entries]


def _without_value(entry: Entry | None) -> tuple[int, ...]:
    if entry is None:
        return ()
    most = largest_number(entry)
    return (most, -most - 1) if SIGNED_VALUES[entry.name] else (most,)


@dataclass(frozen=True)
class SafetyInput:
    """An input that must be closed for torque.

    Attributes:
        name: Name of its field in the log.
        label: Its name for messages.
        mask: Its bits; 0 if the drive does not report it.
        closed: These bits while all its channels are closed.
    """

    name: str
    label: str
    mask: int
    closed: int

    @classmethod
    def of(cls, name: str, label: str, bits: tuple[int, ...], opened: int) -> Self:
        """Input with some bits, each of which has the value `opened` while its channel is open."""
        mask = sum(1 << bit for bit in bits)
        return cls(name, label, mask, 0 if opened else mask)

    def is_open(self, inputs: int) -> bool:
        """Whether one of its channels is open."""
        return inputs & self.mask != self.closed


class Obedience:
    """Whether a drive still follows its commands, by its torque, its status word and the changes of its values.

    Arguments as of `DriveWatch`.
    """

    def __init__(self, limits: DriveLimits, entries: Mapping[str, Entry], cycle: float):
        self._has_torque = "torque" in entries  # without it, a link that rests could be one that hangs
        self._judges_torque = self._has_torque and limits.torque_tolerance < inf
        self._torque = TorqueWatch(1000 * limits.torque_tolerance, ceil(limits.torque_delay / cycle))
        ignored = sum(1 << bit for bit in limits.ignored_status_bits)
        self._warned = {bit: 0 for bit in WARNED_BITS if not bit & ignored}
        self._judges_following = not FOLLOWS_COMMAND & ignored
        self.restart()

    def restart(self) -> None:
        """Forgets earlier readings and commands."""
        self._torque.restart()
        self._warned = dict.fromkeys(self._warned, 0)
        self._follows = False
        self._ignoring = 0
        self._last = dict[str, int]()
        self._same = 0

    def command(self, units: int) -> None:
        """Adds the command that was sent last, in 1/1000 of the rated torque."""
        self._torque.command(units)

    def excess(self, values: Mapping[str, int]) -> str:
        """Takes the inputs of a good frame; returns why torque must go off, or an empty text."""
        status = values["statusword"]
        for bit in self._warned:
            self._warned[bit] = self._warned[bit] + 1 if status & bit else 0
        follows = bool(status & FOLLOWS_COMMAND)
        self._follows = self._follows or follows
        self._ignoring = 0 if follows else self._ignoring + 1
        self._same = self._same + 1 if self._has_torque and self._last == values and self._torque.changed else 0
        self._last = dict(values)
        if self._judges_following and self._follows and self._ignoring >= MOST_WRONG:
            return f"it ignores its commands (bit 12 of its status word); {ONLY_STO}"
        if self._same >= MOST_SAME:
            return f"none of its values changes any more although its commands do: it hangs; {ONLY_STO}"
        if self._judges_torque and self._torque.reading(values["torque"]):
            torque = values["torque"]
            sent = self._torque.commanded
            return f"its torque is {torque}, commanded were {sent} (1/1000 of the rated torque); {ONLY_STO}"
        return ""

    @property
    def warning(self) -> str:
        """Why the robot should land, or an empty text."""
        return next((f"it {WARNED_BITS[bit]}" for bit, count in self._warned.items() if count >= MOST_WARNED), "")


class DriveWatch:
    """Watches the values of one drive, and keeps those that are logged.

    Args:
        label: Name of the drive for messages.
        entries: Entries of its inputs by name.
        cycle: Time between two readings [s].
    """

    def __init__(self, label: str, limits: DriveLimits, entries: Mapping[str, Entry], cycle: float):
        self._label = label
        self._reported = reported_values(limits, entries, cycle)
        self._obedience = Obedience(limits, entries, cycle)
        self.restart()
        inputs = (
            SafetyInput.of("sto", "STO input", limits.sto_bits, limits.sto_open),
            SafetyInput.of("enable", "enable input", limits.enable_bits, limits.enable_open),
        )
        self._inputs = [watched for watched in inputs if watched.mask]
        self._raw = [name for name in MOTION_UNITS if name in entries]
        self._raw += [DIGITAL_INPUTS] if DIGITAL_INPUTS in entries else []
        self.units = {
            **{name: MOTION_UNITS.get(name, "") for name in self._raw},
            **{reported.name: reported.unit for reported in self._reported},
            **{watched.name: "" for watched in self._inputs},
        }
        """Logged values with their units."""
        self.ranges = {reported.name: reported.limits for reported in self._reported}
        """Limits of logged values; infinite if there is none."""
        self.names = {watched.name: INPUT_STATES for watched in self._inputs}
        """Names of the numbers of logged values."""
        self.values: tuple[float, ...] = (nan,) * len(self.units)
        """Logged values in the last reading."""

    def restart(self) -> None:
        """Forgets earlier readings, as after a pause without frames."""
        self._tracks = [Track()] * len(self._reported)
        self._obedience.restart()

    def command(self, units: int) -> None:
        """Adds the command that was sent last, in 1/1000 of the rated torque."""
        self._obedience.command(units)

    def update(self, values: Mapping[str, int]) -> str:
        """Takes the inputs of a good frame; returns why torque must go off, or an empty text."""
        numbers = [float(values[name]) for name in self._raw]
        excess = ""
        for index, reported in enumerate(self._reported):
            raw = values[reported.name]
            self._tracks[index] = track = with_value(reported, self._tracks[index], reported.value(raw))
            excess = excess_of(reported, track) or excess
            numbers.append(raw * reported.scale)
        opened = [float(watched.is_open(values[DIGITAL_INPUTS])) for watched in self._inputs]
        self.values = (*numbers, *opened)
        if any(opened):
            return self.open_inputs(values)
        excess = self._obedience.excess(values) or excess
        return f"{self._label}: {excess}" if excess else ""

    def open_inputs(self, values: Mapping[str, int]) -> str:
        """Names the inputs that are open, or returns an empty text."""
        labels = [watched.label for watched in self._inputs if watched.is_open(values[DIGITAL_INPUTS])]
        if not labels:
            return ""
        verb = "are" if len(labels) > 1 else "is"
        return f"the {' and the '.join(labels)} of {self._label} {verb} open"

    def describe(self, values: Mapping[str, int]) -> str:
        """Describes temperature and bus voltage in the inputs of a frame; empty if the drive reports neither."""
        return ", ".join(f"{values[reported.name] * reported.scale:.1f} {reported.unit}" for reported in self._reported)

    @property
    def warning(self) -> str:
        """Why the robot should land, or an empty text."""
        texts = (*map(warning_of, self._reported, self._tracks), self._obedience.warning)
        return next((f"{self._label}: {text}" for text in texts if text), "")


_T = TypeVar("_T")

NO_STO_INPUT = "no drive reports its STO input (digital_inputs, sto_bits): an open one is seen only by a drive's state"
"""Remark on a bus whose messages cannot name its STO inputs."""

TORQUE_NOT_REPORTED = "does not report its torque (0x6077), so that it cannot be compared with the commands"
"""Remark on a drive."""


class WatchedDrives:
    """Watches what the drives report beside their motion.

    Args:
        inputs: Gives the inputs of a slave from the last good frame.
    """

    def __init__(self, settings: BusSettings, label: Callable[[int], str], inputs: Callable[[int], Mapping[str, int]]):
        self._inputs = inputs
        self._watches = dict[str, tuple[int, DriveWatch]]()
        self.remarks: list[str] = []
        """What drives report without a limit, and whether none reports its STO input."""
        for table, motor in settings.devices.items():
            if isinstance(motor, Motor):
                drive = settings.position(motor.slave)
                entries = settings.input_entries(motor.slave)
                self._watches[table] = drive, DriveWatch(label(drive), motor, entries, settings.cycle)
                self.remarks += motor.remarks(label(drive), entries)
                self.remarks += [] if "torque" in entries else [f"{label(drive)} {TORQUE_NOT_REPORTED}"]
        self.hint = "" if any(motor.sto_bits for motor in settings.motors) else NO_STO_INPUT
        """Why messages cannot name an open STO input; empty if they can."""
        if self.hint:
            self.remarks.insert(0, self.hint)
        self.units = self._of_all(lambda watch: watch.units)
        """Logged values with their units."""
        self.ranges = self._of_all(lambda watch: watch.ranges)
        """Limits of logged values; infinite where there is none."""
        self.names = self._of_all(lambda watch: watch.names)
        """Names of the numbers of logged values."""

    @property
    def values(self) -> tuple[float, ...]:
        """Logged values in the last reading."""
        return tuple([value for _, watch in self._watches.values() for value in watch.values])

    @property
    def warning(self) -> str:
        """Why the robot should land; empty if there is no reason."""
        return next((warning for _, watch in self._watches.values() if (warning := watch.warning)), "")

    def restart(self) -> None:
        """Forgets earlier readings."""
        for _, watch in self._watches.values():
            watch.restart()

    def command(self, number: int, units: int) -> None:
        """Adds the command that was sent to a drive last, in 1/1000 of the rated torque."""
        for drive, watch in self._watches.values():
            if drive == number:
                watch.command(units)

    def update(self) -> str:
        """Takes the inputs of a good frame; returns why torque must go off, or an empty text."""
        faults = [watch.update(self._inputs(drive)) for drive, watch in self._watches.values()]
        return "; ".join(filter(None, faults)) if any(faults) else ""

    def open_inputs(self) -> str:
        """Names the STO and enable inputs that are open in the last good frame; empty if none is."""
        reports = [watch.open_inputs(self._inputs(drive)) for drive, watch in self._watches.values()]
        return "; ".join(filter(None, reports))

    def describe(self, number: int) -> str:
        """Describes temperature and bus voltage of a drive in the last good frame; empty if it reports neither."""
        reports = [watch.describe(self._inputs(drive)) for drive, watch in self._watches.values() if drive == number]
        return ", ".join(filter(None, reports))

    def _of_all(self, values: Callable[[DriveWatch], Mapping[str, _T]]) -> dict[str, _T]:
        """Values of all watches, with the names of the motors before theirs."""
        return {
            f"{motor}_{name}": value
            for motor, (_, watch) in self._watches.items()
            for name, value in values(watch).items()
        }
