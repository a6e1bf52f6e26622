"""The tops of heights: one for each hop, whatever the sensor does; or a refusal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.logs.sections.signals import Signal
from stepgap.logs.sections.tops import hop_faults, tops
from stepgap.records.steps_csv import RecordError
from tests.logs.sections.hopping_logs import hopping


@settings(max_examples=25)
@given(
    step=st.sampled_from([0.0, 1e-4, 1e-3, 5e-3]), noise=st.floats(0, 3e-3), seed=st.integers(0, 999),
    rate=st.sampled_from([100.0, 200.0, 1000.0]),
)  # fmt: skip
def test_every_hop_has_one_top(step: float, noise: float, seed: int, rate: float) -> None:
    """A height rounded to 5 mm at 1 kHz has dozens of equal maxima at the top, and single steps beside them."""
    rng = np.random.default_rng(seed)
    log = hopping(20, rng, rate)
    height = log.height + rng.normal(0, noise, len(log.time))
    found = tops(Signal(log.time, step * np.round(height / step) if step else height))
    np.testing.assert_allclose(found, log.apexes[:, 0], atol=0.04)


def test_times_may_be_rounded_coarser_than_samples_are_apart() -> None:
    log = hopping(12, np.random.default_rng(3))
    found = tops(Signal(np.round(log.time, 2), log.height))
    np.testing.assert_allclose(found, log.apexes[:, 0], atol=0.04)


def test_a_spike_is_no_top() -> None:
    log = hopping(12, np.random.default_rng(3))
    height = log.height.copy()
    height[[500, 2500, 4000]] += 0.3
    np.testing.assert_allclose(tops(Signal(log.time, height)), log.apexes[:, 0], atol=0.02)


@pytest.mark.parametrize("kind", ["noise", "constant", "slope"])
def test_what_has_no_hops_is_refused(kind: str) -> None:
    time = np.arange(0, 20, 0.002)
    values = {"noise": np.random.default_rng(4).normal(size=len(time)), "constant": 0 * time, "slope": time}[kind]
    with pytest.raises(RecordError, match="no clear difference between the tops of hops"):
        tops(Signal(time, values))


def test_a_given_rise_counts() -> None:
    """A strong ripple could be small hops; a user who knows better says so."""
    time = np.arange(0, 10, 0.002)
    height = Signal(time, 0.05 * np.sin(2 * np.pi * time) + 0.03 * np.sin(2 * np.pi * 5 * time))
    assert len(tops(height)) == 50
    assert len(tops(height, rise=0.075)) == 10


def test_a_log_with_unending_samples_is_refused() -> None:
    with pytest.raises(RecordError, match="at most 4194304 are searched"):
        tops(Signal(np.array([0.0, 1e-6, 2e-6, 1e3]), np.zeros(4)))


def test_two_hops_taken_for_one_are_noticed() -> None:
    log = hopping(10, np.random.default_rng(5))
    height, apexes = Signal(log.time, log.height), log.apexes[:, 0]
    assert hop_faults(height, apexes) == [""] * 9
    assert hop_faults(height, np.delete(apexes, 4))[3] == "another top between its sections"
    twice = np.insert(apexes, 4, apexes[4] - 0.02)
    assert hop_faults(height, twice)[4] == "the height hardly descends between its sections"
