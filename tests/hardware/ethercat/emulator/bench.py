"""A machine of two flywheels, and a small master for a ring in this process."""

from collections.abc import Sequence
from struct import Struct, pack, unpack_from

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.frame import BROADCAST, Command, Datagram, Frame, decode, encode
from stepgap.hardware.ethercat.emulator.ring import Machine, Ring
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.emulator.sii import INPUT_START, MAILBOX_AREAS, OUTPUT_START
from stepgap.hardware.hopper.twin_machine import hopper_devices
from stepgap.rigs.rig import RigFault, Torques
from stepgap.robots.hopper.tick.sensors import HopperReading

DRIVES, ENCODERS, ANALOG = (0, 1), (3, 4), 5
DRIVE_OUTPUT, DRIVE_INPUT, ENCODER_INPUT = Struct("<hHbx"), Struct("<ihHbxi"), Struct("<HiI")
LENGTHS = ((6, 14), (6, 14), (0, 0), (6, 10), (6, 10), (0, 4))
STATION = 0x1001
SOURCE = b"\x10\x10\x10\x10\x10\x10"


class Flywheels(Machine):
    """Counts increase by the sum of the torques so far; they are integers, so that any run can be computed by hand."""

    def __init__(self, largest_torque: float = float("inf")):
        self.torques: list[tuple[float, float]] = []
        self.starts, self._largest = 0, largest_torque

    @property
    def period(self) -> float:
        return 1e-3

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        return hopper_devices(settings, self.period)

    def start(self) -> HopperReading:
        self.starts += 1
        self.torques = []
        self._sums = (0.0, 0.0)
        return self._reading()

    def tick(self, torques: Torques) -> HopperReading:
        torque_1, torque_2 = torques
        self.torques.append((torque_1, torque_2))
        self._sums = self._sums[0] + torque_1, self._sums[1] + torque_2
        if max(torque_1, torque_2) > self._largest:
            raise RigFault("too much")
        return self._reading()

    def _reading(self) -> HopperReading:
        count = len(self.torques)
        return HopperReading(self._sums[0], self._sums[1], -count, 2 * count, 12.34)


