"""A torque-controlled drive: its side of the device control of CiA 402-2 (ETG.6010), mode 10 only."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from math import exp, sqrt, tau
from typing import NamedTuple

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.dictionary import Abort, Dictionary, ObjectEntry
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.mailbox import emergency
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.hardware.ethercat.pdo import Pdo
from stepgap.hardware.ethercat.pdo_sets import PDO_SETS
from stepgap.rigs.rig import Reading


@dataclass(frozen=True)
class DriveLayout:
    """PDOs of a drive after power-up.

    Attributes:
        outputs: PDOs from the master.
        inputs: PDOs to the master.
        assigned_outputs: Those of the outputs that are exchanged.
        assigned_inputs: Those of the inputs that are exchanged.
        mappable: Whether a master may write the contents of PDOs.
    """

    outputs: tuple[Pdo, ...]
    inputs: tuple[Pdo, ...]
    assigned_outputs: tuple[int, ...]
    assigned_inputs: tuple[int, ...]
    mappable: bool = True

    def idle_objects(self, implemented: Mapping[tuple[int, int], ObjectEntry]) -> dict[tuple[int, int], ObjectEntry]:
        """Objects in these PDOs that the drive does not implement: they remain 0, or as the master sets them."""
        return {
            (entry.index, entry.subindex): ObjectEntry(0, entry.bits)
            for pdo in (*self.outputs, *self.inputs)
            for entry in pdo.entries
            if entry.index and (entry.index, entry.subindex) not in implemented
        }


ELMO_LAYOUT = DriveLayout(PDO_SETS["elmo-cst"].outputs, PDO_SETS["elmo-cst"].inputs, (0x1602,), (0x1A02,))
"""PDOs for torque control with the mapping of Elmo's drives; only 0x1602 and 0x1A02 are assigned after power-up."""


@dataclass(frozen=True)
class PowerSettings:
    """Parameters of a power stage, which has a supply and a capacitor of its own.

    Attributes:
        ambient: Temperature without losses [°C].
        heating: Rate at which the rated torque heats a cold drive [K/s]; losses are proportional to the square of it.
        cooling_time: Time constant of cooling [s].
        voltage: Voltage of the supply, which gives energy but takes none back [V].
        capacity: Capacity of the bus [F]; so large that the energy of a fall changes the voltage by a few volts only.
        charging_time: Time constant with which the supply charges it [s].
    """

    ambient: float = 25.0
    heating: float = 0.1
    cooling_time: float = 300.0
    voltage: float = 48.0
    capacity: float = 0.5
    charging_time: float = 0.005


class PowerStage(NamedTuple):
    """State of a power stage.

    Attributes:
        temperature: Its temperature [°C].
        voltage: Voltage of its bus [V].
    """

    temperature: float
    voltage: float


def next_stage(
    settings: PowerSettings, stage: PowerStage, time: float, load: float, power: float, heating: float = 0.0
) -> PowerStage:
    """State after a time.

    Args:
        time: The time [s].
        load: Torque, as a fraction of the rated one.
        power: Power that the motor takes from the bus, negative if it is driven [W].
        heating: Further heating [K/s].
    """
    rise = (settings.heating * load * load + heating) * settings.cooling_time
    kept = exp(-time / settings.cooling_time)
    temperature = settings.ambient + rise + (stage.temperature - settings.ambient - rise) * kept
    energy = settings.capacity * stage.voltage**2 / 2 - power * time
    voltage = sqrt(max(0.0, 2 * energy / settings.capacity))
    if voltage < settings.voltage:
        voltage = settings.voltage + (voltage - settings.voltage) * exp(-time / settings.charging_time)
    return PowerStage(temperature, voltage)


ERROR_REGISTER = 0x1001
_ERROR_CODE = 0x603F
CONTROLWORD = 0x6040
STATUSWORD = 0x6041
MODE = 0x6060
MODE_DISPLAY = 0x6061
POSITION = 0x6064
VELOCITY = 0x606C
TARGET_TORQUE = 0x6071
_LARGEST_TORQUE = 0x6072
_RATED_TORQUE = 0x6076
TORQUE = 0x6077
SUPPORTED_MODES = 0x6502
ABORT_CONNECTION = 0x6007
DRIVE_TEMPERATURE = 0x2100
DC_LINK_VOLTAGE = 0x6079
DRIVE_INPUTS = 0x60FD
OPTION_CODES = (0x605A, 0x605B, 0x605C, 0x605E)
"""Objects (CiA 402-2: device control, position, velocity and torque; CiA 301 for the error register).

The temperature [0.1 °C, INTEGER16] is an object of this emulator, since the profile has none; the voltage is in mV.
"""

