"""The impact of feet on the ground."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from stepgap.step import Array


def landing_velocity(model: Any, data: Any, feet: Sequence[str]) -> Array:
    """Velocity (x, z) of the centre of mass just after the feet have stopped, by that before; shape (2, 2).

    All joints but x and z are at rest before. The impact is plastic: v⁺ = v⁻ − M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v⁻, where J is the
    Jacobian of the feet (Y. Hurmuzlu and D. B. Marghitu, Rigid body collisions of planar kinematic chains, 1994).

    Args:
        model: A model whose first two joints move it along x and z.
        data: Its data, in the posture of the landing.
        feet: Names of the geoms that touch the ground.
    """
    mujoco.mj_forward(model, data)
    jacobian, whole = np.zeros((len(feet), 3, model.nv)), np.zeros((3, model.nv))
    for foot, rows in zip(feet, jacobian, strict=True):
        mujoco.mj_jacGeom(model, data, rows, None, model.geom(foot).id)
    stopped = jacobian[:, [0, 2]].reshape(-1, model.nv)
    impulses = np.zeros_like(stopped)
    mujoco.mj_solveM(model, data, impulses, stopped)  # rows of J M⁻¹, because M is symmetric
    change = impulses.T @ np.linalg.pinv(stopped @ impulses.T) @ stopped
    mujoco.mj_jacSubtreeCom(model, data, whole, 1)
    return (whole[[0, 2]] @ (np.eye(model.nv) - change))[:, :2]
