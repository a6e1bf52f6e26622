"""Poincaré sections of a MuJoCo model: the guard function whose fall through zero ends a step."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import mujoco

from stepgap.base.ranges import require

Guard = Callable[[Any, Any], float]  # Function of a MuJoCo model and its data; a step ends when it falls through zero


@final
@dataclass(frozen=True, eq=False)
class Section:
    """The end of a step: a guard falls through zero after it has been larger than a threshold.

    Attributes:
        guard: Function of model and data.
        threshold: The guard must have been larger since the last section, so that a bouncing contact is one section.
        others: Guards with the same threshold. If there are some, a step ends where another guard falls through zero
            than at its begin; the first step begins at the guard that is smallest where the robot is placed.
    """

    guard: Guard
    threshold: float = 0.0
    others: tuple[Guard, ...] = ()


def apex(joint: str, threshold: float = 0.05) -> Section:
    """The highest point: the velocity of a vertical slide joint, upward positive, falls through zero.

    Args:
        threshold: Velocity that must have been exceeded [m/s].
    """
    return Section(lambda model, data: float(data.qvel[model.joint(joint).dofadr[0]]), threshold)


def every(seconds: float) -> Section:
    """Times at equal intervals, from where the robot is placed on, as for walking with a commanded velocity.

    Args:
        seconds: Duration of a step, a multiple of the robot's tick [s].
    """

    def phase(model: Any, data: Any) -> float:
        return (data.time + 0.5 * model.opt.timestep) / seconds % 1.0 - 0.5  # the time is a sum, and not exact

    return Section(phase)


def touchdown(*feet: str | int, threshold: float = 0.005) -> Section:
    """The first contact of one of the feet with the ground after a flight, in which none of them touched it.

    A robot that walks has no flight: its steps end at `next_foot`, or at the touchdown of one foot alone (a stride).
    Heel strike is the touchdown of a heel.

    Args:
        feet: Names, or numbers, of the geoms that touch the ground.
        threshold: Clearance of all feet that must have been exceeded [m].
    """
    return Section(_lowest(feet), threshold)


def next_foot(*feet: str | int | tuple[str | int, ...], threshold: float = 0.005) -> Section:
    """Alternate-foot touchdown, as in walking: another foot touches the ground than at the begin of the step.

    Since the feet take turns, `state` must be the same for both, such as mirrored; `place` puts the model on one foot.

    Args:
        feet: Names, or numbers, of the geoms that touch the ground; those that swing together, as in a trot, as tuple.
        threshold: Clearance of a foot that must have been exceeded before it touches down [m].

    Raises:
        ValueError: There are fewer than two feet.
    """
    require(len(feet) > 1, "feet", list(feet), "be at least two; the touchdown of one is `touchdown`")
    first, *others = (_lowest(foot if isinstance(foot, tuple) else (foot,)) for foot in feet)
    return Section(first, threshold, tuple(others))


def _lowest(feet: tuple[str | int, ...]) -> Guard:
    """Clearance of the lowest of some feet."""
    return lambda model, data: min(clearance(model, data, foot) for foot in feet)


def clearance(model: Any, data: Any, geom: str | int, ground: str = "floor") -> float:
    """Distance between a geom and the ground, negative in contact [m].

    Args:
        geom: Name or number of the geom.
        ground: Name of the ground's geom.
    """
    return float(mujoco.mj_geomDistance(model, data, model.geom(geom).id, model.geom(ground).id, 1.0, None))
