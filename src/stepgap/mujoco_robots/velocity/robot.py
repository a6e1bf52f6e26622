"""The robot `velocity`: a walking robot with the built-in trot, or any one behind the plant `process`."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import dataclass, field
from typing import Any

import mujoco

from stepgap.mujoco_robots.quadruped.model import TOE_RADIUS
from stepgap.mujoco_robots.velocity.model import walker_xml
from stepgap.mujoco_robots.velocity.trot import Trot, TrotGains, standing
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot


@dataclass(frozen=True)
class TrottingRobot(WalkingRobot):
    """A quadruped that trots at a commanded velocity.

    Attributes:
        gait: The gait.
    """

    gait: TrotGains = field(default_factory=TrotGains)

    name = "velocity"

    def mjcf_spec(self) -> Any:
        """The quadruped with position servos."""
        return mujoco.MjSpec.from_string(walker_xml(self.gait.stiffness, self.gait.damping))

    def stand(self, model: Any, data: Any) -> None:  # noqa: ARG002
        """All feet on the ground, below their hips."""
        data.ctrl[:] = standing(self.gait)
        data.qpos[2], data.qpos[7:] = self.gait.height + TOE_RADIUS, data.ctrl

    def walking_control(self) -> Trot:
        """The trot."""
        return Trot(self.gait)
