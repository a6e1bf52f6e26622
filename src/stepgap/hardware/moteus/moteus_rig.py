"""A robot on moteus controllers as a `Rig`: joint commands out; positions, encoders and forces in."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import isfinite, nan
from time import monotonic

import moteus
from moteus import Mode, Register

from stepgap.hardware.bus_rig import COMPUTER, BusRig, HostTime, TorqueWatch
from stepgap.hardware.moteus.can_bus import CanBus, Registers, registers_of
from stepgap.hardware.moteus.moteus_settings import AuxEncoder, AuxForce, CanDevice, CanSettings, Controller
from stepgap.hardware.moteus.watchdog import check_timeout, measure_watchdogs, watchdog_query
from stepgap.rigs.rig import Reading, RigFault, SensorModel, Torques, WatchdogTimes

LIMITING = range(96, 104)  # Fault codes of a controller that works, but at a limit
MOST_LIMITED = 20  # Number of readings in a row at a limit, after which the robot shall land
TORQUE_READINGS = 5  # Number of readings over which delay and lag of a torque extend


class CommandedTorques:
    """Compares the torques that controllers report with the commands, and counts readings at a limit."""

    def __init__(self, motors: Sequence[Controller]):
        self._motors = motors
        self._watches = [TorqueWatch(motor.largest_deviation, TORQUE_READINGS) for motor in motors]
        self._limited = dict[int, int]()

    def restart(self) -> None:
        """Forgets commands and readings."""
        self._limited.clear()
        for watch in self._watches:
            watch.restart()

    def command(self, torques: Torques) -> None:
        """Adds the torques that were sent last [N·m]."""
        for watch, torque in zip(self._watches, torques, strict=True):
            watch.command(torque)

    def excess(self, torques: Torques) -> str:
        """Takes the torques of a reading [N·m]; returns why torque must go off, or an empty text.

        A controller at a limit says itself that it gives less than commanded.
        """
        for motor, watch, torque in zip(self._motors, self._watches, torques, strict=True):
            if watch.reading(torque) and not self._limited.get(motor.id):
                return f"controller {motor.id}: its torque is {torque:.1f} N·m, commanded were {watch.commanded} N·m"
        return ""

    def note_fault(self, number: int, code: int) -> None:
        """Takes the fault code of a controller in a reading; 0 for none."""
        self._limited[number] = self._limited.get(number, 0) + 1 if code in LIMITING else 0

    @property
    def warning(self) -> str:
        """The controller that has been at a limit for `MOST_LIMITED` readings in a row; empty without one."""
        numbers = [number for number, count in self._limited.items() if count >= MOST_LIMITED]
        return f"controller {numbers[0]} is at one of its limits (fault 96 to 103)" if numbers else ""


POSITION_COUNTS = 2**16  # Counts per turn in which moteus stores the position of its output
ANALOG_COUNTS = 4096  # Counts of a controller's analog-digital converter; finer values are noise
REGISTER_MAP = 5  # Version of the register map that this rig supports
ANSWER_TIMEOUT = 1.0  # Timeout of the first answers of the controllers, and of their getting ready [s]
_LAST_FRAMES = 3  # Number of stop commands that are sent at the end, in case one is lost

FAULTS = {
    32: "calibration",
    33: "motor driver",
    34: "over voltage",
    35: "encoder",
    36: "motor not configured",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "outside limit",
    40: "under voltage",
    41: "configuration changed",
    42: "theta invalid",
    43: "position invalid",
    44: "driver enable",
    45: "stop position",
    46: "timing violation",
    47: "feedforward without acceleration limit",
    48: "invalid limits",
}

ENCODER_POSITION = {1: Register.ENCODER_1_POSITION, 2: Register.ENCODER_2_POSITION}
ENCODER_VALID = {1: 0x04, 2: 0x10}  # Bits of the validity register by encoder source

ANALOG_INPUTS = {1: Register.AUX1_ANALOG_IN1, 2: Register.AUX2_ANALOG_IN1}
"""Register of the first pin by auxiliary port."""

SUPPLY = {"bus_voltage": (Register.VOLTAGE, "V"), "temperature": (Register.TEMPERATURE, "°C")}
"""Values of a controller that are logged, with their registers and units; the temperature is that of its board."""

REPORTED = (Register.MODE, Register.FAULT, Register.POSITION, Register.VELOCITY, Register.TORQUE)
"""Registers that each answer must have."""


class MoteusRig(BusRig):
    """Controllers as `moteus.toml` describes them, in position mode with gains zero.

    `read` queries all controllers and waits for their answers, so that they are of this tick; `write` sends each a
    command that includes the watchdog and the torque limit. If answers are missing in a tick, the reading before is
    repeated; too many such ticks in a row are a fault. Any fault stops all controllers. A controller that is in fault
    at connect is reset once.

    Args:
        settings: The robot's bus, with its limit of lost frames.
        host: The computer's clock, with which watchdogs are measured.
    """

    def __init__(self, settings: CanSettings, sensor_model: SensorModel, host: HostTime = COMPUTER):
        super().__init__(settings, sensor_model)
        self._settings = settings
        self._host = host
        self._motors = settings.motors
        self._controllers = {motor.id: self._controller(motor.id) for motor in self._motors}
        self._sensors = tuple(_sensor(device) for device in settings.devices.values())
        self._bus: CanBus | None = None
        self._written = False
        self._reading = settings.reading((0.0,) * len(self._sensors))
        self._commanded = CommandedTorques(self._motors)
        self._supplies = (nan,) * (len(SUPPLY) * len(self._motors))
        self._remarks = list[str]()

    @property
    def diagnostic_units(self) -> Mapping[str, str]:
        """Bus voltage (in steps of 0.5 V) and temperature of the board of every controller."""
        motors = [name for name, device in self._settings.devices.items() if isinstance(device, Controller)]
        return {f"{motor}_{value}": unit for motor in motors for value, (_, unit) in SUPPLY.items()}

    @property
    def diagnostics(self) -> tuple[float, ...]:
        """Those values at the last good reading."""
        return self._supplies

    @property
    def remarks(self) -> tuple[str, ...]:
        """Timeouts in the configuration of the controllers that other programs should know."""
        return tuple(self._remarks)

    @property
    def warning(self) -> str:
        """Names a controller that has been at one of its limits for a while."""
        return self._commanded.warning

    def connect(self) -> None:
        """Opens the bus, checks the controllers, and prepares them without torque.

        The first `write` must follow within the watchdog's time.

        Raises:
            RigFault: There is no such bus, a controller does not answer, has another firmware, would have torque after
                a timeout or does not become ready, an encoder does not work, or the rig had a fault before.
        """
        self._require_no_fault()
        self.close()
        self._bus = CanBus(self._settings.interface, self._settings.channel)
        try:
            self._check_controllers(self._bus)
            checks = [check_timeout(self._bus, controller) for controller in self._controllers.values()]
            self._remarks = [remark for remarks in checks for remark in remarks]
            self._get_ready(self._bus)
        except RigFault:
            self.close()
            raise
        self._losses.restart()
        self._written = False
        self._commanded.restart()

    def read(self) -> Reading:
        """Reads counts and force of this tick, or repeats earlier ones if no more answers than allowed are lost.

        Raises:
            RigFault: Not connected, too many answers lost, or a controller no longer accepts torque commands.
        """
        bus = self._up()
        if not self._written:
            return self._reading
        self._written = False
        replies = self._ask(bus)
        if len(replies) == len(self._controllers):
            self._losses.received()
            self._update_reading(replies)
        elif missed := self._losses.missed():
            raise self._trip(f"{self._absent(replies)} did not answer in time for {missed}")
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Sends the motor torques [N·m] and returns those sent, within limits.

        Raises:
            RigFault: A torque is not finite, or the rig is stopped.
        """
        bus = self._up()
        if self._written:
            self.read()
        self._require_finite(torques)
        limits = [motor.torque_limit for motor in self._motors]
        sent = tuple(min(max(torque, -most), most) for torque, most in zip(torques, limits, strict=True))
        self._command(bus, sent)
        self._commanded.command(sent)
        self._written = True
        return sent

    def watchdog_times(self) -> WatchdogTimes:
        """Sends a last command, without torque, and measures when the controllers report a timeout and no torque.

        Raises:
            RigFault: A controller still accepts torque after twice the time of its watchdog, or has another one.
        """
        bus = self._up()
        self.write((0.0,) * len(self._motors))
        self._written = False
        query = watchdog_query()
        setting = self._settings.watchdog
        pause = self._settings.tick
        return measure_watchdogs(lambda: self._ask(bus, query), self._controllers, setting, pause, self._host)

    def close(self) -> None:
        """Stops the controllers and releases the bus; may be called twice."""
        bus = self._bus
        self._bus = None
        if bus:
            self._stop(bus)
            bus.close()

    def _controller(self, number: int) -> moteus.Controller:
        """Creates the encoder of one controller's frames; its query covers the registers that a reading needs."""
        more = {int(Register.ENCODER_VALIDITY): moteus.INT8}
        for device in self._settings.devices.values():
            if device.id == number and not isinstance(device, Controller):
                more[_register(device)] = moteus.F32
        return moteus.Controller(id=number, query_resolution=_query(more))

    def _check_controllers(self, bus: CanBus) -> None:
        """Stops all controllers, which resets their faults, and checks the version of their registers."""
        version = _query({Register.REGISTER_MAP_VERSION: moteus.INT32})
        self._stop(bus)
        until = monotonic() + ANSWER_TIMEOUT
        replies = self._ask(bus, version)
        while len(replies) < len(self._controllers):
            if monotonic() > until:
                raise RigFault(f"{self._absent(replies)} on {bus.name} did not answer")
            replies = self._ask(bus, version)
        for number, registers in replies.items():
            if registers.get(Register.REGISTER_MAP_VERSION) != REGISTER_MAP:
                raise RigFault(
                    f"controller {number} has registers of version {registers.get(Register.REGISTER_MAP_VERSION)}, "
                    f"but {REGISTER_MAP} is needed: flash another firmware with moteus_tool"
                )

    def _get_ready(self, bus: CanBus) -> None:
        """Commands zero torque until all controllers accept commands."""
        until = monotonic() + ANSWER_TIMEOUT
        while True:
            self._command(bus, (0.0,) * len(self._motors))
            replies = self._ask(bus)
            ready = [registers.get(Register.MODE) == Mode.POSITION for registers in replies.values()]
            if len(ready) == len(self._controllers) and all(ready):
                return self._update_reading(replies)
            if monotonic() > until:
                states = [_state(number, registers) for number, registers in replies.items()]
                raise RigFault(f"the controllers do not become ready: {'; '.join(states) or 'no answers'}")
            self._host.pause(self._settings.tick)

    def _ask(self, bus: CanBus, query: moteus.QueryResolution | None = None) -> dict[int, Registers]:
        """Queries the controllers; returns the answers that arrive in time."""
        self._send(bus, {number: controller.make_query(query) for number, controller in self._controllers.items()})
        return bus.receive(self._controllers, self._settings.reply_timeout, registers_of)

    def _command(self, bus: CanBus, torques: Torques) -> None:
        """Sends a torque to each controller [N·m], without a reply."""
        frames = {}
        for motor, torque in zip(self._motors, torques, strict=True):
            command = motor.torque_command(torque) | {"watchdog_timeout": self._settings.watchdog}
            frames[motor.id] = self._controllers[motor.id].make_position(**command, query=False)
        self._send(bus, frames)

    def _send(self, bus: CanBus, frames: Mapping[int, moteus.Command]) -> None:
        try:
            bus.send(frames)
        except RigFault as fault:
            raise self._trip(str(fault)) from None

    def _update_reading(self, replies: Mapping[int, Registers]) -> None:
        """Updates the reading from complete answers; a controller without torque or an encoder error is a fault."""
        try:
            for number, registers in replies.items():
                mode, fault, *_ = (registers[name] for name in REPORTED)
                if mode != Mode.POSITION or fault not in (0, *LIMITING):
                    raise self._trip(f"{_state(number, registers)}: it no longer accepts torque commands")
                self._commanded.note_fault(number, int(fault))
            torques = tuple(motor.torque_at_link(replies[motor.id][Register.TORQUE]) for motor in self._motors)
            self._supplies = tuple(replies[motor.id][key] for motor in self._motors for key, _ in SUPPLY.values())
            values = [sensor(replies) for sensor in self._sensors]
        except KeyError as missing:
            raise self._trip(f"a controller does not report register 0x{missing.args[0]:03X}") from None
        except ValueError as error:
            raise self._trip(str(error)) from None
        if excess := self._commanded.excess(torques):
            raise self._trip(excess)
        self._reading = self._settings.reading(values)

    def _up(self) -> CanBus:
        if self._fault or not self._bus:
            raise RigFault(self._fault or "the rig is not connected")
        return self._bus

    def _torque_off(self) -> None:
        """Stops all controllers."""
        if self._bus:
            self._stop(self._bus)

    def _stop(self, bus: CanBus) -> None:
        for _ in range(_LAST_FRAMES):
            with suppress(RigFault):  # then their watchdogs stop them
                bus.send({number: controller.make_stop() for number, controller in self._controllers.items()})

    def _absent(self, replies: Mapping[int, Registers]) -> str:
        return " and ".join(f"controller {number}" for number in self._controllers if number not in replies)


