"""The documented model: one object for JSON with everything that another program needs to compute a controller.

docs/model_file.md has its keys and formulas. What is exported to ONNX and CasADi is computed from this object alone.
"""

import json
from collections.abc import Mapping
from importlib.metadata import version
from math import isfinite, nan
from typing import Any, Final

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.cautious_controller import FAILURE_RADIUS, RISK
from stepgap.control.goal import CAUTION
from stepgap.export.controller.portable_controller import PortableController
from stepgap.gauss.gaussian_process import SparseGaussianProcess
from stepgap.gauss.kernel import MATERN_52, SQUARED_EXPONENTIAL
from stepgap.gauss.monomials import monomials
from stepgap.learning import beliefs as rules
from stepgap.learning.beliefs import Beliefs
from stepgap.learning.beliefs_data import beliefs_from_dict, beliefs_to_dict
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.observations import no_observations
from stepgap.learning.polynomial import Polynomial
from stepgap.learning.posterior import Posterior, features_to_dict
from stepgap.learning.regression import Regression
from stepgap.learning.zero import Zero
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import NEIGHBOURS, SurrogateMap, exponents_of
from stepgap.step import Quantity, StepMap, StepStatus

FORMAT: Final = "StepGap model"  # Value of the key `format`
MODEL_SCHEMA: Final = 5  # Number of the format; it grows with every change that a reader must know of

CONSTANTS: Final = (
    "PERIODIC_STD", "HAZARD", "RETURN_HAZARD", "FIRST_HAZARD", "WRONG", "WRONG_WIDTH", "WRONG_FREEDOM", "SUSPECT",
    "ACCIDENTS", "WIDER", "WIDENINGS", "LEAST_TRUST", "LEAST_WEIGHT", "SAME_MEAN", "SAME_SPREAD", "RECENT", "MOST",
    "YOUNG", "REPORTED_ODDS", "SUDDEN",
)  # fmt: skip
"""Names of the constants in `learning.beliefs` that say what happens after a step; the rest has happened before."""


def model_document(controller: PortableController) -> dict[str, Any]:
    """The documented model of a controller, as objects for JSON.

    Args:
        controller: The controller.

    Raises:
        InputError: Its residual has a kernel that is not documented.
    """
    residual = controller.residual
    settings = controller.settings
    return {
        "format": FORMAT,
        "schema": MODEL_SCHEMA,
        "stepgap": version("stepgap"),
        "passport": dict(controller.passport),
        "state": [{**_quantity(quantity), "weight": quantity.weight} for quantity in controller.space.state],
        "command": [_quantity(quantity) for quantity in controller.space.command],
        **({"lagged": True} if controller.space.is_lagged else {}),
        **({"planar_seconds": controller.space.planar_seconds} if controller.space.planar_seconds else {}),
        "nominal": _nominal(controller.nominal),
        "residual": {
            "kind": residual.kind,
            "regressions": [_regression(regression) for regression in residual.regressions],
        },
        "beliefs": None if controller.beliefs is None else _beliefs(controller, controller.beliefs),
        "control": {
            "cautious": settings.cautious,
            "viability": settings.viability,
            "avoid_failures": settings.avoid_failures,
            "evaluations": settings.evaluations,
            "horizon": settings.horizon,
            "largest_change": settings.largest_change,
            "farthest": None if controller.farthest is None else controller.farthest.tolist(),
            "surprise": settings.surprise if isfinite(settings.surprise) else None,
            "make_up": settings.make_up,
            "caution": CAUTION,
            "risk": RISK,
            "failure_radius": FAILURE_RADIUS,
        },
        "failures": controller.failures.tolist(),
        "approximations": list(controller.approximations),
        "notes": list(controller.notes),
    }


def model_text(controller: PortableController) -> str:
    """Text of the model file of a controller."""
    return json.dumps(model_document(controller), ensure_ascii=False, allow_nan=False) + "\n"


