"""A robot on moteus controllers as a `Rig`: joint commands out; positions, encoders and forces in."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import isfinite
from time import monotonic, sleep

import moteus
from moteus import Mode, Register

from stepgap.rigs.limits import RigLimits
from stepgap.rigs.moteus.can_bus import CanBus, Registers
from stepgap.rigs.moteus.joint import JointCommand, JointState
from stepgap.rigs.moteus.moteus_settings import AuxEncoder, AuxForce, CanDevice, CanSettings, Controller
from stepgap.rigs.rig import HEALTHY, LOST, Health, Reading, Rig, RigFault, SensorModel, Torques

POSITION_COUNTS = 2**16
"""Counts a turn in which moteus keeps the position of its output."""

ANALOG_COUNTS = 4096
"""Counts of a controller's converter; what is finer is noise."""

REGISTER_MAP = 5
"""Version of the registers' meaning that this rig knows."""

LIMITING = range(96, 104)
"""Fault codes of a controller that works, but at a limit."""

ANSWER_TIMEOUT = 1.0
"""How long controllers may take to answer first and to get ready [s]."""

_LAST_FRAMES = 3
"""Stop commands that are sent when all is over, in case one is lost."""

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
ENCODER_VALID = {1: 0x04, 2: 0x10}
"""Bits of the validity register by encoder source."""

ANALOG_INPUTS = {1: Register.AUX1_ANALOG_IN1, 2: Register.AUX2_ANALOG_IN1}
"""Register of the first pin by auxiliary port."""

LIMP = JointCommand(0.0, 0.0, 0.0, 0.0, 0.0)


