"""The interface of a smooth piece of motion, and linear combinations of its states; knows no robot.

A state is a tuple of four numbers, two coordinates and their rates. A system is the NamedTuple of the constants of one
smooth piece; its type selects the implementation of the functions here, through `implements`. States are tuples, not
arrays: compiled code keeps them in registers, and their lengths are known at compile time.
"""

from typing import Any

from stepgap.base.compiled import compiled


def rate(system, state) -> Any:
    """Time derivative of the state, which does not depend on time itself; a tuple of four. See `implements`."""
    raise TypeError(f"no rate is implemented for {type(system).__name__}")


def rate_and_guards(system, time, state) -> Any:
    """(rate, guards) at a time since the start of the phase that the piece belongs to [s]; see `implements`.

    Guards are a tuple of scalars, each positive within the piece; it ends where the first of them becomes zero. One
    function returns rate and guards because they share most of their computation.
    """
    raise TypeError(f"no guards are implemented for {type(system).__name__}")


def rate_jacobian(system, state, here) -> Any:
    """∂rate/∂state of a stiff piece, or None for one that is not stiff; it selects the method. See `implements`.

    Args:
        system: Constants of the piece.
        state: State at which it is evaluated.
        here: The rate there.
    """
    raise TypeError(f"no Jacobian of the rate is implemented for {type(system).__name__}")


@compiled
def axpy(state, factor, weights, vectors):
    """Computes state + factor · Σ weights · vectors."""
    sum_0 = 0.0
    sum_1 = 0.0
    sum_2 = 0.0
    sum_3 = 0.0
    for weight, vector in zip(weights, vectors):  # noqa: B905  (Numba has no `strict`)
        sum_0 += weight * vector[0]
        sum_1 += weight * vector[1]
        sum_2 += weight * vector[2]
        sum_3 += weight * vector[3]
    return state[0] + factor * sum_0, state[1] + factor * sum_1, state[2] + factor * sum_2, state[3] + factor * sum_3


@compiled
def hermite(start, here, end, there, h, s):
    """Cubic Hermite interpolant at fraction s of a step of size h, from states and rates at its ends."""
    weights = ((2.0 * s - 3.0) * s * s, s * s * (3.0 - 2.0 * s), h * s * (1.0 - s) ** 2, h * s * s * (s - 1.0))
    return axpy(start, 1.0, weights, (start, end, here, there))
