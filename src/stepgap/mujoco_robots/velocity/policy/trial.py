"""Opens a network in a process of its own, with limits, and prints what is in it, as JSON.

python trial.py NETWORK.onnx SECONDS BYTES
"""

from pathlib import Path
from typing import Any

import numpy as np

from stepgap.mujoco_robots.mjcf.trial import print_described
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork


def _described(path: str) -> dict[str, Any]:
    network = OnnxNetwork(Path(path))
    network(np.zeros(network.input_size))
    return {"inputs": network.input_size, "outputs": network.output_size, "metadata": network.metadata}


if __name__ == "__main__":
    print_described(_described)
