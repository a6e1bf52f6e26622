"""What a check says about frames and clocks, given the ticks of a rig."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.hardware.commissioning.check import clock_check
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import ClockLimits

LIMITS = ClockLimits(usual=1.25e-4, window=2.5e-4, outside=20, difference=1e-6)
NAMES = ("clock_offset", "clock_outside", "slave_1_clock_difference", "slave_3_clock_difference")


def ticks(offsets: list[float], outside: int = 0, first: float = 0.0, third: float = -2e-8) -> TickTable:
    columns = [np.array(offsets), *(np.full(len(offsets), value) for value in (outside, first, third))]
    return TickTable(dict.fromkeys(NAMES, ""), np.column_stack(columns))


@settings(deadline=None)
@given(st.lists(st.floats(-4e-4, 4e-4) | st.just(np.nan), min_size=1, max_size=200))
def test_numbers_are_those_of_the_ticks(offsets: list[float]) -> None:
    found = clock_check(ticks([2e-3] * len(offsets) + offsets), LIMITS)
    known = [offset for offset in offsets if np.isfinite(offset)]
    assert found is not None
    assert found.ticks == len(known)
    if not known:
        assert found.failures() == ["no frame reported its time on the reference clock"]
        return
    assert found.worst == max(map(abs, known))
    assert found.p50 <= found.p99_9 <= found.worst
    changes = [abs(after - before) for before, after in pairwise(known)]
    assert found.jitter <= max(changes, default=0.0)
    assert found.jitter >= np.median(changes or [0.0])
    assert bool(found.failures()) == (found.p99_9 > LIMITS.usual)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (ticks([2e-4] * 500 + [1e-5] * 5000 + [4e-4]), ""),
        (
            ticks([2e-4] * 501 + [1e-5] * 5000 + [-2e-4] * 10),
            "99.9 % of the frames were within 200.0 µs of their times",
        ),
        (ticks([1e-5] * 999, outside=20), ""),
        (ticks([1e-5] * 999, outside=21), "21 frames in a row were outside of the window of 250.0 µs, at most 20"),
        (ticks([1e-5] * 999, third=-2e-6), "the clock of slave 3 differed by 2.0 µs from the reference clock, at most"),
        (ticks([1e-5] * 999, first=np.nan), "slave 1 never reported the difference of its clock (0x092C)"),
    ],
    ids=["one late", "many late", "outside", "too many outside", "apart", "silent"],
)
def test_the_rule(rows: TickTable, expected: str) -> None:
    found = clock_check(rows, LIMITS)
    assert found is not None
    failures = "; ".join(found.failures())
    assert failures.startswith(expected)
    assert bool(failures) == bool(expected)


def test_clocks_may_approach_each_other_at_first() -> None:
    rows = ticks([1e-5] * 100)
    rows.rows[:50, 2] = 9e-6
    found = clock_check(rows, LIMITS)
    assert found is not None
    assert (found.failures(), found.differences) == ([], {"slave 1": 0.0, "slave 3": 2e-8})
    assert "slaves' clocks within 0.020 µs" in found.describe()


def test_without_distributed_clocks_there_is_nothing_to_check() -> None:
    assert clock_check(ticks([0.0]), None) is None
