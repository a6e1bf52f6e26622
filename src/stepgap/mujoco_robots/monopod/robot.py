"""The monopod as a `Robot`: eight states at the apex, of which three are tracked, by three commands.

Its model is a body on one telescopic leg, free in space (M. H. Raibert, 3-D hopping machine, 1984). Raibert's machine
weighs 17.3 kg and runs on compressed air. This one has half of that, a motor in place of the air spring, and moments of
inertia of a flat box of its size; as his, its hip is at the centre of mass of the body, and its leg is light.

Its control law has three parts (M. H. Raibert, Legged Robots That Balance, 1986, ch. 3). In flight the leg points to
where the foot is to land: ahead of the hip by the neutral point of the velocity, by a share of the velocity, and by the
command. In stance the leg is a spring, which from mid-stance on pushes with a thrust and with the command, and the hip
turns the body upright. Forward and to the left are directions of the ground, whatever the heading of the body.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import mujoco
import numpy as np

from stepgap.base.compiled import compiled
from stepgap.base.ranges import require
from stepgap.control.reference import Reference
from stepgap.mujoco_robots.hopping import FLIGHT, THRUST, phase_after, phased
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import ControlLaw, MjcfRobot, MjcfSimulator
from stepgap.mujoco_robots.mjcf.section import Section
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.step import Array, Quantity, StepMap, StepSpace

LEG = 0.5  # Length of the leg from the hip to the middle of the round foot at rest [m]
SOLE_RADIUS = 0.03  # Radius of that foot [m]
TORSO_MASS = 9.0
UPPER_LEG_MASS = 0.6
LOWER_LEG_MASS = 0.25
"""Masses [kg]."""


def monopod_xml() -> str:
    """The model; joints are `root` (free), `hip_roll`, `hip_pitch` [rad] and `leg`, by how much it is extended [m]."""
    return f"""
<mujoco model="monopod">
  <option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="hip"><joint damping="0.05" armature="0.005"/></default>
  </default>
  <worldbody>
    <light pos="0 0 4"/>
    <geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="1" friction="1 0.02 0.0001" condim="4"/>
    <body name="body" pos="0 0 {LEG}">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="{TORSO_MASS}" diaginertia="0.25 0.30 0.35"/>
      <geom name="frame_x" type="capsule" fromto="-0.25 0 0 0.25 0 0" size="0.03"/>
      <geom name="frame_y" type="capsule" fromto="0 -0.2 0 0 0.2 0" size="0.03"/>
      <body name="thigh">
        <joint name="hip_roll" class="hip" axis="1 0 0"/>
        <joint name="hip_pitch" class="hip" axis="0 1 0"/>
        <inertial pos="0 0 -0.2" mass="{UPPER_LEG_MASS}" diaginertia="0.01 0.01 0.001"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03"/>
        <body name="shin" pos="0 0 -{LEG}">
          <joint name="leg" type="slide" axis="0 0 -1" damping="2"/>
          <inertial pos="0 0 0.1" mass="{LOWER_LEG_MASS}" diaginertia="0.003 0.003 0.0002"/>
          <geom name="shin" type="capsule" fromto="0 0 0.25 0 0 0" size="0.015"/>
          <geom name="foot" type="sphere" size="{SOLE_RADIUS}" contype="1" conaffinity="1" friction="1 0.02 0.0001"
            condim="4"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="hip_roll" joint="hip_roll" ctrllimited="true" ctrlrange="-80 80"/>
    <motor name="hip_pitch" joint="hip_pitch" ctrllimited="true" ctrlrange="-80 80"/>
    <motor name="leg" joint="leg" ctrllimited="true" ctrlrange="-1500 1500"/>
  </actuator>
