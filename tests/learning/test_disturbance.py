"""The disturbance is estimated within a deployment and removed from earlier ones; without one nothing changes."""

from dataclasses import replace
from math import nan
from typing import NamedTuple

import numpy as np

from stepgap.learning.disturbance import (
    CHANGE_STD,
    LEAST_EVIDENCE,
    RATES,
    SLOPE_STD,
    STRENGTHS,
    DisturbanceFilter,
    without_periodic_part,
)
from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import PRIOR_COUNT, PRIOR_STD, monomials
from stepgap.learning.steps import Labels
from stepgap.step import Array
from tests.learning.test_corrected_map import SPACE

UNKNOWN = np.full(1000, nan)
NOISE = np.array([0.008, 0.0015])
SIZES = (120, 90, 150)


# Within a deployment


def offsets_over(remaining: np.ndarray, yaws: np.ndarray = UNKNOWN) -> np.ndarray:
    """The offset before each step, given the errors (steps, n) of the steps and their yaws."""
    filters, offsets = DisturbanceFilter.initial(remaining.shape[1]), []
    for error, yaw in zip(remaining, yaws, strict=False):
        offsets.append(filters.predict(yaw).constant)
        filters = filters.updated(error, yaw)
    return np.array(offsets)


def std_of(filters: DisturbanceFilter, yaw: float) -> Array:
    """Standard deviation of the disturbance of a step from a yaw; shape (n,)."""
    return filters.predict(yaw).std(np.empty(0))


def test_nothing_is_added_before_the_first_step() -> None:
    for yaw in (nan, 0.0, 1e6):
        np.testing.assert_array_equal(DisturbanceFilter.initial(3).predict(yaw).constant, np.zeros(3))


def test_each_filter_is_the_recursive_regression() -> None:
    """Oracle: after each step c is the least-squares estimate from the new error and the prior estimate."""
    rng = np.random.default_rng(3)
    remaining, yaws, filters = rng.normal(0, 1, (40, 2)), rng.uniform(0, 100, 40), DisturbanceFilter.initial(2)
    yaws[[0, 7, 8]] = nan
    for error, yaw in zip(remaining, yaws, strict=True):
        filters = filters.updated(error, yaw)
    for rate, (constant, with_yaw) in zip(RATES, zip(*np.split(filters.coefficients, 2), strict=True), strict=True):
        for size, found in ((1, constant), (3, with_yaw)):
            known, covariance = np.zeros((size, 2)), np.eye(size)
            for error, yaw in zip(remaining, yaws, strict=True):
                row = np.nan_to_num([1.0, np.sin(yaw), np.cos(yaw)])[:size]
                precision = np.linalg.inv((1 - rate**2) * covariance + rate**2 * np.eye(size))
                root = np.linalg.cholesky(precision).T
                rows, values = np.vstack([root, row]), np.vstack([root @ known, error])
                known = np.linalg.lstsq(rows, values, rcond=None)[0]
                covariance = np.linalg.inv(rows.T @ rows)
            np.testing.assert_allclose(found[:size], known, atol=1e-10)
            assert (found[size:] == 0).all()


def test_a_filter_without_forgetting_is_the_regression_of_all_steps() -> None:
    rng = np.random.default_rng(6)
    remaining, yaws, filters = rng.normal(0, 1, (40, 1)), rng.uniform(0, 100, 40), DisturbanceFilter.initial(1)
    for error, yaw in zip(remaining, yaws, strict=True):
        filters = filters.updated(error, yaw)
    row = np.column_stack([np.ones(40), np.sin(yaws), np.cos(yaws)])
    slowest = filters.coefficients[len(RATES)]
    np.testing.assert_allclose(slowest, np.linalg.solve(row.T @ row + np.eye(3), row.T @ remaining), atol=0.02)


def test_the_variance_of_an_unobserved_coefficient_does_not_exceed_the_initial_one() -> None:
    """A robot that hops in place while there is a drift: a quarter turn further the variance is the initial one."""
    filters = DisturbanceFilter.initial(1)
    for step in range(3000):
        filters = filters.updated(np.array([3 * np.sin(step / 20)]), 0.0)
    assert (np.linalg.eigvalsh(filters.covariance) < 1 + 1e-9).all()
    assert std_of(filters, np.pi / 2) < np.sqrt(2)


