import json
from math import inf
from typing import Any

import numpy as np
import pytest

from stepgap.base.settings_file import InputError
from stepgap.gauss.gaussian_process_fit import Basis, fit_gaussian_process, fit_like_fitrgp
from stepgap.learning.entry_points import residual_models
from stepgap.learning.observations import Observations
from stepgap.learning.residual import HistoryInputs, Residual, join_points, no_residual
from stepgap.learning.residual_fit import fit_residual, held_out_score, residual_from_dict
from stepgap.learning.zero import NONE, Zero
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.535, 0.625)),
    command=(Quantity("fx", "N", -15.0, 15.0), Quantity("fy", "N", -20.0, 20.0)),
)
SCALE = np.array([0.2, 0.045, 15.0, 20.0])
FITTED = tuple(model.name for model in residual_models())


def steps(size: int = 40, seed: int = 0) -> Observations:
    """Errors of a nominal map at scattered steps, and histories."""
    generator = np.random.default_rng(seed)
    state = np.array([0.2, 0.58]) + SCALE[:2] * generator.uniform(-1, 1, (size, 2))
    command = SCALE[2:] * generator.uniform(-1, 1, (size, 2))
    drag, sag = 0.05 - 0.1 * state[:, 0] + 0.001 * command[:, 0], 0.01 * np.sin(command[:, 1] / 10)
    error, history = np.stack([drag, sag], axis=1), np.arange(float(size))[:, None]
    return Observations(SPACE, state, command, error + [0.004, 0.001] * generator.standard_normal((size, 2)), history)


def part(observations: Observations, rows: slice) -> Observations:
    history = None if observations.history is None else observations.history[rows]
    state, command, error = observations.state[rows], observations.command[rows], observations.error[rows]
    return Observations(SPACE, state, command, error, history)


def points(observations: Observations) -> Array:
    return join_points(observations.state, observations.command)


QUERIES = steps(6, seed=1)
CASES = [(kind, forgetting_time) for kind in FITTED for forgetting_time in (inf, 30.0)]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(map(str, case)))
def residual(request: pytest.FixtureRequest) -> Residual:
    """A residual of every kind; one with history inputs is conditioned on the histories of the queries, one each."""
    kind, forgetting_time = request.param
    assert QUERIES.history is not None
    return fit_residual(kind, steps(), forgetting_time).conditioned_on(QUERIES.history)


class TestEveryResidual:
    def test_shapes_follow_the_points(self, residual: Residual) -> None:
        assert residual.sizes == (2, 2)
        residual = residual.conditioned_on(np.zeros(1))
        for leading in ((), (3,), (2, 0), (2, 3)):
            point = np.broadcast_to([0.2, 0.58, 0.0, 0.0], (*leading, 4))
            assert residual.mean(point).shape == (*leading, 2)
            assert residual.std(point).shape == (*leading, 2)
            assert residual.mean_gradient(point).shape == (*leading, 2, 4)
            assert residual.std_gradient(point).shape == (*leading, 2, 4)

    def test_gradients_are_derivatives(self, residual: Residual) -> None:
        point, step = points(QUERIES), 1e-5 * SCALE
        for function, gradient in ((residual.mean, residual.mean_gradient), (residual.std, residual.std_gradient)):
            for column, size in enumerate(step):
                offset = size * np.eye(4)[column]
                difference = (function(point + offset) - function(point - offset)) / (2e-5)
                found = gradient(point)[..., column] * SCALE[column]
                np.testing.assert_allclose(found, difference, rtol=1e-5, atol=1e-9)

    def test_noise_adds_to_the_standard_deviation(self, residual: Residual) -> None:
        noisy, latent = residual.std(points(QUERIES), include_noise=True), residual.std(points(QUERIES))
        assert np.all(latent >= 0)
        assert np.all(noisy > latent)
        np.testing.assert_allclose(noisy, np.hypot(latent, residual.noise_std), rtol=1e-12)

    def test_is_restored_bit_for_bit(self, residual: Residual) -> None:
        saved = json.loads(json.dumps(residual.to_dict(), allow_nan=False))
        assert QUERIES.history is not None
        loaded = residual_from_dict(saved).conditioned_on(QUERIES.history)
        assert (loaded.kind, loaded.history_inputs, loaded.to_dict()) == (residual.kind, residual.history_inputs, saved)
        for name in ("mean", "std", "mean_gradient", "std_gradient"):
            np.testing.assert_array_equal(
                getattr(loaded, name)(points(QUERIES)), getattr(residual, name)(points(QUERIES))
            )

    def test_appending_is_fitting_to_all_data_at_the_same_hyper_parameters(self, residual: Residual) -> None:
        """`residual_from_dict` conditions a new residual on the data of the extended one."""
        grown, more = residual, steps(5, seed=2)
        assert more.history is not None
        assert QUERIES.history is not None
        for point, error, history in zip(points(more), more.error, more.history, strict=True):
            grown = grown.conditioned_on(history + 40).append(point, error)
        refitted = residual_from_dict(grown.to_dict())
        for found, wanted in zip(grown.regressions, refitted.regressions, strict=True):
            assert type(found) is type(wanted)
        grown, refitted = (each.conditioned_on(QUERIES.history) for each in (grown, refitted))
        for name in ("mean", "std", "mean_gradient"):
            found, wanted = (getattr(each, name)(points(QUERIES)) for each in (grown, refitted))
            np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())
        if residual.kind != "none":
            assert not np.allclose(grown.mean(points(QUERIES)), residual.mean(points(QUERIES)), rtol=1e-6)