class _Turns:
    """Counts of an encoder at an auxiliary port, relative to its zero; its register is a fraction of a turn."""

    def __init__(self, encoder: AuxEncoder):
        self.encoder = encoder
        self._turns = encoder.zero / encoder.counts_per_turn

    def counts(self, registers: Registers) -> int:
        """Unwraps the counts: they are the nearest to those before.

        Raises:
            ValueError: The encoder does not work, or does not report a fraction of a turn.
        """
        encoder = self.encoder
        name = f"encoder {encoder.source} of controller {encoder.id}"
        fraction = registers[ENCODER_POSITION[encoder.source]]
        if not int(registers[Register.ENCODER_VALIDITY]) & ENCODER_VALID[encoder.source]:
            raise ValueError(f"{name} does not work: see aux and motor_position in tview")
        if not 0 <= fraction <= 1:
            raise ValueError(f"{name} reports {fraction:g}, but it must be a fraction of a turn: is the firmware old?")
        self._turns = fraction + round(self._turns - fraction)
        return encoder.sign * (round(self._turns * encoder.counts_per_turn) - encoder.zero)


def _query(more: dict[int, int]) -> moteus.QueryResolution:
    """Creates a query of mode, position, velocity, torque, voltage, temperature, fault, and more registers.

    Voltage and temperature are one byte each, next to the fault, which does not change the length of a frame.
    """
    query = moteus.QueryResolution()
    query._extra = more
    return query