class MoteusRig(Rig):
    """Controllers as `moteus.toml` describes them, in position mode with no gains of their own.

    `read` asks all controllers and waits for their answers, so that they are of this tick; `write` sends each a
    command with the watchdog and the largest torque in it. A tick whose answers do not all come in time repeats the
    reading before; too many in a row are a fault. Whatever is wrong stops all controllers, and the fault stays for the
    life of the object. A controller found in fault at connect is reset once.

    Args:
        settings: The robot's bus; its budget of lost frames holds.
        sensor_model: How the robot reads the counts.
    """

    def __init__(self, settings: CanSettings, sensor_model: SensorModel):
        self._settings, self._sensor_model = settings, sensor_model
        self._motors = settings.motors
        self._controllers = {motor.id: self._controller(motor.id) for motor in self._motors}
        self._sensors = tuple(_sensor(device) for device in settings.devices.values())
        self._bus: CanBus | None = None
        self._fault, self._lost, self._written = "", 0, False
        self._reading = settings.reading((0.0,) * len(self._sensors))
        self._joints = (JointState(0, 0, 0),) * len(self._motors)

    @property
    def sensor_model(self) -> SensorModel:
        """How to read the counts; their zeros and signs are taken care of."""
        return self._sensor_model

    @property
    def limits(self) -> RigLimits:
        """What the safety function allows this robot."""
        return self._settings.budgets

    @property
    def health(self) -> Health:
        """Whether the last answers were lost, so that the reading is an older one."""
        return LOST if self._lost else HEALTHY

    @property
    def joints(self) -> tuple[JointState, ...]:
        """What the controllers said of the top links with the last good reading; for logs."""
        return self._joints

    def connect(self) -> None:
        """Opens the bus, checks the controllers, and readies them without torque.

        The first `write` must follow within the watchdog's time.

        Raises:
            RigFault: There is no such bus, a controller does not answer, is of another firmware or does not get
                ready, an encoder does not work, or the rig had a fault before.
        """
        if self._fault:
            raise RigFault(f"the rig had a fault: {self._fault}; see to it, then start anew")
        self.close()
        self._bus = CanBus(self._settings.interface, self._settings.channel)
        try:
            self._check_controllers(self._bus)
            self._get_ready(self._bus)
        except RigFault:
            self.close()
            raise
        self._lost, self._written = 0, False

    def read(self) -> Reading:
        """Counts and force at this tick, or earlier ones while no more answers than the budget are lost.

        Raises:
            RigFault: Not connected, too many answers lost, or a controller does not take torques any more.
        """
        bus = self._up()
        if not self._written:
            return self._reading
        self._written = False
        replies = self._ask(bus)
        if len(replies) == len(self._controllers):
            self._lost = 0
            self._update_reading(replies)
        else:
            self._lost += 1
            if self._lost > self._settings.budgets.lost_frames:
                raise self._trip(f"{self._absent(replies)} did not answer in time for {self._lost} ticks in a row")
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Sends the motor torques [N·m] and returns those sent, within limits.

        Raises:
            RigFault: A torque is not finite, or the rig is stopped.
        """
        bus = self._up()
        if self._written:
            self.read()
        if not all(map(isfinite, torques)):
            raise self._trip(f"torques must be finite, not {', '.join(map(str, torques))}")
        limits = [motor.torque_limit for motor in self._motors]
        sent = tuple(min(max(torque, -most), most) for torque, most in zip(torques, limits, strict=True))
        self._command(bus, [LIMP._replace(tau=torque) for torque in sent])
        self._written = True
        return sent

    def close(self) -> None:
        """Controllers stopped, the bus released; may be called twice."""
        bus, self._bus = self._bus, None
        if bus:
            self._stop(bus)
            bus.close()

    def _controller(self, number: int) -> moteus.Controller:
        """Makes the frames for one controller; its answers tell what the reading needs of it."""
        more = {int(Register.ENCODER_VALIDITY): moteus.INT8}
        for device in self._settings.devices.values():
            if device.id == number and not isinstance(device, Controller):
                more[_register(device)] = moteus.F32
        return moteus.Controller(id=number, query_resolution=_query(more))

    def _check_controllers(self, bus: CanBus) -> None:
        """Stops all, which ends their faults, and asks for the version of their registers."""
        version = _query({Register.REGISTER_MAP_VERSION: moteus.INT32})
        self._stop(bus)
        until, replies = monotonic() + ANSWER_TIMEOUT, self._ask(bus, version)
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
        """Commands no torque until all controllers take commands."""
        until = monotonic() + ANSWER_TIMEOUT
        while True:
            self._command(bus, [LIMP] * len(self._motors))
            replies = self._ask(bus)
            ready = [registers.get(Register.MODE) == Mode.POSITION for registers in replies.values()]
            if len(ready) == len(self._controllers) and all(ready):
                return self._update_reading(replies)
            if monotonic() > until:
                states = [_state(number, registers) for number, registers in replies.items()]
                raise RigFault(f"the controllers do not get ready: {'; '.join(states) or 'no answers'}")
            sleep(self._settings.tick)

    def _ask(self, bus: CanBus, query: moteus.QueryResolution | None = None) -> dict[int, Registers]:
        """The controllers' answers to a query, as many as come in time."""
        self._send(bus, {number: each.make_query(query) for number, each in self._controllers.items()})
        return bus.receive(self._controllers, self._settings.reply_timeout)

    def _command(self, bus: CanBus, commands: Sequence[JointCommand]) -> None:
        """A command to each controller, not to be answered."""
        frames = {}
        for motor, command in zip(self._motors, commands, strict=True):
            frames[motor.id] = self._controllers[motor.id].make_position(
                **motor.scale.position_command(command),
                maximum_torque=motor.torque_limit / motor.gear,
                watchdog_timeout=self._settings.watchdog,
                query=False,
            )
        self._send(bus, frames)

    def _send(self, bus: CanBus, frames: Mapping[int, moteus.Command]) -> None:
        try:
            bus.send(frames)
        except RigFault as fault:
            raise self._trip(str(fault)) from None

    def _update_reading(self, replies: Mapping[int, Registers]) -> None:
        """The reading of full answers, if all controllers take torques and all encoders work."""
        try:
            for number, registers in replies.items():
                if registers[Register.MODE] != Mode.POSITION or registers[Register.FAULT] not in (0, *LIMITING):
                    raise self._trip(f"{_state(number, registers)}: it takes no torque any more")
            self._joints = tuple(self._joint(replies, motor) for motor in self._motors)
            values = [sensor(replies) for sensor in self._sensors]
        except KeyError as missing:
            raise self._trip(f"a controller does not tell register 0x{missing.args[0]:03X}") from None
        except ValueError as error:
            raise self._trip(str(error)) from None
        self._reading = self._settings.reading(values)

    @staticmethod
    def _joint(replies: Mapping[int, Registers], motor: Controller) -> JointState:
        registers = replies[motor.id]
        return motor.scale.joint_state(
            registers[Register.POSITION], registers[Register.VELOCITY], registers[Register.TORQUE]
        )

    def _up(self) -> CanBus:
        if self._fault or not self._bus:
            raise RigFault(self._fault or "the rig is not connected")
        return self._bus

    def _trip(self, message: str) -> RigFault:
        """Stops all controllers at once and for good; returns the fault to raise."""
        self._fault = message
        if self._bus:
            self._stop(self._bus)
        return RigFault(message)

    def _stop(self, bus: CanBus) -> None:
        for _ in range(_LAST_FRAMES):
            with suppress(RigFault):  # then their watchdogs must do it
                bus.send({number: each.make_stop() for number, each in self._controllers.items()})

    def _absent(self, replies: Mapping[int, Registers]) -> str:
        return " and ".join(f"controller {number}" for number in self._controllers if number not in replies)


