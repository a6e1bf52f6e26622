"""The quadruped as a `Robot`."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import acos, atan2, hypot
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stepgap.mujoco_robots.hopping import phased
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_ground import above_ground
from stepgap.mujoco_robots.mjcf.mjcf_robot import ControlLaw, MjcfRobot
from stepgap.mujoco_robots.mjcf.section import Section, apex
from stepgap.mujoco_robots.quadruped.model import LEGS, LINK, TOE_RADIUS, quadruped_xml
from stepgap.mujoco_robots.quadruped.pronk import PronkGains, foot_placement, pronk
from stepgap.mujoco_robots.quadruped.spring_mass import SpringMassMap, landing_velocity
from stepgap.robots.ground import UnevenGround
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepMap, StepSpace

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.2, 0.8), Quantity("height", "m", 0.38, 0.45)),
    command=(Quantity("fx", "N", -40.0, 40.0), Quantity("fz", "N", -60.0, 60.0)),
)
"""State at the apex: forward speed, and height of the middle of the trunk. Command: forces from mid-stance on."""

FOUR_NUMBERS = np.array([[0.4, 0.0, 0.004, 0.0], [0.0, 0.4, 0.0, 0.0004]])
"""Rough derivatives of the next state: by the same coordinate, and by the force in its direction."""


@dataclass(frozen=True)
class Quadruped(MjcfRobot):
    """A quadruped that pronks.

    Attributes:
        gains: Gains of the control law.
        ground: Its ground, where it is uneven.
    """

    gap: MjcfGap = field(
        default_factory=lambda: replace(
            MjcfGap.none(),
            payload=1.5,
            friction_scale=0.75,
            damping_scale=1.5,
            gear_scale=0.97,
            delay=0.002,
            ground_softness=1.5,
            motor_lag=0.003,
            state_noise=0.005,
            force_noise=0.01,
        )
    )
    gains: PronkGains = field(default_factory=PronkGains)
    ground: UnevenGround = field(default_factory=UnevenGround)

    name = "quadruped"
    longest_step = 1.5
    feet = tuple(f"{leg.name}_foot" for leg in LEGS)

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fz]; on uneven ground, the height above what the feet find."""
        return above_ground(SPACE, self.ground)

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The spring-mass template, four numbers, and the simulated model without differences."""
        middle = (SPACE.state_centre, SPACE.command_centre, SPACE.state_centre)
        return {
            "spring_mass": lambda: SpringMassMap(self.space, self.gains, self._landing()),
            "four_numbers": lambda: AffineMap(self.space, *middle, FOUR_NUMBERS),
            **super().nominal_maps(),
        }

    def prior(self) -> Path:
        """That of 60 random ones with random targets (`benchmarks/priors.py`)."""
        return Path(__file__).with_name("prior.json")

    def _landing(self) -> Array:
        """Velocity of the centre of mass after touchdown by that before, at the middle speed; shape (2, 2)."""
        model = self.mjcf_model()
        data = mujoco.MjData(model)
        self.place(model, data, SPACE.state_centre)
        return landing_velocity(model, data, self.feet)

    def mjcf_model(self) -> Any:
        """The model in the sagittal plane."""
        return mujoco.MjModel.from_xml_string(quadruped_xml())

    def mjcf_spec(self) -> Any:
        """The same before it is compiled."""
        return mujoco.MjSpec.from_string(quadruped_xml())

    def controller(self) -> ControlLaw:
        """The pronk, which starts in flight."""
        return phased(pronk, self.gains.law)

    def section(self) -> Section:
        """The highest point of the trunk."""
        return apex("z")

    def state(self, model: Any, data: Any) -> Array:  # noqa: ARG002
        """Speed and height of the trunk."""
        return np.array([data.qvel[0], data.qpos[1]])

    def place(self, model: Any, data: Any, state: Array) -> None:  # noqa: ARG002
        """Level, at an apex, with the feet where they land."""
        speed, height = state
        data.qpos[1] = height
        data.qvel[0] = speed
        x, z = foot_placement(self.gains.law, speed)
        bend = acos(hypot(x, z) / (2 * LINK))
        thigh = atan2(-x, -z) + bend
        data.qpos[3:] = np.tile([thigh, -2 * bend], len(LEGS))

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002
        """Whether the trunk is tilted by more than 0.6 rad, or less than 0.15 m above its lowest foot."""
        lowest = min(float(data.geom(foot).xpos[2]) for foot in self.feet) - TOE_RADIUS
        return abs(data.qpos[2]) > 0.6 or data.qpos[1] - lowest < 0.15
