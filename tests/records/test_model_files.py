"""Files `models/iteration_K.json`: what is refused when one is read."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.gauss.gaussian_process import condition
from stepgap.learning.beliefs import Beliefs, Observed
from stepgap.learning.entry_points import load_residual_model
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.regression import TrainingData
from stepgap.learning.residual import Residual, no_residual
from stepgap.records.model_files import Model, model_path, read_model, write_model
from stepgap.step import Outcome, Quantity, StepMap, StepSpace, difference_jacobian
from tests.export.controller.learned import CENTRE, SCALE, SPACE, affine, beliefs_about, regression


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A run folder with the model of deployment 1."""
    rng = np.random.default_rng(0)
    sparse = regression("gp", 0.2, rng)
    assert isinstance(sparse, GaussianProcessRegression)
    exact = GaussianProcessRegression(condition(sparse.points, sparse.values, SCALE, sparse.process.hyper_parameters))
    (tmp_path / "models").mkdir()
    write_model(tmp_path, 1, Model(Residual(load_residual_model("gp"), (sparse, exact), 2), None), affine(rng))
    return tmp_path


def change(folder: Path, edit: Any) -> None:
    path = model_path(folder, 1)
    data = json.loads(path.read_text("utf-8"))
    edit(data)
    path.write_text(json.dumps(data), "utf-8")


def refused(folder: Path, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        read_model(folder, 1, SPACE)


def test_the_kernel_is_named_and_checked(written: Path) -> None:
    data = json.loads(model_path(written, 1).read_text("utf-8"))
    assert [each["kernel"] for each in data["regressions"]] == ["Matérn 5/2", "Matérn 5/2"]
    for index in (0, 1):
        change(written, lambda data, index=index: data["regressions"][index].update(kernel="periodic"))
        refused(written, "kernel = 'periodic', but it must be 'Matérn 5/2'")
        change(written, lambda data, index=index: data["regressions"][index].pop("kernel"))
    found = read_model(written, 1, SPACE)  # as former versions wrote it
    assert found is not None
    assert np.isfinite(found.residual.mean(CENTRE)).all()


def test_features_are_of_a_former_version(written: Path) -> None:
    before = model_path(written, 1).read_text("utf-8")
    change(written, lambda data: data.update(feature_map="identity", outliers=[[0, 3]]))
    found = read_model(written, 1, SPACE)
    assert found is not None
    assert found.residual.to_dict().items() <= json.loads(before).items()
    for other in ("linear", ["identity"], None):
        change(written, lambda data, other=other: data.update(feature_map=other))
        refused(written, r"iteration_1\.json: not a residual \(written by a former version; run the experiment again\)")


def test_another_schema_is_refused(written: Path) -> None:
    change(written, lambda data: data.update(schema=2))
    refused(written, "schema must be 1, not 2")


@pytest.mark.parametrize("wrong", [[["height", "m"], ["speed", "m/s"]], [["speed", "m/s"]], "speed", [3, 4], [[], []]])
def test_other_names_are_refused(written: Path, wrong: Any) -> None:
    change(written, lambda data: data.update(state=wrong))
    refused(written, "its state is .*, that of the steps is speed, height; both must be of the same run")


@pytest.fixture
def believed(tmp_path: Path) -> tuple[Path, Beliefs]:
    """A run folder with what is believed before deployment 1, and the beliefs."""
    rng = np.random.default_rng(3)
    beliefs = beliefs_about(None, rng)
    (tmp_path / "models").mkdir()
    write_model(tmp_path, 1, Model(no_residual(2, 2), beliefs), affine(rng))
    return tmp_path, beliefs


def test_beliefs_are_read_as_they_were_written(believed: tuple[Path, Beliefs]) -> None:
    folder, beliefs = believed
    found = read_model(folder, 1, SPACE)
    assert found is not None
    assert found.beliefs is not None
    point = np.array([0.2, -0.1, 0.4, 0.3])
    step = Observed(point, np.array([0.1, 0.05]), 0.3, command=point[2:], from_elsewhere=lambda _: None)
    for one, other in zip(beliefs.after(step).mixture(0.5), found.beliefs.after(step).mixture(0.5), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("beliefs",), []),
        (("beliefs",), [{}] * 101),
        (("beliefs", 0, "kind"), "friend"),
        (("beliefs", 0, "mean"), [[1.0]]),
        (("beliefs", 0, "freedom"), [2.0, 8.0]),
        (("beliefs", 0, "squares"), [1.0, -1.0]),
        (("beliefs", 0, "squares"), [1.0, 10**400]),
        (("beliefs", 0, "log_weight"), None),
        (("beliefs", 0, "rate"), 2.0),
        (("beliefs", 0, "root", 0, 0), 0.0),
        (("change", 1), "x"),
        (("features", "degree"), 3),
        (("features", "inputs"), 10**9),
        (("wrong_measurements",), [0.0, 1.0]),
    ],
)
def test_beliefs_that_are_damaged_are_refused(believed: tuple[Path, Beliefs], path: tuple, value: Any) -> None:
    def edit(data: Any) -> None:
        inner = data["beliefs"]
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value

    change(believed[0], edit)
    refused(believed[0], r"^[^\n]*iteration_1\.json: not a model \([^\n]*\); it must be one that a run wrote$")


