"""MuJoCo model of the monopod: a body on one telescopic leg, free in space (M. H. Raibert, 3-D hopping machine, 1984).

Raibert's machine weighs 17.3 kg and runs on compressed air. This one has half of that, a motor in place of the air
spring, and moments of inertia of a flat box of its size; as his, its hip is at the centre of mass of the body, and its
leg is light.
"""

LEG, SOLE_RADIUS = 0.5, 0.03
"""Length of the leg from the hip to the middle of the round foot at rest, and radius of that foot [m]."""

TORSO_MASS, UPPER_LEG_MASS, LOWER_LEG_MASS = 9.0, 0.6, 0.25
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
