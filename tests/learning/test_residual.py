import json
from typing import Any, get_args

import numpy as np
import pytest

from stepgap.learning.gaussian_process_fit import fit_gaussian_process, fit_like_fitrgp
from stepgap.learning.residual import (
    GaussianProcessKind,
    GaussianProcessResidual,
    NoResidual,
    Residual,
    ResidualKind,
    fit_residual,
    join_points,
    residual_from_dict,
)
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.535, 0.625)),
    command=(Quantity("fx", "N", -15.0, 15.0), Quantity("fy", "N", -20.0, 20.0)),
)
SCALE = np.array([0.2, 0.045, 15.0, 20.0])
KINDS: tuple[ResidualKind, ...] = ("none", "gp", "fitrgp")


def steps(size: int = 40, seed: int = 0) -> tuple[Array, Array, Array]:
    """States, applied commands and errors of a nominal map."""
    generator = np.random.default_rng(seed)
    state = np.array([0.2, 0.58]) + SCALE[:2] * generator.uniform(-1, 1, (size, 2))
    command = SCALE[2:] * generator.uniform(-1, 1, (size, 2))
    drag, sag = 0.05 - 0.1 * state[:, 0] + 0.001 * command[:, 0], 0.01 * np.sin(command[:, 1] / 10)
    return state, command, np.stack([drag, sag], axis=1) + [0.004, 0.001] * generator.standard_normal((size, 2))


@pytest.fixture(scope="module", params=KINDS)
def residual(request: pytest.FixtureRequest) -> Residual:
    return fit_residual(request.param, SPACE, *steps())


class TestEveryResidual:
    def test_shapes_follow_the_points(self, residual: Residual) -> None:
        assert residual.sizes == (2, 2)
        for leading in ((), (3,), (2, 0), (2, 3)):
            point = np.broadcast_to([0.2, 0.58, 0.0, 0.0], (*leading, 4))
            assert residual.mean(point).shape == (*leading, 2)
            assert residual.std(point).shape == (*leading, 2)
            assert residual.mean_gradient(point).shape == (*leading, 2, 4)

    def test_gradient_is_the_derivative_of_the_mean(self, residual: Residual) -> None:
        point = join_points(*steps(5, seed=1)[:2])[:, None, :]
        step = np.diag(1e-5 * SCALE)
        difference = (residual.mean(point + step) - residual.mean(point - step)) / (2e-5 * SCALE[:, None])
        expected = np.swapaxes(difference, -1, -2) * SCALE
        np.testing.assert_allclose(residual.mean_gradient(point[:, 0]) * SCALE, expected, rtol=1e-6, atol=1e-9)

    def test_noise_adds_to_the_standard_deviation(self, residual: Residual) -> None:
        point = join_points(*steps(5, seed=1)[:2])
        noisy, latent = residual.std(point, include_noise=True), residual.std(point)
        assert np.all(latent >= 0)
        assert np.all(noisy >= latent)
        assert np.ptp(noisy**2 - latent**2, axis=0) == pytest.approx(np.zeros(2), abs=1e-12)

    def test_comes_back_bit_for_bit(self, residual: Residual) -> None:
        saved = json.loads(json.dumps(residual.to_dict(), allow_nan=False))
        loaded = residual_from_dict(saved)
        point = join_points(*steps(20, seed=1)[:2])
        assert type(loaded) is type(residual)
        assert loaded.to_dict() == residual.to_dict()
        np.testing.assert_array_equal(loaded.mean(point), residual.mean(point))
        np.testing.assert_array_equal(loaded.std(point), residual.std(point))
        np.testing.assert_array_equal(loaded.mean_gradient(point), residual.mean_gradient(point))


def test_no_residual_is_zero() -> None:
    residual = fit_residual("none", SPACE, *steps())
    point = join_points(*steps()[:2])
    assert residual == NoResidual(2, 2)
    for array in (residual.mean(point), residual.std(point, include_noise=True), residual.mean_gradient(point)):
        np.testing.assert_array_equal(array, 0)


def test_no_residual_needs_no_step() -> None:
    assert fit_residual("none", SPACE, *steps(0)) == NoResidual(2, 2)


def test_gp_is_one_process_per_coordinate_on_the_scales_of_the_space() -> None:
    state, command, error = steps()
    residual = fit_residual("gp", SPACE, state, command, error)
    point = join_points(*steps(5, seed=1)[:2])
    for i in range(2):
        process = fit_gaussian_process(np.hstack([state, command]), error[:, i], SCALE)
        np.testing.assert_allclose(residual.mean(point)[:, i], process.mean(point), rtol=1e-6)
        np.testing.assert_allclose(residual.std(point)[:, i], process.kriging_std(point), rtol=1e-6)


