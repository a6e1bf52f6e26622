"""Two moteus controllers on python-can's virtual bus, in lock-step with a machine behind them.

Frames are taken apart and made here by the published format of the protocol, not by the library that the rig uses. The
watchdog is that of the firmware (fw/moteus_controller.cc, fw/bldc_servo_control.h): only a write of the mode restarts
it, with the time in that command (NaN for none) or, if it is 0, with the configured one. In position mode, its end
leads to the mode *timeout* until a stop command. What the motor does then is configured (`servo.timeout_mode`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf, isfinite, isnan
from struct import Struct
from threading import Event, Thread

import can

from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.hopper.moteus import MoteusSettings
from stepgap.robots.hopper.tick.sensors import HopperReading

MODE, POSITION, VELOCITY, TORQUE, VOLTAGE, TEMPERATURE, FAULT = 0x00, 0x01, 0x02, 0x03, 0x0D, 0x0E, 0x0F
FEEDFORWARD, KP_SCALE, KD_SCALE, MAX_TORQUE, TIMEOUT = 0x22, 0x23, 0x24, 0x25, 0x27
ENCODER_1, ENCODER_2, VALIDITY = 0x52, 0x54, 0x58
ANALOG = {1: 0x60, 2: 0x68}
REGISTER_MAP = 0x102
STOPPED, FAULTED, PREPARING, POSITION_MODE, TIMED_OUT = 0, 1, 2, 10, 11
VALUES = (Struct("<b"), Struct("<h"), Struct("<i"), Struct("<f"))
MOTOR_COUNTS = 16384  # of the machine
PING = 0x7FE
STREAM_WRITE, STREAM_REPLY, STREAM_POLL = 0x40, 0x41, 0x42
DAMPING = 12
FRAME_SIZES = {*range(9), 12, 16, 20, 24, 32, 48, 64}


def varuint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        if data[at] < 0x80:
            return value, at + 1
        at, shift = at + 1, shift + 7


def as_varuint(value: int) -> bytes:
    return bytes([value]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + as_varuint(value >> 7)


def subframes(data: bytes) -> Iterator[tuple[int, int, int, list[float]]]:
    """Subframes of a frame: base (0x00 write, 0x10 read), type, first register, values or as many zeros.

    Of the diagnostic channel: base and type 0x40 or 0x42, the channel, and bytes, or the largest length wanted.
    """
    at = 0
    while at < len(data):
        head, at = data[at], at + 1
        if head == 0x50:
            continue
        if head in (STREAM_WRITE, STREAM_POLL):
            channel, at = varuint(data, at)
            length, at = varuint(data, at)
            text = list(map(float, data[at : at + length])) if head == STREAM_WRITE else [float(length)]
            yield head, head, channel, text
            at += len(text) if head == STREAM_WRITE else 0
            continue
        base, kind, count = head & 0xF0, head >> 2 & 3, head & 3
        if not count:
            count, at = varuint(data, at)
        first, at = varuint(data, at)
        values = [0.0] * count
        if base == 0x00:
            size = VALUES[kind].size
            values = [VALUES[kind].unpack_from(data, at + size * index)[0] for index in range(count)]
            at += size * count
        yield base, kind, first, values


def reply(kind: int, first: int, values: list[float]) -> bytes:
    cast = float if kind == 3 else int
    packed = b"".join(VALUES[kind].pack(cast(value)) for value in values)
    head = 0x20 | kind << 2
    start = bytes([head | len(values)]) if len(values) <= 3 else bytes([head]) + as_varuint(len(values))
    return start + as_varuint(first) + packed


@dataclass
class Controller:
    """One of the two controllers; `registers` are those that the next query reads."""

    registers: dict[int, float]
    prepares: int = 2
    mode: int = STOPPED
    fault: int = 0
    preparing: int = 0
    torque: float = 0.0
    deadline: float = inf
    has_watchdog: bool = True
    ignores_torques: bool = False
    config: dict[str, str] = field(
        default_factory=lambda: {"servo.timeout_mode": "0", "servo.default_timeout_s": "0.100000"}
    )
    text: bytes = b""
    commands: list[dict[int, float]] = field(default_factory=list)

    def command(self, written: dict[int, float], now: float) -> None:
        """Executes a command: the mode comes first, as in the firmware; only a stop resets a fault or a timeout."""
        self.registers[TIMEOUT] = written.get(TIMEOUT, 0.0)
        timeout = self.registers[TIMEOUT] or float(self.config["servo.default_timeout_s"])
        self.deadline = inf if isnan(timeout) or not self.has_watchdog else now + timeout
        if written[MODE] == STOPPED:
            self.break_down(STOPPED)
            return
        assert written[MODE] == POSITION_MODE
        self.commands.append(written)
        if self.mode in (STOPPED, PREPARING):
            self.mode = POSITION_MODE if self.preparing >= self.prepares else PREPARING
            self.preparing += 1
        most = written[MAX_TORQUE]
        assert written[KP_SCALE] == written[KD_SCALE] == 0
        if not self.ignores_torques:
            self.torque = min(max(written[FEEDFORWARD], -most), most) if self.mode == POSITION_MODE else 0.0

    def watch(self, now: float) -> None:
        """Enters the mode *timeout* when the time of the last command is over; torque then depends on its setting."""
        if self.mode == POSITION_MODE and now >= self.deadline:
            self.break_down(TIMED_OUT)

    def take_text(self, line: str) -> None:
        """Answers a line of the diagnostic channel."""
        verb, name = line.strip().rsplit(" ", 1)
        assert verb == "conf get"
        self.text += f"{self.config[name]}\r\n".encode() if name in self.config else b"ERR error reading\r\n"

    def break_down(self, mode: int, fault: int = 0) -> None:
        self.mode, self.fault, self.torque, self.preparing = mode, fault, 0.0, 0


class Controllers(Thread):
    """Both controllers and the machine; a tick passes when each has received a command in position mode.

    `mute[n]` are the numbers of the controllers that do not answer after n ticks, `breaks[n]` is the fault then;
    `overrides` replace registers, and the frames of `noise`, each with a sender, precede every answer. `now` is the
    time by which watchdogs run [s].
    """

    def __init__(self, settings: MoteusSettings, machine: Machine, now: Callable[[], float]):
        super().__init__(daemon=True)
        self._now = now
        self._settings, self._machine = settings, machine
        self._bus, self._test = (can.Bus(interface="virtual", channel=settings.channel, fd=True) for _ in range(2))
        self._over, self._settled, self._due = Event(), Event(), set[int]()
        registers = {REGISTER_MAP: 5, VOLTAGE: 48, TEMPERATURE: 31, TIMEOUT: 0.0}  # in one byte: 0.5 V, 1 °C
        self.controllers = {each.id: Controller(dict(registers)) for each in (settings.motor_1, settings.motor_2)}
        self.torques: list[tuple[float, float]] = []
        self.mute: dict[int, set[int]] = {}
        self.breaks: dict[int, tuple[int, int, int]] = {}
        self.overrides: dict[int, float] = {}
        self.noise: list[tuple[int, bytes]] = []
        self.failure: BaseException | None = None
        self._reading = machine.start()
        self._update_registers()

    def run(self) -> None:
        try:
            while not self._over.is_set():
                message = self._bus.recv(0.05)
                if message and message.arbitration_id == PING:
                    self._settled.set()
                elif message and (message.arbitration_id & 0x7F) in self.controllers:
                    self._answer(message)
        except BaseException as failure:
            self.failure = failure
            self._settled.set()

    def settle(self) -> "Controllers":
        """Waits until all frames sent so far have been processed."""
        if not self.failure:
            self._settled.clear()
            self._test.send(can.Message(arbitration_id=PING))
            assert self._settled.wait(20), "the controllers hang"
        if self.failure:
            raise self.failure
        return self

    def modes(self) -> list[int]:
        return [each.mode for each in self.settle().controllers.values()]

    def send_as(self, number: int, data: bytes) -> None:
        """Sends a frame as if from a controller."""
        self._test.send(can.Message(arbitration_id=number << 8, data=data, is_fd=True, is_extended_id=True))

    def stop(self) -> None:
        try:
            self.settle()
        finally:
            self._over.set()
            self.join()
            self._bus.shutdown()
            self._test.shutdown()

    def _answer(self, message: can.Message) -> None:
        assert message.is_fd
        assert len(message.data) in FRAME_SIZES
        number = message.arbitration_id & 0x7F
        controller = self.controllers[number]
        controller.watch(self._now())
        queried, written, parts = [], {}, []
        for base, kind, first, values in subframes(bytes(message.data)):
            if base == 0x10:
                queried.append((kind, first, len(values)))
            elif base == STREAM_WRITE:
                controller.take_text(bytes(map(int, values)).decode())
            elif base == STREAM_POLL:
                text, controller.text = controller.text[: int(values[0])], controller.text[int(values[0]) :]
                parts.append(bytes([STREAM_REPLY, first, len(text)]) + text)
            else:
                written |= {first + index: value for index, value in enumerate(values)}
        state = {MODE: controller.mode, FAULT: controller.fault, TORQUE: controller.torque}
        current = controller.registers | state | self.overrides
        if written:
            controller.command(written, self._now())
            self._tick(number)
        if message.arbitration_id & 0x8000 and number not in self.mute.get(len(self.torques), ()):
            for sender, data in self.noise:
                self._bus.send(can.Message(arbitration_id=sender << 8, data=data, is_fd=True, is_extended_id=True))
            source = message.arbitration_id >> 8 & 0x7F
            parts += [reply(kind, first, [current[first + n] for n in range(count)]) for kind, first, count in queried]
            data = b"".join(parts)
            size = min(size for size in FRAME_SIZES if size >= len(data))
            data = data.ljust(size, b"\x50")
            self._bus.send(can.Message(arbitration_id=number << 8 | source, data=data, is_fd=True, is_extended_id=True))

    def _tick(self, number: int) -> None:
        """Advances the machine when both controllers have a command and are ready."""
        pair = list(self.controllers.values())
        self._due = self._due | {number} if self.controllers[number].mode != STOPPED else set()
        if len(self._due) == 2 and all(each.mode in (POSITION_MODE, FAULTED, TIMED_OUT) for each in pair):
            self._due.clear()
            motors = (self._settings.motor_1, self._settings.motor_2)
            torques = [motor.sign * motor.gear * each.torque for motor, each in zip(motors, pair, strict=True)]
            self._reading = self._machine.tick((torques[0], torques[1]))
            self.torques.append((torques[0], torques[1]))
            self._update_registers()
            if happens := self.breaks.get(len(self.torques)):
                which, mode, fault = happens
                self.controllers[which].break_down(mode, fault)

    def _update_registers(self) -> None:
        """Sets the registers from the present reading."""
        settings, reading = self._settings, HopperReading(*self._reading)
        for motor, counts in ((settings.motor_1, reading.motor_1), (settings.motor_2, reading.motor_2)):
            turns = motor.zero + motor.sign * motor.gear * counts / MOTOR_COUNTS
            self.controllers[motor.id].registers |= {POSITION: turns, VELOCITY: 0.0, VALIDITY: 0x3F}
        for boom, counts in (
            (settings.boom_horizontal, reading.boom_horizontal),
            (settings.boom_vertical, reading.boom_vertical),
        ):
            share = (boom.zero + boom.sign * counts) / boom.counts_per_turn % 1
            register = {1: ENCODER_1, 2: ENCODER_2}[boom.source]
            self.controllers[boom.id].registers[register] = share
        contact = settings.contact
        share = (contact.zero + reading.contact_force / contact.newton_per_count) / 4096
        self.controllers[contact.id].registers[ANALOG[contact.port] + contact.pin - 1] = share


@contextmanager
def emulated(
    settings: MoteusSettings, machine: Machine, now: Callable[[], float] = lambda: 0.0
) -> Iterator[Controllers]:
    """Runs the controllers; afterwards every command that they received is checked."""
    controllers = Controllers(settings, machine, now)
    controllers.start()
    try:
        yield controllers
    finally:
        controllers.stop()
    for motor in (settings.motor_1, settings.motor_2):
        for command in controllers.controllers[motor.id].commands:
            assert all(isfinite(value) for register, value in command.items() if register != 0x20)
            assert abs(command[TIMEOUT] - settings.watchdog) < 1e-6
            assert abs(command[MAX_TORQUE] * motor.gear - motor.torque_limit) < 1e-5
