"""The robot `policy`: a MuJoCo model that a trained policy moves at a commanded velocity."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork
from stepgap.mujoco_robots.velocity.policy.policy_control import PolicyControl
from stepgap.mujoco_robots.velocity.policy.policy_model import policy_spec, stand
from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings, read_policy_settings
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot


@dataclass(frozen=True)
class PolicyFile:
    """Where the policy is.

    Attributes:
        file: A `policy.toml`, as `stepgap new --policy` writes it; the path is relative to the experiment's file.
    """

    file: str = ""


@dataclass(frozen=True)
class PolicyRobot(WalkingRobot):
    """A robot that a trained policy moves.

    Attributes:
        policy: Where the policy is.
    """

    policy: PolicyFile = field(default_factory=PolicyFile)

    name = "policy"
    files = {"policy.file": False}  # noqa: RUF012

    def check(self) -> None:
        """Raises ValueError if no policy is named."""
        wanted = "name a policy.toml, as stepgap new FOLDER --policy POLICY.onnx --mjcf MODEL.xml writes"
        require(bool(self.policy.file), "policy.file", self.policy.file, wanted)

    @property
    def tick(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Time step of the simulation [s]."""
        return self._settings.timestep

    @cached_property
    def _settings(self) -> PolicySettings:
        return read_policy_settings(Path(self.policy.file))

    @cached_property
    def _network(self) -> OnnxNetwork:
        file = Path(self.policy.file)
        network = OnnxNetwork(file.parent / self._settings.policy)
        check_network(self._settings, network.input_size, network.output_size, file)
        return network

    def mjcf_spec(self) -> Any:
        """The model of the policy."""
        return policy_spec(self._settings, Path(self.policy.file))

    def stand(self, model: Any, data: Any) -> None:
        """On the ground, in the default posture of the policy."""
        stand(self._settings.joints, self._settings.default_joint_pos, model, data)

    def walking_control(self) -> PolicyControl:
        """The policy without memory of the past."""
        return PolicyControl(self._settings, self._network)


def check_network(settings: PolicySettings, inputs: int, outputs: int, file: Path) -> None:
    """Ensures that observation and actions have the sizes of the network.

    Args:
        settings: The policy.
        inputs: Size of the input of its network.
        outputs: Size of its output.
        file: Its `policy.toml`, for messages.

    Raises:
        InputError: They have others.
    """
    sizes = [settings.sizes[term] for term in settings.observation]
    total = sum(size * length for size, length in zip(sizes, settings.histories, strict=True))
    if total != inputs:
        terms = ", ".join(f"{term} {size}" for term, size in zip(settings.observation, sizes, strict=True))
        times = f", history {', '.join(map(str, settings.history))}" if settings.history != (1,) else ""
        found = f"its terms have {total} numbers ({terms}{times}), but {settings.policy} wants {inputs}"
        raise InputError(f"{file}: observation: {found}; give the terms of the training")
    if len(settings.joints) != outputs:
        number = len(settings.joints)
        raise InputError(
            f"{file}: joints: there are {number}, but {settings.policy} has {outputs} actions; give a joint for each"
        )