@pytest.mark.parametrize("kind", [kind for kind in FITTED if kind not in ("none", "posterior")])
@pytest.mark.parametrize("forgetting_time", [inf, 30.0])
def test_left_out_is_conditioning_on_the_others(kind: str, forgetting_time: float) -> None:
    """By `to_dict`, so that the hyper-parameters do not change."""
    residual, observations = fit_residual(kind, steps(), forgetting_time=forgetting_time), steps()
    blocks = [slice(0, 12), slice(12, 13), slice(13, 40)]
    inputs = observations.points(residual.history_inputs)
    for regression, saved in zip(residual.regressions, residual.to_dict()["regressions"], strict=True):
        found = regression.left_out(blocks)
        for block in blocks[:2]:
            others = {key: np.delete(saved[key], block, axis=0).tolist() for key in ("points", "values")}
            data = {**residual.to_dict(), "regressions": [{**saved, **others}] * 2}
            refitted = residual_from_dict(data).regressions[0]
            np.testing.assert_allclose(found.mean[block], refitted.mean(inputs[block]), rtol=1e-7, atol=1e-9)
            np.testing.assert_allclose(found.std[block], refitted.predict(inputs[block]).std, rtol=1e-7)


def test_no_residual_is_zero() -> None:
    residual = no_residual(2, 2)
    for array in (residual.mean, residual.std, residual.mean_gradient, residual.std_gradient):
        np.testing.assert_array_equal(array(points(QUERIES)), 0)
    np.testing.assert_array_equal(residual.std(points(QUERIES), include_noise=True), 0)


def test_none_estimates_the_noise_about_the_nominal_map() -> None:
    residual = fit_residual("none", steps())
    np.testing.assert_array_equal(residual.mean(points(QUERIES)), 0)
    np.testing.assert_array_equal(residual.std(points(QUERIES)), 0)
    rms = np.sqrt(np.mean(steps().error ** 2, axis=0))
    np.testing.assert_allclose(residual.std(points(QUERIES)[0], include_noise=True), rms, rtol=0.02)


def test_gp_is_one_process_per_coordinate_on_the_scales_of_the_space() -> None:
    observations = steps()
    bases: dict[str, Basis] = {"gp": "constant", "gp_on_linear": "linear"}
    for kind, basis in bases.items():
        residual = fit_residual(kind, observations)
        for i in range(2):
            process = fit_gaussian_process(points(observations), observations.error[:, i], SCALE, SCALE[i], basis=basis)
            np.testing.assert_allclose(residual.mean(points(QUERIES))[:, i], process.mean(points(QUERIES)), rtol=1e-6)
            wanted = process.kriging_std(points(QUERIES))
            np.testing.assert_allclose(residual.std(points(QUERIES))[:, i], wanted, rtol=1e-6)


def test_fitrgp_uses_no_scales_and_reports_plug_in_deviations() -> None:
    observations = steps()
    residual = fit_residual("fitrgp", observations)
    for i in range(2):
        process = fit_like_fitrgp(points(observations), observations.error[:, i])
        np.testing.assert_allclose(residual.mean(points(QUERIES))[:, i], process.mean(points(QUERIES)), rtol=1e-6)
        np.testing.assert_allclose(residual.std(points(QUERIES))[:, i], process.std(points(QUERIES)), rtol=1e-6)


@pytest.mark.parametrize("kind", ["gp", "gp_on_linear", "auto"])
def test_predicts_steps_it_was_not_fitted_to(kind: str) -> None:
    given, new = fit_residual(kind, steps(150)), steps(200, seed=2)
    rest = new.error - given.mean(points(new))
    assert np.all(np.sqrt(np.mean(rest**2, axis=0)) < 1.25 * np.array([0.004, 0.001]))
    covered = np.mean(np.abs(rest) < 1.96 * given.std(points(new), include_noise=True), axis=0)
    assert np.all((covered > 0.88) & (covered < 0.995))