class Bench:
    """A ring with flywheels, and a master that a test controls."""

    def __init__(self, *faults: Fault, machine: Flywheels | None = None, **settings: object):
        self.machine = machine or Flywheels()
        # 1000 N·m rated: a count of torque is 1 N·m
        scales = {"rated_torque": 1_000_000, "largest_torque": 100} | settings
        self.ring = Ring(self.machine, RingSettings(faults=faults, **scales))  # type: ignore[arg-type]

    def send(self, *datagrams: Datagram) -> list[list[Datagram]]:
        """The datagrams of every frame that comes back."""
        raw = self.ring.pass_frame(encode(Frame(BROADCAST, SOURCE, datagrams)))
        return [list(decode(answer).datagrams) for answer in raw]

    def ask(self, command: Command, address: int, offset: int, data: bytes) -> Datagram:
        ((answer,),) = self.send(Datagram(command, 7, address, offset, data))
        return answer

    def read(self, slave: int, offset: int, size: int) -> bytes:
        answer = self.ask(Command.FPRD, STATION + slave, offset, bytes(size))
        assert answer.counter == 1
        return answer.data

    def write(self, slave: int, offset: int, data: bytes) -> None:
        assert self.ask(Command.FPWR, STATION + slave, offset, data).counter == 1

    def request(self, slave: int, state: int) -> tuple[int, int]:
        """Status and code after a state request."""
        self.write(slave, reg.AL_CONTROL, pack("<H", state))
        return self.status(slave)

    def status(self, slave: int) -> tuple[int, int]:
        status, _, code = unpack_from("<HHH", self.read(slave, reg.AL_STATUS, 6))
        return status, code

    def sdo(self, slave: int, command: int, index: int, subindex: int, data: bytes = bytes(4)) -> bytes:
        """The CoE answer to an SDO request, from its command byte on."""
        body = pack("<HBHB", 2 << 12, command, index, subindex) + data
        self.write(slave, 0x1000, (pack("<HHBB", len(body), 0, 0, 3) + body).ljust(128, b"\0"))
        answer = self.mail(slave)
        return answer[2 : len(answer)]

    def mail(self, slave: int) -> bytes:
        """The next message in a mailbox, without its header."""
        message = self.read(slave, 0x1080, 128)
        (length,) = unpack_from("<H", message)
        return message[6 : 6 + length]

    def assign(self, slave: int, index: int, pdos: Sequence[int]) -> None:
        for number, value, size in [(0, 0, 1), *((n, pdo, 2) for n, pdo in enumerate(pdos, 1)), (0, len(pdos), 1)]:
            assert self.sdo(slave, 0x23 | (4 - size) << 2, index, number, pack("<I", value))[0] == 0x60

    def pre_operational(self) -> None:
        for slave in range(len(self.ring.slaves)):
            self.ask(Command.APWR, -slave & 0xFFFF, reg.STATION_ADDRESS, pack("<H", STATION + slave))
            for number, area in enumerate(MAILBOX_AREAS):
                manager = pack("<HHBBBB", area.start, area.length, area.control, 0, 1, 0)
                self.write(slave, reg.SYNC_MANAGER + 8 * number, manager)
            assert self.request(slave, 2) == (2, 0)
        for drive in DRIVES:
            self.assign(drive, 0x1C12, (0x1602, 0x160B))
            self.assign(drive, 0x1C13, (0x1A02, 0x1A11))

    def map(self, slave: int, outputs: int, inputs: int, logical: int) -> None:
        """Sync managers and FMMUs of a slave: outputs, then inputs behind them."""
        for number, physical, length, control, kind in (
            (2, OUTPUT_START, outputs, 0x64, 2),
            (3, INPUT_START, inputs, 0x20, 1),
        ):
            manager = pack("<HHBBBB", physical, length, control, 0, length > 0, 0)
            self.write(slave, reg.SYNC_MANAGER + 8 * number, manager)
            fmmu = pack("<IHBBHBBB3x", logical, length, 0, 7, physical, 0, kind, length > 0)
            self.write(slave, reg.FMMU + 16 * (number - 2), fmmu)
            logical += length

    def operational(self) -> "Bench":
        self.pre_operational()
        logical = 0
        for slave, (outputs, inputs) in enumerate(LENGTHS):
            self.map(slave, outputs, inputs, logical)
            logical += outputs + inputs
            assert self.request(slave, 4) == (4, 0)
        for slave in range(len(LENGTHS)):
            assert self.request(slave, 8) == (8, 0)
        return self

    def frame(self, torques: tuple[int, int] = (0, 0), controlword: int = 0x0F, mode: int = 10) -> Datagram:
        data = b""
        for slave, (outputs, inputs) in enumerate(LENGTHS):
            own = DRIVE_OUTPUT.pack(torques[slave], controlword, mode) if slave in DRIVES else bytes(outputs)
            data += own + bytes(inputs)
        return Datagram(Command.LRW, 9, 0, 0, data)

    def cycle(self, torques: tuple[int, int] = (0, 0), controlword: int = 0x0F, mode: int = 10) -> list[Datagram]:
        """Datagrams that come back for a cycle's frame: one, none or two."""
        return [answer for (answer,) in self.send(self.frame(torques, controlword, mode))]

    def enabled(self) -> "Bench":
        """Brings the drives to operation enabled, without torque."""
        self.operational()
        for controlword in (0x06, 0x07, 0x0F, 0x0F):
            (answer,) = self.cycle(controlword=controlword)
        assert [drive_input(answer, drive)[2] & 0x6F for drive in DRIVES] == [0x27, 0x27]
        return self


def inputs(answer: Datagram, slave: int) -> bytes:
    """A slave's inputs in the answer to a cycle's frame."""
    start = sum(map(sum, LENGTHS[:slave])) + LENGTHS[slave][0]
    return answer.data[start : start + LENGTHS[slave][1]]


def drive_input(answer: Datagram, drive: int) -> tuple[int, ...]:
    """Position, torque, statusword, mode, velocity."""
    return DRIVE_INPUT.unpack(inputs(answer, drive))
