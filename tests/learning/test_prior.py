"""A prior over robots: found from robots drawn from a known one, and used where it applies."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import QUADRATIC, Moments, fit_polynomial, monomials, weak_prior
from stepgap.learning.prior import DEGREE, PRIOR, Prior, fit_prior
from stepgap.learning.regression import TrainingData
from stepgap.learning.residual import HistoryInputs
from stepgap.learning.residual_fit import learned_residual, residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)), (Quantity("fx", "N", -15.0, 15.0),)
)
SIZE = monomials(np.zeros(3), DEGREE).size
NOISE = np.array([0.02, 0.03])
SETTINGS = LearningSettings(online=True, remove_yaw_dependence=False)
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


def test_without_steps_the_polynomial_is_the_prior(prior: Prior) -> None:
    points = robot(MEAN, 7, np.random.default_rng(1))
    residual = learned_residual(points.selected(np.arange(0)), SETTINGS, 0, priors=[prior])
    inputs = np.hstack([points.state, points.command])
    basis = monomials(SPACE.scaled_inputs(points.state, points.command), DEGREE)
    for number, found in enumerate(prior.coordinates):
        unit, regression = SPACE.state_scale[number], residual.regressions[number]
        np.testing.assert_allclose(regression.mean(inputs), basis @ found.mean * unit, atol=1e-9)
        variance = np.einsum("pa,ab,pb->p", basis, found.covariance, basis)
        np.testing.assert_allclose(regression.std(inputs), np.sqrt(variance) * unit, rtol=1e-5)
        assert regression.noise_std == pytest.approx(found.noise_std * unit)


def test_other_ranges_and_more_inputs_change_nothing(prior: Prior) -> None:
    """The same function of state and command, where ranges are others and inputs of a touchdown are added."""
    points = robot(MEAN, 9, np.random.default_rng(2))
    inputs = np.hstack([points.state, points.command])
    plain = points.training_data(HistoryInputs(), 0)
    wider = TrainingData(
        np.hstack([inputs, np.zeros((9, 1))]),
        plain.values,
        np.append(plain.centre + 0.1 * plain.scale, 0.0),
        np.append(1.5 * plain.scale, 1.0),
        plain.value_scale,
    )
    one = fit_polynomial(plain, DEGREE, prior.moments(0, plain))
    other = fit_polynomial(wider, DEGREE, prior.moments(0, wider))
    queries = np.hstack([inputs, np.zeros((9, 1))])
    np.testing.assert_allclose(other.mean(queries), one.mean(inputs), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(other.std(queries), one.std(inputs), rtol=2e-3)


def test_three_steps_say_more_with_it(prior: Prior) -> None:
    rng, errors = np.random.default_rng(3), {"prior": 0.0, "quadratic": 0.0}
    for _ in range(20):
        weights = weights_of(rng)
        known, others = robot(weights, 3, rng), robot(weights, 50, rng)
        inputs = np.hstack([others.state, others.command])
        for name, used in (("prior", prior), ("quadratic", None)):
            settings = replace(SETTINGS, residual="quadratic")
            residual = learned_residual(known, settings, 0, priors=[used] if used else [])
            assert residual.kind == name
            errors[name] += float(np.sum(((residual.mean(inputs) - others.error) / SPACE.state_scale) ** 2))
    assert errors["prior"] < 0.2 * errors["quadratic"]


def test_it_is_dropped_where_it_is_wrong(prior: Prior) -> None:
    """Of robots whose commands act the other way, it is dropped within six steps; of those it fits, never."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        right = robot(weights_of(rng), 25, rng)
        wrong = acting_otherwise(right)
        for steps in (1, 3, 6, 25):
            assert learned_residual(right.selected(np.arange(steps)), SETTINGS, 0, priors=[prior]).kind == PRIOR.name
        assert learned_residual(wrong.selected(np.arange(6)), SETTINGS, 0, priors=[prior]).kind != PRIOR.name


