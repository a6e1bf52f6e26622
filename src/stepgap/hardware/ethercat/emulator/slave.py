"""A slave controller: registers, FMMUs, sync managers, mailbox, watchdog, states (ETG.1000.4 §6, ETG.1000.6 §6.4)."""

from struct import pack_into, unpack_from
from typing import NamedTuple

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.clock import NO_ERROR, ClockError, RingTime, SlaveClock, Sync0, SyncWatch
from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.dictionary import ASSIGN_INPUTS, ASSIGN_OUTPUTS, Image
from stepgap.hardware.ethercat.emulator.frame import Command
from stepgap.hardware.ethercat.emulator.mailbox import OutgoingMail, answer, mailbox_area
from stepgap.hardware.ethercat.emulator.registers import AlState, StatusCode
from stepgap.hardware.ethercat.emulator.sii import (
    INPUT_CONTROL,
    INPUT_START,
    MAILBOX_AREAS,
    OUTPUT_CONTROL,
    OUTPUT_START,
    Area,
    build_image,
)
from stepgap.rigs.rig import Reading

NO_IMAGE = Image(())

_READS = frozenset({Command.APRD, Command.FPRD, Command.BRD, Command.APRW, Command.FPRW, Command.BRW, Command.LRD})
_WRITES = frozenset({Command.APWR, Command.FPWR, Command.BWR, Command.APRW, Command.FPRW, Command.BRW, Command.LWR})
_BY_POSITION = frozenset({Command.APRD, Command.APWR, Command.APRW})
_BY_STATION = frozenset({Command.FPRD, Command.FPWR, Command.FPRW})
_BROADCAST = frozenset({Command.BRD, Command.BWR, Command.BRW})
_WRITABLE = bytearray(reg.MEMORY_SIZE)
for _start, _end in reg.WRITABLE:
    _WRITABLE[_start:_end] = b"\1" * (_end - _start)


class _Fmmu(NamedTuple):
    """An active mapping: logical bytes [start, end) ↔ memory from `physical` on (ETG.1000.4 §6.6; only full bytes)."""

    start: int
    end: int
    physical: int
    reads: bool
    writes: bool


