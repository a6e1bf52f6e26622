"""Flights by phase and force, and crossings: glitches are removed, and times are those of the closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.logs.sections.aerial_phases import aerial_phases, airborne, crossings
from stepgap.logs.sections.signals import Signal
from stepgap.records.steps_csv import RecordError

TIME = np.arange(0, 10.2, 0.002)
FLYING = TIME % 0.5 < 0.3  # flights from 0, 0.5, … for 0.3 s


@settings(max_examples=30)
@given(seed=st.integers(0, 9999), count=st.integers(0, 30))
def test_glitches_do_not_change_the_flights(seed: int, count: int) -> None:
    rng, flying = np.random.default_rng(seed), FLYING.copy()
    for begin in rng.choice(
        np.arange(0.05, 10, 0.1), count, replace=False
    ):  # apart from each other and from true edges
        flying ^= (begin - 0.01 < TIME) & (begin + 0.01 > TIME)
    found = aerial_phases(TIME, flying)
    assert len(found) in (19, 20)  # the first one is complete if a glitch precedes it
    last = found[-19:]
    np.testing.assert_allclose([each.begin for each in last], np.arange(1, 20) * 0.5, atol=0.022)
    np.testing.assert_allclose([each.end for each in last], np.arange(1, 20) * 0.5 + 0.3, atol=0.022)


def test_a_short_flight_is_doubtful() -> None:
    flying = FLYING & ~((TIME > 4.1) & (TIME < 4.5))
    doubts = [each.doubts for each in aerial_phases(TIME, flying)]
    assert doubts[7] == ("unusually short phase",)
    assert not any(doubts[:7] + doubts[8:])


def test_the_force_has_hysteresis() -> None:
    """A force that bounces about one threshold at touch-down gives one touch-down."""
    force = np.where(FLYING, 1.0, 100.0)
    force[(TIME % 0.5 > 0.3) & (TIME % 0.5 < 0.32)] = 25.0  # between LOW and HIGH
    assert len(aerial_phases(TIME, airborne(Signal(TIME, force), None))) == 19
    given = airborne(Signal(TIME, force), 60.0)  # contact begins above 60, flight below 20
    assert len(aerial_phases(TIME, given)) == 19
    assert not given[force == 100].any()


def test_a_force_with_a_large_offset_is_refused() -> None:
    with pytest.raises(RecordError, match="not clearly apart; subtract the offset of the sensor"):
        airborne(Signal(TIME, np.where(FLYING, 40.0, 140.0)), None)


@pytest.mark.parametrize("falling", [False, True])
def test_crossings_are_those_of_the_closed_form(falling: bool) -> None:
    signal = Signal(TIME, np.sin(2 * np.pi * TIME) + np.random.default_rng(0).normal(0, 0.005, len(TIME)))
    expected = np.arange(10) + (5 / 12 if falling else 1 / 12)
    np.testing.assert_allclose(crossings(signal, 0.5, falling)[:10], expected, atol=0.004)
