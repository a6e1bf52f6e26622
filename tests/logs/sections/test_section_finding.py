"""Flights by phase and force without their glitches, and steps that end where another foot touches down."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.logs.sections.section_finding import aerial_phases, airborne, find_sections
from stepgap.logs.sections.section_settings import NEXT_FOOT, SectionSettings
from stepgap.logs.sections.signals import Signal, SignalLog, read_signal_log
from stepgap.logs.sections.step_extraction import extract_steps
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


PERIOD, SWING, RATE = 0.8, 0.3, 500.0
STATE = ("speed=rate(x)",)
BY_CONTACT = SectionSettings(contact=("left", "right"), at=NEXT_FOOT, state=STATE)
BY_FORCE = SectionSettings(force=("force_l", "force_r"), at=NEXT_FOOT, state=STATE)


def walk(folder: Path, *, glitch: bool = False) -> SignalLog:
    """Steps of 0.4 s: the right foot lands at 0.4, 1.2, …, the left one at 0.8, 1.6, …; the speed has their period."""
    time = np.arange(0, 8.0, 1 / RATE) + 0.0005
    left, right = (((time - begin) % PERIOD > SWING).astype(float) for begin in (0.5, 0.1))
    if glitch:
        right[(time > 1.24) & (time < 1.25)] = 0.0
    x = 0.5 * time + 0.01 * np.sin(4 * np.pi * time / PERIOD)
    lines = [
        f"{row[0]!r},{row[1]!r},{row[2]:g},{row[3]:g},{400 * row[2]:g},{400 * row[3]:g}"
        for row in zip(time.tolist(), x.tolist(), left, right, strict=True)
    ]
    (folder / "log.csv").write_text("\n".join(["time,x,left,right,force_l,force_r", *lines]))
    return read_signal_log(str(folder / "log.csv"), "", {})


@pytest.mark.parametrize("glitch", [False, True])
@pytest.mark.parametrize("settings", [BY_CONTACT, BY_FORCE])
def test_a_step_is_from_one_foot_to_the_other(tmp_path: Path, settings: SectionSettings, glitch: bool) -> None:
    log = walk(tmp_path, glitch=glitch)
    times = [each.time for each in find_sections(log, settings)]
    np.testing.assert_allclose(times, 0.4 * np.arange(1, len(times) + 1), atol=1 / RATE)
    assert len(times) == 19
    steps = extract_steps(str(tmp_path / "log.csv"), None, settings)
    speed = 0.5 + 0.01 * 4 * np.pi / PERIOD * np.cos(4 * np.pi * np.array(times) / PERIOD)
    np.testing.assert_allclose(steps.sections.state[:, 0], speed, atol=0.03)


def test_a_foot_that_lands_twice_makes_no_step(tmp_path: Path) -> None:
    settings = SectionSettings(contact=("left", "left"), at=NEXT_FOOT, state=STATE)
    pairs = find_sections(walk(tmp_path), settings)
    alone = SectionSettings(contact=("left",), at="end", state=STATE)
    assert len(pairs) >= len(find_sections(walk(tmp_path), alone))
    with pytest.raises(RecordError, match=r"finds 0 section\(s\); .* a robot that walks has no flight.*--at next_foot"):
        find_sections(walk(tmp_path), SectionSettings(contact=("left", "right"), at="end", state=STATE))
