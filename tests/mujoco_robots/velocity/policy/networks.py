"""A cart that is driven by a linear policy, whose actions are known exactly; and its files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from stepgap.step import Array

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Wheels of the cart in the order of the model."""

TERMS = ("base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command")
"""Observation of mjlab: 9 numbers, three for each joint, and the command."""

_AHEAD, _TURNING = 8.0, 3.0
"""How far a wheel's target is ahead of it by the commanded velocities [rad per m/s, rad per rad/s]."""


def cart_xml(actuators: str = "", ground: str = "") -> str:
    """A cart with four wheels: the targets of its servos are so far ahead that they drive like motors."""
    places = ((0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15))
    wheels = "".join(
        f'<body name="{name}" pos="{x} {y} 0"><joint name="{name}" axis="0 1 0" armature="0.01"/>'
        '<geom type="sphere" size="0.1" mass="0.5"/></body>'
        for name, (x, y) in zip(WHEELS, places, strict=True)
    )
    return f"""<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    {ground}
    <body name="cart" pos="0 0 0.5">
      <freejoint/>
      <geom type="box" size="0.25 0.1 0.04" mass="5" contype="0" conaffinity="0"/>
      <site name="imu_site" pos="0.1 0.05 0.02" euler="10 20 30"/>
      {wheels}
    </body>
  </worldbody>
  {actuators}
</mujoco>
"""


def driving() -> Array:
    """Weights of a policy that drives the cart by the observation `TERMS`; shape (4, 24)."""
    weights = np.zeros((4, 24))
    weights[:, 9:13] = np.eye(4)  # a target is ahead of where the wheel is
    weights[:, 21], weights[:, 23] = _AHEAD, [-_TURNING, _TURNING, -_TURNING, _TURNING]
    return weights


def write_network(path: Path, weights: Array, metadata: Mapping[str, str] | None = None, rank: int = 2) -> Path:
    """Writes the network y = W x as ONNX, with this metadata."""
    outputs, inputs = weights.shape
    matrix = numpy_helper.from_array(weights.T.astype(np.float32), "weights")
    batch = [1] * (rank - 1)
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [*batch, size])
        for name, size in (("obs", inputs), ("actions", outputs))
    ]
    node = helper.make_node("MatMul", ["obs", "weights"], ["actions"])
    model = helper.make_model(
        helper.make_graph([node], "policy", ends[:1], ends[1:], [matrix]),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    helper.set_model_props(model, dict(metadata or {}))
    onnx.save(model, path)
    return path


def mjlab_metadata() -> dict[str, str]:
    """Metadata of the cart's policy as mjlab 1.6.0 writes it: commas between items, semicolons in them."""
    return {
        "run_path": "somebody/mjlab/1",
        "joint_names": ",".join(WHEELS),
        "joint_stiffness": ",".join(["2.000"] * 4),
        "joint_damping": ",".join(["0.800"] * 4),
        "default_joint_pos": ",".join(["0.000"] * 4),
        "command_names": "twist",
        "observation_names": ",".join(TERMS),
        "observation_terms_scale": ",".join(["1.000"] * 7),
        "observation_terms_flatten_history_dim": ",".join(["1.000"] * 7),
        "observation_terms_history_length": ",".join(["0.000"] * 7),
        "observation_terms_clip": ",".join(["-inf;inf"] * 7),
        "action_scale": "1.0",
    }