def test_the_standard_deviation_of_an_offset_is_that_of_its_error() -> None:
    """The offset's error for a tilted boom, in standard deviations of the noise; zero where no filter is used."""
    rng = np.random.default_rng(5)
    yaws, innovations, stds = np.cumsum(rng.uniform(0.05, 0.35, 227)), [], []
    for _ in range(20):
        filters, phase = DisturbanceFilter.initial(1), rng.uniform(0, 2 * np.pi)
        assert std_of(filters, 0.0) == 0
        for yaw in yaws:
            added = 1.5 * np.sin(yaw + phase)
            innovations.append(added - filters.predict(yaw).constant[0])
            stds.append(std_of(filters, yaw)[0])
            filters = filters.updated(np.array([added + rng.normal()]), yaw)
    late = np.arange(len(innovations)) % 227 > 100
    assert 0.7 < np.std(np.array(innovations)[late]) / np.mean(np.array(stds)[late]) < 1.3


def test_noise_alone_is_not_tracked() -> None:
    """On average over many records the offset hardly increases the errors."""
    rng = np.random.default_rng(0)
    remaining, round_and_round = rng.normal(0, 1, (227, 200)), np.arange(227) * 0.12
    for yaws in (UNKNOWN, round_and_round):
        innovations = remaining - offsets_over(remaining, yaws)
        assert np.mean(innovations**2) < 1.02 * np.mean(remaining**2)


def test_a_slow_wave_is_tracked_coordinate_by_coordinate() -> None:
    rng, steps = np.random.default_rng(1), np.arange(227)
    wave = 2 * np.sin(2 * np.pi * steps / 55)[:, None]
    remaining = np.hstack([wave, 0 * wave]) + rng.normal(0, 1, (227, 2))
    innovations = (remaining - offsets_over(remaining))[40:]
    assert np.std(innovations[:, 0]) < 1.25 < 1.6 < np.std(remaining[40:, 0])
    assert np.std(innovations[:, 1]) < 1.05 * np.std(remaining[40:, 1])


def test_a_yaw_dependent_disturbance_is_known_after_one_turn() -> None:
    """For a tilted boom hardly any error remains at any speed, if the yaw is known."""
    rng = np.random.default_rng(4)
    yaws = np.cumsum(rng.uniform(0.05, 0.35, 227))
    noise = rng.normal(0, 1, (227, 50))
    remaining = 0.5 + 1.2 * np.sin(yaws - 0.7)[:, None] + noise
    after = yaws > 2 * np.pi
    assert np.std((remaining - offsets_over(remaining, yaws))[after]) < 1.05
    assert np.std((remaining - offsets_over(remaining))[after]) > 1.12


def test_a_constant_error_of_any_size_is_followed_at_once() -> None:
    for size in (14.0, 200.0):
        remaining = np.full((4, 1), size) + np.random.default_rng(7).normal(0, 1, (4, 1))
        assert offsets_over(remaining)[2] > 0.6 * size
        restarted = DisturbanceFilter.initial(1).restarted().updated(remaining[0], nan)
        assert abs(restarted.predict(nan).constant[0] - remaining[0, 0]) < 0.01 * size