</mujoco>
"""


LONGEST_STRIDE = 0.6 * LEG  # Largest horizontal distance of the foot from the hip that is commanded [m]


@dataclass(frozen=True)
class HoppingGains:
    """Gains of the control law.

    Attributes:
        stiffness: Stiffness of the leg [N/m].
        damping: Damping of the leg in stance [N·s/m].
        flight_damping: Damping of the leg in flight [N·s/m].
        thrust: Force from mid-stance on that balances the losses of a step [N].
        neutral_time: Distance by which the foot lands ahead of the hip for a velocity that stays, per velocity [s].
        velocity_gain: Additional distance per velocity, which slows the robot down [s].
        attitude_stiffness: Torque against the tilt of the body in stance [N·m/rad].
        attitude_damping: Torque against its rate [N·m·s/rad].
        swing_stiffness: Torque that swings the leg in flight [N·m/rad].
        swing_damping: Damping of this motion [N·m·s/rad].
    """

    stiffness: float = 3500.0
    damping: float = 10.0
    flight_damping: float = 40.0
    thrust: float = 60.0
    neutral_time: float = 0.085
    velocity_gain: float = 0.03
    attitude_stiffness: float = 150.0
    attitude_damping: float = 15.0
    swing_stiffness: float = 100.0
    swing_damping: float = 8.0

    def __post_init__(self) -> None:
        for name in ("stiffness", "attitude_damping", "swing_stiffness", "swing_damping"):
            require(getattr(self, name) > 0, name, getattr(self, name), "be positive")

    @property
    def law(self) -> "HoppingLaw":
        """These gains for compiled code."""
        return HoppingLaw(**vars(self))


HoppingLaw = namedtuple("HoppingLaw", [gain.name for gain in fields(HoppingGains)])  # `HoppingGains` for compiled code


@compiled
def body_rotation(quaternion):
    """Rotation matrix (3, 3) from the body to the world of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@compiled
def tilt(turned):
    """Roll and pitch of a rotation matrix [rad]; nose down is positive."""
    return np.arctan2(turned[2, 1], turned[2, 2]), -np.arcsin(turned[2, 0])


@compiled
def hip_angles(law, turned, velocity_x, velocity_y, foot_x, foot_y):
    """Roll and pitch of the hip [rad] with which the foot points to where it is to land.

    Args:
        law: `HoppingLaw`.
        turned: Rotation matrix from the body to the world.
        velocity_x: Forward velocity [m/s].
        velocity_y: Velocity to the left [m/s].
        foot_x: Additional distance of the command, forward [m].
        foot_y: The same, to the left [m].
    """
    gain = law.neutral_time + law.velocity_gain
    x = gain * velocity_x + foot_x
    y = gain * velocity_y + foot_y
    shrunk = min(1.0, LONGEST_STRIDE / max(np.sqrt(x * x + y * y), 1e-9))
    x = x * shrunk
    y = y * shrunk
    z = -np.sqrt(LEG * LEG - x * x - y * y)
    along_x, along_y, along_z = turned.T @ np.array([x, y, z])
    return np.arctan2(along_y, -along_z), -np.arcsin(min(1.0, max(-1.0, along_x / LEG)))


@compiled
def hopping(law, phase, contact, position, velocity, command, efforts):
    """Computes a tick of the control; returns its phase.

    Args:
        law: `HoppingLaw`.
        phase: Phase of the tick before.
        contact: Whether the foot touches the ground.
        position: Generalised positions of the model: place, quaternion, roll and pitch of the hip, leg; shape (10,).
        velocity: Generalised velocities, those of the body's rotation in its own frame; shape (9,).
        command: Distances of the foot forward and to the left [m], and force of the leg [N]; shape (3,).
        efforts: Is filled with the torques of the hip [N·m] and the force of the leg [N]; shape (3,).
    """
    turned = body_rotation(position[3:7])
    extension = position[9]
    rate = velocity[8]
    phase = phase_after(phase, contact and velocity[2] < 0.0, rate > 0.0, extension >= 0.0 or not contact)
    if phase == FLIGHT:
        roll, pitch = hip_angles(law, turned, velocity[0], velocity[1], command[0], command[1])
        efforts[0] = law.swing_stiffness * (roll - position[7]) - law.swing_damping * velocity[6]
        efforts[1] = law.swing_stiffness * (pitch - position[8]) - law.swing_damping * velocity[7]
        efforts[2] = -law.stiffness * extension - law.flight_damping * rate
    else:
        roll, pitch = tilt(turned)  # the hip turns the body against the leg, which stands
        efforts[0] = law.attitude_stiffness * roll + law.attitude_damping * velocity[3]
        efforts[1] = law.attitude_stiffness * pitch + law.attitude_damping * velocity[4]
        efforts[2] = -law.stiffness * extension - law.damping * rate
        if phase == THRUST:
            efforts[2] += law.thrust + command[2]
    return phase


MONOPOD_SPACE = StepSpace(
    state=(
        Quantity("speed", "m/s", -0.2, 0.8),
        Quantity("height", "m", 0.64, 0.76),
        Quantity("offset", "m", -0.5, 0.5),
        Quantity("drift", "m/s", -0.5, 0.5, weight=0),
        Quantity("roll", "rad", -0.1, 0.1, weight=0),
        Quantity("pitch", "rad", -0.1, 0.1, weight=0),
        Quantity("roll_rate", "rad/s", -0.4, 0.4, weight=0),
        Quantity("pitch_rate", "rad/s", -0.4, 0.4, weight=0),
    ),
    command=(
        Quantity("foot_x", "m", -0.04, 0.04),
        Quantity("foot_y", "m", -0.04, 0.04),
        Quantity("thrust", "N", -40.0, 40.0),
    ),
)
"""State at the apex: forward speed, height of the hip, place to the left of the line that it follows, velocity to the
left, and tilt of the body with its rates. Command: where the foot lands, and how hard the leg pushes."""

