"""The ring frame by frame, with a master of the tests and flywheels whose counts can be computed by hand."""

import re
from struct import pack, unpack, unpack_from

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.frame import (
    BROADCAST,
    ETHERTYPE,
    SHORTEST_FRAME,
    Command,
    Datagram,
    Frame,
    decode,
    encode,
)
from stepgap.hardware.ethercat.emulator.registers import AlState, StatusCode
from stepgap.hardware.ethercat.emulator.ring_settings import DRIFTING_CLOCKS, RingClocks
from tests.hardware.ethercat.emulator.bench import (
    ANALOG,
    DRIVES,
    ENCODERS,
    SOURCE,
    STATION,
    Bench,
    Flywheels,
    drive_input,
    inputs,
)

COUNTER = 4 * 3 + 1
"""Working counter of a cycle: drives and encoders are read (+1) and written (+2), the analog input is read."""

ENABLING = 4
"""Cycles that `enabled` takes; the machine has made two ticks by then."""


# ---- registers, addressing


def test_slaves_are_addressed_by_position_and_by_station():
    bench = Bench()
    assert bench.ask(Command.APWR, -2 & 0xFFFF, reg.STATION_ADDRESS, b"\x34\x12").counter == 1
    assert bench.ask(Command.FPRD, 0x1234, reg.STATION_ADDRESS, bytes(2)).data == b"\x34\x12"
    assert bench.ask(Command.FPRD, 0x1235, reg.STATION_ADDRESS, bytes(2)).counter == 0


@pytest.mark.parametrize(("command", "address"), [(Command.ARMW, -1 & 0xFFFF), (Command.FRMW, STATION + 1)])
def test_one_slave_is_read_and_the_others_behind_it_written(command, address):
    bench = Bench().operational()
    bench.write(1, 0x1F00, b"\x2a")
    assert bench.ask(command, address, 0x1F00, b"\1").counter == 6
    assert [bench.read(slave, 0x1F00, 1)[0] for slave in range(6)] == [1, 42, 42, 42, 42, 42]


def test_the_ports_form_a_line():
    # ports with communication: bits 9 and 11 of the data link status
    bench = Bench()
    status = [unpack_from("<H", slave.memory, reg.DL_STATUS)[0] for slave in bench.ring.slaves]
    assert [(word >> 9 & 1, word >> 11 & 1) for word in status] == [(1, 1)] * 5 + [(1, 0)]


def test_read_only_registers_do_not_change():
    bench = Bench()
    bench.ask(Command.BWR, 0, reg.AL_STATUS, b"\x08\0")
    assert bench.ask(Command.APRD, 0, reg.AL_STATUS, bytes(2)).data == b"\1\0"


def test_the_eeprom_contains_a_checksum_of_its_configuration():
    bench = Bench()
    bench.ask(Command.APWR, 0, reg.EEPROM_CONTROL, pack("<HI", reg.EEPROM_READ, 0))
    bench.ask(Command.APWR, -1 & 0xFFFF, reg.EEPROM_CONTROL, pack("<HI", reg.EEPROM_READ, 4))
    words = [bench.ask(Command.APRD, -slave & 0xFFFF, reg.EEPROM_DATA, bytes(8)).data for slave in (0, 1)]
    assert words[0][0] == bench.ask(Command.APRD, 0, reg.PDI_CONTROL, bytes(1)).data[0] == 5
    # the polynomial x⁸ + x² + x + 1 divides configuration and checksum, the first byte complemented
    rest = int.from_bytes(b"".join(words)[:15], "big") ^ 0xFF << 14 * 8
    while rest.bit_length() > 8:
        rest ^= 0x107 << rest.bit_length() - 9
    assert rest == 0