def _counts(position: float, motor: Controller) -> int:
    if not isfinite(position):
        raise ValueError(f"the position of controller {motor.id} is not finite")
    return motor.sign * round((position - motor.zero) * POSITION_COUNTS)


def _force(fraction: float, sensor: AuxForce) -> float:
    if not isfinite(fraction):
        raise ValueError("the contact force is not finite")
    return sensor.newton_per_count * (round(ANALOG_COUNTS * fraction) - sensor.zero)


def _register(device: AuxEncoder | AuxForce) -> int:
    if isinstance(device, AuxEncoder):
        return ENCODER_POSITION[device.source]
    return ANALOG_INPUTS[device.port] + device.pin - 1


def _sensor(device: CanDevice) -> Callable[[Mapping[int, Registers]], float]:
    """Creates the function that computes a device's value in a reading from the answers of all controllers."""
    if isinstance(device, Controller):
        return lambda replies: _counts(replies[device.id][Register.POSITION], device)
    if isinstance(device, AuxEncoder):
        turns = _Turns(device)
        return lambda replies: turns.counts(replies[device.id])
    return lambda replies: _force(replies[device.id][_register(device)], device)


def _state(number: int, registers: Registers) -> str:
    mode = int(registers.get(Register.MODE, -1))
    fault = int(registers.get(Register.FAULT, 0))
    name = "getting ready" if 2 <= mode <= 4 else str(mode)
    if mode in set(Mode):
        name = Mode(mode).name.lower()
    cause = f", fault {fault}: {FAULTS.get(fault, 'see the manual')}" if fault else ""
    return f"controller {number} is in mode {name}{cause}"
