"""Distributed clocks: the law that steers frames, and drives that need SYNC0, in a computed time."""

import os
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.bus_rig import HostTime
from stepgap.hardware.commissioning.check import ClockCheck, clock_check
from stepgap.hardware.ethercat import bus
from stepgap.hardware.ethercat.distributed_clocks import DcSettings, Steering, offset_from_grid
from stepgap.hardware.ethercat.emulator.clock import ClockError
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.network import NoNetwork, wire
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import RigFault
from tests.hardware.ethercat.computed_time import TICK, TimedRig, drifting_clocks, settings_with_sync0, timed_rig

INTERFACE = f"dc{os.getpid()}"

BRING_UP = 600
"""Number of frames after which a rig is connected, at most."""


@pytest.fixture(scope="module")
def _network() -> None:
    pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
    try:
        with wire(INTERFACE):
            pass
    except NoNetwork as reason:
        pytest.skip(str(reason))


on_the_ring = pytest.mark.usefixtures("_network")


# ---- the law


@given(st.integers(0, 2**62), st.sampled_from([250_000, 1_000_000]))
def test_an_offset_is_the_distance_from_the_nearest_multiple(time: int, cycle: int) -> None:
    offset = offset_from_grid(time, cycle)
    assert (time - offset) % cycle == 0
    assert -cycle <= 2 * offset < cycle


def offsets_of(
    rate: float, frames: int, lost: frozenset[int] = frozenset(), late: float = 0.0, per_tick: int = 1
) -> list[float]:
    """Offsets under the law for a reference clock with an error of its rate; `late` delays every hundredth frame."""
    now, offsets = 0.0, []
    steering = Steering(TICK, DcSettings(), HostTime(lambda: now, lambda _: None))
    due = 0.0003
    for frame in range(frames):
        now = due + (late if frame % 100 == 99 else 0.0)
        steering.sent()
        if frame not in lost:
            steering.returned(round(1e9 * now * (1 + rate)))
            offsets.append(steering.offset)
        due = now if frame == 0 else due + TICK
        if frame == 0 or frame % per_tick == per_tick - 1:
            due += steering.correction(frames=per_tick)
    return offsets


@pytest.mark.parametrize("rate", [1e-4, -1e-4])
def test_frames_follow_a_clock_with_a_wrong_rate(rate: float) -> None:
    offsets = offsets_of(rate, 1000)
    assert abs(offsets[0]) == pytest.approx(0.0003, rel=1e-3)
    assert max(map(abs, offsets[1:])) < 5e-6
    assert max(map(abs, offsets[500:])) < 1e-8


@pytest.mark.parametrize(("rate", "per_tick"), [(1e-4, 4), (-1e-4, 10)])
def test_frames_between_two_ticks_drift_only_until_the_next_tick(rate: float, per_tick: int) -> None:
    offsets = offsets_of(rate, 4000 * per_tick, per_tick=per_tick)
    drift = per_tick * TICK * abs(rate)
    assert max(map(abs, offsets[1:])) < 30 * drift
    assert max(map(abs, offsets[-1000:])) <= drift


def test_a_late_frame_hardly_moves_the_ones_after_it() -> None:
    offsets = np.abs(offsets_of(1e-4, 2000, late=4e-4))
    on_time = [offset for frame, offset in enumerate(offsets) if frame > 500 and frame % 100 != 99]
    assert max(on_time) < 2e-6


def test_many_frames_beside_their_time_in_a_row_are_a_fault() -> None:
    steering = Steering(TICK, DcSettings(window=0.2, outside=3))
    for offset in (250_000, 250_000, 250_000, 0, 250_000, -250_000, 250_000):
        steering.returned(10**9 + offset)
        assert steering.fault == ""
    steering.returned(10**9 - 210_000)
    expected = (
        "4 frames in a row were more than 200 µs away from their time on the reference clock, the last one -210 µs"
    )
    assert steering.fault == expected


# ---- drives that need SYNC0


@on_the_ring
def test_drives_stay_in_operation_while_all_clocks_drift() -> None:
    rng = np.random.default_rng(1)
    with timed_rig(INTERFACE, drifting_clocks(rng)) as timed:
        offsets = [timed.tick(late)[0] for late in rng.exponential(5e-6, 600)]
        assert abs(timed.apart()) < 50  # ns
        delays = [timed.register(slave, 0x0928, 4) for slave in range(6)]
    assert max(map(abs, offsets)) < 1e-4
    assert max(map(abs, offsets[300:])) < 6e-5
    assert abs(np.mean(offsets[300:])) < 2e-6
    assert delays == [0, 500, 1000, 1500, 2000, 2500]  # as SOEM computes them from the times that the slaves latch


@on_the_ring
def test_a_tick_that_is_late_by_more_than_a_cycle_does_not_change_the_phase() -> None:
    with timed_rig(INTERFACE, drifting_clocks(np.random.default_rng(3))) as timed:
        late = [1.6e-3 if tick == 300 else 0.0 for tick in range(600)]
        offsets = np.array([timed.tick(each)[0] for each in late])
    assert abs(offsets[301]) == pytest.approx(4e-4, abs=5e-6)
    assert max(map(abs, offsets[302:])) < 2e-6


@on_the_ring
def test_op_is_refused_without_sync0(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "STATE_TIMEOUT", 0.15)
    settings = settings_with_sync0(INTERFACE)
    without = replace(settings, slaves=tuple(replace(slave, assign_activate=0) for slave in settings.slaves))
    one = replace(settings, slaves=(settings.slaves[0], *without.slaves[1:]))
    for wrong, first in ((without, 1), (one, 2)):
        with pytest.raises(RigFault) as caught, timed_rig(INTERFACE, settings=wrong):
            pass
        drives = [f"slave {number} 'drive_{number}' is in SAFEOP (0x002D: No sync error)" for number in range(first, 3)]
        assert str(caught.value) == f"a slave refuses OP: {'; '.join(drives)}"