def believed_regressions(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The mixture of the beliefs in a document before a first step of unknown phase, as regressions; none without."""
    if document["beliefs"] is None:
        return []
    space = document["state"] + document["command"]
    lower, upper = (np.array([quantity[key] for quantity in space]) for key in ("lower", "upper"))
    sizes = len(document["state"]), len(document["command"])
    beliefs = beliefs_from_dict(document["beliefs"], sizes)
    mixture = beliefs.mixture(nan)
    count = beliefs.features.count
    return [
        {
            "kind": "posterior",
            "centre": ((lower + upper) / 2).tolist(),
            "scale": ((upper - lower) / 2).tolist(),
            "value_scale": (upper - lower)[coordinate] / 2,
            "features": document["beliefs"]["features"],
            "weights": mixture.mean[coordinate, :count].tolist(),
            "covariance": mixture.covariance[coordinate, :count, :count].tolist(),
            "noise_std": float(np.sqrt(mixture.noise[coordinate])) * (upper - lower)[coordinate] / 2,
        }
        for coordinate in range(sizes[0])
    ]


def _quantity(quantity: Quantity) -> dict[str, Any]:
    return {"name": quantity.name, "unit": quantity.unit, "lower": quantity.lower, "upper": quantity.upper}


def _nominal(nominal: StepMap) -> dict[str, Any]:
    if isinstance(nominal, AffineMap):
        names = ("state", "command", "next_state", "matrix")
        return {"kind": "affine", **{name: getattr(nominal, name).tolist() for name in names}}
    if isinstance(nominal, SurrogateMap):
        names = ("centre", "scale", "weights", "error")
        degrees = exponents_of(len(nominal.centre), nominal.degree)
        failed = nominal.samples.status != StepStatus.OK
        samples = {"points": nominal.samples.points.tolist(), "status": nominal.samples.status.tolist()}
        return {
            "kind": "legendre",
            "degrees": degrees.tolist(),
            **{name: getattr(nominal, name).tolist() for name in names},
            "neighbours": NEIGHBOURS,
            "samples": samples if failed.any() else {"points": [], "status": []},
        }
    raise TypeError(f"{type(nominal).__name__} is not portable")


def _regression(regression: Regression) -> dict[str, Any]:
    """The numbers that a prediction needs, and the data that they follow from."""
    data = {"noise_std": regression.noise_std, "data": regression.to_dict()}
    if isinstance(regression, Zero):
        return {"kind": "zero", **data}
    if isinstance(regression, Posterior):
        return {"kind": "posterior", **_posterior(regression), **data}
    if isinstance(regression, Polynomial):
        return {"kind": "polynomial", **_polynomial(regression), **data}
    if isinstance(regression, GaussianProcessRegression) and isinstance(regression.process, SparseGaussianProcess):
        numbers = _gaussian_process(regression.process)
        return {"kind": "gaussian_process", "constant_is_exact": regression.plug_in, **numbers, **data}
    raise TypeError(f"{type(regression).__name__} is not portable")


def _posterior(posterior: Posterior) -> dict[str, Any]:
    count = posterior.features.count
    return {
        "centre": posterior.data.centre.tolist(),
        "scale": posterior.data.scale.tolist(),
        "value_scale": posterior.data.value_scale,
        "features": features_to_dict(posterior.features),
        "weights": posterior.mean_weights[:count].tolist(),
        "covariance": posterior.covariance[:count, :count].tolist(),
    }


def _beliefs(controller: PortableController, beliefs: Beliefs) -> dict[str, Any]:
    """The beliefs before the first step, what their arithmetic needs, and the steps that they were learned from."""
    steps = no_observations(controller.space) if controller.steps is None else controller.steps
    return {
        **beliefs_to_dict(beliefs),
        "constants": {name.lower(): getattr(rules, name) for name in CONSTANTS},
        "probes": beliefs.probes.tolist(),
        "steps": {"state": steps.state.tolist(), "command": steps.command.tolist(), "error": steps.error.tolist()},
    }


def _polynomial(polynomial: Polynomial) -> dict[str, Any]:
    inputs = len(polynomial.data.centre)
    # The degree of x in a monomial is its logarithm to base 2 where x is 2 and the other inputs are 1.
    degrees = np.log2(monomials(1 + np.eye(inputs), polynomial.degree)).T.astype(int)
    return {
        "centre": polynomial.data.centre.tolist(),
        "scale": polynomial.data.scale.tolist(),
        "degrees": degrees.tolist(),
        "weights": polynomial.weights.tolist(),
        "covariance": polynomial.weight_covariance.tolist(),
    }


def _gaussian_process(process: SparseGaussianProcess) -> dict[str, Any]:
    covariance, (weights, slopes) = process.covariance, process.weights
    if process.kernel not in (MATERN_52, SQUARED_EXPONENTIAL):
        exported = f"{MATERN_52.name} or {SQUARED_EXPONENTIAL.name}"
        raise InputError(f"kernel {process.kernel.name}: cannot be exported; it must be {exported}")
    return {
        "kernel": process.kernel.name,
        "length_scale": covariance.length_scale.tolist(),
        "signal_std": process.hyper_parameters.signal_std,
        "centres": covariance.centres.tolist(),
        "origin": covariance.origin.tolist(),
        "slope_scale": covariance.slope_scale.tolist(),
        "constant": process.coefficient,
        "weights": weights.tolist(),
        "slopes": (slopes * covariance.slope_scale).tolist(),
        "centre_factor": process.inducing_factor.tolist(),
        "weight_factor": process.weight_factor.tolist(),
    }
