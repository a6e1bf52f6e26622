"""The methods to compare with: each is what its name says, by an independent computation."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from stepgap.control.step_controller import StepController
from stepgap.experiment.settings import INTEGRAL_GAIN, METHODS, RLS_FORGETTING
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.polynomial import PRIOR_STD
from stepgap.learning.residual import join_points
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.step import Array, StepMap, StepRecord, StepStatus
from tests.control.maps import LossyHopper

NOMINAL, TRUTH = LossyHopper(), LossyHopper(mass=1.75, keep=0.6, drift=0.08)
TARGET = np.array([0.2, 0.58])
SPACE = NOMINAL.space


def random_steps(truth: StepMap, count: int, noise: float) -> Steps:
    """Steps from random states by random commands, whose errors all inputs explain."""
    rng, steps = np.random.default_rng(5), list[LoggedStep]()
    for number in range(1, count + 1):
        state = SPACE.state_centre + SPACE.state_scale * rng.uniform(-1, 1, 2)
        command = SPACE.command_at(rng.uniform(-1, 1, 2))
        after = truth(state, command) + noise * SPACE.state_scale * rng.standard_normal(2)
        record = StepRecord(state, command, command, after, StepStatus.OK, {"yaw": np.nan})
        steps.append(LoggedStep(0, number, state, state, np.zeros(2), record))
    return Steps(SPACE, steps)


def inputs(state: Array, command: Array) -> Array:
    """1, state and command, the latter two in half ranges; shape (…, 5)."""
    return np.concatenate([np.ones((*state.shape[:-1], 1)), SPACE.scaled_state(state), SPACE.point_of(command)], -1)


def learned(nominal: StepMap, log: Steps, method: str) -> Learner:
    """The learner of a method after it learned from all steps one by one."""
    learner = Learner.start(nominal, Steps(SPACE), METHODS[method].learning, 0)
    for logged in log:
        learner = learner.after(logged)
    return learner


def test_integral_is_the_integrator_of_each_coordinate() -> None:
    log = random_steps(TRUTH, 60, 0.01)
    errors, integral = observe(log, NOMINAL).error, np.zeros(2)
    for error in errors:
        integral = integral + INTEGRAL_GAIN * (error - integral)
    found = learned(NOMINAL, log, "integral").residual.mean([*TARGET, 0, 0])
    assert np.abs(integral - errors.mean(axis=0)).max() > 0.003, "it is not the mean"
    np.testing.assert_allclose(found, integral, rtol=1 / PRIOR_STD**2)


def test_rls_is_recursive_least_squares_with_forgetting_from_the_linearised_map() -> None:
    nominal, log = linearised(NOMINAL, TARGET), random_steps(TRUTH, 300, 0.01)
    weights = np.column_stack([nominal(SPACE.state_centre, SPACE.command_centre), _slopes(nominal)]).T
    before, spread = weights.copy(), PRIOR_STD**2 * np.eye(5)
    for logged in log:
        basis = inputs(logged.record.state, logged.record.requested)
        gain = spread @ basis / (RLS_FORGETTING + basis @ spread @ basis)
        weights = weights + np.outer(gain, logged.record.next_state - basis @ weights)
        spread = (spread - np.outer(gain, basis @ spread)) / RLS_FORGETTING
    step_map = learned(nominal, log, "rls").step_map()
    found = np.column_stack([step_map(SPACE.state_centre, SPACE.command_centre), _slopes(step_map)]).T
    changed = np.abs(weights - before) > 0.02 * SPACE.state_scale
    assert changed.any(axis=0).all()
    np.testing.assert_allclose(found, weights, atol=5e-4 * SPACE.state_scale.min())


def _slopes(step_map: StepMap) -> Array:
    """Derivatives of an affine map by state and command in half ranges; shape (n, n + m)."""
    return step_map.jacobian(TARGET, SPACE.command_centre) * np.concatenate([SPACE.state_scale, SPACE.command_scale])


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_affine_is_least_squares_on_a_linear_plant_inverted_within_the_bounds(noise: float) -> None:
    nominal, truth = linearised(NOMINAL, TARGET), linearised(TRUTH, TARGET)
    log = random_steps(truth, 200, noise)
    learner = Learner.start(nominal, log, METHODS["affine"].learning, 1)
    weights = np.linalg.lstsq(inputs(log.state, log.requested), log.next_state, rcond=None)[0]
    points = random_steps(truth, 50, 0.0)
    expected = inputs(points.state, points.requested) @ weights
    step_map = learner.step_map()
    found = step_map.evaluate(points.state, points.requested).next_state
    np.testing.assert_allclose(found, expected, atol=1e-4 * SPACE.state_scale.min())
    unit, cut = SPACE.error_scale, 0
    for state, target in zip(points.state, points.next_state[::-1], strict=True):
        missing = (target - inputs(state, SPACE.command_centre) @ weights) / unit
        best = lsq_linear(weights[3:].T / unit[:, None], missing, (-1, 1))
        cut += bool(best.active_mask.any())
        plan = StepController(step_map)(state, target)
        np.testing.assert_allclose(SPACE.point_of(plan.command), best.x, atol=2e-3)
    assert 5 < cut < 45, "some commands are cut by their bounds, others are not"


def test_the_linear_methods_know_only_the_linear_part_of_the_nominal_map() -> None:
    for method in ("rls", "affine"):
        assert METHODS[method].linear
    log = random_steps(TRUTH, 40, 0.0)
    step_map = Learner.start(linearised(NOMINAL, TARGET), log, METHODS["affine"].learning, 1).step_map()
    assert isinstance(step_map.nominal, AffineMap)
    point = join_points(log.state, log.requested)
    assert np.ptp(step_map.jacobian(point[:, :2], point[:, 2:]), axis=0).max() < 1e-9
