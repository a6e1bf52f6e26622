"""A robot that is measured wrongly, is pushed, changes, and becomes again what it was."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from stepgap.export.controller.portable_controller import PortableController
from stepgap.step import Array, StepRecord, StepStatus
from tests.export.controller.learned import CENTRE, SCALE, SPACE

WRONGLY_MEASURED: Final = (14, 31)
"""Numbers of the steps whose end is measured wrongly."""

PUSHED: Final = (24,)
SHIFT: Final = (0.5, -0.4)
SLOPES: Final = ((0.1, 0.0, -0.1, 0.05), (0.0, 0.1, 0.0, 0.1))
LIFE: Final = (("as learned", 18), ("loaded", 22), ("as learned", 15))
"""What the robot is like, and for how many steps."""


@dataclass
class ChangingRobot:
    """The robot on its way; `step` makes a step.

    Attributes:
        controller: Its map is that of the robot as it was learned.
        seed: Of its noise.
        life: What it is like, and for how many steps.
    """

    controller: PortableController
    seed: int = 6
    life: tuple[tuple[str, int], ...] = LIFE
    number: int = 0
    phase: float = np.nan
    state: Array = field(default_factory=lambda: SPACE.state_centre)
    measured: Array = field(default_factory=lambda: SPACE.state_centre)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._names = [name for name, count in self.life for _ in range(count)]

    @property
    def is_on_its_way(self) -> bool:
        """Whether it makes a further step."""
        return self.number < len(self._names)

    def target(self) -> Array:
        """A random target."""
        return SPACE.state_centre + SPACE.state_scale * self._rng.uniform(-0.5, 0.5, 2)

    def step(self, command: Array) -> tuple[StepRecord, float]:
        """Makes a step; returns it as it was measured, and the phase at which it started [rad]."""
        start, before = self.measured, self.phase
        moved = self.controller.map(self.state, command) + SPACE.state_scale * 0.01 * self._rng.normal(size=2)
        moved = moved + SPACE.state_scale * [0.05 * np.nan_to_num(np.sin(self.phase)), 0.02]
        if self._names[self.number] == "loaded":
            point = (np.concatenate([self.state, command]) - CENTRE) / SCALE
            moved = moved + SPACE.state_scale * (SHIFT + np.array(SLOPES) @ point)
        if self.number in PUSHED:
            moved = moved + SPACE.state_scale * [0.9, 0.0]
        self.state = moved
        wrong = np.array([0.8, -0.6]) if self.number in WRONGLY_MEASURED else 0.0
        self.measured = moved + SPACE.state_scale * wrong
        self.number += 1
        self.phase = float(np.nan_to_num(self.phase) + self._rng.uniform(0, 0.7))
        return StepRecord(start, command, command, self.measured, StepStatus.OK), before