class _Turns:
    """Counts of an encoder at an auxiliary port, from its zero, forward positive; its register has the turn's share."""

    def __init__(self, encoder: AuxEncoder):
        self.encoder = encoder
        self._turns = encoder.zero / encoder.counts_per_turn

    def counts(self, registers: Registers) -> int:
        """Whole counts, nearest to those before.

        Raises:
            ValueError: The encoder does not work, or tells no share of a turn.
        """
        encoder = self.encoder
        name = f"encoder {encoder.source} of controller {encoder.id}"
        share = registers[ENCODER_POSITION[encoder.source]]
        if not int(registers[Register.ENCODER_VALIDITY]) & ENCODER_VALID[encoder.source]:
            raise ValueError(f"{name} does not work: see aux and motor_position in tview")
        if not 0 <= share <= 1:
            raise ValueError(f"{name} tells {share:g}, but it must be a share of a turn: is the firmware old?")
        self._turns = share + round(self._turns - share)
        return encoder.sign * (round(self._turns * encoder.counts_per_turn) - encoder.zero)


def _query(more: dict[int, int]) -> moteus.QueryResolution:
    """Asks for mode, position, velocity, torque, fault, and more registers at the given resolutions."""
    query = moteus.QueryResolution()
    query.voltage = query.temperature = moteus.IGNORE
    query._extra = more
    return query


def _counts(position: float, motor: Controller) -> int:
    if not isfinite(position):
        raise ValueError(f"the position of controller {motor.id} is no number")
    return motor.sign * round((position - motor.zero) * POSITION_COUNTS)


def _force(share: float, sensor: AuxForce) -> float:
    if not isfinite(share):
        raise ValueError("the contact force is no number")
    return sensor.newton_per_count * (round(ANALOG_COUNTS * share) - sensor.zero)


def _register(device: AuxEncoder | AuxForce) -> int:
    """The register that tells what a sensor measures."""
    if isinstance(device, AuxEncoder):
        return ENCODER_POSITION[device.source]
    return ANALOG_INPUTS[device.port] + device.pin - 1


def _sensor(device: CanDevice) -> Callable[[Mapping[int, Registers]], float]:
    """What a device gives to a reading, from the answers of all controllers."""
    if isinstance(device, Controller):
        return lambda replies: _counts(replies[device.id][Register.POSITION], device)
    if isinstance(device, AuxEncoder):
        turns = _Turns(device)
        return lambda replies: turns.counts(replies[device.id])
    return lambda replies: _force(replies[device.id][_register(device)], device)


def _state(number: int, registers: Registers) -> str:
    """What a controller says of itself."""
    mode, fault = int(registers.get(Register.MODE, -1)), int(registers.get(Register.FAULT, 0))
    name = Mode(mode).name.lower() if mode in set(Mode) else "getting ready" if 2 <= mode <= 4 else str(mode)
    cause = f", fault {fault}: {FAULTS.get(fault, 'see the manual')}" if fault else ""
    return f"controller {number} is in mode {name}{cause}"
