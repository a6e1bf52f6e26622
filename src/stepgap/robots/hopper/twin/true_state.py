"""The true state of the twin, which a controller never sees."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import dataclass
from math import cos, inf, sin
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from stepgap.base.compiled_record import Record
from stepgap.robots.hopper.twin.devices import Views, boom_angles, ground_under
from stepgap.robots.hopper.twin.reality_gap import RealityGap


@dataclass(frozen=True, eq=False)
class TrueState:
    """True state of the twin, for tests and viewers, never for a controller.

    Attributes:
        time: Time since connecting [s].
        held: Whether the hip is still held.
        hip: Distance travelled along the circle and height of the hip, boom deflection included [m, m].
        hip_rate: Rate of `hip` [m/s, m/s].
        boom: Yaw and pitch at the boom's root [rad, rad].
        leg: Angles of the top links driven by motor 1 and 2 [rad, rad].
        leg_rate: Rate of `leg` [rad/s, rad/s].
        deflection: Horizontal and vertical deflection of the boom's tip [m, m].
        foot: Position of the foot in MuJoCo's frame; shape (3,) [m].
        ground_height: Height of the ground under the foot [m].
        contact_force: Vertical ground force on the foot [N].
        closure_error: Distance between the two bottom links at their common joint [m].
        qpos: MuJoCo's coordinates, for a viewer.
    """

    time: float
    held: bool
    hip: NDArray[np.float64]
    hip_rate: NDArray[np.float64]
    boom: NDArray[np.float64]
    leg: NDArray[np.float64]
    leg_rate: NDArray[np.float64]
    deflection: NDArray[np.float64]
    foot: NDArray[np.float64]
    ground_height: float
    contact_force: float
    closure_error: float
    qpos: NDArray[np.float64]


def true_state(
    model: Any, scratch: Any, gap: RealityGap, devices: Record, views: Views, time: float, held: bool
) -> TrueState:
    """Computes the true state from a copy of the motion, so that the motion itself does not change.

    Args:
        model: MuJoCo's model.
        scratch: MuJoCo's data for the copy.
        gap: Differences of the twin from its physics model.
        devices: Record of `Devices`.
        views: Views of MuJoCo's data with the motion.
        time: Time since connecting [s].
        held: Whether the hip is still held.
    """
    rig, data = devices[0], scratch
    data.qpos[:], data.qvel[:] = views.qpos, views.qvel
    mujoco.mj_kinematics(model, data)
    elastic = gap.boom_stiffness < inf
    deflection, deflection_rate = (data.qpos[2:4].copy(), data.qvel[2:4]) if elastic else (np.zeros(2), np.zeros(2))
    hip, hip_rate = data.qpos[:2] + deflection, data.qvel[:2] + deflection_rate
    if gap.boom_arc:
        radius, (yaw, pitch) = rig["boom_length"], data.qpos[:2]
        x, z = deflection
        hip = np.array([radius * yaw + x, gap.boom_pivot_height + radius * sin(pitch) + z * cos(pitch)])
        turning = np.array([radius, radius * cos(pitch) - z * sin(pitch)])
        hip_rate = turning * data.qvel[:2] + deflection_rate * [1, cos(pitch)]
    motors = [rig["motor_1"], rig["motor_2"]]
    foot = data.geom("foot").xpos.copy()
    opening = data.site("front_joint").xpos - data.site("rear_joint").xpos
    return TrueState(
        time=time,
        held=held,
        hip=hip,
        hip_rate=hip_rate,
        boom=np.array(boom_angles(rig, data.qpos)),
        leg=data.qpos[motors],
        leg_rate=data.qvel[motors],
        deflection=deflection,
        foot=foot,
        ground_height=ground_under(devices, views.waves, foot),
        contact_force=views.touch[0],
        closure_error=float(np.linalg.norm(opening)),
        qpos=data.qpos.copy(),
    )
