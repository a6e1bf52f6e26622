"""Which prior over robots is right is decided by the steps of the robot."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from stepgap.learning.observations import observe
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT
from stepgap.learning.prior import fit_prior
from stepgap.learning.prior_evidence import applies, log_evidence_of_none, residual_with
from tests.control.maps import LossyHopper
from tests.learning.test_learner import NOMINAL, REALITY, hops, log_of


@pytest.mark.parametrize("seed", range(5))
def test_the_evidence_of_noise_is_that_of_the_t_distribution(seed: int) -> None:
    found = observe(log_of(hops(REALITY, 7, seed=seed)), NOMINAL)
    shape = NOISE_SCALE**2 * np.eye(len(found))
    errors = (found.error / NOMINAL.space.state_scale).T
    densities: Any = stats.multivariate_t
    expected = sum(densities.logpdf(each, shape=shape, df=PRIOR_COUNT) for each in errors)
    units = len(found) * np.sum(np.log(NOMINAL.space.state_scale))
    assert log_evidence_of_none(found) == pytest.approx(expected - units + found.error.size / 2 * np.log(2 * np.pi))


def test_a_prior_is_dropped_where_the_nominal_map_is_right_but_for_noise() -> None:
    """The weak prior, which expects little noise, is no rival there."""
    rng, kind = np.random.default_rng(0), []
    for seed in range(30):
        hopper = LossyHopper(loss=rng.uniform(0.4, 0.6), keep=rng.uniform(0.5, 0.7), drift=rng.uniform(0.1, 0.2))
        kind.append(observe(log_of(hops(hopper, 20, seed)), NOMINAL))
    prior = fit_prior(kind)
    for each in kind[:10]:
        found = each.selected(np.arange(4))
        assert applies(residual_with(prior, found), found)
        noise = replace(found, error=0.15 * NOMINAL.space.state_scale * rng.standard_normal((4, 2)))
        assert not applies(residual_with(prior, noise), noise)
