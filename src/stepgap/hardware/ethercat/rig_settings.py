"""Settings of an EtherCAT bus and its devices: the part of `rig.toml` that is the same for every robot."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, isfinite

from stepgap.base.ranges import format_value, require
from stepgap.hardware.bus_rig import BusTiming
from stepgap.hardware.ethercat.distributed_clocks import SYNC0_AND_SYNC1, SYNC0_ONLY, DcSettings
from stepgap.hardware.ethercat.drive_limits import DriveLimits
from stepgap.hardware.ethercat.pdo import Entry, Packing, Pdo, PdoSet
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.hardware.ethercat.startup import StartupObject, require_objects


@dataclass(frozen=True, kw_only=True)
class WrittenPdo:
    """A PDO as the file describes it.

    Attributes:
        index: Index of the PDO, such as 0x1A00.
        entries: In order, each as `Entry.parse` reads it.
    """

    index: int
    entries: tuple[str, ...]

    def __post_init__(self) -> None:
        require(0x1600 <= self.index <= 0x1BFF, "index", self.index, "lie between 0x1600 and 0x1BFF")
        for entry in self.entries:
            try:
                Entry.parse(entry)
            except ValueError as error:
                raise ValueError(f"entries = {format_value(entry)}, but it must be an entry: {error}") from None

    def pdo(self) -> Pdo:
        """Returns the PDO."""
        return Pdo(self.index, tuple(map(Entry.parse, self.entries)))


@dataclass(frozen=True, kw_only=True)
class WrittenPdoSet:
    """A set of PDOs as the file describes it.

    Attributes:
        name: Name by which slaves refer to it.
        outputs: PDOs from the master to the slave.
        inputs: PDOs from the slave to the master.
    """

    name: str
    outputs: tuple[WrittenPdo, ...] = ()
    inputs: tuple[WrittenPdo, ...] = ()

    def __post_init__(self) -> None:
        require(self.name not in PDO_SETS, "name", self.name, f"differ from the predefined ones: {', '.join(PDO_SETS)}")
        try:
            self.pdo_set()
        except ValueError as error:
            raise ValueError(f"name = {format_value(self.name)}, but it must be a set of PDOs: {error}") from None

    def pdo_set(self) -> PdoSet:
        """Returns the set."""
        return PdoSet(tuple(pdo.pdo() for pdo in self.outputs), tuple(pdo.pdo() for pdo in self.inputs))


@dataclass(frozen=True, kw_only=True)
class Slave:
    """One device of the bus.

    Attributes:
        name: Name for messages and for the tables that refer to it.
        vendor: Vendor ID.
        product: Product code.
        revision: Revision number that the device must have; 0 if any is right.
        esi: ESI file of its vendor, relative to the folder of this file, with which `rig check` compares these
            settings; empty for none.
        pdos: Name of its set of PDOs.
        startup: Objects that are written and read back before it exchanges process data, in this order, each as
            `StartupObject.parse` reads it.
        assign_activate: Distributed clocks: 0x0300 for SYNC0, 0x0700 for SYNC0 and SYNC1, 0 for none; ESI files name
            it *AssignActivate*.
        sync0_shift: Time from a frame at the reference clock to SYNC0 [cycles].
    """

    name: str
    vendor: int
    product: int
    revision: int = 0
    esi: str = ""
    pdos: str = "none"
    startup: tuple[str, ...] = ()
    assign_activate: int = 0
    sync0_shift: float = 0.5

    def __post_init__(self) -> None:
        require(bool(self.name.strip()) and self.name.isprintable(), "name", self.name, "be a string of one line")
        for name in ("vendor", "product", "revision"):
            require(0 <= getattr(self, name) < 2**32, name, getattr(self, name), "lie between 0 and 2³²")
        require_objects(self.startup)
        activate = self.assign_activate
        shift = self.sync0_shift
        rule = "be 0x0300 (SYNC0), 0x0700 (SYNC0 and SYNC1) or 0 (none)"
        require(activate in (0, SYNC0_ONLY, SYNC0_AND_SYNC1), "assign_activate", activate, rule)
        require(0 < shift < 1, "sync0_shift", shift, "lie between 0 and 1")

    @property
    def startup_objects(self) -> tuple[StartupObject, ...]:
        """Those objects."""
        return tuple(map(StartupObject.parse, self.startup))


def _check_bits(bits: int) -> None:
    require(0 <= bits < 2**16, "error_bits", bits, "have at most 16 bits")


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """An encoder; its angle is 2π · sign · (counts − zero) / counts_per_turn.

    Attributes:
        slave: Name of the device that counts.
        counts_per_turn: Counts of the encoder per turn.
        sign: 1 if the counts increase forward or upward, else −1.
        zero: Counts at angle zero.
        error_bits: Bits of the status word of its terminal that make its values invalid; for a Beckhoff terminal
            open circuit 0x0040, synchronisation error 0x2000 and *TxPDO State* 0x4000.
    """

    slave: str
    counts_per_turn: float
    sign: int = 1
    zero: int = 0
    error_bits: int = 0x6040

    def __post_init__(self) -> None:
        _check_bits(self.error_bits)
        counts = self.counts_per_turn
        require(1 <= counts <= 2**32, "counts_per_turn", counts, "lie between 1 and 2³²")
        require(self.sign in (1, -1), "sign", self.sign, "be 1 or -1")
        require(abs(self.zero) < 2**31, "zero", self.zero, "lie within ±2³¹")


@dataclass(frozen=True, kw_only=True)
class Motor(DriveLimits, Encoder):
    """A drive with its encoder; `DriveLimits` describes the limits of what else it reports.

    Attributes:
        rated_torque: Rated torque of the motor [N·m], as in the drive (0x6076), in 1/1000 of which torques are sent.
        torque_limit: Largest torque at the top link [N·m].
        gear: Turns of motor and encoder per turn of the top link.
        velocity_unit: Counts per second of one unit of the drive's velocity (0x606C), which is compared with the
            position; 0 if the drive does not send one, or in another way.
        keep_reactions: Leave the drive's option codes (0x6007, 0x605A to 0x605E) as they are, instead of setting them
            so that torque goes off; for a drive that refuses this, after reading its manual.
        rated_torque_unit: Unit of 0x6076 of the drive [N·m]; 0.001 according to CiA 402, smaller in some drives
            for small motors.
    """

    rated_torque: float
    torque_limit: float
    gear: float = 1.0
    velocity_unit: float = 1.0
    keep_reactions: bool = False
    rated_torque_unit: float = 1e-3

    def __post_init__(self) -> None:
        Encoder.__post_init__(self)
        DriveLimits.__post_init__(self)
        rated = self.rated_torque
        limit = self.torque_limit
        smallest = self.rated_torque_unit
        require(1e-9 <= smallest <= 1, "rated_torque_unit", smallest, "lie between 1e-9 and 1")
        largest = (2**32 - 1) * smallest
        rule = f"lie in the range of 0x6076, {smallest:g} to {largest:.7g}"
        require(smallest <= rated <= largest, "rated_torque", rated, rule)
        require(1e-3 <= self.gear <= 1e4, "gear", self.gear, "lie between 0.001 and 10000")
        unit = self.velocity_unit
        require(isfinite(unit) and unit >= 0, "velocity_unit", unit, "be finite and not negative")
        most = 32 * self.torque_unit * 1000
        require(
            0 < limit <= most, "torque_limit", limit, f"be positive and at most 32 times the rated torque, {most:g}"
        )

    @property
    def rated_units(self) -> int:
        """Rated torque in units of 0x6076."""
        return round(self.rated_torque / self.rated_torque_unit)

    @property
    def torque_unit(self) -> float:
        """Torque at the top link of one unit in the process data [N·m]."""
        return self.rated_torque * self.gear / 1000

    @property
    def most_units(self) -> int:
        """Torque limit in units of the process data."""
        return floor(self.torque_limit / self.torque_unit)

    @property
    def link_counts(self) -> float:
        """Counts per turn of the top link."""
        return self.counts_per_turn * self.gear


@dataclass(frozen=True, kw_only=True)
class ForceSensor:
    """A force sensor; its force is newton_per_count · (counts − zero).

    Attributes:
        slave: Name of the device that measures the force.
        newton_per_count: Its scale [N]; negative if the counts decrease under load.
        zero: Counts without load.
        error_bits: Bits of the status word of its terminal that make its values invalid; for a Beckhoff terminal
            underrange 0x0001, overrange 0x0002, error 0x0040, synchronisation error 0x2000 and *TxPDO State* 0x4000.
    """

    slave: str
    newton_per_count: float
    zero: int = 0
    error_bits: int = 0x6043

    def __post_init__(self) -> None:
        _check_bits(self.error_bits)
        scale = self.newton_per_count
        require(isfinite(scale) and scale != 0, "newton_per_count", scale, "be finite and not zero")
        require(abs(self.zero) < 2**31, "zero", self.zero, "lie within ±2³¹")


RigDevice = Motor | Encoder | ForceSensor
"""A device that a table of `rig.toml` describes: each gives one number of a reading, and a motor takes a torque."""

MOTOR_OUTPUTS = {"target_torque", "controlword"}
MOTOR_INPUTS = {"position", "statusword"}
"""What a motor's PDOs must have; its mode of operation is written and read by SDO unless they have it, too."""