IN_PLACE = np.array([0.0, 0.7, *np.zeros(6)])
"""State of a hop in place, which the middle of the bounds repeats, roughly."""

_DIFFERENCE = 0.1  # Step of the differences for the derivatives of the model, whose control has ticks [half ranges]


def lanes() -> Reference:
    """Straight hopping in one of two lanes; speed, height or lane change every 15 steps."""
    targets = [(0.2, 0.7, 0.0), (0.4, 0.7, 0.0), (0.4, 0.7, 0.25), (0.4, 0.72, 0.25), (0.4, 0.72, 0.0)]
    targets += [(0.6, 0.72, 0.0), (0.6, 0.7, 0.25), (0.3, 0.7, 0.0)]
    segments = [(1 + 15 * number, target) for number, target in enumerate(targets)]
    return Reference.from_segments(("speed", "height", "offset"), segments, steps=15 * len(targets))


@dataclass(frozen=True)
class Monopod(MjcfRobot):
    """A hopper on one leg that moves forward and sideways.

    Attributes:
        gains: Gains of the control law.
    """

    gap: MjcfGap = field(
        default_factory=lambda: replace(
            MjcfGap.none(),
            payload=1.0,
            friction_scale=0.8,
            damping_scale=1.5,
            gear_scale=0.95,
            delay=0.002,
            ground_softness=1.5,
            state_noise=0.005,
            force_noise=0.01,
        )
    )
    gains: HoppingGains = field(default_factory=HoppingGains)

    name = "monopod"
    longest_step = 1.5

    @property
    def space(self) -> StepSpace:
        """Eight states, of which speed, height and offset are tracked; three commands."""
        return MONOPOD_SPACE

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The derivatives of the model without differences about a hop in place, and that model itself."""
        return {"linear": self._linear, **super().nominal_maps()}

    def _linear(self) -> AffineMap:
        model = SimulatorMap(MONOPOD_SPACE, MjcfSimulator(self), _DIFFERENCE)
        command = MONOPOD_SPACE.command_centre
        return AffineMap(MONOPOD_SPACE, IN_PLACE, command, model(IN_PLACE, command), model.jacobian(IN_PLACE, command))

    def references(self) -> Mapping[str, Callable[[], Reference]]:
        """Lanes at several speeds and heights, and stairs."""
        return {"lanes": lanes, **super().references()}

    def mjcf_model(self) -> Any:
        """The model, free in space."""
        return mujoco.MjModel.from_xml_string(monopod_xml())

    def controller(self) -> ControlLaw:
        """The control law, which starts in flight."""
        return phased(hopping, self.gains.law)

    def section(self) -> Section:
        """The highest point of the hip."""
        return Section(lambda model, data: float(data.qvel[2]), threshold=0.05)

    def state(self, model: Any, data: Any) -> Array:  # noqa: ARG002
        """Velocity, place and tilt of the body."""
        place = data.qpos
        velocity = data.qvel
        angles = tilt(body_rotation(place[3:7]))
        return np.array([velocity[0], place[2], place[1], velocity[1], *angles, velocity[3], velocity[4]])

    def place(self, model: Any, data: Any, state: Array) -> None:  # noqa: ARG002
        """At an apex, without any turn about the vertical, with the foot where it lands without a command."""
        speed, height, offset, drift, roll, pitch, *rates = state
        about_x, about_y = np.array([[np.cos(half), np.sin(half)] for half in (0.5 * roll, 0.5 * pitch)])
        quaternion = np.outer(about_y, about_x).ravel() * [1.0, 1.0, 1.0, -1.0]
        data.qpos[:7] = [0.0, offset, height, *quaternion]
        data.qpos[7:9] = hip_angles(self.gains.law, body_rotation(data.qpos[3:7]), speed, drift, 0.0, 0.0)
        data.qvel[:5] = [speed, drift, 0.0, *rates]

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002
        """Whether the body is tilted by more than 0.7 rad, or the hip lower than 0.25 m."""
        return bool(data.qpos[2] < 0.25 or np.abs(tilt(body_rotation(data.qpos[3:7]))).max() > 0.7)