def shifted(timed: TimedRig, ticks: int) -> None:
    for _ in range(ticks):
        timed.tick(late=5e-4, follow=False)


@on_the_ring
def test_drives_fault_when_frames_do_not_follow_their_clock() -> None:
    """Without corrections, a drift of 100 ppm moves the frames into SYNC0 within 5 s; here half a cycle at once."""
    with timed_rig(INTERFACE) as timed:
        for _ in range(100):
            timed.tick()
        with pytest.raises(RigFault, match="slave 1 'drive_1' is in state fault") as caught:
            shifted(timed, 50)
        assert "drive_1' is in SAFEOP (0x001A: Synchronization error)" in str(caught.value)


@on_the_ring
@pytest.mark.parametrize(
    ("fault", "survives"),
    [(Fault("lost frames", BRING_UP, cycles=3), True), (Fault("lost frames", BRING_UP, cycles=5), False)],
    ids=["three lost", "five lost"],
)
def test_a_drive_tolerates_a_few_missed_windows(fault: Fault, survives: bool) -> None:
    settings = replace(settings_with_sync0(INTERFACE), reply_timeout=0.1)
    with timed_rig(INTERFACE, drifting_clocks(np.random.default_rng(2)), (fault,), settings) as timed:
        message = ""
        try:
            for _ in range(BRING_UP):
                timed.tick()
        except RigFault as caught:
            message = str(caught)
    assert ("no longer accepts torque commands" not in message) == survives, message


# ---- several frames per tick, and ticks at 4 kHz


def run(timed: TimedRig, late: Iterable[float]) -> np.ndarray:
    """Offsets of all frames of these ticks [s]."""
    return np.concatenate([timed.tick(each) for each in late])


@on_the_ring
@pytest.mark.parametrize(("tick", "frames"), [(TICK, 4), (TICK / 4, 1)], ids=["4 frames per tick", "4 kHz"])
def test_frames_every_quarter_millisecond_are_in_time(tick: float, frames: int) -> None:
    """Clocks drift by up to 100 ppm, frames are lost, and ticks are late, one by most of three cycles."""
    rng, count = np.random.default_rng(4), 2400 // frames
    late = rng.exponential(5e-6, count)
    late[count // 2] = 7e-4
    settings = replace(settings_with_sync0(INTERFACE, tick, frames), reply_timeout=0.1)
    lost = tuple(Fault("lost frames", BRING_UP + 300 * number, cycles=2) for number in range(2))
    with timed_rig(INTERFACE, drifting_clocks(rng), lost, settings) as timed:
        offsets = run(timed, late)
        assert abs(timed.apart()) < 50  # ns
    settled = np.abs(offsets[800:])
    assert settled.max() < settings.dc.window * settings.cycle * 2
    assert np.quantile(settled, 0.99) < settings.dc.usual * settings.dc.window * settings.cycle
    assert np.median(settled) < 5e-6


# ---- the check


def checked(timed: TimedRig, late: Iterable[float]) -> ClockCheck:
    """Check of these ticks."""
    rows = []
    for each in late:
        timed.tick(each)
        rows.append(timed.rig.diagnostics)
    found = clock_check(TickTable(timed.rig.diagnostic_units, np.array(rows)), timed.rig.clock_limits)
    assert found is not None
    return found


@on_the_ring
def test_a_check_measures_frames_and_clocks() -> None:
    rng = np.random.default_rng(5)
    with timed_rig(INTERFACE, drifting_clocks(rng)) as timed:
        good = checked(timed, rng.exponential(5e-6, 1000))
        bad = checked(timed, rng.exponential(5e-5, 1000))
    assert good.failures() == []
    assert good.p99_9 < 1e-4
    assert 1e-5 < good.jitter < 1e-4
    assert good.differences == {"slave 1": pytest.approx(0.0, abs=1e-7), "slave 2": pytest.approx(0.0, abs=1e-7)}
    (failure,) = bad.failures()
    assert "but must be within 125.0 µs (dc.usual): frames are late if ticks are" in failure


@on_the_ring
def test_four_frames_per_tick_are_all_checked_and_four_missed_ones_a_fault() -> None:
    settings = settings_with_sync0(INTERFACE, frames=4)
    with timed_rig(INTERFACE, settings=settings) as timed:
        found = checked(timed, [2e-5 if tick % 100 == 99 else 0.0 for tick in range(500)])
        offsets = run(timed, [0.0] * 20)
        assert max(map(abs, offsets)) < 2e-6
        assert (found.worst > 1.8e-5, found.jitter > 1.8e-5, found.failures()) == (True, True, [])
        with pytest.raises(RigFault, match=r"slave 1 'drive_1' is in SAFEOP \(0x001A: Synchronization error\)"):
            run(timed, [1.1e-3, 0.0, 0.0])


@on_the_ring
def test_a_slave_whose_clock_follows_only_roughly_fails_the_check() -> None:
    """Its rate is wrong by more than its compensation corrects, which leaves it behind by 4 µs."""
    with timed_rig(INTERFACE, (ClockError(), ClockError(-1250.0))) as timed:
        found = checked(timed, [0.0] * 300)
    (failure,) = found.failures()
    assert failure.startswith("the clock of slave 2 differed by ")
    assert "its `assign_activate` may be wrong" in failure