@dataclass(frozen=True, kw_only=True)
class BusSettings(BusTiming):
    """The bus of a robot; each robot adds the tables of its motors, sensors and limits.

    Attributes:
        interface: Network interface of the bus.
        slaves: All devices, in the order of the bus.
        tick: Time between two ticks of control [s].
        frames_per_tick: Frames per tick, such as 4 for a bus at 4 kHz; those between ticks repeat the torques.
        reply_timeout: Timeout of a frame [s]; longer than a tick only for a ring in lock-step.
        watchdog: Time without a frame after which drives switch torque off [s].
        pdo_sets: Sets of PDOs besides the predefined ones.
        dc: Limits of the frames on the reference clock, where slaves use distributed clocks.
    """

    interface: str
    slaves: tuple[Slave, ...]
    tick: float = 1e-3
    frames_per_tick: int = 1
    reply_timeout: float = 5e-4
    watchdog: float = 0.05
    pdo_sets: tuple[WrittenPdoSet, ...] = ()
    dc: DcSettings = DcSettings()

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The motors among the devices, in their order."""
        return tuple(device for device in self.devices.values() if isinstance(device, Motor))

    @property
    def cycle(self) -> float:
        """Time between two frames [s]."""
        return self.tick / self.frames_per_tick

    @property
    def uses_clocks(self) -> bool:
        """Whether a slave uses distributed clocks."""
        return any(slave.assign_activate for slave in self.slaves)

    def __post_init__(self) -> None:
        named = re.fullmatch(r"[!-.0-~]{1,15}", self.interface)  # SOEM copies the name into 16 bytes without a check
        require(bool(named), "interface", self.interface, "name a network interface, such as 'eth0'")
        self.check_times()
        require(1 <= self.frames_per_tick <= 10, "frames_per_tick", self.frames_per_tick, "lie between 1 and 10")
        self._check_slaves()
        for table, device in self.devices.items():
            self._check_use(table, device)

    def _check_slaves(self) -> None:
        """Refuses names that are not distinct, and unknown sets of PDOs."""
        names = [slave.name for slave in self.slaves]
        require(len(set(names)) == len(names), "slaves", names, "have names that differ")
        written = [pdo_set.name for pdo_set in self.pdo_sets]
        require(len(set(written)) == len(written), "pdo_sets", written, "have names that differ")
        sets = self._sets()
        for number, slave in enumerate(self.slaves, start=1):
            require(slave.pdos in sets, f"slaves {number}.pdos", slave.pdos, f"be one of {', '.join(sets)}")
            shift = slave.sync0_shift
            window = self.dc.window
            reached = bool(slave.assign_activate) and not window < shift < 1 - window
            rule = f"lie between dc.window = {window:g} and {1 - window:g}, or frames in the window could meet SYNC0"
            require(not reached, f"slaves {number}.sync0_shift", shift, rule)

    def pdo_set(self, slave: Slave) -> PdoSet:
        """PDOs that a slave exchanges."""
        return self._sets()[slave.pdos]

    def position(self, name: str) -> int:
        """Index on the bus of the slave with a name, from 0."""
        return [slave.name for slave in self.slaves].index(name)

    def _sets(self) -> Mapping[str, PdoSet]:
        return {**PDO_SETS, **{written.name: written.pdo_set() for written in self.pdo_sets}}

    def _check_use(self, table: str, device: RigDevice) -> None:
        """Refuses an unknown slave, or one that does not exchange the values that a table needs."""
        outputs, inputs = _values_of(device)
        name = device.slave
        names = [slave.name for slave in self.slaves]
        require(name in names, f"{table}.slave", name, f"name one of the slaves: {', '.join(names)}")
        pdos = self.pdo_set(self.slaves[names.index(name)])
        lacking = outputs - set(Packing(pdos.outputs).names) | inputs - set(Packing(pdos.inputs).names)
        rule = f"be a slave whose PDOs have {', '.join(sorted(lacking))}"
        require(not lacking, f"{table}.slave", name, rule)
        if isinstance(device, Motor):
            device.require_values(table, name, self.input_entries(name))

    def input_entries(self, name: str) -> Mapping[str, Entry]:
        """Entries of the values that the slave with a name sends, by their names."""
        mapping = Packing(self.pdo_set(self.slaves[self.position(name)]).inputs).mapping
        return {value: entry for value, (entry, _) in mapping.items()}


def _values_of(device: RigDevice) -> tuple[set[str], set[str]]:
    """Names of the values that a device receives from the master, and of those that it sends."""
    if isinstance(device, Motor):
        return MOTOR_OUTPUTS, MOTOR_INPUTS
    return set(), {"counter"} if isinstance(device, Encoder) else {"force"}
