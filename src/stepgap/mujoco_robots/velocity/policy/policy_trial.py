"""Whether onnxruntime can open and run a network, and what is in it, without a risk for this process."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from stepgap.mujoco_robots.mjcf.model_trial import description

_TRIAL: Final = Path(__file__).with_name("trial.py")


class NetworkParts(NamedTuple):
    """What is in a network.

    Attributes:
        inputs: Size of its input.
        outputs: Size of its output.
        metadata: What its file says of it, by names.
    """

    inputs: int
    outputs: int
    metadata: Mapping[str, str]


def parts_of_network(network: Path) -> NetworkParts:
    """Opens a network in another process, and runs it once.

    Args:
        network: The ONNX file.

    Raises:
        ValueError: It cannot be opened, or needs too much time or memory; the message names it, with the reason.
    """
    try:
        return NetworkParts(**description(_TRIAL, network, "onnxruntime"))
    except ValueError as error:
        raise ValueError(f"{network}: {str(error).removeprefix(f'{network.resolve()}: ')}") from None
