"""Stationary kernels of a Gaussian process: the covariance of two points as a function of their distance."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from stepgap.step import Array


@final
@dataclass(frozen=True)
class Kernel:
    """A kernel k(r), a function of the distance r of two points in length scales, with k(0) = 1.

    Both functions take r² instead of r, because some kernels need no root, and return an array of the same shape.

    Attributes:
        name: Its name in the literature.
        covariance: k.
        radial_derivative: (dk/dr) / r, which is finite where two points coincide.
    """

    name: str
    covariance: Callable[[Array], Array]
    radial_derivative: Callable[[Array], Array]


def _matern_52(squared: Array) -> Array:
    distance = np.sqrt(5 * squared)
    return (1 + distance + distance**2 / 3) * np.exp(-distance)


def _matern_52_derivative(squared: Array) -> Array:
    distance = np.sqrt(5 * squared)
    return -5 / 3 * (1 + distance) * np.exp(-distance)


def _squared_exponential(squared: Array) -> Array:
    return np.exp(-0.5 * squared)


MATERN_52: Final = Kernel("Matérn 5/2", _matern_52, _matern_52_derivative)
"""k(r) = (1 + √5 r + 5r²/3) exp(−√5 r), twice differentiable (RW Eq. 4.17): that of the paper, and the default."""

SQUARED_EXPONENTIAL: Final = Kernel(
    "squared exponential", _squared_exponential, lambda squared: -_squared_exponential(squared)
)
"""k(r) = exp(−r²/2), infinitely differentiable (RW Eq. 4.9)."""