def test_of_several_priors_the_right_one_is_used(prior: Prior) -> None:
    """The other one is of robots whose commands act the other way; the order does not matter."""
    rng = np.random.default_rng(9)
    kinds = {"right": prior, "other": fit_prior([acting_otherwise(robot(weights_of(rng), 30, rng)) for _ in range(60)])}
    for _ in range(10):
        known = {"right": robot(weights_of(rng), 4, rng)}
        known["other"] = acting_otherwise(robot(weights_of(rng), 4, rng))
        for name, steps in known.items():
            alone = learned_residual(steps, SETTINGS, 0, priors=[kinds[name]])
            for order in (kinds, reversed(kinds)):
                chosen = learned_residual(steps, SETTINGS, 0, priors=[kinds[each] for each in order])
                assert chosen.to_dict() == alone.to_dict()


def acting_otherwise(steps: Observations) -> Observations:
    return replace(steps, error=steps.error + 0.8 * steps.command / 15.0 * SPACE.state_scale)


def test_what_is_no_polynomial_is_left_to_the_residual_of_the_settings(prior: Prior) -> None:
    rng = np.random.default_rng(6)
    bent = robot(weights_of(rng), 120, rng)
    bent = replace(bent, error=bent.error + 0.3 * np.sin(6 * bent.command / 15.0) * SPACE.state_scale)
    assert learned_residual(bent, SETTINGS, 0, priors=[prior]).kind == "gp_on_linear"


def test_without_a_residual_there_is_no_prior(prior: Prior) -> None:
    known = robot(MEAN, 3, np.random.default_rng(7))
    assert learned_residual(known, replace(SETTINGS, residual="none"), 0, priors=[prior]).kind == "none"


def test_a_saved_residual_is_the_same(prior: Prior) -> None:
    known = robot(MEAN, 4, np.random.default_rng(8))
    residual = learned_residual(known, SETTINGS, 0, priors=[prior])
    restored = residual_from_dict(residual.to_dict())
    inputs = np.hstack([known.state, known.command])
    for name in ("mean", "std"):
        np.testing.assert_array_equal(getattr(restored, name)(inputs), getattr(residual, name)(inputs))
    assert restored.kind == "prior"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("information", [[1.0, 2.0], [2.0, 1.0]]),
        ("projection", [1.0]),
        ("squares", -1.0),
        ("degrees_of_freedom", 2.0),
    ],
)
def test_a_damaged_prior_of_a_saved_polynomial_is_refused(prior: Prior, key: str, value: object) -> None:
    known = robot(MEAN, 4, np.random.default_rng(8))
    saved = learned_residual(known, SETTINGS, 0, priors=[prior]).to_dict()
    saved["regressions"][1]["prior"][key] = value
    with pytest.raises(ValueError, match=key if key != "projection" else "information"):
        residual_from_dict(saved)


def test_evidence_is_the_product_of_predictions() -> None:
    """Each value by Student's t distribution, given those before it."""
    rng = np.random.default_rng(9)
    points, values = rng.uniform(-1, 1, (12, 2)), rng.normal(0.1, 0.05, 12)
    data = TrainingData(points[:0], values[:0], np.zeros(2), np.ones(2), 1.0)
    prior = weak_prior(data, DEGREE)
    prior = Moments(prior.information * 100, prior.projection + 0.01, prior.squares + 1.0, 4.0)
    polynomial = fit_polynomial(data, DEGREE, prior)
    expected = 0.0
    for point, value in zip(points, values, strict=True):
        degrees = polynomial.moments.degrees_of_freedom
        mean, std = polynomial.predict(point)
        scale = float(std) * np.sqrt((degrees - 2) / degrees)
        expected += float(stats.t.logpdf(value, degrees, float(mean), scale))
        polynomial = polynomial.append(point, float(value))
    assert polynomial.log_evidence - 12 / 2 * np.log(2 * np.pi) == pytest.approx(expected)


def test_too_few_robots_have_no_prior() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 5"):
        fit_prior([robot(MEAN, 30, rng)] * 4)


def test_without_a_prior_the_model_is_quadratic() -> None:
    known = robot(MEAN, 8, np.random.default_rng(1)).training_data(HistoryInputs(), 0)
    np.testing.assert_array_equal(
        PRIOR.fit(known, None).mean(known.points), QUADRATIC.fit(known, None).mean(known.points)
    )
