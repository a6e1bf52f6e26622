"""Monomials of several inputs, which are the features of a polynomial, and their derivatives."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array


@cache
def pairs(inputs: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Factors i ≤ j of all products; a planner asks for them some hundred times a step."""
    return np.triu_indices(inputs)


def number_of_monomials(inputs: int, degree: int) -> int:
    """Number of monomials up to a degree, d_φ."""
    return sum([1, inputs, inputs * (inputs + 1) // 2][: degree + 1])


def monomials(x: Array, degree: int) -> Array:
    """1, xᵢ, xᵢ xⱼ (i ≤ j) up to a degree; (…, d) to (…, d_φ)."""
    i, j = pairs(x.shape[-1])
    parts = [np.ones((*x.shape[:-1], 1)), x, x[..., i] * x[..., j]][: degree + 1]
    return np.concatenate(parts, axis=-1)


def monomials_gradient(x: Array, degree: int) -> Array:
    """∂monomial/∂x; (…, d) to (…, d_φ, d)."""
    d = x.shape[-1]
    i, j = pairs(d)
    unit = np.eye(d)
    products = unit[i] * x[..., j, None] + unit[j] * x[..., i, None]
    parts = [np.zeros((*x.shape[:-1], 1, d)), np.broadcast_to(unit, (*x.shape[:-1], d, d)), products][: degree + 1]
    return np.concatenate(parts, axis=-2)