def test_the_eeprom_refuses_to_be_written():
    # bit 13: the command was refused (ETG.1000.4, SII control)
    bench = Bench()
    bench.ask(Command.APWR, 0, reg.EEPROM_CONTROL, pack("<HIHH", 0x0201, 0x08, 0, 7))
    assert bench.ask(Command.APRD, 0, reg.EEPROM_CONTROL, bytes(2)).data == pack("<H", 0x2040)
    bench.ask(Command.APWR, 0, reg.EEPROM_CONTROL, pack("<H", 0))
    assert bench.ask(Command.APRD, 0, reg.EEPROM_CONTROL, bytes(2)).data == pack("<H", 0x0040)


# ---- mailbox


@pytest.mark.parametrize(
    ("command", "index", "subindex", "data", "code"),
    [
        (0x40, 0x2000, 0, 0, 0x06020000),  # no such object
        (0x40, 0x1018, 9, 0, 0x06090011),  # no such subindex
        (0x2B, 0x6041, 0, 1, 0x06010002),  # read only
        (0x23, 0x6072, 0, 1, 0x06070010),  # too long
        (0x2F, 0x6060, 0, 8, 0x06090030),  # a mode that is not there
        (0x2B, 0x1C12, 1, 0x1602, 0x06010003),  # still assigned
        (0x00, 0x1018, 0, 0, 0x05040001),  # a segment of nothing
        (0x50, 0x1018, 0, 0, 0x06010000),  # complete access
    ],
)
def test_sdo_refusals(command, index, subindex, data, code):
    bench = Bench()
    bench.pre_operational()
    assert bench.sdo(0, command, index, subindex, pack("<I", data)) == pack("<BHBI", 0x80, index, subindex, code)


def test_pdos_are_assigned_in_pre_operational_only():
    bench = Bench().operational()
    assert unpack("<I", bench.sdo(0, 0x2F, 0x1C12, 0)[4:]) == (0x08000022,)


def sent(bench: Bench, kind: int, body: bytes, length: int | None = None) -> int:
    """Working counter of a read of the mailbox after a message was sent; 0 if there is no answer."""
    length = len(body) if length is None else length
    bench.write(0, 0x1000, (pack("<HHBB", length, 0, 0, kind) + body).ljust(128, b"\0"))
    return bench.ask(Command.FPRD, STATION, 0x1080, bytes(128)).counter


def test_a_message_with_the_counter_of_the_last_one_is_not_served_again():
    bench = Bench()
    bench.pre_operational()
    upload = pack("<HBHBI", 2 << 12, 0x40, 0x1018, 1, 0)
    assert [sent(bench, counter << 4 | 3, upload) for counter in (1, 1, 2, 2, 0, 0, 2)] == [1, 0, 1, 0, 1, 1, 1]
    bench.request(0, 1)  # a new master starts again from INIT
    bench.request(0, 2)
    assert sent(bench, 2 << 4 | 3, upload) == 1


def test_an_abort_of_the_master_is_not_answered():
    bench = Bench()
    bench.pre_operational()
    assert sent(bench, 3, pack("<HBHBI", 2 << 12, 0x80, 0x1018, 1, 0x05040000)) == 0


@pytest.mark.parametrize(
    ("kind", "body", "length", "detail"),
    [
        (3, b"", 0, 0x0005),  # no length
        (0, bytes(4), 4, 0x0005),  # an error of the master
        (2, bytes(4), 4, 0x0002),  # Ethernet over EtherCAT
        (3, pack("<HB", 2 << 12, 0x40), 3, 0x0006),
        (3, pack("<HBHBI", 4 << 12, 0, 0, 0, 0), 10, 0x0004),  # a PDO
        (3, pack("<HBHBI", 9 << 12, 0, 0, 0, 0), 10, 0x0005),  # no such service
    ],
)
def test_mailbox_errors(kind, body, length, detail):
    # as Beckhoff's sample code for slaves and SOES answer
    bench = Bench()
    bench.pre_operational()
    bench.write(0, 0x1000, (pack("<HHBB", length, 0, 0, kind) + body).ljust(128, b"\0"))
    message = bench.read(0, 0x1080, 128)
    assert (message[5] & 0x0F, message[:2], message[6:10]) == (0, b"\4\0", pack("<HH", 1, detail))