@dataclass(frozen=True)
class Mileage(StepMap):
    """A position far from zero, in a narrow range: nine digits of it are coarser than the tolerance of a step."""

    stride: float = 1e-7 / 3

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("position", "m", 1000.0, 1000.001),), (Quantity("push", "N", -1.0, 1.0),))

    jacobian = difference_jacobian  # pyright: ignore[reportAssignmentType]

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        moved = np.asarray(state, float) + self.stride * np.asarray(command, float)
        return Outcome(moved, np.zeros(moved.shape[:-1], np.int64))


def test_a_map_is_known_again_although_its_steps_are_rounded(tmp_path: Path) -> None:
    nominal, other = Mileage(), Mileage(stride=1e-3)
    (tmp_path / "models").mkdir()
    write_model(tmp_path, 1, Model(no_residual(1, 1), None), nominal)
    assert read_model(tmp_path, 1, nominal.space, nominal) is not None
    with pytest.raises(ValueError, match=r"push -?0\.5 its next position was 1000\.0005 m, that of this map"):
        read_model(tmp_path, 1, nominal.space, other)


def process_formula(saved: dict[str, Any], x: np.ndarray, *, constant_is_exact: bool) -> tuple[float, float]:
    """Mean and standard deviation at x, by the formulas of docs/model_file.md for a Gaussian process of a run."""
    X, y = np.array(saved["points"]), np.array(saved["values"])
    scale, s = np.array(saved["input_scale"]), saved["signal_std"]
    b = saved["slope_std"] / s / scale

    def covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        r = np.sqrt(5 * ((((one[:, None] - other) / scale / saved["length_scale"]) ** 2).sum(axis=-1)))
        return (1 + r + r**2 / 3) * np.exp(-r) + ((one - X[0]) * b) @ ((other - X[0]) * b).T

    K = covariance(X, X) + (saved["noise_std"] / s) ** 2 * np.eye(len(X))
    one, at = np.ones(len(X)), covariance(x[None], X)[0]
    K_one, K_at = np.linalg.solve(K, one), np.linalg.solve(K, at)
    beta = K_one @ y / (K_one @ one)
    variance = covariance(x[None], x[None])[0, 0] - at @ K_at
    if not constant_is_exact:
        variance += (1 - one @ K_at) ** 2 / (K_one @ one)
    return beta + K_at @ (y - beta), s * np.sqrt(variance)


def polynomial_formula(saved: dict[str, Any], x: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation at x, by the formulas of docs/model_file.md for a quadratic polynomial of a run."""
    y, (i, j) = np.array(saved["values"]), np.triu_indices(len(x))

    def monomials(x: np.ndarray) -> np.ndarray:
        z = (x - np.array(saved["centre"])) / saved["scale"]
        return np.concatenate([np.ones((*z.shape[:-1], 1)), z, z[..., i] * z[..., j]], axis=-1)

    Phi, phi = monomials(np.array(saved["points"])), monomials(x)
    A = np.eye(len(phi)) / 30**2 + Phi.T @ Phi
    w = np.linalg.solve(A, Phi.T @ y)
    noise = (3 * (0.02 * saved["value_scale"]) ** 2 + y @ y - w @ Phi.T @ y) / (len(y) + 1)
    return float(phi @ w), float(np.sqrt(noise * phi @ np.linalg.solve(A, phi)))


def posterior_formula(saved: dict[str, Any], x: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation at x of the error that beliefs expect: of weighted features."""
    features, (i, j) = saved["features"], np.triu_indices(len(saved["used"]))
    z = ((x - np.array(saved["centre"])) / saved["scale"])[saved["used"]]
    frequencies, count = np.array(features["frequencies"]).reshape(-1, len(z)), max(1, len(features["shifts"]))
    waves = np.sqrt(2 / count) * np.cos(frequencies @ z + features["shifts"])
    phi = np.concatenate([[1.0], z, z[i] * z[j], waves])
    w, C = np.array(saved["weights"])[: len(phi)], np.array(saved["covariance"])[: len(phi), : len(phi)]
    return saved["value_scale"] * float(w @ phi), saved["value_scale"] * float(np.sqrt(phi @ C @ phi))


@pytest.mark.parametrize("kind", ["quadratic", "gp", "gp_on_linear", "fitrgp", "posterior", "many steps"])
def test_the_formulas_of_the_page_predict_what_was_learned(kind: str) -> None:
    rng = np.random.default_rng(1)
    found = regression("quadratic" if kind == "many steps" else kind, 0.2, rng)
    if kind == "many steps":  # so many that what is believed has waves
        points = CENTRE + SCALE * rng.uniform(-1, 1, (110, 4))
        found = POSTERIOR.fit(TrainingData(points, np.sin(points[:, 0]), CENTRE, SCALE, 0.2))
        assert found.to_dict()["features"]["shifts"]
    if isinstance(found, GaussianProcessRegression):
        process = condition(found.points, found.values, SCALE, found.process.hyper_parameters)
        found = GaussianProcessRegression(process, found.plug_in)
    for x in CENTRE + SCALE * rng.uniform(-1.5, 1.5, (20, 4)):
        if isinstance(found, GaussianProcessRegression):
            computed = process_formula(found.to_dict(), x, constant_is_exact=kind == "fitrgp")
        elif kind in ("posterior", "many steps"):
            computed = posterior_formula(found.to_dict(), x)
        else:
            computed = polynomial_formula(found.to_dict(), x)
        assert np.allclose(computed, (found.mean(x), found.std(x)), rtol=0, atol=1e-10)
