"""What the steps of a deployment fell short of their targets, for later targets to make up for it.

It is the sum of what all steps were short of. Where states are velocities of a body that moves in a plane, such sums
are not its place: it turns, and what was to its left is then elsewhere. There the pose to which the targets lead and
that of the body are followed apart, each along an arc in each step, and what is behind is their difference, seen from
the body. A pose that is measured takes the place of the sum of measured velocities. On a way forward, only the distance
to its side is made up for.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array, StepSpace

NOWHERE: Final = np.zeros(3)
"""The pose at the begin: place in the plane [m] and heading [rad]."""

LEAST_UNKNOWN: Final = 1e30
"""A number of this size is no measurement, nor is NaN: its square could be infinite."""


@final
@dataclass(frozen=True, eq=False)
class Shortfall:
    """What the steps of a deployment so far fell short of their targets.

    Attributes:
        space: Names and units; with `planar_seconds`, the first three states are velocities of a body in a plane.
        total: Sum of the targets less the states; shape (n,).
        wanted: Pose to which the targets lead from `NOWHERE`; shape (3,).
        pose: Pose of the body, from `NOWHERE`; shape (3,).
        zero: Measured pose at `NOWHERE`, NaN where it was not yet measured; shape (3,).
    """

    space: StepSpace
    total: Array
    wanted: Array
    pose: Array
    zero: Array

    @classmethod
    def start(cls, space: StepSpace) -> Self:
        """Nothing is short before the first step."""
        return cls(space, np.zeros(len(space.state)), NOWHERE, NOWHERE, np.full(3, np.nan))

    @property
    def behind(self) -> Array:
        """What is to be made up for, as a sum of states over steps; shape (n,)."""
        seconds = self.space.planar_seconds
        if not seconds:
            return self.total
        turn = (self.wanted[2] - self.pose[2] + pi) % (2 * pi) - pi
        return np.concatenate([np.array([*self._way, turn]) / seconds, self.total[3:]])

    @property
    def _way(self) -> tuple[float, float]:
        """Where it should be, forward and to the left of where it is [m]."""
        return turned(-self.pose[2], *(self.wanted - self.pose)[:2])

    def after(self, target: Array, state: Array, pose: Array, part: float = 1.0) -> Self:
        """The shortfall after a step.

        Args:
            target: Its target, NaN in coordinates without one; shape (n,).
            state: At its end, where the target counts as reached if it is not measured; shape (n,).
            pose: Place [m] and heading [rad] at its end, from any zero, NaN where they are not measured; shape (3,).
            part: Part of its duration after which it was ended.
        """
        target = np.where(_is_known(target), target, np.where(_is_known(state), state, 0.0))
        state = np.where(_is_known(state), state, target)
        total = self.total + part * (target - state)
        seconds = part * self.space.planar_seconds
        if not seconds:
            return replace(self, total=total)
        wanted = moved(self.wanted, target[:3] * seconds)
        summed = moved(self.pose, state[:3] * seconds)
        measured = np.where(_is_known(pose), pose, np.nan)
        zero = _zero_of(self.zero, summed, measured)
        after = replace(self, total=total, wanted=wanted, pose=_corrected(summed, measured, zero), zero=zero)
        if not target[0]:
            return after
        # What it was too slow is forgotten: who makes up for it at the limits of a gait makes the robot fall.
        lost = turned(after.pose[2], after._way[0], 0.0)
        return replace(after, wanted=wanted - np.array([*lost, 0.0]))


def moved(pose: Array, way: Array) -> Array:
    """A pose (3,) after a way along an arc: forward and to the left [m], and how far it turned [rad]; shape (3,)."""
    ahead, left, turn = way
    chord = np.sinc(turn / (2 * pi))
    return pose + np.array([*turned(pose[2] + turn / 2, chord * ahead, chord * left), turn])


def turned(angle: Array | float, x: Array | float, y: Array | float) -> tuple[Any, Any]:
    """Vectors turned to the left by angles [rad]: numbers, or arrays of one shape."""
    cos = np.cos(angle)
    sin = np.sin(angle)
    return cos * x - sin * y, sin * x + cos * y


def _is_known(values: Array) -> NDArray[np.bool_]:
    """Which values are measurements."""
    return np.abs(values) < LEAST_UNKNOWN


def _zero_of(zero: Array, pose: Array, measured: Array) -> Array:
    """The measured pose at `NOWHERE`, of which what was not known follows from that at another pose."""
    turn = zero[2] if np.isfinite(zero[2]) else measured[2] - pose[2]
    return np.where(np.isfinite(zero), zero, [*(measured[:2] - turned(turn, *pose[:2])), turn])


def _corrected(pose: Array, measured: Array, zero: Array) -> Array:
    """A pose from the sum of velocities, with what is measured of it in its place."""
    heading = measured[2] - zero[2]
    place = turned(-zero[2], *(measured[:2] - zero[:2]))
    return np.where(np.isfinite([*place, heading]), [*place, heading], pose)