def test_a_lost_answer_is_repeated():
    bench = Bench()
    bench.pre_operational()
    first = bench.sdo(0, 0x40, 0x1018, 2)
    activate = reg.SYNC_MANAGER + reg.SYNC_MANAGER_SIZE + 6
    bench.write(0, activate, bytes([reg.SYNC_MANAGER_ENABLED | reg.REPEAT]))
    assert bench.read(0, activate + 1, 1)[0] == reg.REPEAT
    assert bench.mail(0)[2:] == first


# ---- states


def test_states_go_up_one_at_a_time():
    bench = Bench()
    bench.pre_operational()
    assert bench.request(0, 8) == (0x12, StatusCode.INVALID_CHANGE)
    assert bench.request(0, 4) == (0x12, StatusCode.INVALID_CHANGE)  # not acknowledged
    assert bench.request(0, 0x12) == (2, 0)
    assert bench.request(0, 7) == (0x12, StatusCode.UNKNOWN_STATE)


@pytest.mark.parametrize(
    ("outputs", "inputs", "code"),
    [(5, 14, StatusCode.INVALID_OUTPUTS), (0, 14, StatusCode.INVALID_OUTPUTS), (6, 15, StatusCode.INVALID_INPUTS)],
)
def test_a_wrong_length_is_refused(outputs, inputs, code):
    bench = Bench()
    bench.pre_operational()
    bench.map(0, outputs, inputs, 0)
    assert bench.request(0, 4) == (0x12, code)


def test_a_mapping_error_is_scripted_from_the_start_and_later():
    bench = Bench(Fault("wrong mapping", 0, "drive_2"))
    with pytest.raises(AssertionError):
        bench.operational()
    assert bench.status(1) == (0x12, StatusCode.INVALID_INPUTS)
    bench = Bench(Fault("wrong mapping", ENABLING, "boom_vertical")).enabled()
    bench.cycle()
    assert bench.status(4) == (0x12, StatusCode.INVALID_INPUTS)


# ---- drives and machine


def test_a_cycle_is_a_tick_and_returns_the_inputs_before_it():
    bench = Bench().enabled()
    ticks = len(bench.machine.torques)
    answers = [bench.cycle((3, -2))[0] for _ in range(4)]
    assert bench.machine.torques[ticks:] == [(3, -2)] * 4
    assert {answer.counter for answer in answers} == {COUNTER}
    assert [drive_input(answer, 0)[0] for answer in answers] == [0, 3, 6, 9]
    assert [drive_input(answer, 1)[0] for answer in answers] == [0, -2, -4, -6]
    assert drive_input(answers[-1], 0)[1:] == (3, 0x27 | 0x1210, 10, 3000)
    counts = [int.from_bytes(inputs(answers[-1], encoder)[2:6], "little", signed=True) for encoder in ENCODERS]
    assert counts == [-(ticks + 3), 2 * (ticks + 3)]
    assert unpack("<Hh", inputs(answers[-1], ANALOG)) == (0, 123)


def test_torque_is_limited_and_only_in_torque_mode():
    bench = Bench().enabled()
    bench.cycle((1000, -1000))
    assert bench.machine.torques[-1] == (100, -100)
    bench.cycle((50, 50), mode=8)
    assert bench.machine.torques[-1] == (50, 50)  # a mode that is not there is not taken
    bench.cycle((50, 50), mode=0)
    assert bench.machine.torques[-1] == (0, 0)


@pytest.mark.parametrize("controlword", [0x00, 0x06, 0x07, 0x0B, 0x0D])
def test_a_drive_that_is_not_enabled_has_no_torque(controlword):
    bench = Bench().enabled()
    bench.cycle((5, 5), controlword)
    assert bench.machine.torques[-1] == (0, 0)


