"""Simulated steps along motions: where they begin, and that nothing but the generator decides it."""

import numpy as np
import pytest

from stepgap.robots.nominal_maps.motions import WIDENED, Motions, Samples
from stepgap.step import StepStatus
from tests.control.maps import NeverWorks, StumblingHopper


def sampled(seed: int = 0, count: int = 64) -> tuple[Motions, Samples]:
    motions = Motions(StumblingHopper(), np.random.default_rng(seed))
    return motions, motions.continued(motions.begun(count), 2 * count)


def test_half_of_the_further_steps_begin_where_earlier_ones_ended_within_the_ranges() -> None:
    motions, samples = sampled()
    n = len(motions.space.state)
    assert len(samples.status) == 192
    begins = motions.centre[:n] + motions.scale[:n] * samples.points[:, :n]
    ends = samples.next_state
    assert not any(np.isclose(ends[:64], begin).all(axis=1).any() for begin in begins[64:128])
    for row in range(128, 192):
        (before,) = np.nonzero(np.isclose(ends[:row], begins[row], rtol=0, atol=1e-12).all(axis=1))
        assert len(before) > 0
        assert samples.status[before[0]] == StepStatus.OK
    assert (np.abs(motions.space.scaled_state(begins)) <= WIDENED + 1e-12).all()
    assert (np.abs(samples.points[:, n:]) <= 1).all()
    assert np.std(samples.points[128:, n:], axis=0) == pytest.approx(1 / np.sqrt(3), rel=0.1)
    assert (samples.status != StepStatus.OK).any(), "failed steps are samples, too"


def test_the_seed_decides_and_the_way_of_computing_does_not() -> None:
    def backwards(function, states, commands):
        found = [function(state, command) for state, command in zip(states[::-1], commands[::-1], strict=True)]
        return found[::-1]

    _, first = sampled()
    motions = Motions(StumblingHopper(), np.random.default_rng(0), backwards)
    again = motions.continued(motions.begun(64), 128)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(first.points, sampled(seed=1)[1].points)


def test_without_a_step_that_stays_in_the_ranges_all_steps_are_first_ones() -> None:
    motions = Motions(NeverWorks(), np.random.default_rng(0))
    samples = motions.continued(motions.begun(16), 32)
    assert len(samples.status) == 48
    assert len(np.unique(samples.points, axis=0)) == 48
