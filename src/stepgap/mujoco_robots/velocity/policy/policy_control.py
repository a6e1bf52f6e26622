"""Walking by a trained policy: its actions are the targets of position servos."""

from typing import Any

import numpy as np

from stepgap.mujoco_robots.velocity.policy.observation import Observation
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork
from stepgap.mujoco_robots.velocity.policy.policy_model import actuators_of_joints
from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings
from stepgap.mujoco_robots.velocity.walking_control import WalkingControl
from stepgap.step import Array


class PolicyControl(WalkingControl):
    """A policy with the memory that its observation has.

    Args:
        settings: The policy.
        network: Its network.
    """

    def __init__(self, settings: PolicySettings, network: OnnxNetwork):
        self._settings, self._network = settings, network
        self.period = settings.period

    def start(self, model: Any, data: Any) -> None:
        """Forgets all observations and actions; actuators of other joints keep their control signals."""
        self._observation = Observation(self._settings, model)
        self._actions, self._calls, self._ctrl = np.zeros(len(self._settings.joints)), 0, data.ctrl.copy()
        actuators = actuators_of_joints(model)
        self._actuators = [actuators[joint] for joint in self._settings.joints]

    def control(self, model: Any, data: Any, command: Array) -> Array:
        """Observes, and computes the targets of the joints."""
        seconds = self._calls * self.period
        observation = self._observation.next(model, data, self._actions, command, seconds)
        clip, scale = self._settings.action_clip, np.array(self._settings.action_scale)
        self._actions, self._calls = np.clip(self._network(observation), -clip, clip), self._calls + 1
        self._ctrl[self._actuators] = np.array(self._settings.default_joint_pos) + scale * self._actions
        return self._ctrl
