"""Clocks of slave controllers: drift, compensation, receive times; SYNC0 as a condition of OP, and its supervision."""

from math import sin, tau
from struct import pack, unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.clock import ClockError, RingTime, SlaveClock, Sync0, SyncWatch
from stepgap.hardware.ethercat.emulator.frame import Command, Datagram
from stepgap.hardware.ethercat.emulator.ring_settings import RingClocks
from tests.hardware.ethercat.emulator.bench import LENGTHS, STATION, Bench

MILLISECOND = 1_000_000
CYCLE = 100 * MILLISECOND
"""So long that the ticks of the bench are exact."""


@given(st.floats(-100, 100), st.floats(0, 50), st.floats(1, 100), st.floats(0, 1000))
def test_a_clock_gains_the_integral_of_its_rate(rate: float, wander: float, period: float, time: float) -> None:
    error, step = ClockError(rate, wander, period), 1e-3 * period
    gained = error.gained(time + step) - error.gained(time)
    middle = rate + wander * sin(tau * (time + step / 2) / period)
    assert gained == pytest.approx(1e-6 * step * middle, rel=1e-4, abs=1e-4 * 1e-6 * step + 1e-15)


@pytest.mark.parametrize("size", [4, 8])
@pytest.mark.parametrize("rate", [200.0, -200.0])
def test_a_clock_follows_distributed_times(rate: float, size: int) -> None:
    time, memory = RingTime(), bytearray(reg.MEMORY_SIZE)
    clock = SlaveClock(memory, time, ClockError(rate, 20, 2.0), delay=700)
    memory[reg.DC_DELAY : reg.DC_DELAY + 4] = pack("<I", 700)
    apart = []
    for tick in range(3000):
        time.now = 4_290_000_000 + tick * MILLISECOND  # passes the end of 32 bits
        if tick == 0:
            offset = time.now + 700 - clock.local_time()
            memory[reg.DC_OFFSET : reg.DC_OFFSET + 8] = pack("<q", offset)
        apart.append(clock.system_time() - time.now - 700)
        clock.compensate(time.now % 256**size)
    assert max(map(abs, apart)) < 5000
    assert max(map(abs, apart[500:])) < 100
    clock.refresh()
    (difference,) = unpack("<I", memory[reg.DC_DIFFERENCE : reg.DC_DIFFERENCE + 4])
    assert difference & 0x7FFFFFFF < 100
    clock.reset_compensation()
    before, time.now = clock.local_time(), time.now + 1000 * MILLISECOND
    assert clock.local_time() - before == pytest.approx(1e9 * (1 + 1e-6 * rate), abs=21_000)


def test_receive_times_differ_by_the_way_to_the_end_and_back() -> None:
    bench = Bench(clocks=RingClocks(hop_delay=300))
    bench.pre_operational()
    bench.ring.advance()
    bench.ask(Command.BWR, 0, reg.DC_RECEIVE_TIME, bytes(4))
    for slave in range(6):
        there, back = unpack("<II", bench.read(slave, reg.DC_RECEIVE_TIME, 8))
        assert back - there == 2 * 300 * (5 - slave)
        assert unpack("<Q", bench.read(slave, reg.DC_RECEIVE_TIME_UNIT, 8)) == (there,)


def test_one_command_reads_the_reference_clock_and_writes_the_others() -> None:
    errors = ClockError(), ClockError(100.0)
    bench = Bench(clocks=RingClocks(errors, hop_delay=0))
    bench.pre_operational()
    answer = Datagram(Command.FRMW, 7, STATION, reg.DC_SYSTEM_TIME, bytes(8))
    for _ in range(3000):
        ((answer,),) = bench.send(Datagram(Command.FRMW, 7, STATION, reg.DC_SYSTEM_TIME, bytes(8)))
        bench.ring.advance()
    assert answer.counter == 6
    assert unpack("<Q", answer.data) == (2999 * MILLISECOND,)
    now = [unpack("<Q", bench.read(slave, reg.DC_SYSTEM_TIME, 8))[0] for slave in (0, 1)]
    assert now[0] == 3000 * MILLISECOND
    assert abs(now[1] - now[0]) < 5  # uncorrected 300 µs


def sync0(bench: Bench, slave: int, cycle: int, start: int, active: int = 3) -> None:
    bench.write(slave, reg.DC_START, pack("<Q", start))
    bench.write(slave, reg.DC_CYCLE_0, pack("<I", cycle))
    bench.write(slave, reg.DC_ACTIVATION, bytes([active]))


def test_a_drive_that_needs_sync0_refuses_op_without() -> None:
    bench = Bench(clocks=RingClocks(need_sync0=("drive_1",)))
    bench.pre_operational()
    bench.map(0, *LENGTHS[0], 0)
    assert bench.request(0, 4) == (4, 0)
    assert bench.request(0, 8) == (0x14, reg.StatusCode.NO_SYNC)
    sync0(bench, 0, 0, MILLISECOND)
    assert bench.request(0, 0x18) == (0x14, reg.StatusCode.INVALID_SYNC)
    sync0(bench, 0, CYCLE, 2 * MILLISECOND)
    assert bench.request(0, 0x18) == (0x14, reg.StatusCode.NO_SYNC), "it has not begun"
    for _ in range(3):
        bench.ring.advance()
    sync0(bench, 0, CYCLE, 2 * MILLISECOND, active=1)
    assert bench.request(0, 0x18) == (0x14, reg.StatusCode.NO_SYNC), "cyclic operation alone is not enough"
    sync0(bench, 0, CYCLE, 2 * MILLISECOND)
    assert bench.request(0, 0x18) == (8, 0)


SYNC = Sync0(True, 0, 1000)


@pytest.mark.parametrize(
    ("times", "errors"),
    [
        ([500, 1500, 2500], [0, 0, 0]),
        ([500, 600, 700, 1500], [0, 0, 0, 0]),
        ([1500, 2500, 3500, 4500], [2, 1, 0, 0]),
        ([500, 1050, 2500], [0, 3, 2]),
        ([500, 1950, 2500], [0, 3, 2]),
        ([500, 3500], [0, 5]),
        ([4500], [11]),
    ],
)
def test_intervals_without_a_frame_in_their_window_are_counted(times: list[int], errors: list[int]) -> None:
    watch, found, passed = SyncWatch(10, 0.1), [], []
    watch.start(SYNC, -500)
    for time in times:
        passed.append(watch.passed(SYNC, time))
        found.append(watch.errors)
    assert found == errors
    assert passed == [count <= 10 for count in errors]