@pytest.mark.parametrize("kind", FITTED)
def test_one_step_is_enough(kind: str) -> None:
    residual = fit_residual(kind, steps(1))
    assert np.isfinite(residual.mean(points(QUERIES))).all()
    assert (residual.std(points(QUERIES), include_noise=True) > 0).all()


class TestChoice:
    """Errors that one kind explains and simpler ones do not; more flexible ones only learn noise."""

    @staticmethod
    def of(shape: Any, size: int = 90, noise: float = 0.01) -> Observations:
        generator = np.random.default_rng(7)
        x = generator.uniform(-1, 1, (size, 4))
        error = SCALE[:2] * (np.stack([shape(x)] * 2, axis=1) + noise * generator.standard_normal((size, 2)))
        return Observations(SPACE, np.array([0.2, 0.58]) + SCALE[:2] * x[:, :2], SCALE[2:] * x[:, 2:], error)

    @pytest.mark.parametrize(
        ("shape", "too_simple"),
        [
            (lambda x: 0.2 + 0.0 * x[:, 0], {"none"}),
            (lambda x: 0.2 + 0.1 * x[:, 0] - 0.1 * x[:, 3], {"none", "constant"}),
            (lambda x: 0.2 * np.sin(4 * x[:, 0]) * np.cos(3 * x[:, 2]), {"none", "constant", "linear", "quadratic"}),
        ],
    )
    def test_the_model_that_explains_the_errors_is_chosen(self, shape: Any, too_simple: set[str]) -> None:
        assert fit_residual("auto", self.of(shape)).kind not in too_simple

    def test_little_evidence_gives_a_simple_model(self) -> None:
        assert fit_residual("auto", self.of(lambda x: 0.2 + 0.0 * x[:, 0], size=2)).kind in ("none", "constant")
        assert fit_residual("auto", part(steps(1), slice(0, 0))).kind == "none"

    def test_the_choice_is_that_of_the_score(self) -> None:
        observations = steps(30)
        scores = {kind: held_out_score(fit_residual(kind, observations), observations) for kind in FITTED}
        del scores["fitrgp"]
        assert fit_residual("auto", observations).kind == max(scores, key=lambda kind: scores[kind])

    def test_a_residual_without_held_out_predictions_has_no_score(self) -> None:
        assert held_out_score(fit_residual("gp", steps(1)), steps(1)) == -inf


class TestHistoryInputs:
    def test_inputs_are_those_of_the_setting(self) -> None:
        history = np.arange(3.0)
        assert HistoryInputs(context_inputs=2).of(history).tolist() == [1, 2]
        assert HistoryInputs(2.0, context_inputs=2).of(history + 1).tolist() == [2, 3, 0.5]

    def test_a_residual_with_history_inputs_requires_the_history(self) -> None:
        residual = fit_residual("linear", steps(), 30.0)
        with pytest.raises(ValueError, match="condition it on the history"):
            residual.mean(points(QUERIES))

    def test_conditioned_it_is_a_function_of_state_and_command(self) -> None:
        """Each history gives the slice of the whole function there."""
        residual = fit_residual("gp", steps(), 30.0)
        assert QUERIES.history is not None
        together = residual.conditioned_on(QUERIES.history).mean(points(QUERIES))
        for row, (point, history) in enumerate(zip(points(QUERIES), QUERIES.history, strict=True)):
            np.testing.assert_allclose(residual.conditioned_on(history).mean(point), together[row], rtol=1e-12)
        assert not np.allclose(residual.conditioned_on(np.full(1, 40.0)).mean(points(QUERIES)), together)

    @pytest.mark.parametrize("forgetting_time", [0.0, float("nan")])
    def test_invalid_history_inputs_are_refused(self, forgetting_time: float) -> None:
        with pytest.raises(ValueError, match=r"= .*, but it must be"):
            HistoryInputs(forgetting_time)

    def test_without_histories_the_steps_count_from_zero(self) -> None:
        data = steps()
        bare = Observations(SPACE, data.state, data.command, data.error)
        assert fit_residual("linear", bare, 10.0).to_dict() == fit_residual("linear", data, 10.0).to_dict()


