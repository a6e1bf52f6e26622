"""The MuJoCo model of a robot with a policy: time step and gains of the training, and the posture at the start."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from stepgap.base.errors import InputError
from stepgap.mujoco_robots.mjcf.model_files import model_files
from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings

_TURNING = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_ROUND = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE))


def policy_spec(settings: PolicySettings, file: Path) -> Any:
    """The model as a `mujoco.MjSpec`, with the time step of the policy, and its gains if it has any.

    Servos with gains of the training are integrated as there, implicitly: small links are unstable otherwise.

    Args:
        file: Its `policy.toml`, for paths and messages.

    Raises:
        InputError: The model cannot be loaded, or has not what the policy needs; the message names the key.
    """
    try:
        spec = _walking_spec(file.parent / settings.model)
    except ValueError as error:
        raise InputError(f"{file}: model = {settings.model}: {error}") from None
    spec.option.timestep = settings.timestep
    if settings.imu and spec.site(settings.imu) is None:
        raise InputError(f"{file}: imu = {settings.imu!r}, but the model has no such site")
    servos = [_servo(spec, joint, file) for joint in settings.joints]
    if settings.stiffness:
        if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:  # explicit in the damping of servos
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        gains = np.broadcast_arrays(settings.stiffness, settings.damping, np.zeros(len(servos)))[:2]
        for servo, stiffness, damping in zip(servos, *gains, strict=True):
            _set_gains(servo, float(stiffness), float(damping))
    else:
        for servo, joint in zip(servos, settings.joints, strict=True):
            if servo.biastype != mujoco.mjtBias.mjBIAS_AFFINE or servo.gainprm[0] != -servo.biasprm[1]:
                what = f"the actuator of joint {joint} is no position servo"
                raise InputError(f"{file}: stiffness = [], but {what}; give stiffness and damping of the training")
    return spec


def _walking_spec(path: Path) -> Any:
    """The model in a file; raises ValueError if it cannot be loaded, or cannot walk."""
    try:
        model_files(path)  # raises if it would read the files of somebody else, such as a device that never ends
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"{' '.join(str(error).split()):.300}") from None
    body = spec.worldbody.first_body()
    if body is None or body.first_joint() is None or body.first_joint().type != mujoco.mjtJoint.mjJNT_FREE:
        raise ValueError("its first body has no free joint; give it <freejoint/>, or put the robot before other bodies")
    if not any(joint.type in _TURNING for joint in body.find_all("joint")):
        raise ValueError(f"its first body, {body.name!r}, has no hinges or slides; put the robot before other bodies")
    if not np.any(spec.option.gravity):
        raise ValueError("it has no gravity; give it that of the training")
    return spec


def _servo(spec: Any, joint: str, file: Path) -> Any:
    """The only actuator of a joint."""
    turning = [one.name for one in spec.joints if one.type in _TURNING]
    if joint not in turning:
        names = ", ".join(turning)
        raise InputError(f"{file}: joints has {joint!r}, but the hinges and slides of the model are {names:.600}")
    moving = [actuator for actuator in spec.actuators if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT]
    actuators = [actuator for actuator in moving if actuator.target == joint]
    if len(actuators) != 1:
        raise InputError(f"{file}: joint {joint} has {len(actuators)} actuators in the model; it must have one")
    if not actuators[0].gear[0]:
        raise InputError(f"{file}: the actuator of joint {joint} has gear 0 in the model; give it another one")
    return actuators[0]


def _set_gains(servo: Any, stiffness: float, damping: float) -> None:
    """Makes an actuator a position servo of its joint; that of a motor has the motor's largest force."""
    if servo.biastype == mujoco.mjtBias.mjBIAS_NONE and servo.ctrlrange[0] < servo.ctrlrange[1]:
        servo.forcerange = np.array(servo.ctrlrange) * servo.gainprm[0]
        servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    gear = servo.gear[0]
    servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[:3] = stiffness / gear, 0.0, 0.0  # the actuator sees gear times the position of the joint
    servo.biasprm[:3] = 0.0, -stiffness / gear**2, -damping / gear**2


def actuators_of_joints(model: Any) -> dict[str, int]:
    """Numbers of actuators by the name of the joint that they move."""
    moving = np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT))
    return {model.joint(model.actuator_trnid[number, 0]).name: int(number) for number in moving}


def stand(joints: Sequence[str], positions: Sequence[float], model: Any, data: Any) -> None:
    """Puts a model that was reset on the ground, these joints at these positions, with servos that hold all joints."""
    for joint, position in zip(joints, positions, strict=True):
        data.joint(joint).qpos = position
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= min((_lowest(model, data, geom) for geom in _touching(model)), default=0.0)
    for joint, actuator in actuators_of_joints(model).items():
        if model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE):
            data.ctrl[actuator] = data.joint(joint).qpos[0]


def standing_height(joints: Sequence[str], positions: Sequence[float], path: Path) -> float:
    """Height of the frame of the first body of a model that stands with these joints at these positions [m].

    Raises:
        ValueError: The model cannot be loaded, or cannot walk; the message is the reason.
    """
    model = _walking_spec(path).compile()
    data = mujoco.MjData(model)
    stand(joints, positions, model, data)
    return float(data.qpos[2])


def _touching(model: Any) -> Sequence[int]:
    """Numbers of the geoms of the robot that can touch the ground."""
    can = (model.geom_contype | model.geom_conaffinity) != 0
    return np.flatnonzero(can & (model.geom_bodyid > 0)).tolist()


def _lowest(model: Any, data: Any, geom: int) -> float:
    """Height of the lowest point of a geom, or a little less if it is neither a sphere nor a capsule [m]."""
    up = data.geom_xmat[geom].reshape(3, 3)[2]
    size = model.geom_size[geom]
    if model.geom_type[geom] in _ROUND:
        return float(data.geom_xpos[geom, 2] - size[0] - abs(up[2]) * size[1])
    centre, halves = model.geom_aabb[geom].reshape(2, 3)
    return float(data.geom_xpos[geom, 2] + up @ centre - np.abs(up) @ halves)
