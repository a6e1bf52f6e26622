"""Cross-validation: it holds out the right steps, and its significance test is neither too weak nor too strict."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.learning.observations import Observations
from stepgap.learning.residual_fit import fit_residual
from stepgap.logs.fits.validation import (
    FOLDS,
    HeldOut,
    Reduction,
    Validation,
    contiguous_folds,
    deployment_folds,
    reduction,
    validate,
    validate_on,
)
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    (Quantity("speed", "m/s", -1, 1), Quantity("height", "m", -1, 1)),
    (Quantity("fx", "N", -1, 1), Quantity("fy", "N", -1, 1)),
)
SIMPLE: tuple[str, ...] = ("none", "constant", "gp")


def steps_with(truth, count: int, seed: int) -> Observations:
    """Steps whose error is a function of state and command plus noise of 0.1 m/s and 0.01 m."""
    rng = np.random.default_rng(seed)
    state, command = rng.uniform(-1, 1, (2, count, 2))
    error = truth(state, command) + rng.normal(size=(count, 2)) * [0.1, 0.01]
    return Observations(SPACE, state, command, error)


def held_out(remaining: Array) -> HeldOut:
    return HeldOut("none", remaining, np.zeros_like(remaining), np.ones_like(remaining), 0.0)


# Folds


@given(st.integers(2, 300), st.integers(2, 60))
def test_blocks_are_contiguous_and_of_one_size(steps: int, number: int) -> None:
    number = min(number, steps)
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


def test_predictions_do_not_depend_on_the_held_out_steps() -> None:
    steps, folds = steps_with(lambda state, command: state, 40, 0), contiguous_folds(40, 4)
    held = folds.fold == 2
    spoilt = replace(steps, error=np.where(held[:, None], 1e3, steps.error))
    for kind in (*SIMPLE, "posterior"):
        before, after = (validate([kind], each, folds).held_out[kind] for each in (steps, spoilt))
        np.testing.assert_array_equal(before.mean[held], after.mean[held])
        np.testing.assert_array_equal(before.std[held], after.std[held])
        if kind != "none":
            assert (before.mean[~held] != after.mean[~held]).all()


# Scores


def test_scores_are_those_of_a_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    std, mean = rng.uniform(0.5, 2, (4000, 2)), rng.normal(size=(4000, 2))
    exact = HeldOut("gp", mean + std * rng.normal(size=(4000, 2)), mean, std, 0.0)
    np.testing.assert_allclose(exact.coverage, 0.95, atol=0.011)  # three binomial standard deviations
    np.testing.assert_allclose(exact.rmse, np.sqrt(np.mean(std**2, axis=0)), rtol=0.05)
    assert np.isnan(replace(exact, std=0 * std).coverage).all(), "without standard deviations there is no coverage"


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.floats(1e-6, 1e6))
def test_a_reduction_has_no_units_and_two_directions(seed: int, unit: float) -> None:
    one, other = np.random.default_rng(seed).normal(size=(2, 30, 2))
    block = contiguous_folds(30).block
    forth = reduction(held_out(one), held_out(other), block, [0, 1])
    changed = reduction(held_out(one * [1, unit]), held_out(other * [1, unit]), block, [0, 1])
    assert (changed.value, changed.standard_error) == pytest.approx((forth.value, forth.standard_error), rel=1e-6)
    there = reduction(held_out(one), held_out(other), block, [1])
    back = reduction(held_out(other), held_out(one), block, [1])
    assert (1 - there.value) * (1 - back.value) == pytest.approx(1)
    assert not (there.certain and back.certain)


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
    found = [validated(steps_with(lambda state, command: 0 * state, 60, seed)).best.gain for seed in range(3)]
    assert sum(each.certain for each in found) <= 1
    assert np.mean([each.value for each in found]) == pytest.approx(0, abs=0.05)


def test_an_offset_is_a_constant() -> None:
    found = [validated(steps_with(lambda state, command: np.array([0.2, -0.02]), 60, seed)).best for seed in range(2)]
    assert all(each.gain.certain for each in found)
    assert sum("constant" in (each.kind, *each.alike) for each in found) >= 1


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
    found = validate_on(("none", "gp"), steps, other)
    residual = fit_residual("gp", steps)
    points = np.hstack([other.state, other.command])
    np.testing.assert_allclose(found.held_out["gp"].mean, residual.mean(points), rtol=1e-12)
    assert found.folds.count == 1


def test_progress_is_reported_fit_by_fit() -> None:
    calls = []
    steps = steps_with(lambda state, command: state, 20, 0)
    validate(("none", "constant"), steps, contiguous_folds(20, 3), on_fit=lambda *done: calls.append(done))
    assert calls == [(done, 6) for done in range(1, 7)]
