"""MuJoCo model of a walking quadruped: the machine of `robots/quadruped/model.py`, free, with twelve servos."""

from stepgap.robots.quadruped.model import (
    CALF_MASS,
    CALF_TORQUE,
    HIP_MASS,
    LEGS,
    LINK,
    THIGH_MASS,
    THIGH_TORQUE,
    THIGH_Y,
    TOE_RADIUS,
    TRUNK_MASS,
)

THIGH_OFFSET = 0.0955
"""Distance of a thigh from the axis about which its leg moves sideways [m]."""
HIP_Y = THIGH_Y - THIGH_OFFSET
"""Distance of this axis from the middle plane [m]."""
_TORQUES = {"hip": THIGH_TORQUE, "thigh": THIGH_TORQUE, "calf": CALF_TORQUE}


def walker_xml(stiffness: float, damping: float) -> str:
    """The model; its joints are a free one, and `LEG_hip`, `LEG_thigh` and `LEG_calf` of each leg, in this order.

    Args:
        stiffness: Stiffness of the position servos [N·m/rad].
        damping: Their damping [N·m·s/rad].
    """
    legs = "".join(_leg(*leg) for leg in LEGS)
    servos = "".join(
        f'<position name="{leg.name}_{link}" joint="{leg.name}_{link}" kp="{stiffness}" kv="{damping}"'
        f' forcerange="-{most} {most}"/>'
        for leg in LEGS
        for link, most in _TORQUES.items()
    )
    return f"""
<mujoco model="walker">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default>
    <geom contype="0" conaffinity="0" mass="0"/>
    <default class="leg"><joint damping="0.1" armature="0.01" frictionloss="0.2"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="100 100 0.1" contype="1" conaffinity="1" friction="0.8" solref="0.01 1"/>
    <body name="trunk" pos="0 0 0.3">
      <freejoint name="trunk"/>
      <inertial pos="0.021112 0 -0.005366" mass="{TRUNK_MASS}" diaginertia="0.02448 0.098077 0.107"/>
      <geom name="trunk" type="box" size="0.1881 0.04675 0.057"/>
      <geom name="head" type="sphere" size="0.047" pos="0.285 0 0.01"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{servos}</actuator>
</mujoco>
"""


def _leg(name: str, x: float, y: float) -> str:
    front, left = (1 if x > 0 else -1), (1 if y > 0 else -1)
    return f"""
      <body name="{name}_hip" pos="{x} {left * HIP_Y} 0">
        <joint name="{name}_hip" class="leg" axis="1 0 0"/>
        <inertial pos="{-0.0054 * front} 0 -0.000105" mass="{HIP_MASS}" diaginertia="0.00048 0.000884 0.000596"/>
        <body name="{name}_thigh" pos="0 {left * THIGH_OFFSET} 0">
          <joint name="{name}_thigh" class="leg" axis="0 1 0"/>
          <inertial pos="-0.00374 {-0.0223 * left} -0.0327" mass="{THIGH_MASS}" diaginertia="0.00584 0.0058 0.00103"/>
          <geom name="{name}_thigh" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.02"/>
          <body name="{name}_calf" pos="0 0 -{LINK}">
            <joint name="{name}_calf" class="leg" axis="0 1 0"/>
            <inertial pos="0.00629595 0 -0.141417" mass="{CALF_MASS}" diaginertia="0.0014901 0.00146356 0.0000531"/>
            <geom name="{name}_calf" type="capsule" fromto="0 0 0 0 0 -{LINK}" size="0.012"/>
            <geom name="{name}_foot" type="sphere" pos="0 0 -{LINK}" size="{TOE_RADIUS}" contype="1" conaffinity="1"
              friction="0.8" condim="3"/>
          </body>
        </body>
      </body>"""