def test_the_machine_is_held_until_both_drives_are_enabled_and_again_after_init():
    bench = Bench().operational()
    for _ in range(10):
        bench.cycle(controlword=0x06)
    assert bench.machine.torques == []
    for controlword in (0x07, 0x0F):
        bench.cycle((1, 1), controlword)
    assert bench.machine.torques == [(1, 1)]
    starts = bench.machine.starts
    bench.ask(Command.BWR, 0, reg.AL_CONTROL, b"\x11\0")
    bench.cycle((1, 1))
    assert bench.machine.starts == starts + 1
    assert bench.machine.torques == []


def test_a_machine_that_leaves_its_bounds_trips_the_drives():
    bench = Bench(machine=Flywheels(largest_torque=50)).enabled()
    bench.cycle((60, 0))
    (answer,) = bench.cycle((60, 0))
    assert [drive_input(answer, drive)[2] & 0x4F for drive in DRIVES] == [0x08, 0x08]
    assert bench.machine.torques[-1] == (0, 0)


# ---- watchdog


def set_watchdog(bench: Bench, ticks: int) -> None:
    for drive in DRIVES:
        bench.write(drive, reg.WATCHDOG_TIME, pack("<H", 10 * ticks))  # of 100 µs


@pytest.mark.parametrize("limit", [5, 20])
def test_the_watchdog_ends_torque_without_frames(limit):
    bench = Bench(Fault("silence", ENABLING + 3, ticks=100)).enabled()
    set_watchdog(bench, limit)
    for _ in range(3):
        bench.cycle((7, 7))
    before = len(bench.machine.torques)
    bench.cycle((7, 7))
    after = bench.machine.torques[before:]
    assert after == [(7, 7)] * (limit - 1) + [(0, 0)] * (len(after) - limit + 1)
    assert len(after) == 101
    assert bench.status(0) == (0x14, StatusCode.WATCHDOG)
    (answer,) = bench.cycle((7, 7))
    assert drive_input(answer, 0)[2] & 0x4F == 0x08
    assert bench.machine.torques[-1] == (0, 0)


def test_a_drive_that_tripped_remains_in_fault_until_acknowledged_and_reset():
    bench = Bench(Fault("silence", ENABLING, ticks=200)).enabled()
    bench.cycle((7, 7))
    for drive in DRIVES:
        assert unpack("<HHB5x", bench.mail(drive)) == (0x1000, 0x8130, 1)
        assert bench.request(drive, 8) == (0x14, StatusCode.WATCHDOG)  # not acknowledged
        assert bench.request(drive, 0x18) == (8, 0)
    for controlword in (0x0F, 0x06, 0x07, 0x0F):
        bench.cycle((7, 7), controlword)
    assert bench.machine.torques[-1] == (0, 0)
    for controlword in (0x80, 0x06, 0x07, 0x0F):
        bench.cycle((7, 7), controlword)
    assert bench.machine.torques[-1] == (7, 7)


def test_the_watchdog_can_be_off():
    bench = Bench(Fault("silence", ENABLING, ticks=1000)).enabled()
    set_watchdog(bench, 0)
    bench.cycle((7, 7))
    assert bench.status(0) == (8, 0)


# ---- scripted faults


@pytest.mark.parametrize("count", [1, 3])
def test_lost_frames_hold_the_torque(count):
    bench = Bench(Fault("lost frames", ENABLING + 1, cycles=count)).enabled()
    bench.cycle((4, 4))
    ticks = len(bench.machine.torques)
    for _ in range(count):
        assert bench.cycle((9, 9)) == []
    assert bench.machine.torques[ticks:] == [(4, 4)] * count
    assert len(bench.cycle((9, 9))) == 1
    assert bench.machine.torques[-1] == (9, 9)