def test_a_change_of_the_robot_is_the_bayesian_regression_on_state_and_command() -> None:
    """Oracle: a filter that forgets nothing is the posterior of a linear model with this prior."""
    rng, weights = np.random.default_rng(8), np.array([4.0, -2.0, 0.0, 3.0])
    inputs, filters = rng.uniform(-1, 1, (30, 3)), DisturbanceFilter.initial(1, 3).restarted()
    errors = weights[0] + inputs @ weights[1:] + rng.normal(0, 1, 30)
    assert filters.changed
    for row, error in zip(inputs, errors, strict=True):
        filters = replace(filters, prior=filters.covariance).updated(np.array([error]), nan, 1.0, row)
    rows = np.column_stack([np.ones(30), inputs])
    covariance = np.linalg.inv(rows.T @ rows + np.diag([1 / (1 + CHANGE_STD**2), *[1 / SLOPE_STD**2] * 3]))
    slowest = replace(filters, prior=filters.covariance, scores=1.0 - np.eye(len(filters.scores))[1][:, None])
    disturbance, points = slowest.predict(nan, 2.0), rng.uniform(-1, 1, (5, 3))
    there = np.column_stack([np.ones(5), points])
    np.testing.assert_allclose(disturbance.mean(points)[:, 0], there @ covariance @ rows.T @ errors, rtol=1e-9)
    variance = 4.0 * np.einsum("ka,ab,kb->k", there, covariance, there)
    np.testing.assert_allclose(disturbance.std(points)[:, 0] ** 2, variance, rtol=1e-9)
    differences = [(disturbance.std(points + h) - disturbance.std(points - h)) / 2e-6 for h in 1e-6 * np.eye(3)]
    np.testing.assert_allclose(disturbance.std_gradient(points), np.stack(differences, axis=-1), atol=1e-6)


def test_after_the_drift_the_offset_returns_to_zero() -> None:
    rng = np.random.default_rng(2)
    remaining = np.where(np.arange(400) < 100, 3.0, 0.0)[:, None] + rng.normal(0, 1, (400, 20))
    offsets = offsets_over(remaining)
    assert np.median(offsets[80:100]) > 2.5
    assert np.mean((remaining - offsets)[200:] ** 2) < 1.1 * np.mean(remaining[200:] ** 2)


# Of earlier deployments


def smooth(state: Array, command: Array) -> Array:
    """An error that is more nonlinear than a quadratic."""
    speed, height = ((state - SPACE.state_centre) / SPACE.state_scale).T
    force = SPACE.point_of(command)[:, 0]
    return np.column_stack([0.05 * np.sin(speed + force), 0.02 * np.cos(height) + 0.005 * force])


def effect(yaw: Array, deployment: Array, strength: Array) -> Array:
    """The disturbance of a tilted boom, with another zero of yaw in each deployment."""
    return strength * np.sin(yaw + 2.1 * deployment)[:, None]


class Recorded(NamedTuple):
    observations: Observations
    yaw: Array
    deployment: Labels
    added: Array


def recorded(strength: Array, seed: int = 0) -> Recorded:
    """Three deployments on a course of slow stairs, and the disturbance of each step."""
    rng, parts = np.random.default_rng(seed), []
    for number, size in enumerate(SIZES):
        stair = np.arange(size) // 15
        speed = 0.2 + 0.15 * np.sin(1.3 * stair) + rng.normal(0, 0.01, size)
        state = np.column_stack([speed, rng.normal(0.58, 0.015, size)])
        command = rng.uniform(-10, 10, (size, len(SPACE.command)))
        yaw = np.cumsum(np.abs(speed)) * 0.7 + rng.uniform(0, 50)
        parts.append((state, command, yaw, np.full(size, number)))
    state, command, yaw, deployment = (np.concatenate(column) for column in zip(*parts, strict=True))
    added = effect(yaw, deployment, strength)
    error = smooth(state, command) + added + NOISE * rng.standard_normal(added.shape)
    return Recorded(Observations(SPACE, state, command, error, None, yaw, deployment), yaw, deployment, added)


def test_the_yaw_dependent_part_is_removed() -> None:
    for seed in range(5):
        observations, _, _, added = recorded(np.array([0.015, 0.0]), seed)
        removed = observations.error - without_periodic_part(observations, 3).error
        assert np.std(removed[:, 0] - added[:, 0]) < 0.25 * np.std(added[:, 0])
        assert np.std(removed[:, 1]) < 0.2 * NOISE[1]


def test_nothing_is_removed_where_nothing_was_added() -> None:
    removed = []
    for seed in range(20):
        observations = recorded(np.zeros(2), seed).observations
        removed.append(observations.error - without_periodic_part(observations, 3).error)
    assert (np.sqrt(np.mean(np.square(removed), axis=(0, 1))) < 0.05 * NOISE).all()


