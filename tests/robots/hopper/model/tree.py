"""The hopper's four links in MuJoCo: an open tree, closed by a tangent map that is derived here.

The tree's coordinates are the hip (x, y) and four hinges: rear top, front top, and each bottom link
against its top link. Nothing of MuJoCo's contacts, constraints or integrators is used.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import mujoco
import numpy as np

from stepgap.robots.hopper import RobotParameters


def ideal_tree(robot: RobotParameters):
    """Model and data of the tree; the world's z is up, and a positive hinge angle moves a link forward."""
    boom_x = robot.boom_inertia_horizontal / robot.boom_length**2
    boom_y = robot.boom_inertia_vertical / robot.boom_length**2

    def link(name: str, depth: float, com: float, mass: float, inertia: float, inside: str = "") -> str:
        return f"""
        <body name="{name}" pos="0 0 {-depth}"><joint name="{name}" type="hinge" axis="0 -1 0"/>
          <inertial pos="0 0 {-com}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>{inside}
        </body>"""

    legs = ""
    for side in ("front", "rear"):
        shank = link(f"{side}_bottom", robot.top_length, robot.bottom_com, robot.bottom_mass, robot.bottom_inertia)
        legs += link(f"{side}_top", 0.0, robot.top_com, robot.top_mass, robot.top_inertia, shank)
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><compiler angle="radian" balanceinertia="false" boundmass="0"/>
      <option gravity="0 0 {-robot.gravity}"/>
      <worldbody><body name="hip">
        <joint name="x" type="slide" axis="1 0 0" armature="{boom_x}"/>
        <joint name="y" type="slide" axis="0 0 1" armature="{boom_y}"/>
        <inertial pos="0 0 0" mass="{robot.body_mass}" diaginertia="1 1 1"/>{legs}
      </body></worldbody></mujoco>""")
    return model, mujoco.MjData(model)


def tree_terms(tree, robot: RobotParameters, q, qd):
    """Mass matrix Tᵀ M T and bias Tᵀ (c + M Ṫ q̇) on (x, y, α₁, α₂), where T maps q̇ to the tree's velocities."""
    model, data = tree
    ratio = robot.top_length / robot.bottom_length
    beta = np.arcsin(ratio * np.sin(q[3]))
    d_beta = ratio * np.cos(q[3]) / np.cos(beta)  # from sin β = (ℓ₁/ℓ₂) sin α₂, differentiated once and twice
    dd_beta = (np.sin(beta) * d_beta**2 - ratio * np.sin(q[3])) / np.cos(beta)
    # Absolute link angles: front top α₁ + α₂, front bottom α₁ − β; rear top α₁ − α₂, rear bottom α₁ + β.
    position = [q[0], q[1], q[2] + q[3], -beta - q[3], q[2] - q[3], beta + q[3]]
    tangent = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, -d_beta - 1], [0, 0, 1, -1], [0, 0, 0, d_beta + 1]]
    )
    tangent_rate_qd = np.array([0, 0, 0, -dd_beta, 0, dd_beta]) * qd[3] ** 2
    order = [
        model.joint(name).qposadr[0] for name in ("x", "y", "front_top", "front_bottom", "rear_top", "rear_bottom")
    ]
    data.qpos[order], data.qvel[order] = position, tangent @ qd
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    mass, bias = mass[np.ix_(order, order)], data.qfrc_bias[order]
    return tangent.T @ mass @ tangent, tangent.T @ (bias + mass @ tangent_rate_qd)
