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


HIP_X = 0.1934  # Distance of a hip from the middle of the trunk [m]
HIP_Y = 0.0465  # Distance of a hip from the middle plane [m]
THIGH_OFFSET = 0.0955  # Distance of a thigh from the hip [m]
THIGH_Y = HIP_Y + THIGH_OFFSET  # Distance of a thigh from the middle plane [m]
LEGS = tuple(
    LegMount(end + side, HIP_X * (1 if end == "F" else -1), THIGH_Y * (1 if side == "L" else -1))
    for end in "FR"
    for side in "LR"
)
LINK = 0.213  # Length of thigh and of calf [m]
TOE_RADIUS = 0.022  # Radius of the round foot [m]
THIGH_TORQUE = 23.7  # Largest torque of the motor of a thigh [N·m]
CALF_TORQUE = 45.43  # Largest torque of the motor of a calf [N·m]
TRUNK_MASS = 6.921
HIP_MASS = 0.678
THIGH_MASS = 1.152
CALF_MASS = 0.241352
"""Masses [kg]; that of the calf contains the foot."""
TOTAL_MASS = TRUNK_MASS + 4 * (HIP_MASS + THIGH_MASS + CALF_MASS)


def quadruped_xml() -> str:
    """The model; its joints are `x`, `z`, `pitch` (nose down positive), and `LEG_thigh` and `LEG_calf` of each leg."""
    motors = "".join(
        f'<motor name="{leg.name}_{link}" joint="{leg.name}_{link}" ctrllimited="true" ctrlrange="-{most} {most}"/>'
        for leg in LEGS
        for link, most in (("thigh", THIGH_TORQUE), ("calf", CALF_TORQUE))
    )
    joints = """<joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>"""
    return machine_xml("quadruped", 'timestep="0.001"', "100 2 0.1", 0.0, joints, "".join(map(leg_xml, LEGS)), motors)


def machine_xml(name: str, option: str, floor: str, height: float, joints: str, legs: str, actuators: str) -> str:
    """A model of the machine. Its geoms touch nothing but the floor, and weigh nothing.

    Args:
        name: Name of the model.
        option: More attributes of its options, such as the time step.
        floor: Size of the floor, as in MJCF.
        height: Height of the trunk in the first posture [m].
        joints: Joints of the trunk.
        legs: Legs, as by `leg_xml`.
    """
    return f"""
<mujoco model="{name}">
  <compiler angle="radian"/>
  <option {option} integrator="implicitfast" cone="elliptic"/>
  <default>
    <geom contype="0" conaffinity="0" mass="0"/>
    <default class="leg"><joint axis="0 1 0" damping="0.1" armature="0.01" frictionloss="0.2"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="{floor}" contype="1" conaffinity="1" friction="0.8" solref="0.01 1"/>
    <body name="trunk" pos="0 0 {height}">
      {joints}
      <inertial pos="0.021112 0 -0.005366" mass="{TRUNK_MASS}" diaginertia="0.02448 0.098077 0.107"/>
      <geom name="trunk" type="box" size="0.1881 0.04675 0.057"/>
      <geom name="head" type="sphere" size="0.047" pos="0.285 0 0.01"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""


def leg_xml(leg: LegMount, hip_joint: str = "", thigh_y: float = 0.0) -> str:
    """A leg, whose joints have the default class `leg`.

    Args:
        leg: Where it is mounted.
        hip_joint: The joint about which it moves sideways; none if that is locked.
        thigh_y: Place of the thigh's centre of mass, outward [m].
    """
    front = 1 if leg.x > 0 else -1
    left = 1 if leg.y > 0 else -1
    return f"""
      <body name="{leg.name}_hip" pos="{leg.x} {left * HIP_Y} 0">
        {hip_joint}
        <inertial pos="{-0.0054 * front} 0 -0.000105" mass="{HIP_MASS}" diaginertia="0.00048 0.000884 0.000596"/>
        <body name="{leg.name}_thigh" pos="0 {left * THIGH_OFFSET} 0">
          <joint name="{leg.name}_thigh" class="leg"/>
          <inertial pos="-0.00374 {left * thigh_y} -0.0327" mass="{THIGH_MASS}" diaginertia="0.00584 0.0058 0.00103"/>
          <geom name="{leg.name}_thigh" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.02"/>
          <body name="{leg.name}_calf" pos="0 0 -{LINK}">
            <joint name="{leg.name}_calf" class="leg"/>
            <inertial pos="0.00629595 0 -0.141417" mass="{CALF_MASS}" diaginertia="0.0014901 0.00146356 0.0000531"/>
            <geom name="{leg.name}_calf" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.012"/>
            <geom name="{leg.name}_foot" type="sphere" pos="0 0 -{LINK}" size="{TOE_RADIUS}" contype="1" conaffinity="1"
              friction="0.8" condim="3"/>
          </body>
        </body>
      </body>"""
