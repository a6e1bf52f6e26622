"""What a smooth piece of motion says of itself, and sums over its states; knows no robot.

A state is a tuple of four numbers, two coordinates and their rates, and a system the NamedTuple of the constants of
one smooth piece. Its type selects, through `implements`, what the functions here stand for. Tuples, not arrays:
compiled code keeps them in registers, and their lengths are known when it is compiled.
"""

from typing import Any

from stepgap.base.compiled import compiled


def rate(system, state) -> Any:
    """Time derivative of the state, which does not depend on time itself; a tuple of four. See `implements`."""
    raise TypeError(f"no rate is implemented for {type(system).__name__}")


def rate_and_guards(system, time, state) -> Any:
    """(rate, guards) at a time since the start of the phase that the piece belongs to [s]; see `implements`.

    Guards are a tuple of scalars, each positive within the piece; it ends where the first of them ceases to be. Both
    come from one function because they share most of their work.
    """
    raise TypeError(f"no guards are implemented for {type(system).__name__}")


def rate_jacobian(system, state, here) -> Any:
    """∂rate/∂state for a piece that is stiff, None for one that is not: it selects the method. See `implements`.

    Args:
        system: Constants of the piece.
        state: Where.
        here: The rate there.
    """
    raise TypeError(f"no Jacobian of the rate is implemented for {type(system).__name__}")


@compiled
def _sum(weights, vectors, i):
    total = 0.0
    for j in range(len(weights)):
        total += weights[j] * vectors[j][i]
    return total


@compiled
def axpy(state, factor, weights, vectors):
    """State + factor · Σ weights · vectors."""
    return (
        state[0] + factor * _sum(weights, vectors, 0),
        state[1] + factor * _sum(weights, vectors, 1),
        state[2] + factor * _sum(weights, vectors, 2),
        state[3] + factor * _sum(weights, vectors, 3),
    )


@compiled
def hermite(start, here, end, there, h, s):
    """Cubic Hermite interpolant at fraction s of a step of size h, from states and rates at its ends."""
    weights = ((2.0 * s - 3.0) * s * s, s * s * (3.0 - 2.0 * s), h * s * (1.0 - s) ** 2, h * s * s * (s - 1.0))
    return axpy(start, 1.0, weights, (start, end, here, there))
