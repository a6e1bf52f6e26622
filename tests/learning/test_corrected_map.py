import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import Observations
from stepgap.learning.residual import Residual, join_points, no_residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.step import (
    Array,
    Outcome,
    Quantity,
    StepFailed,
    StepMap,
    StepSpace,
    StepStatus,
    difference_jacobian,
)

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.535, 0.625)),
    command=(Quantity("fx", "N", -15.0, 15.0),),
)


class SimpleMap(StepMap):
    """Smooth; falls where the speed is above 0.3 m/s."""

    @property
    def space(self) -> StepSpace:
        return SPACE

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        point = join_points(state, command)
        speed, height, force = np.moveaxis(point, -1, 0)
        next_state = np.stack([0.8 * speed + 0.01 * force, 0.58 + 0.5 * (height - 0.58) + 0.1 * speed**2], axis=-1)
        finite = np.isfinite(point).all(axis=-1)
        status = np.where(finite, np.where(speed > 0.3, StepStatus.FELL, StepStatus.OK), StepStatus.INVALID)
        next_state = np.where((status == StepStatus.OK)[..., None], next_state, np.nan)
        return Outcome(next_state, status.astype(np.int64))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return difference_jacobian(self, state, command)


NOMINAL = SimpleMap()


def actual(state: Array, command: Array) -> Array:
    """The true map of the robot, with drag and a weaker leg that the nominal map does not model."""
    drag = -0.04 - 0.2 * state[..., 0] * np.cos(command[..., 0] / 10)
    return NOMINAL(state, command) + np.stack([drag, -0.02 + 0.1 * state[..., 0]], axis=-1)


def apexes(size: int, seed: int) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    return generator.uniform([0.0, 0.535], [0.3, 0.625], (size, 2)), generator.uniform(-15, 15, (size, 1))


@pytest.fixture(scope="module")
def residual() -> Residual:
    state, command = apexes(60, seed=0)
    error = actual(state, command) - NOMINAL(state, command)
    error += 1e-4 * np.random.default_rng(1).standard_normal(error.shape)
    return fit_residual("gp", Observations(SPACE, state, command, error))


@pytest.fixture(scope="module")
def corrected(residual: Residual) -> CorrectedMap:
    return CorrectedMap(NOMINAL, residual)


def test_predicts_what_the_robot_does(corrected: CorrectedMap) -> None:
    state, command = apexes(300, seed=2)
    gap = np.abs(NOMINAL(state, command) - actual(state, command))
    rest = np.abs(corrected(state, command) - actual(state, command))
    assert np.all(rest.mean(axis=0) < 0.03 * gap.mean(axis=0))
    assert np.all(np.mean(rest < 3 * corrected.std(state, command), axis=0) > 0.9)


def test_is_nominal_plus_residual(corrected: CorrectedMap, residual: Residual) -> None:
    state, command = apexes(6, seed=3)
    expected = NOMINAL(state, command) + residual.mean(join_points(state, command))
    np.testing.assert_array_equal(corrected(state, command), expected)
    np.testing.assert_allclose(corrected(state[0], command[0]), expected[0], rtol=1e-12)
    assert corrected.space is SPACE


def test_arguments_broadcast(corrected: CorrectedMap) -> None:
    state, command = apexes(6, seed=3)
    outcome = corrected.evaluate(state[:, None], command[None, :4])
    assert outcome.next_state.shape == (6, 4, 2)
    assert outcome.status.shape == (6, 4)
    np.testing.assert_allclose(outcome.next_state[5, 1], corrected(state[5], command[1]), rtol=1e-12)
    assert corrected.std(state[:, None], command[None, :4]).shape == (6, 4, 2)
    assert corrected.jacobian(state[:, None], command[None, :4]).shape == (6, 4, 2, 3)


def test_failures_stay_failures(corrected: CorrectedMap) -> None:
    state = np.array([[0.1, 0.58], [0.35, 0.58], [np.inf, 0.58], [np.nan, 0.58]])
    next_state, status = corrected.evaluate(state, [0.0])
    np.testing.assert_array_equal(status, [StepStatus.OK, StepStatus.FELL, StepStatus.INVALID, StepStatus.INVALID])
    np.testing.assert_array_equal(np.isnan(next_state).all(axis=-1), [False, True, True, True])
    np.testing.assert_array_equal(np.isnan(next_state).any(axis=-1), [False, True, True, True])
    assert np.isnan(corrected.jacobian(state[1], [0.0])).all()
    with pytest.raises(StepFailed) as failure:
        corrected(state[1], [0.0])
    assert failure.value.status is StepStatus.FELL


def test_jacobian_is_the_derivative(corrected: CorrectedMap) -> None:
    state, command = apexes(20, seed=4)
    state[:, 0] *= 0.9  # away from the falls
    scale = np.concatenate([SPACE.state_scale, SPACE.command_scale])
    expected = difference_jacobian(corrected, state, command) * scale
    np.testing.assert_allclose(corrected.jacobian(state, command) * scale, expected, rtol=1e-5, atol=1e-8)
    assert np.abs(expected - NOMINAL.jacobian(state, command) * scale).max() > 1e-3


def test_standard_deviation_is_the_residual_s(corrected: CorrectedMap, residual: Residual) -> None:
    state, command = apexes(6, seed=5)
    point = join_points(state, command)
    np.testing.assert_array_equal(corrected.std(state, command), residual.std(point))
    noisy = np.hypot(corrected.std(state, command), corrected.noise_std)
    np.testing.assert_allclose(noisy, residual.std(point, include_noise=True), rtol=1e-12)
    np.testing.assert_array_equal(corrected.std_gradient(state, command), residual.std_gradient(point))


def test_an_offset_is_taken_from_measured_states(residual: Residual) -> None:
    """The step begins where the state is, not where it was measured; what is measured at its end is right again."""
    offset = np.array([0.03, -0.01])
    plain, shifted = CorrectedMap(NOMINAL, residual), CorrectedMap(NOMINAL, residual, offset)
    state, command = apexes(20, seed=7)
    state[:, 0] *= 0.9  # away from the falls
    np.testing.assert_allclose(shifted(state + offset, command), plain(state, command), rtol=1e-9)
    for name in ("jacobian", "std", "std_gradient"):
        found, expected = getattr(shifted, name)(state + offset, command), getattr(plain, name)(state, command)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-12)
    scale = np.concatenate([SPACE.state_scale, SPACE.command_scale])
    expected = difference_jacobian(shifted, state, command) * scale
    np.testing.assert_allclose(shifted.jacobian(state, command) * scale, expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_array_equal(shifted.noise_std, plain.noise_std)


def test_without_a_residual_the_map_is_the_nominal_one() -> None:
    state, command = apexes(6, seed=6)
    same = CorrectedMap(NOMINAL, no_residual(2, 1))
    np.testing.assert_array_equal(same(state, command), NOMINAL(state, command))
    np.testing.assert_array_equal(same.jacobian(state, command), NOMINAL.jacobian(state, command))
    np.testing.assert_array_equal(same.std(state, command), np.zeros((6, 2)))


def test_corrections_never_stack(corrected: CorrectedMap) -> None:
    with pytest.raises(ValueError, match="stack"):
        CorrectedMap(corrected, no_residual(2, 1))


def test_sizes_must_agree() -> None:
    with pytest.raises(ValueError, match="sizes"):
        CorrectedMap(NOMINAL, no_residual(2, 2))