class EmulatedSlave:
    """A slave controller with a device behind it.

    Args:
        device: The device.
        delay: Time of a frame from the first slave to this one [ns].
        watch: Supervision of frames by a device that needs SYNC0; None if it needs none.
    """

    def __init__(
        self,
        device: EmulatedDevice,
        time: RingTime,
        error: ClockError = NO_ERROR,
        delay: int = 0,
        watch: SyncWatch | None = None,
    ):
        self.device = device
        self._clock_parts = (time, error, delay)
        self._sync_watch = watch
        areas: tuple[Area, ...] = ()
        if device.dictionary is not None:
            outputs, inputs = (device.dictionary.image(which).length for which in (ASSIGN_OUTPUTS, ASSIGN_INPUTS))
            ports = Area(OUTPUT_START, outputs, OUTPUT_CONTROL, 3), Area(INPUT_START, inputs, INPUT_CONTROL, 4)
            areas = MAILBOX_AREAS + ports
        self._areas = areas
        self._eeprom = build_image(device.identity, areas)
        self.stalled = False
        """Whether the device no longer acts nor senses, while the slave controller is running."""
        self.wrong_mapping = False
        """Whether the device expects one byte more than its assigned PDOs have."""
        self._travel_behind = 0
        self.power_on()

    def power_on(self) -> None:
        """Resets the slave to its state after power-up."""
        self.memory = bytearray(reg.MEMORY_SIZE)
        self.clock = SlaveClock(self.memory, *self._clock_parts)
        self.memory[reg.TYPE] = 0x11
        self.memory[reg.FMMU_COUNT : reg.ESC_FEATURES] = bytes([reg.FMMU_SLOTS, reg.SYNC_MANAGER_SLOTS, 4, 0x0F])
        pack_into("<H", self.memory, reg.ESC_FEATURES, 0x000C)  # distributed clocks, 64 bit
        self.memory[reg.PDI_CONTROL] = self._eeprom[0]
        pack_into("<H", self.memory, reg.WATCHDOG_DIVIDER, 2498)
        pack_into("<H", self.memory, reg.WATCHDOG_TIME, 1000)  # 100 ms
        pack_into("<H", self.memory, reg.PDI_WATCHDOG_TIME, 1000)
        self.memory[reg.WATCHDOG_STATUS] = 1
        self._fmmus: list[_Fmmu] = []
        self._mail = OutgoingMail(self.memory)
        self._request_counter = 0
        self._time = self._written = 0
        self._outputs = NO_IMAGE
        self._inputs = NO_IMAGE
        self._outputs_at = 0
        self._inputs_at = 0
        self.set_state(AlState.INIT)
        self.device.power_on()

    def link(self, ports: int, travel_behind: int = 0) -> None:
        """Sets the first `ports` (1 or 2) as linked, the others as looped back (DL_STATUS, ETG.1000.4 §6.1.4).

        Args:
            travel_behind: Time until a frame comes back from the slaves behind this one [ns].
        """
        self._travel_behind = travel_behind
        pack_into("<H", self.memory, reg.DL_STATUS, 0x5611 if ports == 1 else 0x5A31)

    def exchange(self, command: int, address: int, offset: int, data: bytearray) -> int:
        """Processes a datagram that passes (ETG.1000.4 §5.4.1); changes `data`.

        Returns:
            Increment of the working counter.
        """
        if Command.LRD <= command <= Command.LRW:
            return self._exchange_logical(command, offset << 16 | address, data)
        if command in _BY_POSITION:
            taken = address == 0
        elif command in _BY_STATION:
            taken = address == self._word(reg.STATION_ADDRESS)
        elif command in (Command.ARMW, Command.FRMW):
            own = 0 if command == Command.ARMW else self._word(reg.STATION_ADDRESS)
            return self._read_into(offset, data) if address == own else self._write(offset, bytes(data))
        else:
            taken = command in _BROADCAST
        if not taken:
            return 0
        written = bytes(data)
        counter = self._read_into(offset, data, command in _BROADCAST) if command in _READS else 0
        if command in _WRITES:
            counter += self._write(offset, written) * (2 if command in _READS else 1)
        return counter

    def take_outputs(self) -> None:
        """Checks the watchdog of the outputs and lets the device act on them, before a tick of the machine."""
        if self.state is AlState.OP:
            self._watch()
        if not self.stalled:
            operational = self.state is AlState.OP
            if operational:
                start = self._outputs_at
                self._outputs.unpack(bytes(self.memory[start : start + self._outputs.length]))
            self.device.update(operational)
        if self.device.messages:
            self._mail.add(self.device.messages)
            self.device.messages.clear()

    def give_inputs(self, reading: Reading, time: int) -> None:
        """Updates the inputs from the sensors, and the ring's time [ns], after a tick of the machine."""
        self._time = time
        if self.stalled:
            return
        self.device.sense(reading)
        self._refresh_inputs()

    def _refresh_inputs(self) -> None:
        if self.state >= AlState.SAFEOP and self._inputs.length:
            self.memory[self._inputs_at : self._inputs_at + self._inputs.length] = self._inputs.pack()

    def _watch(self) -> None:
        """Returns to SAFEOP when the watchdog of the process data expires (ETG.1000.4 §6.3, ETG.1000.6 §6.4.1)."""
        limit = self._word(reg.WATCHDOG_TIME) * (self._word(reg.WATCHDOG_DIVIDER) + 2) * 40
        if self._outputs.length and limit and self._time - self._written >= limit:
            self.memory[reg.WATCHDOG_STATUS] = 0
            self.memory[reg.WATCHDOG_COUNTER] = min(self.memory[reg.WATCHDOG_COUNTER] + 1, 255)
            self.set_state(AlState.SAFEOP, StatusCode.WATCHDOG)

    def _watch_sync(self) -> None:
        """Returns to SAFEOP when too many frames with outputs miss their windows between two SYNC0 events."""
        if self._sync_watch is None or self.state is not AlState.OP:
            return
        if not self._sync_watch.passed(Sync0.of(self.memory), self.clock.system_time()):
            self.set_state(AlState.SAFEOP, StatusCode.SYNCHRONISATION)

    # ---- memory

    def _word(self, address: int) -> int:
        return self.memory[address] | self.memory[address + 1] << 8

    def _exchange_logical(self, command: int, address: int, data: bytearray) -> int:
        """Processes LRD, LWR, LRW: reads the old memory and writes the new data through every overlapping FMMU."""
        read = written = False
        end = address + len(data)
        incoming = bytes(data)
        # One datagram may meet several mappings: all of them write what came in, from `incoming`, since `data` already
        # has what an earlier one has read. The counter counts a read and a write once for each slave.
        for fmmu in self._fmmus:
            low = max(address, fmmu.start)
            high = min(end, fmmu.end)
            if low >= high:
                continue
            physical = fmmu.physical + low - fmmu.start
            part = slice(low - address, high - address)
            if fmmu.reads and command != Command.LWR:
                data[part] = self.memory[physical : physical + high - low]
                read = True
            if fmmu.writes and command != Command.LRD:
                written |= bool(self._write(physical, incoming[part]))
        return read + written * (2 if command == Command.LRW else 1)

    def _read_into(self, offset: int, data: bytearray, combine: bool = False) -> int:
        """Copies memory into `data`, or combines it by OR for a broadcast; returns 1 if it could be read."""
        end = offset + len(data)
        if end > reg.MEMORY_SIZE or not data:
            return 0
        start, length, full = mailbox_area(self.memory, 1)
        mail = start <= offset < start + length
        if mail and not full:
            return 0
        if offset < reg.DC_SPEED_COUNTER and end > reg.DC_SYSTEM_TIME:
            self.clock.refresh()
        content = self.memory[offset:end]
        data[:] = bytes(a | b for a, b in zip(data, content, strict=True)) if combine else content
        if mail and end >= start + length:
            self._mail.taken()
        return 1

    def _write(self, offset: int, data: bytes) -> int:
        """Writes the bytes that a master may write and acts on changed registers; returns 1 if it could be written."""
        end = offset + len(data)
        if end > reg.MEMORY_SIZE or not data:
            return 0
        if offset >= reg.PROCESS_RAM:
            self.memory[offset:end] = data
            self._take_written(offset, end)
            return 1
        for register, byte in enumerate(data, offset):
            if _WRITABLE[register]:
                self.memory[register] = byte
        if offset == reg.DC_SYSTEM_TIME and len(data) in (4, 8):
            self.clock.compensate(int.from_bytes(data[:4], "little"))
            return 1
        self._act_on_registers(offset, end)
        return 1

    def _act_on_registers(self, start: int, end: int) -> None:
        def touches(register: int, size: int) -> bool:
            return start < register + size and register < end

        if touches(reg.AL_CONTROL, 1):
            self._request_state(self.memory[reg.AL_CONTROL])
        if touches(reg.EEPROM_CONTROL, 2):
            self._serve_eeprom()
        if touches(reg.FMMU, reg.FMMU_SLOTS * reg.FMMU_SIZE):
            self._fmmus = [fmmu for slot in range(reg.FMMU_SLOTS) if (fmmu := self._read_fmmu(slot))]
        if touches(reg.SYNC_MANAGER, reg.SYNC_MANAGER_SLOTS * reg.SYNC_MANAGER_SIZE):
            self._mail.repeat()
        if touches(reg.DC_RECEIVE_TIME, 4):
            self.clock.latch(self._travel_behind)
        if touches(reg.DC_SPEED_COUNTER, 2):
            self.clock.reset_compensation()

    def _take_written(self, start: int, end: int) -> None:
        """Restarts the watchdog after process data; answers a mailbox message after its last byte."""
        base = reg.SYNC_MANAGER + 2 * reg.SYNC_MANAGER_SIZE
        first, length = unpack_from("<HH", self.memory, base)
        if start < first + length and first < end and self.memory[base + 4] & reg.WATCHDOG_TRIGGER:
            self._written = self._time
            self.memory[reg.WATCHDOG_STATUS] = 1
            self._watch_sync()
        first, length, _ = mailbox_area(self.memory, 0)
        if self.device.dictionary and start < first + length <= end and self.state is not AlState.INIT:
            request = bytes(self.memory[first : first + length])
            counter = request[5] >> 4 & 7 if length > 5 else 0
            if counter and counter == self._request_counter:
                return  # a master that repeats a message repeats its counter (ETG.1000.4, mailbox header)
            self._request_counter = counter
            room = mailbox_area(self.memory, 1)[1]
            reply = answer(self.device.dictionary, request, self.state is AlState.PREOP, room)
            if reply is not None:
                self._mail.add([reply])

    def _read_fmmu(self, slot: int) -> _Fmmu | None:
        """Reads the mapping of a slot; None if it is not active or not within memory."""
        base = reg.FMMU + slot * reg.FMMU_SIZE
        start, length, _, _, physical, _, kind, active = unpack_from("<IHBBHBBB", self.memory, base)
        if not active & 1 or physical < reg.PROCESS_RAM or physical + length > reg.MEMORY_SIZE:
            return None
        return _Fmmu(start=start, end=start + length, physical=physical, reads=bool(kind & 1), writes=bool(kind & 2))

    # ---- EEPROM

    def _serve_eeprom(self) -> None:
        """Reads eight bytes at a word address (ETG.1000.4 §6.4); other commands but none are answered with an error."""
        command = self._word(reg.EEPROM_CONTROL) & reg.EEPROM_COMMANDS
        status = reg.EEPROM_READS_8_BYTES
        if command not in (0, reg.EEPROM_READ):
            status |= reg.EEPROM_COMMAND_ERROR
        elif command:
            address = 2 * unpack_from("<I", self.memory, reg.EEPROM_ADDRESS)[0]
            content = self._eeprom[address : address + 8].ljust(8, b"\xff")
            self.memory[reg.EEPROM_DATA : reg.EEPROM_DATA + 8] = content
        pack_into("<H", self.memory, reg.EEPROM_CONTROL, status)

    # ---- states

    def set_state(self, state: AlState, code: StatusCode = StatusCode.NONE) -> None:
        """Enters a state; a status code says why it was refused or lost, which the master must acknowledge."""
        self.state = state
        """Present state of the application layer."""
        pack_into("<H", self.memory, reg.AL_STATUS, state | (reg.ERROR_FLAG if code else 0))
        pack_into("<H", self.memory, reg.AL_STATUS_CODE, code)

    def _request_state(self, control: int) -> None:
        """Handles a state request (ETG.1000.6 §6.4.1): up one state, down to any, after errors are acknowledged.

        A request of INIT acknowledges them, too.
        """
        wanted = control & 0x0F
        present = self.state
        acknowledged = control & reg.ACKNOWLEDGE or wanted == AlState.INIT
        if self.memory[reg.AL_STATUS] & reg.ERROR_FLAG and not acknowledged:
            return
        if wanted == reg.BOOTSTRAP:
            self.set_state(present, StatusCode.NO_BOOTSTRAP if present is AlState.INIT else StatusCode.INVALID_CHANGE)
        elif wanted not in tuple(AlState):
            self.set_state(present, StatusCode.UNKNOWN_STATE)
        elif wanted > 2 * present:
            self.set_state(present, StatusCode.INVALID_CHANGE)
        else:
            self.set_state(*self._enter(AlState(wanted), present))
            self._refresh_inputs()

    def _enter(self, wanted: AlState, present: AlState) -> tuple[AlState, StatusCode]:
        """Changes the state; returns the state reached and the reason if it is not the wanted one."""
        if wanted is AlState.INIT:
            self._mail.clear()
            self._request_counter = 0
            return wanted, StatusCode.NONE
        if wanted is AlState.PREOP and present is AlState.INIT and not self._mailboxes_agree():
            return present, StatusCode.INVALID_MAILBOX
        if wanted is AlState.SAFEOP and present is AlState.PREOP:
            return self._enter_safe_operational()
        if wanted is AlState.OP:
            self._written = self._time
            return self._enter_operational(present)
        return wanted, StatusCode.NONE

    def _enter_operational(self, present: AlState) -> tuple[AlState, StatusCode]:
        """Enters OP; a device that needs SYNC0 refuses it without one (ETG.1020)."""
        if self._sync_watch is None:
            return AlState.OP, StatusCode.NONE
        sync = Sync0.of(self.memory)
        time = self.clock.system_time()
        if not sync.active:
            return present, StatusCode.NO_SYNC
        if not sync.cycle:
            return present, StatusCode.INVALID_SYNC
        if not sync.events(time):
            return present, StatusCode.NO_SYNC
        self._sync_watch.start(sync, time)
        return AlState.OP, StatusCode.NONE

    def _enter_safe_operational(self) -> tuple[AlState, StatusCode]:
        """Enters SAFEOP if the lengths that the master mapped are those of the assigned PDOs."""
        dictionary = self.device.dictionary
        self._outputs = NO_IMAGE
        self._inputs = NO_IMAGE
        if dictionary is not None:
            outputs = dictionary.image(ASSIGN_OUTPUTS)
            inputs = dictionary.image(ASSIGN_INPUTS)
            if not self._maps(2, outputs.length):
                return AlState.PREOP, StatusCode.INVALID_OUTPUTS
            if not self._maps(3, inputs.length + self.wrong_mapping):
                return AlState.PREOP, StatusCode.INVALID_INPUTS
            self._outputs = outputs
            self._inputs = inputs
            self._outputs_at = self._manager(2)[0]
            self._inputs_at = self._manager(3)[0]
        return AlState.SAFEOP, StatusCode.NONE

    def _maps(self, number: int, expected: int) -> bool:
        """Whether a sync manager of process data is on, in free memory, with the expected length; off for length 0."""
        start, length, enabled = self._manager(number)
        if not expected:
            return not (enabled and length)
        return enabled and length == expected and reg.PROCESS_RAM <= start <= reg.MEMORY_SIZE - length

    def _mailboxes_agree(self) -> bool:
        """Whether the mailboxes are those of the EEPROM."""
        wanted = [(area.start, area.length, True) for area in self._areas[:2]]
        return [self._manager(number) for number in range(len(wanted))] == wanted

    def _manager(self, number: int) -> tuple[int, int, bool]:
        base = reg.SYNC_MANAGER + number * reg.SYNC_MANAGER_SIZE
        start, length = unpack_from("<HH", self.memory, base)
        return start, length, bool(self.memory[base + 6] & reg.SYNC_MANAGER_ENABLED)
