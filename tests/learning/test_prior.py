"""A prior over robots: found from robots drawn from a known one, and used where it applies."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from stepgap.gauss.features import Features
from stepgap.gauss.monomials import monomials
from stepgap.learning.beliefs import Beliefs, Observed
from stepgap.learning.first_beliefs import Family, unknown
from stepgap.learning.observations import Observations
from stepgap.learning.prior import DEGREE, Prior, fit_prior
from stepgap.step import Array, ContextQuantity, Quantity, StepSpace

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)), (Quantity("fx", "N", -15.0, 15.0),)
)
SIZE = monomials(np.zeros(3), DEGREE).size
NOISE = np.array([0.02, 0.03])
RNG = np.random.default_rng(5)
MEAN = RNG.normal(0, 0.3, (2, SIZE))
ROOT = RNG.normal(0, 0.2, (2, SIZE, 3))


def weights_of(rng: np.random.Generator) -> Array:
    """Weights of a robot: three directions in which robots differ; shape (2, k) [half ranges]."""
    return MEAN + np.einsum("nkr,nr->nk", ROOT, rng.standard_normal((2, 3)))


def robot(weights: Array, steps: int, rng: np.random.Generator) -> Observations:
    points = rng.uniform(-1, 1, (steps, 3))
    noise = NOISE * rng.standard_normal((steps, 2))
    error = (monomials(points, DEGREE) @ weights.T + noise) * SPACE.state_scale
    state = SPACE.state_centre + SPACE.state_scale * points[:, :2]
    return Observations(SPACE, state, SPACE.command_at(points[:, 2:]), error)


@pytest.fixture(scope="module")
def prior() -> Prior:
    rng = np.random.default_rng(0)
    return fit_prior([robot(weights_of(rng), 30, rng) for _ in range(60)])


def test_it_is_that_from_which_robots_were_drawn(prior: Prior) -> None:
    for number, found in enumerate(prior.coordinates):
        true_covariance = ROOT[number] @ ROOT[number].T
        spread = np.sqrt(np.diag(true_covariance))
        assert (np.abs(found.mean - MEAN[number]) < 4 * spread / np.sqrt(60) + 0.01).all()
        assert np.abs(found.covariance - true_covariance).max() < 0.5 * true_covariance.max()
        assert found.noise_std == pytest.approx(NOISE[number], rel=0.1)


def test_a_bad_robot_changes_little(prior: Prior) -> None:
    """Its errors are noise ten times as large as a half range."""
    rng = np.random.default_rng(0)
    robots = [robot(weights_of(rng), 30, rng) for _ in range(60)]
    wild = replace(robots[0], error=10 * SPACE.state_scale * rng.standard_normal((30, 2)))
    for one, other in zip(prior.coordinates, fit_prior([*robots, wild]).coordinates, strict=True):
        assert np.abs(one.mean - other.mean).max() < 0.05
        assert other.noise_std == pytest.approx(one.noise_std, rel=0.1)


def features_of(space: StepSpace) -> Features:
    """Those of beliefs about robots with this state, command and context inputs, without waves."""
    inputs = len(space.names) + len(space.context_inputs)
    return Features(inputs, DEGREE, np.empty((0, inputs)), np.empty(0))


def moments_at(family: Family, features: Features, points: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of errors at points (p, d) in half ranges; shapes (p, 2)."""
    basis = features(points)
    variance = np.einsum("pa,nab,pb->pn", basis, family.covariance, basis)
    return basis @ family.mean.T, np.sqrt(variance)


def test_a_family_with_its_own_ranges_is_the_prior(prior: Prior) -> None:
    family = prior.family(SPACE, features_of(SPACE))
    for number, found in enumerate(prior.coordinates):
        np.testing.assert_allclose(family.mean[number], found.mean, atol=1e-9)
        np.testing.assert_allclose(family.covariance[number], found.covariance, atol=1e-9)
        assert family.noise_std[number] == pytest.approx(found.noise_std)


def test_other_ranges_change_nothing(prior: Prior) -> None:
    """The same function of state and command in the units of both, with the same uncertainty and noise."""
    other = StepSpace(
        (Quantity("speed", "m/s", -0.1, 0.7), Quantity("height", "m", 0.52, 0.59)),
        (Quantity("fx", "N", -12.0, 25.0),),
    )
    points = robot(MEAN, 9, np.random.default_rng(2))
    found = []
    for space in (SPACE, other):
        family, features = prior.family(space, features_of(space)), features_of(space)
        mean, std = moments_at(family, features, space.scaled_inputs(points.state, points.command))
        found.append((mean * space.state_scale, std * space.state_scale, family.noise_std * space.state_scale))
    for one, again in zip(*found, strict=True):
        np.testing.assert_allclose(again, one, rtol=1e-6, atol=1e-9)


