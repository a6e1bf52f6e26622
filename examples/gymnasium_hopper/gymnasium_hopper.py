"""Gymnasium's hopper as a robot: its model is the file of the installed `gymnasium`, its controller `hopper_law.py`."""

from dataclasses import dataclass
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from hopper_law import HopperLaw, landing_posture, mass_centre

from stepgap import MjcfRobot, Quantity, StepSpace, touchdown

MJCF = Path(gymnasium.__file__).parent / "envs/mujoco/assets/hopper.xml"
FALL_SPEED = 1.1
"""Usual speed of falling at touchdown [m/s]."""


@dataclass(frozen=True)
class GymnasiumHopper(MjcfRobot):
    name = "gymnasium_hopper"
    tick = 0.002

    @property
    def space(self):
        return StepSpace(
            state=(Quantity("speed", "m/s", -0.4, -0.1), Quantity("pitch", "rad", -1.025, -0.925)),
            command=(Quantity("aim", "m/s", 0.0, 0.5), Quantity("push", "m/s^2", 4.0, 8.5)),
        )

    def mjcf_model(self):
        return mujoco.MjModel.from_xml_path(str(MJCF))

    def controller(self):
        return HopperLaw(self.mjcf_model())

    def section(self):
        return touchdown("foot_geom")

    def state(self, model, data):
        """Speed of the centre of mass and pitch of the torso; the height of a hop hardly affects the next one."""
        return np.array([mass_centre(model, data)[1][0], data.qpos[2]])

    def place(self, model, data, state):
        """The landing posture, turned to the pitch, and the centre of mass at its speed after a common fall."""
        speed, pitch = state
        data.qpos[:] = landing_posture(model, pitch)
        velocity = mass_centre(model, data)[1]
        data.qvel[:2] += speed - velocity[0], -FALL_SPEED - velocity[2]

    def failed(self, model, data):  # noqa: ARG002
        return data.qpos[1] < 0.5 or abs(data.qpos[2] + 1.0) > 0.8
