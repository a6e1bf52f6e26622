"""Poincaré sections of a MuJoCo model: the guard function whose fall through zero ends a step."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import mujoco

Guard = Callable[[Any, Any], float]
"""Function of a MuJoCo model and its data; a step ends when it falls through zero."""


@final
@dataclass(frozen=True, eq=False)
class Section:
    """The end of a step: a guard falls through zero after it has been larger than a threshold.

    Attributes:
        guard: Function of model and data.
        threshold: The guard must have been larger since the last section, so that a bouncing contact is one section.
    """

    guard: Guard
    threshold: float = 0.0


def apex(joint: str, threshold: float = 0.05) -> Section:
    """The highest point: the velocity of a vertical slide joint, upward positive, falls through zero.

    Args:
        joint: Name of the joint.
        threshold: Velocity that must have been exceeded [m/s].
    """
    return Section(lambda model, data: float(data.qvel[model.joint(joint).dofadr[0]]), threshold)


def touchdown(*feet: str, threshold: float = 0.005) -> Section:
    """The first contact of one of the feet with the ground after a time in which none of them touched it.

    Heel strike is the touchdown of a heel.

    Args:
        feet: Names of the geoms that touch the ground.
        threshold: Clearance of all feet that must have been exceeded [m].
    """
    return Section(lambda model, data: min(clearance(model, data, foot) for foot in feet), threshold)


def clearance(model: Any, data: Any, geom: str, ground: str = "floor") -> float:
    """Distance between a geom and the ground, negative in contact [m].

    Args:
        model: MuJoCo model.
        data: Its data.
        geom: Name of the geom.
        ground: Name of the ground's geom.
    """
    return float(mujoco.mj_geomDistance(model, data, model.geom(geom).id, model.geom(ground).id, 1.0, None))
