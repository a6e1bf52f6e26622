"""The corrected map as a function of CasADi, which differentiates it, built from the documented model."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Final

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.versions import INSTALL

SMALLEST_SQUARE: Final = 1e-30
"""Added to a squared distance, so that its root has a derivative where it is zero."""


def casadi_function(document: Mapping[str, Any]) -> Any:
    """The map (state, command) → (next_state, std) as a `casadi.Function`; its derivatives are those of CasADi.

    It has no failures: a step that would fail has the next state of the continued polynomial.

    Args:
        document: The model as `model_document` returns it.

    Raises:
        InputError: The package casadi is not installed.
    """
    casadi = _package()
    state, command = (casadi.MX.sym(key, len(document[key])) for key in ("state", "command"))
    point = casadi.vertcat(state, command)
    parts = [_regression(casadi, each, point) for each in document["residual"]["regressions"]]
    mean, std = (casadi.vertcat(*column) for column in zip(*parts, strict=True))
    next_state = _nominal(casadi, document["nominal"], point) + mean
    names = ["state", "command"], ["next_state", "std"]
    return casadi.Function("stepgap_map", [state, command], [next_state, std], *names)


def casadi_text(document: Mapping[str, Any]) -> str:
    """Content of the file that `casadi.Function.load` reads; see `casadi_function`."""
    return casadi_function(document).serialize()


def _nominal(casadi: Any, nominal: Mapping[str, Any], point: Any) -> Any:
    """Next state of the nominal map."""
    if nominal["kind"] == "affine":
        origin = casadi.DM([*nominal["state"], *nominal["command"]])
        return casadi.DM(nominal["next_state"]) + casadi.DM(nominal["matrix"]) @ (point - origin)
    scaled = (point - casadi.DM(nominal["centre"])) / casadi.DM(nominal["scale"])
    inside = casadi.fmin(casadi.fmax(scaled, -1), 1)
    degrees = np.array(nominal["degrees"])
    pairs = [_legendre(casadi, inside[axis], each) for axis, each in enumerate(degrees.T)]
    factors = [value for value, _ in pairs]
    basis = _product(factors)
    for axis, (_, derivative) in enumerate(pairs):
        by_axis = _product([*factors[:axis], derivative, *factors[axis + 1 :]])
        basis = basis + by_axis * (scaled[axis] - inside[axis])
    return casadi.DM(nominal["weights"]).T @ basis


def _legendre(casadi: Any, x: Any, degrees: Any) -> tuple[Any, Any]:
    """Legendre polynomials of these degrees (T,) and their derivatives, as columns."""
    values, derivatives = [casadi.MX(1), x], [casadi.MX(0), casadi.MX(1)]
    for k in range(1, degrees.max(initial=1)):
        values.append(((2 * k + 1) * x * values[k] - k * values[k - 1]) / (k + 1))
        derivatives.append(derivatives[k - 1] + (2 * k + 1) * values[k])
    value, derivative = casadi.vertcat(*values), casadi.vertcat(*derivatives)
    chosen = degrees.tolist()
    return value[chosen], derivative[chosen]


def _regression(casadi: Any, part: Mapping[str, Any], point: Any) -> tuple[Any, Any]:
    """Mean and standard deviation of a regression."""
    if part["kind"] == "zero":
        return casadi.MX(0), casadi.MX(0)
    if part["kind"] == "polynomial":
        scaled = (point - casadi.DM(part["centre"])) / casadi.DM(part["scale"])
        basis = _product([_power(casadi, scaled[i], each) for i, each in enumerate(np.array(part["degrees"]).T)])
        mean = casadi.DM(part["weights"]).T @ basis
        return mean, casadi.sqrt(casadi.bilin(casadi.DM(part["covariance"]), basis, basis))
    return _gaussian_process(casadi, part, point)


def _power(casadi: Any, x: Any, degrees: Any) -> Any:
    """Powers of these degrees (T,) as a column."""
    powers = [casadi.MX(1)]
    for _ in range(degrees.max(initial=0)):
        powers.append(powers[-1] * x)
    return casadi.vertcat(*powers)[degrees.tolist()]


def _gaussian_process(casadi: Any, part: Mapping[str, Any], point: Any) -> tuple[Any, Any]:
    length, centres = np.array(part["length_scale"]), np.array(part["centres"])
    away = casadi.repmat((point / casadi.DM(length)).T, len(centres), 1) - casadi.DM(centres / length)
    kernel = _kernel(casadi, part["kernel"], casadi.sum2(away**2))
    linear = point - casadi.DM(part["origin"])
    slopes, weights = casadi.DM(part["slopes"]), casadi.DM(part["weights"])
    mean = part["constant"] + slopes.T @ linear + weights.T @ kernel
    white = casadi.DM(np.linalg.inv(part["centre_factor"])) @ kernel
    rows = np.linalg.inv(part["weight_factor"])
    features = casadi.vertcat(white, linear * casadi.DM(part["slope_scale"]), 1)
    response = casadi.DM(rows[:-1] if part["constant_is_exact"] else rows) @ features
    variance = casadi.fmax(1 - casadi.sumsqr(white), 0) + casadi.sumsqr(response)
    return mean, part["signal_std"] * casadi.sqrt(variance)


def _kernel(casadi: Any, name: str, squared: Any) -> Any:
    """Covariance of f at squared distances."""
    if name == "squared exponential":
        return casadi.exp(-squared / 2)
    r = casadi.sqrt(5 * squared + SMALLEST_SQUARE)
    return (1 + r + r**2 / 3) * casadi.exp(-r)


def _product(factors: Sequence[Any]) -> Any:
    """Product, element by element."""
    total = factors[0]
    for factor in factors[1:]:
        total = total * factor
    return total


def _package() -> Any:
    try:
        return import_module("casadi")
    except ImportError:
        raise InputError(f"--to casadi needs casadi: {INSTALL} 'stepgap[casadi]'") from None
