"""The tasks of the learning benchmark: what the robot tracks, and what is special about the twins.

The paper's reference is slow, and its twins do not change. The other tasks differ from it in one respect each.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stepgap.control.reference import Reference
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.twin.reality_gap import RealityGap

DEFAULT_TASK = "reference"
"""Name of the task with the paper's reference and the twins as they are drawn."""

PAYLOAD_STEP = 114
"""First step with the payload: the middle of the paper's reference."""

SQUARE_STEPS = 227
"""Number of steps of the square wave, as many as of the paper's reference."""


@dataclass(frozen=True)
class Change:
    """A change of the robot in the midst of a deployment.

    Attributes:
        step: First step of the changed robot, from 1.
        factors: Factors on numbers of the twin's `RealityGap`, by their names.
    """

    step: int
    factors: Mapping[str, float]

    def of(self, gap: RealityGap) -> RealityGap:
        """Gap of the changed robot."""
        return replace(gap, **{name: factor * getattr(gap, name) for name, factor in self.factors.items()})


@dataclass(frozen=True, eq=False)
class Task:
    """What the robot is to do.

    Attributes:
        name: Name for the command line, files and reports.
        reference: Reference to track.
        gap: Numbers of every twin's `RealityGap` that are not drawn, by their names.
        change: Change in the deployment that is measured; the deployments before it are made with the unchanged robot.
    """

    name: str
    reference: Reference
    gap: Mapping[str, float] = field(default_factory=dict)
    change: Change | None = None

    def gap_of(self, drawn: RealityGap) -> RealityGap:
        """Gap of a twin, given the drawn one."""
        return replace(drawn, **self.gap)


def tasks() -> dict[str, Task]:
    """All tasks by name."""
    paper = paper_reference()
    found = [
        Task(DEFAULT_TASK, paper),
        Task("payload", paper, change=Change(PAYLOAD_STEP, {"body_mass_scale": 1.15})),
        Task("torque_limit", paper, gap={"torque_limit": 13.0}),  # [N·m]; on the reference the twin asks for up to 17
        Task("square", square_reference()),
        Task("rough", paper, gap={"ground_roughness": 0.010}),  # [m]
    ]
    return {task.name: task for task in found}


def square_reference() -> Reference:
    """Fast square waves: the speed changes between 0.15 and 0.35 m/s every 4 steps, the height 0.58–0.62 m every 8."""
    steps = np.arange(SQUARE_STEPS)
    speed = np.where(steps // 4 % 2, 0.35, 0.15)
    height = np.where(steps // 8 % 2, 0.62, 0.58)
    return Reference(("speed", "height"), np.stack([speed, height], axis=1))
