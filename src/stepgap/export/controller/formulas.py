"""The formulas of docs/model_file.md, written once for all programs that compute the corrected map.

A value is a row of numbers, or in some programs one for each of many steps, and has the operators +, −, ·, / and @. The
other functions that formulas need are the `Algebra` of the program. All numbers are those of the documented model.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import mul
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Value = Any
"""Rows of numbers in a program; shape (B, d)."""

SMALLEST_SQUARE: Final = 1e-30
"""Added to a squared distance, so that its root has a derivative where it is zero."""


INVERSE: Final = "inverse_of_"
"""Before the name of a factor, key of its inverse, if a program has computed it once for all points."""


class Algebra(Protocol):
    """Functions of values in a program."""

    def constant(self, numbers: ArrayLike) -> Value:
        """A number, a row (d,) or a matrix."""

    def exp(self, x: Value) -> Value:
        """Exponential, number by number."""

    def sqrt(self, x: Value) -> Value:
        """Square root, number by number."""

    def cos(self, x: Value) -> Value:
        """Cosine, number by number."""

    def clipped(self, x: Value, lower: float, upper: float) -> Value:
        """The nearest numbers within limits."""

    def joined(self, parts: Sequence[Value]) -> Value:
        """Rows side by side."""

    def chosen(self, x: Value, columns: NDArray[np.int64]) -> Value:
        """Columns of rows."""

    def sum_of_squares(self, x: Value) -> Value:
        """Sum of the squares of each row; (B, 1)."""

    def squared_distances(self, x: Value, centres: NDArray[np.float64]) -> Value:
        """Squared distances to centres (k, d); (B, k)."""


def nominal_state(algebra: Algebra, nominal: Mapping[str, Any], point: Value) -> Value:
    """Next state of the nominal map, as if no step failed; (B, n)."""
    constant = algebra.constant
    if nominal["kind"] == "affine":
        moved = (point - constant([*nominal["state"], *nominal["command"]])) @ constant(np.transpose(nominal["matrix"]))
        return moved + constant(nominal["next_state"])
    scaled = scaled_point(algebra, nominal, point)
    inside = algebra.clipped(scaled, -1.0, 1.0)
    degrees = np.array(nominal["degrees"]).T
    pairs = [_legendre(algebra, _column(algebra, inside, axis), exponents) for axis, exponents in enumerate(degrees)]
    factors = [value for value, _ in pairs]
    basis = reduce(mul, factors)
    for axis, (_, derivative) in enumerate(pairs):
        by_axis = reduce(mul, [*factors[:axis], derivative, *factors[axis + 1 :]])
        basis = basis + by_axis * _column(algebra, scaled - inside, axis)
    return basis @ constant(nominal["weights"])


def scaled_point(algebra: Algebra, part: Mapping[str, Any], point: Value) -> Value:
    """(point − centre) / scale."""
    return (point - algebra.constant(part["centre"])) / algebra.constant(part["scale"])


def _legendre(algebra: Algebra, x: Value, degrees: NDArray[np.int64]) -> tuple[Value, Value]:
    """Legendre polynomials of x (B, 1) of these degrees (T,), and their derivatives; (B, T)."""
    one = x * 0.0 + 1.0
    values = [one, x]
    derivatives = [one * 0.0, one]
    for k in range(1, degrees.max(initial=1)):
        values.append((x * values[k] * (2.0 * k + 1) - values[k - 1] * float(k)) / (k + 1.0))
        derivatives.append(derivatives[k - 1] + values[k] * (2.0 * k + 1))
    return algebra.chosen(algebra.joined(values), degrees), algebra.chosen(algebra.joined(derivatives), degrees)


def regression(algebra: Algebra, part: Mapping[str, Any], point: Value) -> tuple[Value, Value]:
    """Mean and standard deviation of a regression; (B, 1) each."""
    if part["kind"] == "zero":
        nothing = algebra.sum_of_squares(point * 0.0)
        return nothing, nothing
    formulas = {"polynomial": _polynomial, "posterior": _posterior, "gaussian_process": _gaussian_process}
    return formulas[part["kind"]](algebra, part, point)


def corrections(
    algebra: Algebra, fitted: Sequence[Mapping[str, Any]], believed: Sequence[Mapping[str, Any]], point: Value
) -> list[tuple[Value, Value]]:
    """Mean and standard deviation of the error of each state coordinate; (B, 1) each.

    Args:
        algebra: Functions of values.
        fitted: The regressions of the fitted residual.
        believed: Those of what is believed of its remaining error; none if there are no beliefs.
        point: Rows of states and commands.
    """
    parts = [regression(algebra, part, point) for part in fitted]
    if not believed:
        return parts
    others = [regression(algebra, part, point) for part in believed]
    return [
        (mean + added, algebra.sqrt(std * std + more * more))
        for (mean, std), (added, more) in zip(parts, others, strict=True)
    ]


def _posterior(algebra: Algebra, part: Mapping[str, Any], point: Value) -> tuple[Value, Value]:
    features = _features(algebra, part["features"], scaled_point(algebra, part, point))
    spread = features @ algebra.constant(np.linalg.cholesky(np.array(part["covariance"])))
    mean = features @ _upright(algebra, part["weights"])
    unit = float(part["value_scale"])
    return mean * unit, algebra.sqrt(algebra.sum_of_squares(spread)) * unit


def _features(algebra: Algebra, features: Mapping[str, Any], scaled: Value) -> Value:
    """Monomials and waves of scaled points; (B, p)."""
    inputs = features["inputs"]
    waves = len(features["shifts"])
    rows, columns = np.triu_indices(inputs)
    parts = [_column(algebra, scaled, 0) * 0.0 + 1.0, scaled]
    if features["degree"] == 2:
        parts.append(algebra.chosen(scaled, rows) * algebra.chosen(scaled, columns))
    if waves:
        angles = scaled @ algebra.constant(np.transpose(features["frequencies"]))
        parts.append(algebra.cos(angles + algebra.constant(features["shifts"])) * float(np.sqrt(2.0 / waves)))
    return algebra.joined(parts)


def _polynomial(algebra: Algebra, part: Mapping[str, Any], point: Value) -> tuple[Value, Value]:
    scaled = scaled_point(algebra, part, point)
    factors = []
    for axis, degrees in enumerate(np.array(part["degrees"]).T):
        x = _column(algebra, scaled, axis)
        powers = [x * 0.0 + 1.0]
        for _ in range(degrees.max(initial=0)):
            powers.append(powers[-1] * x)
        factors.append(algebra.chosen(algebra.joined(powers), degrees))
    basis = reduce(mul, factors)
    spread = basis @ algebra.constant(np.linalg.cholesky(np.array(part["covariance"])))
    return basis @ _upright(algebra, part["weights"]), algebra.sqrt(algebra.sum_of_squares(spread))


def _gaussian_process(algebra: Algebra, part: Mapping[str, Any], point: Value) -> tuple[Value, Value]:
    """The standard deviation uses the inverses of the factors, since not all programs solve triangular systems."""
    constant = algebra.constant
    length = np.array(part["length_scale"])
    squared = algebra.squared_distances(point / constant(length), np.array(part["centres"]) / length)
    kernel = _kernel(algebra, part["kernel"], squared)
    linear = point - constant(part["origin"])
    slopes = linear @ _upright(algebra, part["slopes"])
    mean = kernel @ _upright(algebra, part["weights"]) + slopes + float(part["constant"])
    white = kernel @ constant(_inverse(part, "centre_factor").T)
    one = _column(algebra, linear, 0) * 0.0 + 1.0
    features = algebra.joined([white, linear * constant(part["slope_scale"]), one])
    rows = _inverse(part, "weight_factor")
    response = features @ constant((rows[:-1] if part["constant_is_exact"] else rows).T)
    conditional = algebra.clipped(constant(1.0) - algebra.sum_of_squares(white), 0.0, 1.0)
    return mean, algebra.sqrt(conditional + algebra.sum_of_squares(response)) * float(part["signal_std"])


def _inverse(part: Mapping[str, Any], key: str) -> NDArray[np.float64]:
    return part[INVERSE + key] if INVERSE + key in part else np.linalg.inv(np.array(part[key]))


def _kernel(algebra: Algebra, name: str, squared: Value) -> Value:
    if name == "squared exponential":
        return algebra.exp(squared * -0.5)
    r = algebra.sqrt(squared * 5.0 + SMALLEST_SQUARE)
    return (r + r * r / 3.0 + 1.0) * algebra.exp(r * -1.0)


def _column(algebra: Algebra, x: Value, axis: int) -> Value:
    """A column of rows; (B, 1)."""
    return algebra.chosen(x, np.array([axis]))


def _upright(algebra: Algebra, numbers: Sequence[float]) -> Value:
    """A constant column."""
    return algebra.constant(np.array(numbers)[:, None])
