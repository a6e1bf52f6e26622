"""Uneven ground by place: table `[ground]` of a robot, and the treads that a simulation makes of it.

Its parts add up: stairs of random heights, ramps that rise and fall in turn, a smooth random field, a measured profile,
and patches of another stiffness and friction. The ground repeats after a length, such as a turn of a boom. The same
seed gives the same ground.
"""

from dataclasses import dataclass, fields
from math import isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np

from stepgap.base.ranges import require
from stepgap.step import Array

LARGEST_SLOPE = 0.5
"""Steepest ramp, rise over length."""

FINEST = 0.01
"""Length of the straight pieces of a random field [m], or a tenth of its wave length where that is shorter."""

SHORTEST = 0.02
"""Shortest length of a tread, a ramp, a wave or a patch [m]."""

_STRIDE = 0.3
"""Distance of two footholds that limits expect [m]."""


class Treads(NamedTuple):
    """Straight pieces of a ground, one behind the other; between two of them there may be a riser.

    Attributes:
        start: Place at which each piece begins, ascending from 0 [m]; shape (k,).
        height: Height there [m]; shape (k,).
        slope: Rise over length in the piece; shape (k,).
        stiffness: Its stiffness as a part of that of the ground elsewhere; shape (k,).
        friction: Its coefficient of friction as a part of that of the ground elsewhere; shape (k,).
    """

    start: Array
    height: Array
    slope: Array
    stiffness: Array
    friction: Array


@dataclass(frozen=True)
class UnevenGround:
    """Uneven ground by place; flat by default.

    Attributes:
        stair_height: Largest height of a riser, up or down; their heights are drawn independently and uniformly [m].
        stair_length: Mean length of a tread [m]; each is between half and one and a half times as long.
        slope: Rise over length of ramps that rise and fall in turn.
        ramp_length: Length of a ramp [m].
        roughness: Standard deviation of a smooth random height [m].
        wave_length: Its shortest wave [m]; all longer ones that fit have the same amplitude.
        patch_stiffness: Stiffness of every other patch, as a part of that of the ground.
        patch_friction: Coefficient of friction of every other patch, as a part of that of the ground.
        patch_length: Length of a patch [m].
        measured_heights: Whether a robot without a simulation, too, measures heights above the ground that its foot
            finds at touchdown, and chooses the command anew there; on uneven ground it always does.
        inputs: Whether the slope and the yielding that a touchdown finds are inputs of the residual; `false` for a
            controller that will be exported.
    """

    stair_height: float = 0.0
    stair_length: float = 0.8
    slope: float = 0.0
    ramp_length: float = 1.5
    roughness: float = 0.0
    wave_length: float = 0.5
    patch_stiffness: float = 1.0
    patch_friction: float = 1.0
    patch_length: float = 1.0
    measured_heights: bool = False
    inputs: bool = True

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            require(isfinite(value), each.name, value, "be finite")
        for name in ("stair_height", "roughness"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "not be negative")
        require(0 <= self.slope <= LARGEST_SLOPE, "slope", self.slope, f"lie between 0 and {LARGEST_SLOPE:g}")
        for name in ("stair_length", "ramp_length", "wave_length", "patch_length"):
            require(getattr(self, name) >= SHORTEST, name, getattr(self, name), f"be at least {SHORTEST:g} m")
        for name in ("patch_stiffness", "patch_friction"):
            require(getattr(self, name) > 0, name, getattr(self, name), "be positive")

    @property
    def is_flat(self) -> bool:
        """Whether the ground is the same everywhere."""
        patches = self.patch_stiffness != 1 or self.patch_friction != 1
        return not (self.stair_height or self.slope or self.roughness or patches)

    @property
    def is_measured(self) -> bool:
        """Whether heights are those above the ground that was measured at touchdown."""
        return self.measured_heights or not self.is_flat

    @property
    def largest_change(self) -> float:
        """Change of height from a foothold to the next [m] that limits should allow; three deviations at rough ones."""
        return self.stair_height + _STRIDE * self.slope + 6 * self.roughness

    def treads(self, length: float, rng: np.random.Generator) -> Treads:
        """The pieces of a ground that repeats after a length [m].

        Args:
            length: The length.
            rng: Draws the ground. Parts that are left out draw nothing.
        """
        stairs = self._stairs(length, rng) if self.stair_height else (np.zeros(1), np.zeros(1))
        rough = self._field(length, rng) if self.roughness else (np.zeros(1), np.zeros(1))
        ramps = _evenly(length, self.ramp_length) if self.slope else np.zeros(1)
        softer = self.patch_stiffness != 1 or self.patch_friction != 1
        patches = _evenly(length, self.patch_length) if softer else np.zeros(1)
        start = np.unique(np.concatenate([stairs[0], rough[0], ramps, patches]))
        end = np.append(start[1:], length)
        tread, ramp, patch = (np.searchsorted(each, start, "right") - 1 for each in (stairs[0], ramps, patches))
        waves = np.interp(np.stack([start, end]), *rough, period=length) if self.roughness else np.zeros((2, 1))
        half = length / len(ramps)
        climb = self.slope * (np.where(ramp % 2, half - (start - ramps[ramp]), start - ramps[ramp]) - half / 2)
        odd = patch % 2 == 1
        return Treads(
            start=start,
            height=stairs[1][tread] + waves[0] + climb,
            slope=np.where(ramp % 2, -self.slope, self.slope) + (waves[1] - waves[0]) / (end - start),
            stiffness=np.where(odd, self.patch_stiffness, 1.0),
            friction=np.where(odd, self.patch_friction, 1.0),
        )

    def _stairs(self, length: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """Where treads begin, and their heights [m]."""
        count = max(2, round(length / self.stair_length))
        lengths = rng.uniform(0.5, 1.5, count)
        start = np.append(0.0, np.cumsum(lengths)[:-1]) * (length / lengths.sum())
        risers = rng.uniform(-self.stair_height, self.stair_height, count)
        risers -= risers.mean()  # after its length, the ground is as high as where it began
        heights = np.cumsum(risers * min(1.0, self.stair_height / np.abs(risers).max()))
        return start, heights - heights.mean()

    def _field(self, length: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """Places and heights of the corners of a smooth random profile [m]."""
        waves = np.arange(1, max(2, int(length / self.wave_length) + 1))
        place = np.linspace(0, length, max(16, round(length / min(FINEST, self.wave_length / 10))), endpoint=False)
        phases = rng.uniform(0, 2 * pi, len(waves))
        angles = 2 * pi * np.outer(place / length, waves) + phases
        return place, self.roughness * sqrt(2 / len(waves)) * np.sin(angles).sum(axis=1)


def _evenly(length: float, wanted: float) -> Array:
    """Where equal pieces begin that fill a length, of about the wanted length each; an even number of them."""
    pairs = max(1, round(length / (2 * wanted)))
    return np.linspace(0, length, 2 * pairs, endpoint=False)


FLAT_GROUND = UnevenGround()
"""Ground that is the same everywhere."""
