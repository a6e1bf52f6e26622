"""What a place adds is told apart from what state and command do, and nothing is taken where nothing was added."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stepgap.learning.observations import Observations
from stepgap.learning.place_effects import PRIOR_COUNT, PRIOR_STD, RELUCTANCE, STRENGTHS, without_place_effects
from stepgap.learning.polynomial import monomials
from stepgap.learning.step_table import Labels
from stepgap.step import Array
from tests.learning.test_corrected_map import SPACE

NOISE = np.array([0.008, 0.0015])
SIZES = (120, 90, 150)


def smooth(state: Array, command: Array) -> Array:
    """An error that bends more than a quadratic."""
    speed, height = ((state - SPACE.state_centre) / SPACE.state_scale).T
    force = SPACE.point_of(command)[:, 0]
    return np.column_stack([0.05 * np.sin(speed + force), 0.02 * np.cos(height) + 0.005 * force])


def effect(place: Array, deployment: Array, strength: Array) -> Array:
    """Of a boom that leans, its zero of yaw elsewhere in each deployment."""
    return strength * np.sin(place + 2.1 * deployment)[:, None]


class Recorded(NamedTuple):
    observations: Observations
    place: Array
    deployment: Labels
    added: Array


def recorded(strength: Array, seed: int = 0) -> Recorded:
    """Three deployments on a course of slow stairs, and what the place added to each step."""
    rng, parts = np.random.default_rng(seed), []
    for number, size in enumerate(SIZES):
        stair = np.arange(size) // 15
        speed = 0.2 + 0.15 * np.sin(1.3 * stair) + rng.normal(0, 0.01, size)
        state = np.column_stack([speed, rng.normal(0.58, 0.015, size)])
        command = rng.uniform(-10, 10, (size, len(SPACE.command)))
        place = np.cumsum(np.abs(speed)) * 0.7 + rng.uniform(0, 50)
        parts.append((state, command, place, np.full(size, number)))
    state, command, place, deployment = (np.concatenate(column) for column in zip(*parts, strict=True))
    added = effect(place, deployment, strength)
    error = smooth(state, command) + added + NOISE * rng.standard_normal(added.shape)
    return Recorded(Observations(SPACE, state, command, error, None, place, deployment), place, deployment, added)


def test_what_the_place_added_is_taken_out() -> None:
    for seed in range(5):
        observations, _, _, added = recorded(np.array([0.015, 0.0]), seed)
        taken = observations.error - without_place_effects(observations, 3).error
        assert np.std(taken[:, 0] - added[:, 0]) < 0.25 * np.std(added[:, 0])
        assert np.std(taken[:, 1]) < 0.2 * NOISE[1]


def test_nothing_is_taken_where_nothing_was_added() -> None:
    taken = []
    for seed in range(20):
        observations = recorded(np.zeros(2), seed).observations
        taken.append(observations.error - without_place_effects(observations, 3).error)
    assert (np.sqrt(np.mean(np.square(taken), axis=(0, 1))) < 0.05 * NOISE).all()


def test_a_constant_of_each_deployment_is_no_place_effect() -> None:
    for seed in range(5):
        observations, place, deployment, _ = recorded(np.zeros(2), seed)
        half_round = replace(observations, place=np.pi * (place - place.min()) / np.ptp(place))
        shifts = np.random.default_rng(seed).normal(0, NOISE, (3, 2))
        shifted = replace(half_round, error=half_round.error + shifts[deployment])
        taken = shifted.error - without_place_effects(shifted, 3).error
        assert (np.sqrt(np.mean(taken**2, axis=0)) < 0.3 * NOISE).all()


def test_it_is_the_regression_of_all_steps_at_once() -> None:
    """Oracle: weights and effects from one dense system, and the evidence from the covariance of all errors."""
    observations, place, deployment, _ = recorded(np.array([0.015, 0.003]))
    state = (observations.state - SPACE.state_centre) / SPACE.state_scale
    basis = monomials(np.hstack([state, SPACE.point_of(observations.applied_command)]), 2)
    wave = [np.sin(place), np.cos(place)]
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
            candidates.append((evidence - (RELUCTANCE if strength else 0.0), strength**2 * waves @ (waves.T @ weights)))
        expected = max(candidates, key=lambda candidate: candidate[0])[1]
        taken = error - without_place_effects(observations, 3).error[:, column]
        np.testing.assert_allclose(taken, expected, atol=1e-9)


def test_the_zero_of_the_place_does_not_matter() -> None:
    observations, place, deployment, _ = recorded(np.array([0.015, 0.003]))
    turned = replace(observations, place=place + 1.234 + 2 * np.pi * deployment)
    there, here = without_place_effects(turned, 3), without_place_effects(observations, 3)
    np.testing.assert_allclose(there.error, here.error, atol=1e-12)


def test_a_deployment_that_goes_on_and_steps_without_a_place_stay_as_they_are() -> None:
    observations, place, deployment, _ = recorded(np.array([0.015, 0.003]))
    known = replace(observations, place=np.where(np.arange(len(observations)) % 7, place, np.nan))
    changed = (without_place_effects(known, 2).error != observations.error).any(axis=1)
    np.testing.assert_array_equal(changed, (deployment < 2) & (np.arange(len(observations)) % 7 > 0))


def test_without_places_there_is_nothing_to_do() -> None:
    observations = recorded(np.array([0.015, 0.003])).observations
    nowhere = replace(observations, place=np.full(len(observations), np.nan))
    for untold in (nowhere, replace(observations, place=None), replace(observations, deployment=None)):
        assert without_place_effects(untold, 3) is untold
    assert without_place_effects(observations, 0) is observations


def test_one_step_or_the_same_step_again_is_no_failure() -> None:
    observations, place, deployment, _ = recorded(np.array([0.015, 0.003]))
    for rows in ([0], [0] * 30):
        few = Observations(
            SPACE,
            observations.state[rows],
            observations.applied_command[rows],
            observations.error[rows],
            place=place[rows],
            deployment=deployment[rows],
        )
        assert np.isfinite(without_place_effects(few, 1).error).all()
