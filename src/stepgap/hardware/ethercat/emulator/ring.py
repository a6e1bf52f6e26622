"""The ring: a frame in, frames out, and a machine that moves tick by tick; without sockets and clock."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.clock import RingTime, SyncWatch
from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.drive import SPEED_RUN_AWAY, Drive
from stepgap.hardware.ethercat.emulator.faults import DRIVE_FAULTS, SENSOR_FAULTS, Fault
from stepgap.hardware.ethercat.emulator.frame import Command, Datagram, Frame, FrameError, decode, encode
from stepgap.hardware.ethercat.emulator.mailbox import emergency
from stepgap.hardware.ethercat.emulator.registers import AlState, StatusCode
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.emulator.slave import EmulatedSlave
from stepgap.rigs.rig import Reading, RigFault, Torques


class Machine(ABC):
    """Motors and what they move."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Time of a tick [s]."""

    @abstractmethod
    def devices(self, settings: RingSettings) -> Sequence[EmulatedDevice]:
        """Creates its drives and sensors, in the order in which frames pass them."""

    @abstractmethod
    def start(self) -> Reading:
        """Puts the machine into its start position, where it is held until the first tick."""

    @abstractmethod
    def tick(self, torques: Torques) -> Reading:
        """Simulates one tick with the motors' torques [N·m] and returns the sensor values at its end.

        Raises:
            RigFault: The machine left its bounds.
        """


_COUNTED_ON = frozenset({Command.APRD, Command.APWR, Command.APRW, Command.ARMW, Command.BRD, Command.BWR, Command.BRW})
_OUTPUTS = frozenset({Command.LRW, Command.LWR})
_SEEN = 0x02  # Bit that slaves set in the first byte of a frame's source address


