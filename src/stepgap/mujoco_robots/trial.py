"""Opens a model or a network of others in another process, with limits, and says what is in it.

A file that ends its reader, or never lets it end, ends this process only. This module is also its program:

    python -m stepgap.mujoco_robots.trial READER FILE SECONDS BYTES
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import hashlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from stepgap.base.trial_process import answer_of, print_answer

_SECONDS: Final = 60  # longest time of a processor [s]
_MEMORY: Final = 4 * 2**30  # largest memory [bytes]


class Parts(NamedTuple):
    """What is in a model; a part without a name has an empty one.

    Attributes:
        joints: Names of the joints, in the order of `qpos`.
        actuators: Names of the actuators, in the order of `ctrl`.
        geoms: By the name of each body, or its number if it has none, the names of its geoms, or their numbers.
        touching: The geoms that can touch another one, without those of the world.
        coordinates: Addresses `height` in `qpos`, `rise` and `speed` in `qvel`, of the robot's place, as far as known.
        start: The first posture, `qpos0`.
        addresses: Addresses in `qpos` of hinges and slides, by the name of the joint.
        driven: Joint that each actuator moves, empty if it moves none; in the order of `ctrl`.
        servos: Whether each actuator is a position servo or another one with a bias.
        keyframes: Their `qpos`, by the name of the keyframe, or its number if it has none.
        sites: Names of the sites.
        ground: Whether a plane or a height field is fixed to the world.
        timestep: Time step of the simulation [s].
        same: Equal for the same model.
    """

    joints: list[str]
    actuators: list[str]
    geoms: dict[str | int, list[str | int]]
    touching: list[str | int]
    coordinates: dict[str, int]
    start: list[float]
    addresses: dict[str, int]
    driven: list[str]
    servos: list[bool]
    keyframes: dict[str, list[float]]
    sites: list[str]
    ground: bool
    timestep: float
    same: str


class NetworkParts(NamedTuple):
    """What is in a network.

    Attributes:
        inputs: Size of its input.
        outputs: Size of its output.
        metadata: What its file says of it, by names.
        ends: Names of its input and its output.
    """

    inputs: int
    outputs: int
    metadata: Mapping[str, str]
    ends: Sequence[str] = ()


def parts_of_model(model: Path, seconds: int = _SECONDS, memory: int = _MEMORY) -> Parts:
    """Loads a MuJoCo model.

    Args:
        model: The file.
        seconds: Longest time of a processor that it may need [s].
        memory: Largest memory that it may need [bytes].

    Raises:
        ValueError: It cannot be loaded, or needs more; the message is the reason.
    """
    parts = _tried("MuJoCo", model, seconds, memory)
    parts["geoms"] = dict(parts["geoms"])
    return Parts(**parts)


def parts_of_network(network: Path) -> NetworkParts:
    """Opens an ONNX file, and runs its network once.

    Raises:
        ValueError: It cannot be opened, or needs too much time or memory; the message names it, with the reason.
    """
    try:
        return NetworkParts(**_tried("onnxruntime", network, _SECONDS, _MEMORY))
    except ValueError as error:
        raise ValueError(f"{network}: {str(error).removeprefix(f'{network.absolute()}: ')}") from None


def _tried(reader: str, file: Path, seconds: int, memory: int) -> dict[str, Any]:
    with TemporaryDirectory() as folder:  # MuJoCo writes a log into the current folder
        return answer_of(__name__, [reader, str(file.absolute())], reader, seconds, memory, Path(folder))


# ---- in the other process


def _network_parts(path: str) -> dict[str, Any]:
    import numpy as np

    from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork

    network = OnnxNetwork(Path(path))
    network(np.zeros(network.input_size))
    sizes = {"inputs": network.input_size, "outputs": network.output_size}
    return sizes | {"metadata": network.metadata, "ends": network.ends}


def _model_parts(path: str) -> dict[str, Any]:
    """`Parts` of a model, whose `geoms` are pairs, since keys of JSON are no numbers."""
    import mujoco

    turning = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    grounds = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)
    model = mujoco.MjModel.from_xml_path(path)
    mujoco.MjData(model)
    joints = [model.joint(number) for number in range(model.njnt)]
    keys = [model.key(number) for number in range(model.nkey)]
    geoms = dict[str | int, list[str | int]]()
    touching = []
    ground = False
    for number, body in enumerate(model.geom_bodyid):
        geom = model.geom(number).name or number
        geoms.setdefault(model.body(body).name or int(body), []).append(geom)
        if body > 0 and model.geom_contype[number] | model.geom_conaffinity[number]:
            touching.append(geom)
        ground |= model.body_weldid[body] == 0 and model.geom_type[number] in grounds
    driven = [
        model.joint(target).name if kind == int(mujoco.mjtTrn.mjTRN_JOINT) else ""
        for kind, target in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True)
    ]
    return {
        "joints": [joint.name for joint in joints],
        "actuators": [model.actuator(number).name for number in range(model.nu)],
        "geoms": list(geoms.items()),
        "touching": touching,
        "coordinates": _coordinates(model),
        "start": model.qpos0.tolist(),
        "addresses": {joint.name: int(joint.qposadr[0]) for joint in joints if joint.type[0] in turning},
        "driven": driven,
        "servos": (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)).tolist(),
        "keyframes": {key.name or str(key.id): key.qpos.tolist() for key in keys},
        "sites": [model.site(number).name for number in range(model.nsite)],
        "ground": bool(ground),
        "timestep": float(model.opt.timestep),
        "same": _digest(model),
    }


def _coordinates(model: Any) -> dict[str, int]:
    """Addresses of the height in `qpos` and `qvel`, and of the forward speed in `qvel`, as far as joints have them."""
    import mujoco

    addresses: dict[str, int] = {}
    for number in range(model.njnt):
        position = int(model.jnt_qposadr[number])
        rate = int(model.jnt_dofadr[number])
        axis = abs(model.jnt_axis[number])
        if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE:
            return {"height": position + 2, "rise": rate + 2, "speed": rate}
        if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE and model.body_parentid[model.jnt_bodyid[number]] == 0:
            if axis[2] > 0.9:
                addresses |= {"height": position, "rise": rate}
            elif axis[0] > 0.9:
                addresses |= {"speed": rate}
    return addresses


def _digest(model: Any) -> str:
    """Equal for models that move in the same way and look the same."""
    names = "body_mass", "body_inertia", "geom_size", "geom_pos", "qpos0", "mesh_vert", "tex_data", "hfield_data"
    digest = hashlib.sha256(str([model.nq, model.nv, model.nu, model.na, model.nsensor, model.nskinvert]).encode())
    for name in names:
        digest.update(getattr(model, name).tobytes())
    return digest.hexdigest()


_READERS: Mapping[str, Callable[[str], dict[str, Any]]] = {"MuJoCo": _model_parts, "onnxruntime": _network_parts}


if __name__ == "__main__":
    print_answer(lambda: _READERS[sys.argv[1]](sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
