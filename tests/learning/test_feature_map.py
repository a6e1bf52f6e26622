"""Feature maps: contract of the residuals on features, what features leave out, files, plug-ins and runs."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.export.controller.portable_controller import portable_controller
from stepgap.learning.entry_points import load_feature_model, load_residual_model
from stepgap.learning.feature_map import FeatureModel, FeatureRegression, LeftOutPart, with_features
from stepgap.learning.function_features import function_features
from stepgap.learning.gradient_samples import gradient_covariance
from stepgap.learning.polynomial import PRIOR_STD
from stepgap.learning.regression import ResidualModel
from stepgap.learning.residual_fit import fit_residual, residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.missing import Missing
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array
from tests.control.maps import LossyHopper
from tests.learning.residual_contract import (
    CENTRE,
    INPUTS,
    QUERIES,
    SCALE,
    VALUE_SCALE,
    ResidualContract,
    training_data,
)
from tests.learning.test_own_residual import install
from tests.learning.test_residual import points, steps
from tests.report.pages import Page
from tests.report.runs import REAL, TARGETS, report_of

LINEAR = load_feature_model("linear")


def pair(point: Array) -> Array:
    """Two features of the first three inputs; a fourth is left out."""
    x = (point[..., :3] - CENTRE[:3]) / SCALE[:3]
    return np.stack([x[..., 0] + 0.5 * x[..., 0] ** 2, x[..., 1] * np.cos(x[..., 2])], axis=-1) + 0 * point.sum(
        axis=-1, keepdims=True
    )


def pair_jacobian(point: Array) -> Array:
    """Its Jacobian."""
    x = (point[..., :3] - CENTRE[:3]) / SCALE[:3]
    jacobian = np.zeros((*point.shape[:-1], 2, point.shape[-1]))
    jacobian[..., 0, 0] = (1 + x[..., 0]) / SCALE[0]
    jacobian[..., 1, 1] = np.cos(x[..., 2]) / SCALE[1]
    jacobian[..., 1, 2] = -x[..., 1] * np.sin(x[..., 2]) / SCALE[2]
    return jacobian


PAIR, EXACT_PAIR = function_features("pair", pair), function_features("pair", pair, pair_jacobian)


@pytest.mark.parametrize(
    ("kind", "features"),
    [("gp_on_linear", LINEAR), ("quadratic", LINEAR), ("gp", PAIR), ("quadratic", EXACT_PAIR)],
    ids=["gp_on_linear, linear", "quadratic, linear", "gp, function", "quadratic, function with Jacobian"],
)
class TestResidualsOnFeatures(ResidualContract):
    @pytest.fixture
    def model(self, kind: str, features: FeatureModel) -> ResidualModel:
        return with_features(load_residual_model(kind), features)


def test_differences_are_the_jacobian() -> None:
    data = training_data()
    for found in (PAIR.fit(data), EXACT_PAIR.fit(data)):
        np.testing.assert_allclose(np.ptp(found.features(data.points), axis=0), 2, rtol=1e-12)
    one, other = PAIR.fit(data).jacobian(QUERIES), EXACT_PAIR.fit(data).jacobian(QUERIES)
    np.testing.assert_allclose(one * SCALE, other * SCALE, atol=1e-8)


def test_the_part_left_out_has_the_variance_of_a_linear_function_of_it() -> None:
    """In function space, as a Gaussian process whose kernel is that of the linear function (RW Eqs. 2.25 and 2.26)."""
    data = training_data()
    features = data.scaled(data.points)[:, :1]
    part = LeftOutPart.fit(data, features, 0.3)

    def left_out(point: Array) -> Array:
        scaled, known = data.scaled(point), data.scaled(data.points)
        basis = np.column_stack([np.ones(len(known)), known[:, 0]])
        weights, *_ = np.linalg.lstsq(basis, known)
        return scaled - np.column_stack([np.ones(len(scaled)), scaled[:, 0]]) @ weights

    query, known = left_out(QUERIES), left_out(data.points)
    covariance = PRIOR_STD**2 * known @ known.T + np.eye(len(known))
    cross = PRIOR_STD**2 * query @ known.T
    wanted = PRIOR_STD**2 * np.sum(query**2, axis=1) - np.sum(cross * np.linalg.solve(covariance, cross.T).T, axis=1)
    np.testing.assert_allclose(part.std(QUERIES, data.scaled(QUERIES)[:, :1]), 0.3 * np.sqrt(wanted), rtol=1e-6)


@pytest.mark.parametrize("kind", ["constant", "linear", "gp", "gp_on_linear"])
def test_a_direction_that_the_features_leave_out_is_uncertain_far_from_the_data(kind: str) -> None:
    first = function_features("first", lambda point: point[..., :1])
    regression = with_features(load_residual_model(kind), first).fit(training_data(), None)
    for column in range(1, INPUTS):
        distances = CENTRE + np.array([0.0, 1.0, 3.0, 10.0])[:, None] * (SCALE * np.eye(INPUTS)[column])
        np.testing.assert_allclose(regression.mean(distances), regression.mean(CENTRE), rtol=1e-12)
        std = regression.std(distances)
        assert (np.diff(std) > 0).all()
        assert std[-1] > 1.5 * regression.noise_std


def test_none_is_not_changed_by_features() -> None:
    assert fit_residual("none", steps(), feature_map="linear").to_dict() == fit_residual("none", steps()).to_dict()


def test_the_identity_is_in_no_file() -> None:
    alone = fit_residual("gp", steps()).to_dict()
    assert alone == fit_residual("gp", steps(), feature_map="identity").to_dict()
    assert not {"feature_map", "left_out_part"} & {*alone, *alone["regressions"][0]}


def test_a_residual_on_features_is_restored_and_grows() -> None:
    residual = fit_residual("gp_on_linear", steps(), "previous_error", 30.0, feature_map="linear")
    saved = json.loads(json.dumps(residual.to_dict(), allow_nan=False))
    assert saved["feature_map"] == "linear"
    loaded, history = residual_from_dict(saved), np.zeros(7)
    assert (loaded.name, loaded.to_dict()) == ("gp_on_linear of linear features with previous error", saved)
    query = points(steps(6, seed=1))
    one, other = (each.conditioned_on(history) for each in (residual, loaded))
    for name in ("mean", "std", "mean_gradient", "std_gradient"):
        np.testing.assert_array_equal(getattr(one, name)(query), getattr(other, name)(query))
    grown = one.append(query[0], one.mean(query[0]) + 0.1)
    assert (grown.mean(query[0]) > one.mean(query[0]) + 0.001).all()
    again = fit_residual("gp_on_linear", steps(45), "previous_error", 30.0, residual, feature_map="linear")
    assert all(isinstance(each, FeatureRegression) for each in again.regressions)


def test_gradient_samples_see_through_features() -> None:
    """Without features left out, of a linear function the covariance of the gradient is that in the inputs."""
    everything = function_features("everything", lambda point: point)
    scale = np.array([0.2, 0.045, 15.0, 20.0])
    plain, on_features = (fit_residual("gp", steps(), feature_map=each) for each in ("identity", everything))
    query = points(steps(6, seed=1))[0]
    one, other = (
        np.sqrt(np.diagonal(gradient_covariance(each, query, scale), 0, 1, 2)) for each in (plain, on_features)
    )
    np.testing.assert_allclose(one, other, rtol=0.5)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"feature_map": 3}, "feature_map must be the name of a feature map"),
        ({"feature_map": "os.path"}, "feature map 'os.path': unknown; the feature maps installed here are linear"),
        ({"feature_map": "linaer"}, r"feature map 'linaer': unknown; did you mean linear\? "),
    ],
)
def test_a_file_with_an_unknown_feature_map_is_refused(entry: dict[str, object], message: str) -> None:
    saved = {**fit_residual("gp", steps(), feature_map="linear").to_dict(), **entry}
    with pytest.raises((InputError, ValueError), match=f"^{message}"):
        residual_from_dict(saved)


@pytest.mark.parametrize(
    ("part", "key", "value", "message"),
    [
        ("feature_map", "matrix", [[1.0]], "feature_map is not valid: matrix must have 4 columns"),
        ("left_out_part", "root", [[1.0]], "left_out_part is not valid: centre, scale, reconstruction and root"),
        ("left_out_part", "scale", [0.0] * 4, "left_out_part is not valid: centre, scale, reconstruction and root"),
        ("left_out_part", "reconstruction", [[0.0] * 4], "feature_map has [1-4] features, and left_out_part 0"),
    ],
)
def test_parts_of_a_file_that_do_not_fit_are_named(part: str, key: str, value: object, message: str) -> None:
    saved = fit_residual("gp", steps(), feature_map="linear").to_dict()
    saved["regressions"][1][part][key] = value
    with pytest.raises(ValueError, match=rf"^regressions\[1\].{message}"):
        residual_from_dict(saved)


def test_settings_know_the_installed_maps() -> None:
    assert LearningSettings().feature_map == "identity"
    LearningSettings(feature_map="linear")
    with pytest.raises(
        ValueError, match=r"^feature_map = 'liner', but it must be one of identity, linear; did you mean"
    ):
        LearningSettings(feature_map="liner")


CODE = """
from stepgap.learning.function_features import function_features
import numpy as np

