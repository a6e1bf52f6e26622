"""MuJoCo model of the quadruped: a machine of the class of Unitree's Go2 that moves in the sagittal plane.

Masses, moments of inertia, lengths and torque limits are those of MuJoCo Menagerie (unitree_go2/go2.xml), most of which
are also in the manufacturer's URDF (repository unitree_ros). The URDF has lighter calves, 0.154 kg and 0.04 kg for the
foot, and in an older version 35.55 N·m for their motors. The abduction joints are locked, so the robot stays in the
sagittal plane, and products of inertia are left out.
"""

from typing import NamedTuple


class LegMount(NamedTuple):
    """Where a leg is mounted on the trunk.

    Attributes:
        name: Name of the leg: F or R (front, rear), then L or R (left, right).
        x: Position of its hip, forward [m].
        y: Position of its thigh, to the left [m].
    """

    name: str
    x: float
    y: float


HIP_X, THIGH_Y = 0.1934, 0.0465 + 0.0955
"""Distances of a hip from the middle of the trunk, and of a thigh from its middle plane [m]."""
LEGS = tuple(
    LegMount(end + side, HIP_X * (1 if end == "F" else -1), THIGH_Y * (1 if side == "L" else -1))
    for end in "FR"
    for side in "LR"
)
LINK, TOE_RADIUS = 0.213, 0.022
"""Length of thigh and calf, and radius of the round foot [m]."""
THIGH_TORQUE, CALF_TORQUE = 23.7, 45.43
"""Largest torques of the motors of thigh and calf [N·m]."""
TRUNK_MASS, HIP_MASS, THIGH_MASS, CALF_MASS = 6.921, 0.678, 1.152, 0.241352
"""Masses [kg]; that of the calf contains the foot."""
TOTAL_MASS = TRUNK_MASS + 4 * (HIP_MASS + THIGH_MASS + CALF_MASS)


def quadruped_xml() -> str:
    """The model; its joints are `x`, `z`, `pitch` (nose down positive), and `LEG_thigh` and `LEG_calf` of each leg."""
    legs = "".join(_leg(*leg) for leg in LEGS)
    motors = "".join(
        f'<motor name="{leg.name}_{link}" joint="{leg.name}_{link}" ctrllimited="true" ctrlrange="-{most} {most}"/>'
        for leg in LEGS
        for link, most in (("thigh", THIGH_TORQUE), ("calf", CALF_TORQUE))
    )
    return f"""
<mujoco model="quadruped">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
  <default>
    <geom contype="0" conaffinity="0" mass="0"/>
    <default class="motor"><joint axis="0 1 0" damping="0.1" armature="0.01" frictionloss="0.2"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="100 2 0.1" contype="1" conaffinity="1" friction="0.8" solref="0.01 1"/>
    <body name="trunk">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <inertial pos="0.021112 0 -0.005366" mass="{TRUNK_MASS}" diaginertia="0.02448 0.098077 0.107"/>
      <geom name="trunk" type="box" size="0.1881 0.04675 0.057"/>
      <geom name="head" type="sphere" size="0.047" pos="0.285 0 0.01"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""


def _leg(name: str, x: float, y: float) -> str:
    front, left = (1 if x > 0 else -1), (1 if y > 0 else -1)
    return f"""
      <body name="{name}_hip" pos="{x} {left * 0.0465} 0">
        <inertial pos="{-0.0054 * front} 0 -0.000105" mass="{HIP_MASS}" diaginertia="0.00048 0.000884 0.000596"/>
        <body name="{name}_thigh" pos="0 {left * 0.0955} 0">
          <joint name="{name}_thigh" class="motor"/>
          <inertial pos="-0.00374 0 -0.0327" mass="{THIGH_MASS}" diaginertia="0.00584 0.0058 0.00103"/>
          <geom name="{name}_thigh" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.02"/>
          <body name="{name}_calf" pos="0 0 -{LINK}">
            <joint name="{name}_calf" class="motor"/>
            <inertial pos="0.00629595 0 -0.141417" mass="{CALF_MASS}" diaginertia="0.0014901 0.00146356 0.0000531"/>
            <geom name="{name}_calf" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.012"/>
            <geom name="{name}_foot" type="sphere" pos="0 0 -{LINK}" size="{TOE_RADIUS}" contype="1" conaffinity="1"
              friction="0.8" condim="3"/>
          </body>
        </body>
      </body>"""
