"""The true state of the twin, which a controller never sees."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from stepgap.base.compiled_record import Record
from stepgap.robots.hopper.twin.devices import Views, boom_angles, ground_under
from stepgap.robots.hopper.twin.true_apex import true_hip


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
    qpos: NDArray[np.float64]


def true_state(model: Any, scratch: Any, devices: Record, views: Views, time: float, held: bool) -> TrueState:
    """Computes the true state from a copy of the motion, so that the motion itself does not change.

    Args:
        model: MuJoCo's model.
        scratch: MuJoCo's data for the copy.
        devices: Record of `Devices`.
        views: Views of MuJoCo's data with the motion.
        time: Time since connecting [s].
        held: Whether the hip is still held.
    """
    rig = devices[0]
    data = scratch
    data.qpos[:] = views.qpos
    data.qvel[:] = views.qvel
    mujoco.mj_kinematics(model, data)
    hip, hip_rate = true_hip(devices, data.qpos, data.qvel)
    motors = [rig["motor_1"], rig["motor_2"]]
    foot = data.geom("foot").xpos.copy()
    return TrueState(
        time=time,
        held=held,
        hip=np.array(hip),
        hip_rate=np.array(hip_rate),
        boom=np.array(boom_angles(rig, data.qpos)),
        leg=data.qpos[motors],
        leg_rate=data.qvel[motors],
        deflection=data.qpos[2:4].copy() if rig["boom_elastic"] else np.zeros(2),
        foot=foot,
        ground_height=ground_under(devices, views._replace(foot=foot)),
        contact_force=views.touch[0],
        qpos=data.qpos.copy(),
    )
