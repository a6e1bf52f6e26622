"""The closed loop near a limit cycle: how the step controller responds to a state error, and how that error evolves.

At a constant command an error of the state is multiplied by A = ∂next/∂state in each step. The step controller changes
the command by K times the error, so that it is multiplied by A + B K, with B = ∂next/∂command.
"""

import numpy as np

from stepgap.control.cost_to_go import goals_for
from stepgap.control.limit_cycle import FixedPoint
from stepgap.step import Array, StepMap

AT_BOUND = 1e-6
"""Distance of a command from its bound below which it counts as lying on it, in half ranges."""


def step_controller_gain(step_map: StepMap, point: FixedPoint) -> Array:
    """∂command/∂state of the step controller of a map at a state that it holds, with this state as the target.

    The command is the one of least error, as `CautiousController` finds it on a certain map; where several have none,
    the nearest one. Its error is zero at the point, so the derivative is that of linear least squares, −B⁺ A, with the
    derivatives A, B of the errors. A command on its bound stays there.

    Args:
        step_map: The map.
        point: State and command.

    Returns:
        K; shape (m, n), NaN where the map has no Jacobian.
    """
    space = step_map.space
    n, m = len(space.state), len(space.command)
    jacobian = step_map.jacobian(point.state, point.command)
    if not np.isfinite(jacobian).all():
        return np.full((m, n), np.nan)
    (goal,) = goals_for(step_map, np.where(point.wanted, point.state, np.nan)[None]).onward
    jacobian = goal.errors_by(jacobian)
    free = np.abs(space.point_of(point.command)) < 1 - AT_BOUND
    gain = np.zeros((m, n))
    gain[free] = -np.linalg.pinv((jacobian[:, n:] * space.command_scale)[:, free]) @ jacobian[:, :n]
    return gain * space.command_scale[:, None]


def largest_multiplier(jacobian: Array, gain: Array | None = None) -> Array:
    """Largest magnitude of the Floquet multipliers, the eigenvalues of A + B K, or of A at a constant command.

    Args:
        jacobian: Derivatives of the next state, A and B side by side; shape (…, n, n + m).
        gain: K; shape (m, n). None: constant command.

    Returns:
        Shape (…), NaN where a derivative is not known.
    """
    n = jacobian.shape[-2]
    matrix = jacobian[..., :n] if gain is None else jacobian[..., :n] + jacobian[..., n:] @ gain
    known = np.asarray(np.isfinite(matrix).all(axis=(-2, -1), keepdims=True))
    sizes = np.abs(np.linalg.eigvals(np.where(known, matrix, 0.0))).max(axis=-1)
    return np.where(known[..., 0, 0], sizes, np.nan)
