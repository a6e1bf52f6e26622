"""Loads a MuJoCo model in a process of its own, with limits, and prints what is in it, as JSON.

    python trial.py MODEL.xml SECONDS BYTES

It imports nothing of StepGap, so that it starts quickly.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import hashlib
import json
import resource
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np

_TURNING = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_GROUNDS = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)


def print_described(describe: Callable[[str], dict[str, Any]]) -> None:
    """Sets the limits, and prints the description of the file, or under `error` why there is none."""
    path, seconds, size = sys.argv[1:]
    for kind, limit in ((resource.RLIMIT_CPU, int(seconds)), (resource.RLIMIT_AS, int(size))):
        _, hard = resource.getrlimit(kind)
        with suppress(OSError, ValueError):  # macOS has no limit of the memory
            resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    try:
        answer = describe(path)
    except MemoryError:
        answer = {"error": f"it needs more than {int(size) / 2**30:.0f} GiB of memory"}
    except Exception as error:  # of any kind
        answer = {"error": " ".join(str(error).split()) or type(error).__name__}
    json.dump(answer, sys.stdout)


def _described(path: str) -> dict[str, Any]:
    model = mujoco.MjModel.from_xml_path(path)
    mujoco.MjData(model)
    joints = [model.joint(number) for number in range(model.njnt)]
    keys = [model.key(number) for number in range(model.nkey)]
    fixed = model.geom_type[model.body_weldid[model.geom_bodyid] == 0]
    return {
        "joints": [joint.name for joint in joints],
        "actuators": [model.actuator(number).name for number in range(model.nu)],
        "bodies": [model.body(number).name for number in range(model.nbody)],
        "geoms": [[model.geom(number).name, int(model.geom_bodyid[number])] for number in range(model.ngeom)],
        "touching": [
            number for number in range(model.ngeom) if model.geom_contype[number] | model.geom_conaffinity[number]
        ],
        "coordinates": _coordinates(model),
        "start": model.qpos0.tolist(),
        "addresses": {joint.name: int(joint.qposadr[0]) for joint in joints if joint.type[0] in _TURNING},
        "driven": [_driven(model, number) for number in range(model.nu)],
        "servos": (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)).tolist(),
        "keyframes": {key.name or str(key.id): key.qpos.tolist() for key in keys},
        "sites": [model.site(number).name for number in range(model.nsite)],
        "ground": bool(np.isin(fixed, _GROUNDS).any()),
        "timestep": float(model.opt.timestep),
        "same": _digest(model),
    }


def _driven(model: Any, actuator: int) -> str:
    """Name of the joint that an actuator moves; empty if it moves none."""
    moves = model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_JOINT)
    return model.joint(model.actuator_trnid[actuator, 0]).name if moves else ""


def _coordinates(model: Any) -> dict[str, int]:
    """Addresses of the height in `qpos` and `qvel`, and of the forward speed in `qvel`, as far as joints have them."""
    found: dict[str, int] = {}
    for number in range(model.njnt):
        position, rate = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
        axis = abs(model.jnt_axis[number])
        if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE:
            return {"height": position + 2, "rise": rate + 2, "speed": rate}
        if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE and model.body_parentid[model.jnt_bodyid[number]] == 0:
            if axis[2] > 0.9:
                found |= {"height": position, "rise": rate}
            elif axis[0] > 0.9:
                found |= {"speed": rate}
    return found


def _digest(model: Any) -> str:
    """Equal for models that move in the same way and look the same."""
    names = "body_mass", "body_inertia", "geom_size", "geom_pos", "qpos0", "mesh_vert", "tex_data", "hfield_data"
    digest = hashlib.sha256(str([model.nq, model.nv, model.nu, model.na, model.nsensor, model.nskinvert]).encode())
    for name in names:
        digest.update(getattr(model, name).tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    print_described(_described)
