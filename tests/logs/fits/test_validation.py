"""Cross-validation: it holds out the right steps, and its significance test is neither too weak nor too strict."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t

from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, observe
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.logs.fits.validation import (
    FOLDS,
    HeldOut,
    Reduction,
    Validation,
    contiguous_folds,
    deployment_folds,
    fit_steps,
    reduction,
    validate,
    validate_on,
)
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus
from tests.control.maps import LossyHopper

SPACE = StepSpace(
    (Quantity("speed", "m/s", -1, 1), Quantity("height", "m", -1, 1)),
    (Quantity("fx", "N", -1, 1), Quantity("fy", "N", -1, 1)),
)
STATIC = LearningSettings(drift=False, remove_yaw_dependence=False)
SIMPLE: tuple[str, ...] = ("none", "constant", "gp")


def steps_with(truth, count: int, seed: int) -> Observations:
    """Steps whose error is a function of state and command plus noise of 0.1 m/s and 0.01 m."""
    rng = np.random.default_rng(seed)
    state, command = rng.uniform(-1, 1, (2, count, 2))
    error = truth(state, command) + rng.normal(size=(count, 2)) * [0.1, 0.01]
    return Observations(SPACE, state, command, error, deployment=np.zeros(count, np.intp))


def held_out(remaining: Array) -> HeldOut:
    return HeldOut("none", remaining, np.zeros_like(remaining), np.ones_like(remaining), 0.0)


# Folds


@given(st.integers(2, 300), st.integers(2, 60))
def test_blocks_are_contiguous_and_of_one_size(steps: int, number: int) -> None:
    if number > steps:
        with pytest.raises(ValueError, match="at least 2"):
            contiguous_folds(steps, number)
        return
    folds = contiguous_folds(steps, number)
    assert (np.diff(folds.fold) >= 0).all()
    sizes = np.bincount(folds.fold)
    assert len(sizes) == folds.count == number
    assert np.ptp(sizes) <= 1
    blocks = int(folds.block.max()) + 1
    assert blocks >= min(FOLDS, steps // 2)
    for block in range(blocks):
        assert len(set(folds.fold[folds.block == block])) == 1


@given(st.lists(st.integers(1, 40), min_size=2, max_size=30), st.randoms(use_true_random=False))
def test_complete_deployments_are_held_out(lengths: list[int], order) -> None:
    labels = list(range(len(lengths)))
    order.shuffle(labels)
    deployment = np.repeat(labels, lengths)
    folds = deployment_folds(deployment)
    assert set(folds.fold) == set(range(min(len(lengths), FOLDS)))
    for label in labels:
        assert len(set(folds.fold[deployment == label])) == 1
    for block in range(int(folds.block.max()) + 1):
        assert len(set(folds.fold[folds.block == block])) == 1
    if min(lengths) >= FOLDS:
        assert folds.block.max() + 1 >= FOLDS


def test_one_deployment_cannot_be_held_out() -> None:
    with pytest.raises(ValueError, match="only one deployment"):
        deployment_folds(np.zeros(30, np.intp))


def test_predictions_do_not_depend_on_the_held_out_steps() -> None:
    steps, folds = steps_with(lambda state, command: state, 40, 0), contiguous_folds(40, 4)
    held = folds.fold == 2
    spoilt = replace(steps, error=np.where(held[:, None], 1e3, steps.error))
    for kind in SIMPLE:
        before, after = (validate([kind], each, folds, STATIC).held_out[kind] for each in (steps, spoilt))
        np.testing.assert_array_equal(before.mean[held], after.mean[held])
        np.testing.assert_array_equal(before.std[held], after.std[held])
        if kind != "none":
            assert (before.mean[~held] != after.mean[~held]).all()


def with_yaw(steps: Observations, shift: Array, laps: float = 2.0) -> Observations:
    """The same steps in three deployments, of which each turns round twice, with errors that depend on the yaw."""
    count = len(steps) // 3
    yaw, deployment = np.tile(np.linspace(0, laps * 2 * np.pi, count), 3), np.repeat(np.arange(3), count)
    turned = yaw + np.array([0.0, 1.0, 4.0])[deployment]  # each deployment begins elsewhere
    return replace(steps, error=steps.error + np.outer(np.sin(turned), shift), phase=yaw, deployment=deployment)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_prediction_depends_on_earlier_held_out_steps_only(number: int) -> None:
    steps = with_yaw(steps_with(bent, 90, 2), np.array([0.4, 0.04]))
    folds = deployment_folds(steps.labels[:, 0])
    first = int(np.flatnonzero(folds.fold == number)[0])
    later = np.arange(len(steps)) > first + 20
    spoilt = replace(steps, error=steps.error + 0.5 * (later & (folds.fold == number))[:, None])
    for kind in ("constant", "quadratic"):
        before, after = (validate([kind], each, folds).held_out[kind] for each in (steps, spoilt))
        known = slice(first, first + 22)
        np.testing.assert_array_equal(before.mean[known], after.mean[known])
        np.testing.assert_array_equal(before.std[known], after.std[known])
        assert (before.mean[first + 22 : first + 30] != after.mean[first + 22 : first + 30]).any()


@pytest.mark.parametrize("kind", ["constant", "gp_on_linear"])
def test_a_deployment_is_predicted_as_the_learner_of_a_run_predicts_it(kind: str) -> None:
    nominal, reality = LossyHopper(), LossyHopper(loss=0.45, keep=0.6, drift=0.09)
    rng, log = np.random.default_rng(3), list[LoggedStep]()
    for iteration in range(3):
        state, yaw = np.array([0.2, 0.58]), 0.0
        for number in range(1, 31):
            command = rng.uniform(-4, 4, 2)
            after = reality(state, command) + 0.03 * np.sin(yaw + iteration) + rng.normal(0, [4e-3, 1e-3])
            yaw += 0.3
            record = StepRecord(state, command, command, after, StepStatus.OK, {"yaw": yaw})
            log.append(LoggedStep(iteration, number, after, after, np.zeros(2), record))
            state = after
    settings_of_run = LearningSettings(residual=kind, monitor=False)
    learner = Learner.start(nominal, Steps(nominal.space, log[:60]), settings_of_run, iteration=2)
    expected = []
    for logged in log[60:]:
        expected.append(learner.step_map()(logged.record.state, logged.record.requested))
        learner = learner.after(logged)
    observed = observe(Steps(nominal.space, log), nominal)
    predicted = nominal.evaluate(observed.state, observed.command).next_state
    held = validate([kind], observed, deployment_folds(observed.labels[:, 0])).held_out[kind]
    np.testing.assert_allclose((predicted + held.mean)[60:], expected, rtol=0, atol=1e-12)


def test_errors_that_depend_on_the_yaw_do_not_hide_what_can_be_learned() -> None:
    truth = lambda state, command: np.stack([0.5 * state[:, 0], 0.05 * command[:, 1]], axis=-1)  # noqa: E731
    steps = with_yaw(steps_with(truth, 180, 5), np.array([0.5, 0.05]))
    folds = deployment_folds(steps.labels[:, 0])
    as_run, as_noise = (validate(("none", "linear"), steps, folds, each) for each in (LearningSettings(), STATIC))
    assert (as_noise.held_out["linear"].rmse > [0.3, 0.03]).all(), "the amplitude 0.5 is an RMSE of 0.35"
    assert (as_run.held_out["linear"].rmse < [0.25, 0.025]).all(), "the noise is 0.1"
    np.testing.assert_array_equal(as_run.held_out["none"].mean, 0)


# Scores


def test_scores_are_those_of_a_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    std, mean = rng.uniform(0.5, 2, (4000, 2)), rng.normal(size=(4000, 2))
    exact = HeldOut("gp", mean + std * rng.normal(size=(4000, 2)), mean, std, 0.0)
    np.testing.assert_allclose(exact.coverage, 0.95, atol=0.011)  # three binomial standard deviations
    np.testing.assert_allclose(exact.rmse, np.sqrt(np.mean(std**2, axis=0)), rtol=0.05)


def test_without_standard_deviations_there_is_no_coverage() -> None:
    assert np.isnan(HeldOut("none", np.ones((3, 2)), np.zeros((3, 2)), np.zeros((3, 2)), 0.0).coverage).all()


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.floats(1e-6, 1e6))
def test_a_reduction_has_no_units_and_two_directions(seed: int, unit: float) -> None:
    one, other = np.random.default_rng(seed).normal(size=(2, 30, 2))
    block = contiguous_folds(30).block
    forth = reduction(held_out(one), held_out(other), block, [0, 1])
    changed = reduction(held_out(one * [1, unit]), held_out(other * [1, unit]), block, [0, 1])
    assert (changed.value, changed.standard_error) == pytest.approx((forth.value, forth.standard_error), rel=1e-6)
    there, back = (reduction(*pair, block, [1]) for pair in _both_ways(held_out(one), held_out(other)))
    assert (1 - there.value) * (1 - back.value) == pytest.approx(1)
    assert not (there.certain and back.certain)


def _both_ways(one: HeldOut, other: HeldOut) -> list[tuple[HeldOut, HeldOut]]:
    return [(one, other), (other, one)]


def test_its_standard_error_is_its_spread() -> None:
    rng = np.random.default_rng(1)
    block = contiguous_folds(200, 20).block
    found = []
    for _ in range(400):
        common, own = rng.normal(size=(2, 200, 1))
        found.append(reduction(held_out(0.6 * common + 0.3 * own), held_out(common), block, [0]))
    spread = np.std([by.value for by in found])
    assert np.mean([by.value for by in found]) == pytest.approx(1 - np.hypot(0.6, 0.3), abs=0.01)
    assert np.sqrt(np.mean([by.standard_error**2 for by in found])) == pytest.approx(spread, rel=0.15)


def test_few_blocks_need_a_larger_advantage() -> None:
    assert not Reduction(0.22, 0.1, 10).certain
    assert Reduction(0.23, 0.1, 10).certain
    assert Reduction(1.3, 0.1, 2).certain
    assert not Reduction(1.2, 0.1, 2).certain
    assert not Reduction(0.2, 0.1, 10**6).certain
    assert Reduction(0.201, 0.1, 10**6).certain


def test_the_interval_is_that_of_student() -> None:
    low, high = Reduction(0.22, 0.1, 10).interval
    half_width = t.ppf(0.975, 9) * 0.1
    assert (low, high) == pytest.approx((0.22 - half_width, 0.22 + half_width))


def test_the_best_residual_and_those_that_may_be_as_good() -> None:
    rng = np.random.default_rng(4)
    good, noise = rng.normal(size=(2, 200, 1))
    remaining = {"none": 3 * good, "constant": good + 0.02 * noise, "linear": good, "gp": 2 * good, "fitrgp": good}
    remaining["auto"] = 0.9 * good
    validation = Validation(contiguous_folds(200), {kind: held_out(each) for kind, each in remaining.items()})
    best = validation.best
    assert (best.kind, best.alike) == ("linear", ("constant", "fitrgp")), "the simplest of equal ones; never auto"
    assert best.gain == validation.reduction("linear", "none", [0])
    assert best.gain.value == pytest.approx(2 / 3)


def test_an_error_of_zero_cannot_be_reduced() -> None:
    nothing, something = held_out(np.zeros((20, 1))), held_out(np.ones((20, 1)))
    block = contiguous_folds(20).block
    assert reduction(nothing, nothing, block, [0]).value == 0
    assert reduction(something, nothing, block, [0]).value == -np.inf
    assert not reduction(something, nothing, block, [0]).certain
    assert reduction(nothing, something, block, [0]).value == 1
    assert reduction(nothing, something, block, [0]).certain


# What is concluded, where the truth is known


def validated(steps: Observations) -> Validation:
    """Predictions of 60 held-out steps in five blocks."""
    return validate(SIMPLE, steps, contiguous_folds(60, 5))


def test_in_noise_there_is_nothing_to_learn() -> None:
    found = [validated(steps_with(lambda state, command: 0 * state, 60, seed)).best.gain for seed in range(4)]
    assert sum(each.certain for each in found) <= 1
    assert np.mean([each.value for each in found]) == pytest.approx(0, abs=0.05)


def test_an_offset_is_a_constant() -> None:
    found = [validated(steps_with(lambda state, command: np.array([0.2, -0.02]), 60, seed)).best for seed in range(3)]
    assert all(each.gain.certain for each in found)
    assert sum("constant" in (each.kind, *each.alike) for each in found) >= 2


def bent(state: Array, command: Array) -> Array:
    return np.stack([np.sin(3 * state[:, 0]) * command[:, 1], 0.1 * np.cos(3 * command[:, 0])], axis=-1)


def test_a_nonlinear_error_needs_a_gaussian_process() -> None:
    validation = validate(SIMPLE, steps_with(bent, 120, 0), contiguous_folds(120, 5))
    assert (validation.best.kind, validation.best.alike) == ("gp", ())
    assert (validation.held_out["gp"].rmse < 0.5 * validation.held_out["constant"].rmse).all()


def test_each_coordinate_is_judged_separately() -> None:
    steps = steps_with(lambda state, command: bent(state, command) * [1, 0], 120, 1)
    validation = validate(SIMPLE, steps, contiguous_folds(120, 5))
    assert validation.reduction("gp", "none", [0]).certain
    assert not validation.reduction("gp", "none", [1]).certain


def test_other_steps_are_predicted_by_a_fit_to_all() -> None:
    steps, other = (steps_with(bent, count, seed) for count, seed in ((80, 0), (40, 1)))
    found = validate_on(("none", "gp"), steps, other, STATIC)
    residual = fit_steps(steps, replace(STATIC, residual="gp"))
    points = np.hstack([other.state, other.command])
    np.testing.assert_allclose(found.held_out["gp"].mean, residual.mean(points), rtol=1e-12)
    assert found.folds.count == 1


def test_progress_is_reported_fit_by_fit() -> None:
    calls = []
    steps = steps_with(lambda state, command: state, 20, 0)
    validate(("none", "constant"), steps, contiguous_folds(20, 3), on_fit=lambda *done: calls.append(done))
    assert calls == [(done, 6) for done in range(1, 7)]