class Ring:
    """Slaves in a line; the drives among them move a machine's motors, in their order.

    The machine is held until every drive has been enabled once, and returns to its start when a master broadcasts INIT,
    which masters do first.

    Args:
        machine: Machine that the drives move.
        now: Time at which a frame reaches the first slave [ns]; by default the ticks so far times their period.

    Raises:
        ValueError: There is no drive, names are not distinct, or a fault names an unknown slave.
    """

    def __init__(self, machine: Machine, settings: RingSettings, now: Callable[[], int] | None = None):
        self._time = RingTime()
        self._now = now or (lambda: self.ticks * self._period)
        self.slaves = _slaves(machine.devices(settings), settings, self._time)
        self._by_name = {slave.device.name: slave for slave in self.slaves}
        self.drives = [slave.device for slave in self.slaves if isinstance(slave.device, Drive)]
        if not self.drives or len(self._by_name) < len(self.slaves):
            raise ValueError(f"a ring needs drives and distinct names, not {', '.join(self._by_name)}")
        for fault in settings.faults:
            if fault.slave and fault.slave not in self._by_name:
                raise ValueError(f"{fault} names an unknown slave; the slaves are {', '.join(self._by_name)}")
        if unknown := set(settings.clocks.need_sync0) - self._by_name.keys():
            raise ValueError(f"need_sync0 names unknown slaves: {', '.join(sorted(unknown))}")
        self._machine = machine
        self._settings = settings
        self._period = round(machine.period * 1e9)
        self.cycles = 0
        """Number of frames with outputs so far, including lost ones."""
        self.ticks = 0
        """Number of ticks of the ring; in some the machine may have been held."""
        self._late: list[bytes] = []
        self._start()
        for fault in settings.faults:
            if fault.kind == "wrong mapping" and fault.cycle == 0:
                self._by_name[fault.slave].wrong_mapping = True
        self._reach(len(self.slaves))

    def pass_frame(self, raw: bytes) -> list[bytes]:
        """Passes a frame through the ring; returns the frames that come back, none if it is not EtherCAT."""
        try:
            frame = decode(raw)
        except FrameError:
            return []
        self._time.now = self._now()
        if not any(datagram.command in _OUTPUTS for datagram in frame.datagrams):
            return self._answers(frame, raw)
        return self._pass_cycle(frame, raw)

    def advance(self) -> None:
        """Advances by one tick: the slaves act on their outputs, the machine moves, the slaves sense."""
        for slave in self.slaves:
            slave.take_outputs()
        if not self._released and all(drive.is_enabled for drive in self.drives):
            self._released = True
        if self._released:
            try:
                self._reading = self._machine.tick(tuple(drive.torque for drive in self.drives))
            except RigFault:
                for drive in self.drives:
                    drive.trip(SPEED_RUN_AWAY)
        self.ticks += 1
        for slave in self.slaves:
            slave.give_inputs(self._reading, self.ticks * self._period)

    def _start(self) -> None:
        self._reading = self._machine.start()
        self._released = False
        for slave in self.slaves:
            slave.device.sense(self._reading)

    def _pass_cycle(self, frame: Frame, raw: bytes) -> list[bytes]:
        """Passes a frame with outputs, with its scripted faults; in lock-step a tick follows."""
        cycle = self.cycles
        settings = self._settings
        self.cycles += 1
        faults = settings.faults
        if faults:
            self._disturb(cycle)
        lost = any(fault.kind == "lost frames" and fault.lasts(cycle) for fault in faults)
        copies = 2 if faults and Fault("duplicated frame", cycle) in faults else 1
        late = bool(faults) and Fault("late frame", cycle) in faults
        answers = [] if lost else self._answers(frame, raw)
        if settings.lock_step:
            self.advance()
            if settings.inputs_after_tick:
                answers = [self._with_new_inputs(answer) for answer in answers]
        answers = self._late + answers * copies
        self._late = answers if late else []
        return [] if late else answers

    def _answers(self, frame: Frame, raw: bytes) -> list[bytes]:
        """The frame after it has passed all connected slaves; nothing if the first one is not connected."""
        if self._reached == 0:
            return []
        if any(datagram.command == Command.BWR and _requests_init(datagram) for datagram in frame.datagrams):
            self._start()
        datagrams = tuple(self._pass(datagram) for datagram in frame.datagrams)
        source = bytes([frame.source[0] | _SEEN]) + frame.source[1:]
        return [encode(Frame(frame.destination, source, datagrams), raw)]

    def _pass(self, datagram: Datagram) -> Datagram:
        command, _, address, offset, sent, counter, _, _ = datagram
        data = bytearray(sent)
        for slave in self.slaves[: self._reached]:
            counter += slave.exchange(command, address, offset, data)
            if command in _COUNTED_ON:
                address = address + 1 & 0xFFFF
        return datagram._replace(address=address, data=bytes(data), counter=counter & 0xFFFF)

    def _with_new_inputs(self, raw: bytes) -> bytes:
        frame = decode(raw)
        datagrams = []
        for datagram in frame.datagrams:
            data = bytearray(datagram.data)
            if datagram.command == Command.LRW:
                for slave in self.slaves[: self._reached]:
                    slave.exchange(Command.LRD, datagram.address, datagram.offset, data)
            datagrams.append(datagram._replace(data=bytes(data)))
        return encode(frame._replace(datagrams=tuple(datagrams)), raw)

    def _reach(self, count: int) -> None:
        """Connects the first `count` slaves: frames turn back after them, and their ports are set accordingly."""
        self._reached = count
        for number, slave in enumerate(self.slaves, 1):
            travel = 2 * max(0, count - number) * self._settings.clocks.hop_delay
            slave.link(1 if number in (count, len(self.slaves)) else 2, travel)

    def _disturb(self, cycle: int) -> None:
        """Applies the scripted faults of this cycle to slaves and time."""
        reached = len(self.slaves)
        number = {name: index for index, name in enumerate(self._by_name)}
        for fault in self._settings.faults:
            if fault.kind == "stalled":
                self._by_name[fault.slave].stalled = fault.lasts(cycle)
            elif fault.kind in ("unplugged", "power lost") and fault.lasts(cycle):
                reached = min(reached, number[fault.slave])
            if fault.cycle == cycle:
                self._begin(fault)
        if reached != self._reached:
            self._reach(reached)

    def _begin(self, fault: Fault) -> None:
        """Applies the part of a fault that happens once."""
        if fault.kind == "silence":
            for _ in range(fault["ticks"]):
                self.advance()
        slave = self._by_name.get(fault.slave)
        if slave is None:
            return
        if fault.kind == "power lost":
            slave.power_on()
            self._reach(self._reached)
        elif fault.kind in DRIVE_FAULTS and isinstance(slave.device, Drive):
            slave.device.begin(fault)
        elif fault.kind == "emergency":
            slave.device.messages.append(emergency(fault["code"], 0))
        elif fault.kind in SENSOR_FAULTS:
            slave.device.begin_sensor_fault(fault)
        elif fault.kind == "wrong mapping":
            slave.wrong_mapping = True
            if slave.state in (AlState.SAFEOP, AlState.OP):
                slave.set_state(AlState.PREOP, StatusCode.INVALID_INPUTS)


def _slaves(devices: Sequence[EmulatedDevice], settings: RingSettings, time: RingTime) -> list[EmulatedSlave]:
    """Slave controllers for devices, each with its own clock."""
    clocks = settings.clocks
    watched = {name: SyncWatch(clocks.error_limit, clocks.guard) for name in clocks.need_sync0}
    return [
        EmulatedSlave(device, time, clocks.error(number), number * clocks.hop_delay, watched.get(device.name))
        for number, device in enumerate(devices)
    ]


def _requests_init(datagram: Datagram) -> bool:
    index = reg.AL_CONTROL - datagram.offset
    return 0 <= index < len(datagram.data) and datagram.data[index] & 0x0F == AlState.INIT
