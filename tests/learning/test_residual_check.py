"""What a residual model returns is checked, and whatever is wrong names the model, before a robot moves with it."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.base.errors import StepGapWarning
from stepgap.base.settings_file import InputError
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.learning.entry_points import residual_models
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.regression import BatchRegression, Regression, ResidualModel, TrainingData
from stepgap.learning.residual import Residual
from stepgap.learning.residual_check import ResidualError
from stepgap.learning.residual_fit import fit_residual, residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.logs.fits.validation import contiguous_folds, validate, validate_on
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.model_files import MAP, NominalSource, saved_model_text
from tests.learning.test_learner import NOISE, NOMINAL, REALITY, hops, log_of
from tests.learning.test_own_residual import install, packages
from tests.learning.test_residual import SPACE, steps
from tests.logs.fits.test_validation import steps_with

__all__ = ["packages"]

Answer = Callable[[np.ndarray], Any]
"""What a method returns at points (…, d)."""


@dataclass(frozen=True, eq=False)
class Told(BatchRegression):
    """A regression that is zero except for the answers of some of its methods."""

    answers: Mapping[str, Answer] = field(default_factory=dict)

    def _answer(self, method: str, point: ArrayLike, right: np.ndarray) -> Any:
        return self.answers[method](np.asarray(point)) if method in self.answers else right

    @property
    def noise_std(self) -> float:
        return self._answer("noise_std", self.points, np.array(0.01))

    def mean(self, point: ArrayLike) -> np.ndarray:
        return self._answer("mean", point, np.zeros(np.shape(point)[:-1]))

    def mean_gradient(self, point: ArrayLike) -> np.ndarray:
        return self._answer("mean_gradient", point, np.zeros(np.shape(point)))

    def std(self, point: ArrayLike) -> np.ndarray:
        return self._answer("std", point, np.full(np.shape(point)[:-1], 0.01))

    def std_gradient(self, point: ArrayLike) -> np.ndarray:
        return self._answer("std_gradient", point, np.zeros(np.shape(point)))

    def to_dict(self) -> dict[str, Any]:
        return {**self.data.to_dict(), **({"extra": object()} if "to_dict" in self.answers else {})}


def model_of(**answers: Answer) -> ResidualModel:
    def fit(data: TrainingData) -> Regression:
        return Told(data, answers)

    return ResidualModel("told", "what it is told", fit, lambda saved: Told(TrainingData.from_dict(saved), answers))


@pytest.mark.parametrize(
    ("method", "answer", "reason"),
    [
        ("mean", lambda x: np.full(x.shape[:-1], np.nan), "its mean returned nan; it must be finite"),
        ("mean", lambda x: np.full(x.shape[:-1], 1e300), "its mean returned 1e+300; it must be finite, and at most"),
        ("mean", lambda x: np.where(x[..., 0] > 0.2, 0.0, np.inf), "its mean returned inf"),
        ("mean", lambda x: np.zeros((*x.shape[:-1], 3)), "its mean returned the shape (3,); it must be ()"),
        ("mean", lambda x: 0.0, "its mean returned the shape (); it must be (30,)"),
        ("mean", lambda x: None, "its mean returned None; it must return numbers of shape ()"),
        ("mean_gradient", lambda x: np.full(x.shape, np.nan), "its mean_gradient returned nan"),
        ("mean_gradient", lambda x: np.zeros(x.shape[:-1]), "its mean_gradient returned the shape (); it must be (4,)"),
        ("std", lambda x: np.full(x.shape[:-1], np.nan), "its std returned nan"),
        ("std", lambda x: np.full(x.shape[:-1], -1.0), "its std returned -1; it must be finite and not negative"),
        ("std_gradient", lambda x: np.zeros((9, 9)), "its std_gradient returned the shape (9, 9)"),
        ("noise_std", lambda x: np.nan, "its noise_std returned nan"),
        ("noise_std", lambda x: -1.0, "its noise_std returned -1"),
        ("mean", lambda x: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_a_wrong_answer_is_refused_when_the_model_is_fitted(method: str, answer: Answer, reason: str) -> None:
    fit_residual(model_of(), steps())
    with pytest.raises(ResidualError, match=re.escape(f"residual 'told': {reason}")):
        fit_residual(model_of(**{method: answer}), steps())


def test_a_fit_that_fails_or_makes_no_regression_names_the_model() -> None:
    def no_space(data: TrainingData) -> Regression:
        raise OSError(28, "No space left")

    with pytest.raises(ResidualError, match=r"residual 'told': OSError: .*No space left"):
        fit_residual(replace(model_of(), fit=no_space), steps())
    with pytest.raises(ResidualError, match="residual 'told': made None; it must make a Regression"):
        fit_residual(replace(model_of(), fit=lambda data: None), steps())  # pyright: ignore[reportArgumentType]


def test_what_cannot_be_saved_or_read_names_the_model(packages: Path) -> None:
    with pytest.raises(ResidualError, match="residual 'told': TypeError: Object of type object is not JSON"):
        saved_model_text(fit_residual(model_of(to_dict=lambda x: None), steps()), SPACE, NominalSource(MAP, NOMINAL))
    code = "from dataclasses import replace\nfrom stepgap.learning.zero import NONE\n"
    code += "def fail(saved): raise RuntimeError('no memory')\nMODEL = replace(NONE, name='own', from_dict=fail)"
    install(packages, "broken", code, own="broken:MODEL")
    with pytest.raises(ResidualError, match="residual 'own': RuntimeError: no memory"):
        residual_from_dict(fit_residual("own", steps()).to_dict())


@pytest.mark.parametrize("believed", [False, True], ids=["alone", "with beliefs"])
@pytest.mark.parametrize("method", ["mean", "std"])
def test_no_motor_gets_the_command_of_a_residual_without_a_prediction(method: str, *, believed: bool) -> None:
    """It has predictions at the steps that it was fitted to, but none for the commands of the deployment."""
    known, residual = sparse(method)
    beliefs = Learner.start(NOMINAL, known, LearningSettings("linear"), 1).beliefs if believed else None
    learner = Learner.restored(NOMINAL, known, LearningSettings("linear"), 1, residual, beliefs)
    plant = ModelPlant(REALITY, np.array([0.1, 0.55]), NOISE, np.random.default_rng(0))
    reference = Reference.from_segments(("speed", "height"), [(1, (0.2, 0.58))], steps=3)
    name = "posterior" if believed else "told"
    with pytest.raises(ResidualError, match=f"residual '{name}': its {method} returned nan"):
        next(deploy(learner, plant, reference, 1))


def sparse(method: str) -> tuple[Steps, Residual]:
    """Some steps, and a residual that predicts nothing for other commands."""
    known = log_of(hops(REALITY, 12, seed=0))

    def answer(point: np.ndarray) -> np.ndarray:
        return np.where((point[..., None, 2:] == known.requested).all(axis=-1).any(axis=-1), 0.01, np.nan)

    return known, fit_residual(model_of(**{method: answer}), observe(known, NOMINAL))


@pytest.mark.parametrize("code", ["", "MODEL = 3", "import no_such_package"])
def test_a_model_that_cannot_be_loaded_is_refused_before_the_first_deployment(packages: Path, code: str) -> None:
    install(packages, "broken", code, own="broken:MODEL")
    with pytest.raises(InputError, match="residual 'own'"):
        Learner.start(NOMINAL, log_of([]), LearningSettings("own"), 0)


def test_a_model_that_cannot_be_used_is_left_out_of_comparisons(packages: Path) -> None:
    code = "from stepgap.learning.regression import ResidualModel\n"
    code += "FAILS = ResidualModel('fails', '', lambda data: None, lambda saved: None, candidate=False)"
    install(packages, "broken", code, missing="broken:NONE", fails="broken:FAILS")
    with pytest.warns(StepGapWarning, match="left out: residual 'missing': broken:NONE of broken cannot be imported"):
        names = [model.name for model in residual_models()]
    assert {"none", "linear", "fails"} < set(names)
    data = steps_with(lambda state, command: 0 * state, 40, seed=0)
    with pytest.warns(StepGapWarning, match="left out: residual 'fails': made None"):
        assert list(validate(("none", "fails"), data, contiguous_folds(40, 2)).held_out) == ["none"]
    with pytest.warns(StepGapWarning, match="left out: residual 'fails': made None"):
        assert list(validate_on(("none", "fails"), data, data).held_out) == ["none"]