def test_fitrgp_knows_no_scales_and_reports_plug_in_deviations() -> None:
    state, command, error = steps()
    residual = fit_residual("fitrgp", SPACE, state, command, error)
    point = join_points(*steps(5, seed=1)[:2])
    for i in range(2):
        process = fit_like_fitrgp(np.hstack([state, command]), error[:, i])
        np.testing.assert_allclose(residual.mean(point)[:, i], process.mean(point), rtol=1e-6)
        np.testing.assert_allclose(residual.std(point)[:, i], process.std(point), rtol=1e-6)


def test_gp_predicts_steps_it_has_not_seen() -> None:
    residual = fit_residual("gp", SPACE, *steps(80))
    state, command, error = steps(200, seed=2)
    point = join_points(state, command)
    rest = error - residual.mean(point)
    assert np.all(np.sqrt(np.mean(rest**2, axis=0)) < 1.25 * np.array([0.004, 0.001]))
    covered = np.mean(np.abs(rest) < 1.96 * residual.std(point, include_noise=True), axis=0)
    assert np.all((covered > 0.88) & (covered < 0.995))


def test_join_broadcasts_leading_axes() -> None:
    joined = join_points([[1.0, 2.0], [3.0, 4.0]], [5.0, 6.0, 7.0])
    np.testing.assert_array_equal(joined, [[1, 2, 5, 6, 7], [3, 4, 5, 6, 7]])


class TestRefused:
    @pytest.mark.parametrize("kind", KINDS)
    @pytest.mark.parametrize("argument", [0, 1, 2])
    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_a_row_that_is_not_finite(self, kind: ResidualKind, argument: int, bad: float) -> None:
        data = steps()
        data[argument][3, 1] = bad
        with pytest.raises(
            ValueError, match=f"^{('state', 'applied_command', 'error')[argument]} must be finite, but row 3"
        ):
            fit_residual(kind, SPACE, *data)

    @pytest.mark.parametrize("argument", [0, 1, 2])
    def test_a_wrong_number_of_columns_or_rows(self, argument: int) -> None:
        data = steps()
        named = ("state", "applied_command", "error")[argument]

        def fit_with(wrong: Array) -> None:
            state, command, error = (wrong if i == argument else array for i, array in enumerate(data))
            fit_residual("gp", SPACE, state, command, error)

        for wrong in (data[argument][:, :1], data[argument][0]):
            with pytest.raises(ValueError, match=f"^{named} must have the columns"):
                fit_with(wrong)
        with pytest.raises(ValueError, match="39"):
            fit_with(data[argument][1:])

    def test_an_unknown_kind_is_told_the_known_ones(self) -> None:
        kind: Any = "neural"
        with pytest.raises(ValueError, match="none, gp, fitrgp"):
            fit_residual(kind, SPACE, *steps())

    @pytest.mark.parametrize("kind", get_args(GaussianProcessKind))
    def test_a_process_without_steps(self, kind: GaussianProcessKind) -> None:
        with pytest.raises(ValueError, match="at least one step"):
            fit_residual(kind, SPACE, *steps(0))

    @pytest.mark.parametrize(
        ("change", "named"),
        [
            ({"kind": "neural"}, "^kind must be one of none, gp, fitrgp"),
            ({"kind": ["gp"]}, "^kind must be one of"),
            ({"kind": "none"}, "^state_size must be"),
            ({"kind": "none", "state_size": 2, "command_size": 0}, "^command_size must be"),
            ({"processes": []}, "^processes must be"),
            ({"processes": {}}, "^processes must be"),
            ({"processes": [None, None]}, r"^processes\[0\] must be"),
        ],
    )
    def test_a_wrong_entry_is_named(self, change: dict[str, Any], named: str) -> None:
        saved = fit_residual("gp", SPACE, *steps(5)).to_dict()
        with pytest.raises(ValueError, match=named):
            residual_from_dict({**saved, **change})

    def test_a_wrong_entry_of_a_process_is_named(self) -> None:
        saved = fit_residual("gp", SPACE, *steps(5)).to_dict()
        saved["processes"][1]["values"] = [0.0]
        with pytest.raises(ValueError, match=r"^processes\[1\]\.values must be"):
            residual_from_dict(saved)

    def test_processes_that_do_not_belong_together(self) -> None:
        state, command, error = steps(5)
        four = fit_gaussian_process(np.hstack([state, command]), error[:, 0], SCALE)
        two = fit_gaussian_process(state, error[:, 1], SCALE[:2])
        for processes in ((four, two), (two, two), ()):
            with pytest.raises(ValueError, match="inputs"):
                GaussianProcessResidual("gp", processes)
