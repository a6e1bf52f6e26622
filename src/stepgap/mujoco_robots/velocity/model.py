"""MuJoCo model of a walking quadruped: the machine of `mujoco_robots/quadruped/model.py`, free, with twelve servos."""

from stepgap.mujoco_robots.quadruped.model import CALF_TORQUE, LEGS, THIGH_TORQUE, TRUNK_MASS, leg_xml

_TORQUES = {"hip": THIGH_TORQUE, "thigh": THIGH_TORQUE, "calf": CALF_TORQUE}


def walker_xml(stiffness: float, damping: float) -> str:
    """The model; its joints are a free one, and `LEG_hip`, `LEG_thigh` and `LEG_calf` of each leg, in this order.

    Args:
        stiffness: Stiffness of the position servos [N·m/rad].
        damping: Their damping [N·m·s/rad].
    """
    legs = "".join(
        leg_xml(leg, f'<joint name="{leg.name}_hip" class="leg" axis="1 0 0"/>', thigh_y=-0.0223) for leg in LEGS
    )
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
    <default class="leg"><joint axis="0 1 0" damping="0.1" armature="0.01" frictionloss="0.2"/></default>
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