def test_a_constant_of_each_deployment_is_not_removed() -> None:
    for seed in range(5):
        observations, yaw, deployment, _ = recorded(np.zeros(2), seed)
        half_round = replace(observations, phase=np.pi * (yaw - yaw.min()) / np.ptp(yaw))
        shifts = np.random.default_rng(seed).normal(0, NOISE, (3, 2))
        shifted = replace(half_round, error=half_round.error + shifts[deployment])
        removed = shifted.error - without_periodic_part(shifted, 3).error
        assert (np.sqrt(np.mean(removed**2, axis=0)) < 0.3 * NOISE).all()


def test_the_removal_is_the_regression_of_all_steps_at_once() -> None:
    """Oracle: weights and effects from one dense system, and the evidence from the covariance of all errors."""
    observations, yaw, deployment, _ = recorded(np.array([0.015, 0.003]))
    state = (observations.state - SPACE.state_centre) / SPACE.state_scale
    basis = monomials(np.hstack([state, SPACE.point_of(observations.command)]), 2)
    wave = [np.sin(yaw), np.cos(yaw)]
    waves = np.column_stack([part * (deployment == number) for number in range(3) for part in wave])
    constants = np.column_stack([deployment == number for number in range(3)])
    for column, error in enumerate(observations.error.T):
        candidates = []
        for strength in STRENGTHS:
            prior = np.repeat([PRIOR_STD**2, 1.0, strength**2], [basis.shape[1], 3, waves.shape[1]])
            inputs = np.hstack([basis, constants, waves])
            covariance = np.eye(len(error)) + inputs * prior @ inputs.T
            weights = np.linalg.solve(covariance, error)
            squares = PRIOR_COUNT * (0.02 * SPACE.state_scale[column]) ** 2 + error @ weights
            determinant = np.linalg.slogdet(covariance)[1]
            evidence = -0.5 * ((PRIOR_COUNT + len(error)) * np.log(squares) + determinant)
            evidence -= LEAST_EVIDENCE if strength else 0.0
            candidates.append((evidence, strength**2 * waves @ (waves.T @ weights)))
        expected = max(candidates, key=lambda candidate: candidate[0])[1]
        removed = error - without_periodic_part(observations, 3).error[:, column]
        np.testing.assert_allclose(removed, expected, atol=1e-9)


def test_the_zero_of_the_yaw_does_not_matter() -> None:
    observations, yaw, deployment, _ = recorded(np.array([0.015, 0.003]))
    turned = replace(observations, phase=yaw + 1.234 + 2 * np.pi * deployment)
    there, here = without_periodic_part(turned, 3), without_periodic_part(observations, 3)
    np.testing.assert_allclose(there.error, here.error, atol=1e-12)


def test_the_running_deployment_and_steps_without_a_yaw_do_not_change() -> None:
    observations, yaw, deployment, _ = recorded(np.array([0.015, 0.003]))
    known = replace(observations, phase=np.where(np.arange(len(observations)) % 7, yaw, np.nan))
    changed = (without_periodic_part(known, 2).error != observations.error).any(axis=1)
    np.testing.assert_array_equal(changed, (deployment < 2) & (np.arange(len(observations)) % 7 > 0))


def test_without_yaws_nothing_is_removed() -> None:
    observations = recorded(np.array([0.015, 0.003])).observations
    nowhere = replace(observations, phase=np.full(len(observations), np.nan))
    for unknown in (nowhere, replace(observations, phase=None), replace(observations, deployment=None)):
        assert without_periodic_part(unknown, 3) is unknown
    assert without_periodic_part(observations, 0) is observations


def test_the_removal_works_for_one_step_or_equal_steps() -> None:
    observations, yaw, deployment, _ = recorded(np.array([0.015, 0.003]))
    for rows in ([0], [0] * 30):
        few = Observations(
            SPACE,
            observations.state[rows],
            observations.command[rows],
            observations.error[rows],
            phase=yaw[rows],
            deployment=deployment[rows],
        )
        assert np.isfinite(without_periodic_part(few, 1).error).all()
