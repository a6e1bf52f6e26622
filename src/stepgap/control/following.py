"""Whether a robot follows what it is told, and what is changed of its next step because of that.

A run decides by a `Following`, and so does every exported controller: in Python by this code, in C by a port of it.
"""

from dataclasses import dataclass, replace
from math import inf, isfinite, sqrt
from statistics import fmean
from typing import Final, Self, final

import numpy as np

from stepgap.control.settings import ControlSettings
from stepgap.control.shortfall import LEAST_UNKNOWN, Shortfall
from stepgap.step import Array, StepSpace

MADE_UP: Final = 0.4  # Largest difference of a target by which errors before are made up for [half ranges]
SURPRISES: Final = 2  # Number of steps whose predictions are looked at for `control.surprise`


@final
@dataclass(frozen=True, eq=False)
class Following:
    """How a robot followed its commands in a deployment so far.

    Attributes:
        shortfall: What its steps fell short of their targets; nothing if that is not made up for.
        make_up: Number of steps over which it is made up for; 0 for not at all.
        surprise: Root mean square error of the latest predictions [half ranges] above which the command is the target.
        farthest: Largest distance of a command from the state that is allowed; None for any. Shape (m,).
        misses: Mean squares of the errors of the latest predictions that can be judged [half ranges²].
    """

    shortfall: Shortfall
    make_up: float = 0
    surprise: float = inf
    farthest: Array | None = None
    misses: tuple[float, ...] = ()

    @classmethod
    def start(cls, space: StepSpace, settings: ControlSettings, farthest: Array | None) -> Self:
        """Before the first step of a deployment.

        Args:
            space: Names, units and ranges.
            settings: Settings of step control.
            farthest: Largest distance of a command from the state in deployments before, shape (m,); infinite before
                the first redeployment, whose map is wrong. None where states are no velocities in a plane.
        """
        following = cls(Shortfall.start(space), settings.make_up)
        if farthest is None or not np.isfinite(farthest).all():
            return following
        limit = (1 + settings.widening) * farthest if isfinite(settings.widening) else None
        return replace(following, surprise=settings.surprise, farthest=limit)

    def wanted(self, targets: Array) -> Array:
        """Targets (…, n) of the next steps, with what is made up for."""
        if not self.make_up:
            return targets
        most = MADE_UP * self.shortfall.space.state_scale
        return targets + np.clip(self.shortfall.behind / self.make_up, -most, most)

    def told(self, state: Array, target: Array) -> Array | None:
        """The target as a command (m,), if the robot does not follow; else None.

        Args:
            state: Measured state; shape (n,).
            target: As of `wanted`, NaN in coordinates without one; shape (n,).
        """
        if len(self.misses) < SURPRISES or sqrt(fmean(self.misses)) <= self.surprise:
            return None
        space = self.shortfall.space
        told = np.where(np.isfinite(target), target, state)[: len(space.command)]
        return np.clip(told, space.command_lower, space.command_upper)

    def around(self, state: Array) -> tuple[Array, Array] | None:
        """Least and largest command at a state (n,) by `farthest`, each (m,); None for no limit."""
        if self.farthest is None:
            return None
        now = state[: len(self.farthest)]
        return now - self.farthest, now + self.farthest

    def after(self, target: Array, predicted: Array, state: Array, pose: Array, part: float = 1.0) -> "Following":
        """What is known after a step. What is not measured of it counts as reached, and says nothing of predictions.

        Args:
            target: Its target, NaN in coordinates without one; shape (n,).
            predicted: State that was predicted, NaN without a prediction; shape (n,).
            state: Measured state at its end; shape (n,).
            pose: As of `Shortfall.after`.
            part: Part of its duration after which it was ended.
        """
        away = (state - predicted) / self.shortfall.space.state_scale
        known = bool((np.abs(away) < LEAST_UNKNOWN).all())
        misses = (*self.misses, float(np.mean(away**2)))[-SURPRISES:] if known else self.misses
        shortfall = self.shortfall.after(target, state, pose, part) if self.make_up else self.shortfall
        return replace(self, misses=misses, shortfall=shortfall)