def test_a_disconnected_slave_disconnects_those_behind_it_and_comes_back():
    bench = Bench(Fault("unplugged", ENABLING + 1, "drive_2", cycles=3)).enabled()
    bench.cycle((4, 4))
    answers = [bench.cycle((5, 5))[0] for _ in range(3)]
    assert {answer.counter for answer in answers} == {3}
    assert bench.machine.torques[-3:] == [(5, 4)] * 3
    assert bench.ask(Command.BRD, 0, reg.TYPE, bytes(1)).counter == 1
    (answer,) = bench.cycle((5, 5))
    assert answer.counter == COUNTER
    assert bench.machine.torques[-1] == (5, 5)


def test_a_slave_that_lost_power_is_reset():
    bench = Bench(Fault("power lost", ENABLING + 1, "drive_2", cycles=2)).enabled()
    bench.cycle((4, 4))
    answers = [bench.cycle((5, 5))[0] for _ in range(3)]
    assert [answer.counter for answer in answers] == [3, 3, COUNTER - 3]
    assert bench.machine.torques[-3:] == [(5, 0)] * 3
    slave = bench.ring.slaves[1]
    assert (slave.state, slave.memory[reg.STATION_ADDRESS]) == (AlState.INIT, 0)


def test_a_stalled_slave_still_counts():
    bench = Bench(Fault("stalled", ENABLING + 2, "drive_1", cycles=3)).enabled()
    bench.cycle((4, 4))
    bench.cycle((4, 4))
    answers = [bench.cycle((5, 5))[0] for _ in range(3)]
    assert {answer.counter for answer in answers} == {COUNTER}
    assert {drive_input(answer, 0)[0] for answer in answers} == {8}
    assert bench.machine.torques[-3:] == [(4, 5)] * 3
    bench.cycle((5, 5))
    assert bench.machine.torques[-1] == (5, 5)


def test_a_drive_fault_is_latched_and_reported():
    bench = Bench(Fault("trip", ENABLING + 1, "drive_1", code=0x2310)).enabled()
    answer = [bench.cycle((4, 4))[0] for _ in range(3)][-1]
    assert drive_input(answer, 0)[2] & 0x4F == 0x08
    assert drive_input(answer, 1)[2] & 0x6F == 0x27
    assert bench.machine.torques[-2:] == [(0, 4)] * 2
    assert unpack("<HHB5x", bench.mail(0)) == (0x1000, 0x2310, 1)
    assert bench.sdo(0, 0x40, 0x603F, 0)[4:6] == pack("<H", 0x2310)


# ---- anything may come

BENCH = Bench().enabled()


def a_datagram(command: int, mark: int, address: int, offset: int, data: bytes) -> Datagram:
    return Datagram(command, mark, address, offset, data)


COMMANDS = st.integers(0, 16)
OFFSETS = st.one_of(
    st.integers(0, 0xFFFF),
    st.sampled_from(
        [0x10, 0x120, 0x502, 0x600, 0x610, 0x800, 0x808, 0x810, 0x818, 0x900, 0x1000, 0x1080, 0x1100, 0x1FFF]
    ),
)
ADDRESSES = st.one_of(
    st.integers(0, 0xFFFF), st.integers(STATION, STATION + 5), st.integers(0xFFFA, 0xFFFF), st.just(0)
)
ANYTHING = st.builds(a_datagram, COMMANDS, st.integers(0, 255), ADDRESSES, OFFSETS, st.binary(max_size=140))


@given(st.binary(max_size=200))
def test_arbitrary_bytes_never_crash_the_ring_nor_come_back_malformed(body):
    for raw in (body, BROADCAST * 2 + ETHERTYPE.to_bytes(2, "big") + body):
        for answer in BENCH.ring.pass_frame(raw):
            assert len(answer) == max(len(raw), SHORTEST_FRAME)
            assert len(decode(answer).datagrams) == len(decode(raw).datagrams)


@given(st.lists(st.lists(ANYTHING, min_size=1, max_size=4), max_size=12))
@settings(max_examples=60, deadline=None)
def test_arbitrary_datagrams_never_crash_the_ring_nor_exceed_the_torque(frames):
    bench = Bench().enabled()
    for datagrams in frames:
        bench.ring.pass_frame(encode(Frame(BROADCAST, BROADCAST, tuple(datagrams))))
        bench.cycle((30000, -30000))
        assert all(len(slave.memory) == reg.MEMORY_SIZE for slave in bench.ring.slaves)