def test_robots_of_the_family_do_not_depend_on_context_inputs_as_far_as_is_known(prior: Prior) -> None:
    """Where an input of a touchdown is zero, it is the prior; elsewhere nothing is known of its effect."""
    more = replace(SPACE, context=(ContextQuantity("rise", "m", input_scale=0.05),))
    assert len(more.context_inputs) == 1
    rng = np.random.default_rng(4)
    points, features = rng.uniform(-1, 1, (7, 3)), features_of(more)
    family = prior.family(more, features)
    wide = np.hstack([points, np.zeros((7, 1))])
    for one, other in zip(
        moments_at(family, features, wide),
        moments_at(prior.family(SPACE, features_of(SPACE)), features_of(SPACE), points),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, atol=1e-9)
    wide[:, -1] = 1.0
    added = (
        moments_at(family, features, wide)[1] ** 2
        - moments_at(family, features, 0 * wide + wide * [1, 1, 1, 0])[1] ** 2
    )
    own = unknown(features, 2)
    index = [4, *(1 + 4 + np.flatnonzero(np.triu_indices(4)[1] == 3))]  # of the input, and of its products
    basis = features(wide)[:, index] ** 2
    expected = basis @ np.diagonal(own.covariance, axis1=1, axis2=2)[:, index].T
    np.testing.assert_allclose(added, expected, rtol=1e-6)


def test_with_many_inputs_the_family_is_linear(prior: Prior) -> None:
    features = Features(3, 1, np.empty((0, 3)), np.empty(0))
    family = prior.family(SPACE, features)
    for number, found in enumerate(prior.coordinates):
        np.testing.assert_allclose(family.mean[number], found.mean[:4], atol=1e-9)
        np.testing.assert_allclose(family.covariance[number], found.covariance[:4, :4], atol=1e-9)


def learned(steps: Observations, priors: Sequence[Prior]) -> Beliefs:
    """Beliefs after steps that did not follow each other."""
    features = features_of(SPACE)
    beliefs = Beliefs.start(features, (2, 1), [each.family(SPACE, features) for each in priors], None)
    for state, command, error in zip(steps.state, steps.command, steps.error, strict=True):
        point = SPACE.scaled_inputs(state, command)
        step = Observed(point, error / SPACE.state_scale, np.nan, command=point[2:], from_elsewhere=lambda _: None)
        beliefs = beliefs.unlinked().after(step)
    return beliefs


def error_of(beliefs: Beliefs, steps: Observations) -> float:
    """Root mean square of the errors that are left at other steps [half ranges]."""
    basis = beliefs.features(SPACE.scaled_inputs(steps.state, steps.command))
    left = basis @ beliefs.mixture(np.nan).mean[:, : basis.shape[1]].T - steps.error / SPACE.state_scale
    return float(np.sqrt(np.mean(left**2)))


def share(beliefs: Beliefs, kind: str) -> float:
    return float(sum(p for one, p in zip(beliefs.beliefs, beliefs.probabilities, strict=True) if one.kind == kind))


def test_three_steps_say_more_with_it(prior: Prior) -> None:
    rng, errors = np.random.default_rng(3), dict.fromkeys(("with", "without"), 0.0)
    for _ in range(12):
        weights = weights_of(rng)
        known, others = robot(weights, 3, rng), robot(weights, 50, rng)
        errors["with"] += error_of(learned(known, [prior]), others)
        errors["without"] += error_of(learned(known, []), others)
    assert errors["with"] < 0.4 * errors["without"]


def test_it_loses_where_it_is_wrong(prior: Prior) -> None:
    """Robots whose commands act the other way have left it after eight steps; those that it fits never do."""
    rng = np.random.default_rng(4)
    for _ in range(8):
        right = robot(weights_of(rng), 8, rng)
        assert share(learned(right, [prior]), "family") > 0.9
        assert share(learned(acting_otherwise(right), [prior]), "family") < 0.1


def test_of_several_priors_the_right_one_wins(prior: Prior) -> None:
    """The other one is of robots whose commands act the other way; the order does not matter."""
    rng = np.random.default_rng(9)
    other = fit_prior([acting_otherwise(robot(weights_of(rng), 30, rng)) for _ in range(60)])
    for _ in range(4):
        weights = weights_of(rng)
        for steps, right in ((robot(weights, 4, rng), prior), (acting_otherwise(robot(weights, 4, rng)), other)):
            alone, queries = learned(steps, [right]), robot(weights, 20, rng)
            for order in ([prior, other], [other, prior]):
                found = learned(steps, order)
                assert error_of(found, queries) == pytest.approx(error_of(alone, queries), abs=0.03)


def acting_otherwise(steps: Observations) -> Observations:
    return replace(steps, error=steps.error + 0.8 * steps.command / 15.0 * SPACE.state_scale)


def test_too_few_robots_have_no_prior() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 5"):
        fit_prior([robot(MEAN, 30, rng)] * 4)
