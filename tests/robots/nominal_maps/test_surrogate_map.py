"""Surrogates against the maps that they were fitted to, at random points."""

import json

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from stepgap.base.errors import StepGapError
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.nominal_maps.motions import WIDENED, Motions
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.nominal_maps.surrogate_map import (
    fit_surrogate,
    products,
    products_gradient,
    surrogate_from_dict,
)
from stepgap.step import Array, StepStatus, difference_jacobian
from tests.control.maps import LossyHopper, NeverWorks, StumblingHopper

RNG = np.random.default_rng(11)
NOMINAL = ApexMap()


@pytest.fixture(scope="module")
def surrogate():
    return fit_surrogate(NOMINAL, np.random.default_rng(0))


def test_the_products_are_a_basis_of_all_polynomials_and_have_the_gradient_of_differences() -> None:
    points = RNG.uniform(-1, 1, (400, 3))
    basis = products(points, 3)
    assert basis.shape == (400, 20)
    wanted = Polynomial([1, -2, 0.5])(points[:, 0]) * points[:, 2] + points[:, 1] ** 3
    np.testing.assert_allclose(basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0], wanted, atol=1e-12)
    ahead = [products(points + 1e-6 * unit, 3) for unit in np.eye(3)]
    behind = [products(points - 1e-6 * unit, 3) for unit in np.eye(3)]
    differences = np.stack([(a - b) / 2e-6 for a, b in zip(ahead, behind, strict=True)], axis=-1)
    np.testing.assert_allclose(products_gradient(points, 3), differences, atol=1e-7)


def test_it_predicts_unseen_steps_as_well_as_it_says(surrogate) -> None:
    motions = Motions(NOMINAL, np.random.default_rng(1))
    unseen = motions.continued(motions.begun(128), 512)
    states, commands = np.split(motions.centre + motions.scale * unseen.points, [2], axis=1)
    found = surrogate.evaluate(states, commands)
    good = unseen.status == StepStatus.OK
    assert np.mean(good == (found.status == StepStatus.OK)) > 0.97
    stays = good & (np.abs(NOMINAL.space.scaled_state(unseen.next_state)) < WIDENED).all(axis=1)
    rms = np.sqrt(np.nanmean((unseen.next_state - found.next_state)[stays] ** 2, axis=0))
    assert (rms < 1.5 * surrogate.error).all()
    assert (rms < [0.004, 0.001]).all()


class Leaping(LossyHopper):
    """The same, but a large force throws it far out of its ranges."""

    def next_state(self, state: Array, command: Array) -> Array:
        thrown = 3 * np.maximum(0, command[..., 0] / 15 - 0.5) ** 2
        return super().next_state(state, command) + thrown[..., None] * np.array([30.0, 0.0])


def test_steps_that_leave_the_ranges_do_not_spoil_the_others() -> None:
    exact = Leaping()
    found = fit_surrogate(exact, np.random.default_rng(0))
    states, commands = RNG.uniform([0, 0.52], [0.4, 0.64], (300, 2)), RNG.uniform([-15, -20], [15, 20], (300, 2))
    wanted = exact(states, commands)
    stays = np.abs(exact.space.scaled_state(wanted)[:, 0]) < 1
    rms = np.sqrt(np.mean((found(states, commands) - wanted)[stays] ** 2, axis=0)) / exact.space.state_scale
    largest = np.abs(exact.space.scaled_state(wanted)).max()
    assert largest > 50
    assert (rms < 0.5).all()


def test_its_jacobian_is_that_of_differences_and_near_the_exact_one(surrogate) -> None:
    states, commands = RNG.uniform([0.05, 0.54], [0.35, 0.62], (50, 2)), RNG.uniform(-8, 8, (50, 2))
    np.testing.assert_allclose(
        surrogate.jacobian(states, commands), difference_jacobian(surrogate, states, commands), rtol=1e-5, atol=1e-7
    )
    exact = NOMINAL.jacobian(states, commands)
    size = np.abs(exact).max(axis=(0, 1), keepdims=True)
    assert np.median(np.abs(surrogate.jacobian(states, commands) - exact) / size) < 0.01


def test_outside_the_sampled_range_it_continues_linearly(surrogate) -> None:
    command = np.zeros(2)
    edge, out = np.array([0.45, 0.58]), np.array([0.7, 0.58])
    by_state = surrogate.jacobian(edge, command)[:, 0]
    np.testing.assert_allclose(surrogate(out, command), surrogate(edge, command) + by_state * 0.25, rtol=1e-6)


def test_a_point_without_numbers_is_invalid(surrogate) -> None:
    assert surrogate.evaluate([np.nan, 0.58], [0, 0]).status == StepStatus.INVALID
    assert np.isnan(surrogate.jacobian([0.2, 0.58], [np.inf, 0])).all()


def test_points_among_failures_fail_with_their_reason() -> None:
    exact = StumblingHopper(fall_line=9.0, least_force=-8.0)
    found = fit_surrogate(exact, np.random.default_rng(0))
    states, commands = RNG.uniform([0, 0.52], [0.4, 0.64], (300, 2)), RNG.uniform([-15, -20], [15, 20], (300, 2))
    wanted, outcome = exact.evaluate(states, commands), found.evaluate(states, commands)
    assert np.mean(wanted.status == outcome.status) > 0.91
    np.testing.assert_array_equal(np.isnan(outcome.next_state).all(axis=1), outcome.status != StepStatus.OK)


def test_a_map_without_steps_is_refused() -> None:
    with pytest.raises(StepGapError, match="only 0 of 128 simulated steps"):
        fit_surrogate(NeverWorks(), np.random.default_rng(0))


def test_it_is_stored_in_json_and_the_seed_determines_it() -> None:
    first, again = (fit_surrogate(LossyHopper(), np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first.weights, again.weights)
    stored = surrogate_from_dict(first.space, json.loads(json.dumps(first.to_dict(), allow_nan=False)))
    np.testing.assert_array_equal(stored([0.2, 0.58], [1, 2]), first([0.2, 0.58], [1, 2]))


def test_noise_is_averaged_and_reported_as_error() -> None:
    """A map with noise of a known size, as a simulator that is not smooth."""
    exact, noise = LossyHopper(), np.random.default_rng(5)

    def step(state: Array, command: Array) -> Array:
        return exact(state, command) + noise.normal(0, [0.01, 0.002])

    found = fit_surrogate(SimulatorMap(exact.space, step), np.random.default_rng(1))
    np.testing.assert_allclose(found.error, [0.01, 0.002], rtol=0.2)
    states, commands = RNG.uniform([0, 0.52], [0.4, 0.64], (200, 2)), RNG.uniform([-15, -20], [15, 20], (200, 2))
    rms = np.sqrt(np.mean((found(states, commands) - exact(states, commands)) ** 2, axis=0))
    assert (rms < [0.005, 0.001]).all()