CLOCK_WRITES = st.builds(
    a_datagram,
    st.sampled_from([Command.APWR, Command.APRW, Command.BWR, Command.BRW, Command.ARMW, Command.FRMW]),
    st.integers(0, 255),
    ADDRESSES,
    st.one_of(st.sampled_from([reg.DC_RECEIVE_TIME, reg.DC_SYSTEM_TIME, reg.DC_OFFSET]), st.integers(0x8F8, 0x9B0)),
    st.one_of(st.binary(max_size=180), st.binary(min_size=4, max_size=4), st.binary(min_size=8, max_size=8)),
)


@pytest.mark.parametrize("clocks", [RingClocks(), DRIFTING_CLOCKS])
@given(st.lists(CLOCK_WRITES, max_size=20))
@settings(max_examples=100, deadline=None)
def test_arbitrary_writes_to_the_clocks_leave_the_ring_running(clocks, writes):
    """A time that is distributed far ahead of a clock sets it back beyond zero, from where its times wrap."""
    bench = Bench(clocks=clocks)
    for write in (*writes, Datagram(Command.BWR, 7, 0, reg.DC_RECEIVE_TIME, bytes(4))):
        bench.send(write)
        bench.cycle()
    assert bench.ask(Command.BRD, 0, reg.TYPE, bytes(1)).counter == 6


@given(st.binary(max_size=128))
def test_arbitrary_mail_is_answered(message):
    bench = Bench()
    bench.pre_operational()
    message = message.ljust(128, b"\0")
    bench.write(0, 0x1000, message)
    (length,) = unpack_from("<H", message)
    is_abort = length >= 8 and message[5] & 0x0F == 3 and message[7] >> 4 == 2 and message[8] >> 5 == 4
    assert is_abort or bench.ask(Command.FPRD, STATION, 0x1080, bytes(128)).counter == 1


@given(st.lists(ANYTHING, min_size=1, max_size=6), st.binary(max_size=30))
@settings(max_examples=100)
def test_what_comes_back_is_the_frame_changed_only_where_slaves_may(datagrams, padding):
    raw = encode(Frame(BROADCAST, SOURCE, tuple(datagrams))) + padding
    (back,) = BENCH.ring.pass_frame(raw)
    assert (back[:6], back[6], back[7:16], len(back)) == (BROADCAST, SOURCE[0] | 2, raw[7:16], len(raw))
    end = 16 + (raw[14] | raw[15] << 8) % 0x800
    assert back[end:] == raw[end:]
    for sent, received in zip(datagrams, decode(back).datagrams, strict=True):
        same = ("command", "mark", "offset", "flags", "event")
        assert [getattr(sent, name) for name in same] == [getattr(received, name) for name in same]
        assert len(received.data) == len(sent.data)
        assert 0 <= received.counter <= 6 * 3
        passed = received.address - sent.address & 0xFFFF
        assert passed == (6 if sent.command in {1, 2, 3, 7, 8, 9, 13} else 0)


@pytest.mark.parametrize(
    ("kind", "slave", "numbers", "message"),
    [
        ("lost frame", "", {}, "there is no fault 'lost frame'; the faults are lost frames, "),
        ("silence", "", {}, "a fault 'silence' has the numbers ticks, not {}"),
        ("trip", "drive_1", {"rate": 1}, "a fault 'trip' has the numbers code, not {'rate': 1}"),
        ("trip", "", {}, "a fault 'trip' is one of a slave, so name it"),
        ("late frame", "drive_1", {}, "a fault 'late frame' is one of frames"),
    ],
)
def test_a_wrong_fault_is_refused(kind: str, slave: str, numbers: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        Fault(kind, 1, slave, **numbers)