class TestForgettingTime:
    """A level that drifts: a finite forgetting time tracks it, an infinite one averages."""

    @staticmethod
    def drifting(size: int = 240) -> Observations:
        generator = np.random.default_rng(8)
        x = generator.uniform(-1, 1, (size, 4))
        level = 0.1 * np.arange(size) / size + 0.05 * x[:, 0]
        error = SCALE[:2] * (np.stack([level] * 2, axis=1) + 0.01 * generator.standard_normal((size, 2)))
        return Observations(SPACE, np.array([0.2, 0.58]) + SCALE[:2] * x[:, :2], SCALE[2:] * x[:, 2:], error)

    @pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "gp", "gp_on_linear"])
    def test_old_steps_count_less(self, kind: str) -> None:
        observations, middle = self.drifting(), np.array([0.2, 0.58, 0.0, 0.0])
        now, after = SCALE[:2] * 0.1, np.full(1, 240.0)
        for_ever = fit_residual(kind, observations).conditioned_on(after).mean(middle)
        fading = fit_residual(kind, observations, forgetting_time=30.0).conditioned_on(after).mean(middle)
        assert np.all(np.abs(fading - now) < 0.45 * np.abs(for_ever - now))

    def test_without_drift_a_long_forgetting_time_is_as_good_as_an_infinite_one(self) -> None:
        kinds: tuple[str, ...] = ("linear", "gp")
        for kind in kinds:
            for_ever, long = fit_residual(kind, steps()), fit_residual(kind, steps(), forgetting_time=1e5)
            found = long.conditioned_on(np.full(1, 40.0)).mean(points(QUERIES))
            np.testing.assert_allclose(found, for_ever.mean(points(QUERIES)), atol=2e-5)


def test_join_broadcasts_leading_axes() -> None:
    joined = join_points([[1.0, 2.0], [3.0, 4.0]], [5.0, 6.0, 7.0])
    np.testing.assert_array_equal(joined, [[1, 2, 5, 6, 7], [3, 4, 5, 6, 7]])


class TestRefused:
    def test_the_error_of_an_unknown_kind_lists_the_known_ones(self) -> None:
        names = "constant, fitrgp, gp, gp_on_linear, linear, none, posterior, quadratic$"
        with pytest.raises(InputError, match=f"^residual 'neural': unknown; the residuals installed here are {names}"):
            fit_residual("neural", steps())
        with pytest.raises(InputError, match=r"^residual 'gp_on_line': unknown; did you mean gp_on_linear\?"):
            fit_residual("gp_on_line", steps())

    @pytest.mark.parametrize("kind", FITTED[1:])
    def test_a_model_without_steps(self, kind: str) -> None:
        with pytest.raises(ValueError, match="at least one step"):
            fit_residual(kind, part(steps(), slice(0, 0)))

    @pytest.mark.parametrize(
        ("change", "named"),
        [
            ({"regressions": []}, "^regressions must be"),
            ({"regressions": {}}, "^regressions must be"),
            ({"regressions": [None, None]}, r"^regressions\[0\] must be"),
            ({"kind": "neural"}, "^residual 'neural': unknown; the residuals installed here are constant"),
            ({"kind": "stepgap.learning.zero:NONE"}, "^residual 'stepgap.learning.zero:NONE': unknown"),
            ({"kind": ["gp"]}, "^kind must be the name of a residual"),
            (
                {"kind": "none", "regressions": [{"inputs": 0, "noise_std": 0.0}]},
                r"^regressions\[0\]\.inputs is 0, but it must",
            ),
            ({"kind": "none", "regressions": [{"inputs": 4}]}, r"^regressions\[0\]\.noise_std must be"),
            ({"command_size": True}, "^command_size is true, but it must be an integer from 1"),
            ({"command_size": 0}, "^command_size is 0, but it must be an integer from 1"),
            ({"command_size": 3}, "must have 5 inputs"),
            ({"lagged_inputs": "previous_error"}, "^lagged_inputs = 'previous_error': models with inputs of the step"),
            ({"forgetting_time": 0.0}, "^forgetting_time = 0.0, but"),
            ({"forgetting_time": "long"}, "^forgetting_time must be"),
        ],
    )
    def test_a_wrong_entry_is_named(self, change: dict[str, Any], named: str) -> None:
        saved = fit_residual("gp", steps(5)).to_dict()
        with pytest.raises(ValueError, match=named):
            residual_from_dict({**saved, **change})

    @pytest.mark.parametrize("key", ["kind", "forgetting_time", "command_size", "regressions"])
    def test_a_missing_entry_is_named(self, key: str) -> None:
        saved = fit_residual("gp", steps(5)).to_dict()
        del saved[key]
        with pytest.raises(ValueError, match=f"^{key} "):
            residual_from_dict(saved)

    @pytest.mark.parametrize("kind", ["gp", "linear"])
    def test_a_wrong_entry_of_a_regression_is_named(self, kind: str) -> None:
        saved = fit_residual(kind, steps(5)).to_dict()
        saved["regressions"][1]["values"] = [0.0]
        with pytest.raises(ValueError, match=r"^regressions\[1\]\.(values|points)\b.* must be"):
            residual_from_dict(saved)

    def test_regressions_that_do_not_belong_together(self) -> None:
        for regressions in ((Zero(4), Zero(3)), (Zero(3), Zero(3)), ()):
            with pytest.raises(ValueError, match="inputs"):
                Residual(NONE, regressions, 2)