def energy(point):
    speed, height, fx, fy = np.moveaxis(point, -1, 0)
    return np.stack([speed, 9.81 * height + speed**2 / 2, fx, fy], axis=-1)

MODEL = function_features("energy", energy)
"""


def test_a_function_of_another_package_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "own_features", CODE, group="stepgap.feature_maps", energy="own_features:MODEL")
    with monkeypatch.context() as patched:
        patched.syspath_prepend(tmp_path)
        patched.delitem(sys.modules, "own_features", raising=False)
        LearningSettings(feature_map="energy")
        residual = fit_residual("gp", steps(), feature_map="energy")
        saved, query = json.loads(json.dumps(residual.to_dict())), points(steps(6, seed=1))
        np.testing.assert_array_equal(residual_from_dict(saved).mean(query), residual.mean(query))
        assert "def" not in json.dumps(saved)
    with pytest.raises(InputError, match=r"^feature map 'energy': unknown; the feature maps installed here are linear"):
        residual_from_dict(saved)


def test_a_function_that_returns_the_wrong_shape_is_named() -> None:
    wrong = function_features("wrong", lambda point: point[..., 0])
    message = re.escape("residual 'gp': ValueError: feature map 'wrong': returned the shape (40,)")
    with pytest.raises(InputError, match=f"^{message}"):
        fit_residual("gp", steps(), feature_map=wrong)


def test_a_run_uses_features_and_its_report_says_so(tmp_path: Path) -> None:
    def plant(rng: np.random.Generator) -> ModelPlant:
        return ModelPlant(REAL, np.array([0.1, 0.56]), np.array([0.005, 0.002]), rng)

    learning = LearningSettings(iterations=1, tolerance=0.0, feature_map="linear")
    first, last = run_experiment(Setup(LossyHopper(), Plants(plant), TARGETS, learning), tmp_path)
    assert last.residual == "gp_on_linear of linear features"
    assert sum(last.rmse / VALUE_SCALE) < 0.6 * sum(first.rmse / VALUE_SCALE)
    settings = Experiment(Hopper(), learning=learning)
    run = Run(tmp_path, space=LossyHopper().space, nominal=LossyHopper(), settings=settings)
    loaded = run.residual(1)
    assert not isinstance(loaded, Missing)
    assert loaded.feature_map == "linear"
    refused = (
        "residual 'gp_on_linear of linear features': feature maps cannot be exported; run with learning.feature_map"
    )
    with pytest.raises(InputError, match=f"^{refused}"):
        portable_controller(run, None, np.random.default_rng(0))
    page = Page(report_of(tmp_path))
    assert "began with the residual 'gp_on_linear of linear features'" in page.text
    assert "The model has features of the inputs" in page.text