CYCLIC_SYNCHRONOUS_TORQUE = 10

# Error codes (CiA 402-2, error codes): no process data while enabled; the machine left its bounds.
COMMUNICATION_LOST = 0x8130
SPEED_RUN_AWAY = 0x8400

GENERIC_ERROR = 0x01  # Bit of the error register (CiA 301)
ELMO_GOLD = Identity("Gold drive", 0x0000009A, 0x00030924, 0x00010420)  # Identity of Elmo's Gold drives

# Bits of the digital inputs: both channels of the STO input, and the enable input; 1 where they are closed.
STO_CLOSED = 0x3_0000
ENABLE_CLOSED = 0x4_0000

# Bits of the controlword (CiA 402-2, object 0x6040).
_SWITCH_ON = 0x01
VOLTAGE = 0x02
NO_QUICK_STOP = 0x04
_ENABLE = 0x08
FAULT_RESET = 0x80

# Bits of the statusword besides the state: voltage enabled, remote, drive follows the command value.
VOLTAGE_ENABLED = 0x0010
REMOTE = 0x0200
FOLLOWS = 0x1000


class DriveState(IntEnum):
    """States, with their low bits in the statusword (CiA 402-2, object 0x6041)."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT = 0x08


def next_drive_state(state: DriveState, controlword: int, before: int) -> DriveState:
    """Next state for a controlword (CiA 402-2, device control state machine); at most one transition upwards.

    The controlword `before` counts, too, since a fault is reset by a rising edge.
    """
    if state is DriveState.FAULT:
        rises = controlword & ~before & FAULT_RESET
        return DriveState.SWITCH_ON_DISABLED if rises else state
    if not controlword & VOLTAGE or state is DriveState.QUICK_STOP:  # a quick stop is over within a tick: no torque
        return DriveState.SWITCH_ON_DISABLED
    if not controlword & NO_QUICK_STOP:
        return DriveState.QUICK_STOP if state is DriveState.OPERATION_ENABLED else DriveState.SWITCH_ON_DISABLED
    if state is DriveState.SWITCH_ON_DISABLED:
        return state if controlword & _SWITCH_ON else DriveState.READY_TO_SWITCH_ON
    if not controlword & _SWITCH_ON:
        return DriveState.READY_TO_SWITCH_ON
    if state is DriveState.READY_TO_SWITCH_ON:
        return DriveState.SWITCHED_ON
    return DriveState.OPERATION_ENABLED if controlword & _ENABLE else DriveState.SWITCHED_ON


@dataclass(frozen=True)
class DriveSettings:
    """Parameters of a drive.

    Attributes:
        identity: Its identity.
        layout: The PDOs that it exchanges.
        rated_torque: Torque of the value 1000 of a torque object, in `rated_torque_unit`.
        rated_torque_unit: Unit of that object, 0x6076 [N·m].
        largest_torque: Limit of the drive, in 1/1000 of `rated_torque`; the master may change it by SDO.
        period: Time of a tick [s].
        abort_connection: What it does when frames end, after power-up: 0 nothing, 1 fault, 2 or 3 torque off
            (CiA 402-2, object 0x6007).
        ramps: Value of its other option codes after power-up: 0 torque off, 1 and 2 ramps (0x605A to 0x605E).
        counts_per_turn: Counts of its encoder per turn of the motor, for the power that it takes.
        power: Parameters of its power stage.
    """

    identity: Identity = ELMO_GOLD
    layout: DriveLayout = ELMO_LAYOUT
    rated_torque: int = 16_000
    rated_torque_unit: float = 1e-3
    largest_torque: int = 2500
    period: float = 1e-3
    abort_connection: int = 1
    ramps: int = 1
    counts_per_turn: float = 16384.0
    power: PowerSettings = PowerSettings()


class Drive(EmulatedDevice):
    """A drive behind a slave controller.

    Args:
        name: Its name in the ring.
        counts: Selects its motor's encoder counts from a reading.
    """

    def __init__(self, name: str, settings: DriveSettings, counts: Callable[[Reading], float]):
        self._settings = settings
        self._counts = counts
        self._true_counts = 0
        self._closed = STO_CLOSED | ENABLE_CLOSED
        self._heating = self._fed = 0.0
        self._stuck: dict[int, int] = {}
        self._wrong: Fault | None = None
        self._raised = self._cleared = self._kept = 0
        self._late_torque = deque([0], maxlen=1)
        self._late_counts = deque([0], maxlen=1)
        super().__init__(name, settings.identity)
        self.power_on()

    def power_on(self) -> None:
        """Resets the drive: switch-on disabled, no torque, PDOs as after power-up."""
        settings = self._settings
        layout = settings.layout
        self._objects = _objects_after_power_up(settings)
        objects = {(index, 0): entry for index, entry in self._objects.items()}
        self.dictionary = Dictionary(
            settings.identity,
            {**objects, **layout.idle_objects(objects)},
            layout.outputs,
            layout.inputs,
            layout.assigned_outputs,
            layout.assigned_inputs,
            _check,
            layout.mappable,
        )
        self._stage = PowerStage(settings.power.ambient, settings.power.voltage)
        self.state = DriveState.SWITCH_ON_DISABLED
        self.torque = 0.0
        self._before = 0
        self.messages.clear()
        self._measure(0.0)

    @property
    def is_enabled(self) -> bool:
        """Whether the drive is enabled, so that torque follows its target."""
        return self.state is DriveState.OPERATION_ENABLED

    def update(self, operational: bool) -> None:
        """Updates the state, then the torque; an enabled drive without process data trips."""
        if operational:
            controlword = self._objects[CONTROLWORD].value
            self.state = next_drive_state(self.state, controlword, self._before)
            self._before = controlword
        elif self.state in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP):
            self._lose_connection()
        elif self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
        if self._closed != STO_CLOSED | ENABLE_CLOSED and self.state is not DriveState.FAULT:
            self.state = DriveState.SWITCH_ON_DISABLED
        if self.state is not DriveState.FAULT and self._objects[_ERROR_CODE].value:
            self._report_error(0, 0)  # it is reset
        if self._objects[MODE].value in (0, CYCLIC_SYNCHRONOUS_TORQUE):
            self._objects[MODE_DISPLAY].value = self._objects[MODE].value
        self._act()

    def _lose_connection(self) -> None:
        """Acts as the option code 0x6007 demands, after which a drive may continue with its last torque."""
        option = self._objects[ABORT_CONNECTION].value
        if option == 1:
            self.trip(COMMUNICATION_LOST)
        elif option in (2, 3):
            self.state = DriveState.SWITCH_ON_DISABLED

    def trip(self, code: int) -> None:
        """Enters the fault state: torque off, emergency sent, latched until reset; the first fault is kept."""
        if self.state is not DriveState.FAULT:
            self.state = DriveState.FAULT
            self._report_error(code, GENERIC_ERROR)
        self._act()

    def _report_error(self, code: int, register: int) -> None:
        self._objects[_ERROR_CODE].value = code
        self._objects[ERROR_REGISTER].value = register
        self.messages.append(emergency(code, register))

    def begin(self, fault: Fault) -> None:
        """Begins one of `DRIVE_FAULTS`."""
        match fault.kind:
            case "trip":
                self.trip(fault["code"])
            case "heated":
                self._heating += fault["rate"]
            case "fed bus":
                self._fed += fault["power"]
            case "opened input":
                self._closed &= ~fault["bits"]
                if fault["code"]:
                    self.trip(fault["code"])
            case "stuck object":
                present = self._objects[fault["index"]].value
                value = fault["value"]
                self._stuck[fault["index"]] = present if value is None else value
            case "wrong torque":
                self._wrong = fault
                self._kept = self._objects[TORQUE].value
            case "status bits":
                self._raised |= fault["raised"]
                self._cleared |= fault["cleared"]
            case "delayed":
                length = fault["torque"] + 1
                self._late_torque = deque([self._objects[TORQUE].value] * length, length)
                length = fault["counts"] + 1
                self._late_counts = deque([self._true_counts] * length, length)

    def sense(self, reading: Reading) -> None:
        """Updates position and velocity of the motor [counts, counts/s]."""
        self._late_counts.append(round(self._counts(reading)))
        counts = self._late_counts[0]
        shown = self.error.shown(counts)
        position = self._objects[POSITION]
        moved = counts - self._true_counts if self.error.true_velocity else shown - position.value
        self._objects[VELOCITY].value = round(moved / self._settings.period)
        position.value = shown
        self._true_counts = counts
        self._measure(moved / self._settings.counts_per_turn * tau)

    def _measure(self, turned: float) -> None:
        """Updates temperature, bus voltage and inputs after a tick in which the motor turned by an angle [rad]."""
        settings = self._settings
        period = self._settings.period
        taken = self.torque * turned / period - self._fed
        load = self._objects[TORQUE].value / 1000
        self._stage = next_stage(settings.power, self._stage, period, load, taken, self._heating)
        self._objects[DRIVE_TEMPERATURE].value = round(10 * self._stage.temperature)
        self._objects[DC_LINK_VOLTAGE].value = round(1000 * self._stage.voltage)
        self._objects[DRIVE_INPUTS].value = self._closed
        for index, value in self._stuck.items():
            self._objects[index].value = value

    def _act(self) -> None:
        follows = self.is_enabled and self._objects[MODE_DISPLAY].value == CYCLIC_SYNCHRONOUS_TORQUE
        limit = self._objects[_LARGEST_TORQUE].value
        self._late_torque.append(min(max(self._objects[TARGET_TORQUE].value, -limit), limit) if follows else 0)
        commanded = given = self._late_torque[0] if follows else 0
        if follows and self._wrong:
            wrong = self._wrong
            given = self._kept if wrong["is_kept"] else round(wrong["factor"] * commanded) + wrong["offset"]
            commanded = given if wrong["is_reported"] else commanded
        self._objects[TORQUE].value = commanded
        self.torque = given * self._settings.rated_torque * (self._settings.rated_torque_unit / 1000)
        status = self.state | VOLTAGE_ENABLED | REMOTE | (FOLLOWS if follows else 0)
        self._objects[STATUSWORD].value = (status | self._raised) & ~self._cleared


def _objects_after_power_up(settings: DriveSettings) -> dict[int, ObjectEntry]:
    """The objects of a drive, by index."""
    return {
        ABORT_CONNECTION: ObjectEntry(settings.abort_connection, 16, True, True),
        **{index: ObjectEntry(settings.ramps, 16, True, True) for index in OPTION_CODES},
        CONTROLWORD: ObjectEntry(0, 16, writable=True),
        STATUSWORD: ObjectEntry(DriveState.SWITCH_ON_DISABLED, 16),
        MODE: ObjectEntry(0, 8, True, True),
        MODE_DISPLAY: ObjectEntry(0, 8, True),
        POSITION: ObjectEntry(0, 32, True),
        VELOCITY: ObjectEntry(0, 32, True),
        TARGET_TORQUE: ObjectEntry(0, 16, True, True),
        _LARGEST_TORQUE: ObjectEntry(settings.largest_torque, 16, writable=True),
        _RATED_TORQUE: ObjectEntry(settings.rated_torque, 32),
        TORQUE: ObjectEntry(0, 16, True),
        _ERROR_CODE: ObjectEntry(0, 16),
        ERROR_REGISTER: ObjectEntry(0, 8),
        DRIVE_TEMPERATURE: ObjectEntry(0, 16, True),
        DC_LINK_VOLTAGE: ObjectEntry(0, 32),
        DRIVE_INPUTS: ObjectEntry(0, 32),
        SUPPORTED_MODES: ObjectEntry(1 << CYCLIC_SYNCHRONOUS_TORQUE - 1, 32),
    }


def _check(index: int, value: int) -> None:
    """Refuses modes other than cyclic synchronous torque and 0, which is no mode, and unknown option codes."""
    if index in (ABORT_CONNECTION, *OPTION_CODES) and not 0 <= value <= 3:
        raise Abort(Abort.VALUE_RANGE)
    if index == MODE and value not in (0, CYCLIC_SYNCHRONOUS_TORQUE):
        raise Abort(Abort.VALUE_RANGE)
