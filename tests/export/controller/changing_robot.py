"""Steps of a robot that is pushed, changes, becomes again what it was, and does not follow its commands for a while."""

from dataclasses import dataclass

import numpy as np

from stepgap.export.controller.portable_controller import PortableController
from stepgap.step import Array, StepRecord, StepStatus
from tests.export.controller.learned import CENTRE, SCALE, SPACE

PUSHES = (17, 30)
SHIFTS = {"loaded": (0.5, -0.4), "heavier": (-0.6, 0.3)}
SLOPES = {
    "loaded": ((0.1, 0.0, -0.1, 0.05), (0.0, 0.1, 0.0, 0.1)),
    "heavier": ((0.0, 0.0, 0.2, 0.0), (0.1, 0.0, 0.0, 0.0)),
}
LIFE = (
    ("as learned", 40), ("loaded", 20), ("heavier", 20), ("as learned", 20), ("loaded", 4), ("as learned", 16),
    ("nominal", 25), ("as learned", 25), ("stuck", 8), ("as learned", 12),
)  # fmt: skip
"""What the robot is like, and for how many steps."""


@dataclass(frozen=True)
class ChangingStep:
    """A step, and the phase at which it started [rad], NaN for the first one."""

    record: StepRecord
    phase: float


def changing_steps(controller: PortableController, life: tuple[tuple[str, int], ...] = LIFE) -> list[ChangingStep]:
    """The steps of a deployment with such a robot."""
    rng, steps, yaw = np.random.default_rng(6), list[ChangingStep](), np.nan
    for name in [name for name, count in life for _ in range(count)]:
        point = rng.uniform(-0.8, 0.8, 4)
        if name == "stuck":
            point[2:] = np.sign(point[2:])
        state, command = np.split(CENTRE + SCALE * point, [2])
        after = _next_state(controller, name, point) + 0.01 * SPACE.state_scale * rng.normal(size=2)
        after = after + SPACE.state_scale * [0.05 * np.nan_to_num(np.sin(yaw)), 0.02]
        if len(steps) in PUSHES:
            after = after + SPACE.state_scale * [0.7, 0.0]
        if name == "stuck":
            after = after + SPACE.state_scale * rng.uniform(0.5, 1.0, 2) * rng.choice([-1, 1], 2)
        steps.append(ChangingStep(StepRecord(state, command, command, after, StepStatus.OK), yaw))
        yaw = np.nan_to_num(yaw) + rng.uniform(0, 0.7)
    return steps


def _next_state(controller: PortableController, name: str, point: Array) -> Array:
    state, command = np.split(CENTRE + SCALE * point, [2])
    if name == "nominal":
        return controller.map.nominal(state, command)
    changed = np.array(SHIFTS[name]) + np.array(SLOPES[name]) @ point if name in SHIFTS else 0.0
    return controller.map(state, command) + SPACE.state_scale * changed
