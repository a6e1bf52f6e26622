"""The interface of what moves a walking robot at a commanded velocity: a gait, or a trained policy."""

from abc import ABC, abstractmethod
from typing import Any

from stepgap.step import Array


class WalkingControl(ABC):
    """Moves the joints of a walking robot at a commanded velocity.

    One object controls one robot; a copy of the robot is made by `deepcopy`, with the memory of its control.

    Attributes:
        period: Time between two calls of `control` [s], a multiple of the robot's tick.
    """

    period: float

    def start(self, model: Any, data: Any) -> None:  # noqa: B027  (a control without memory needs none)
        """Forgets the past; the robot stands in its start posture.

        Args:
            model: MuJoCo model.
            data: Its data.
        """

    @abstractmethod
    def control(self, model: Any, data: Any, command: Array) -> Array:
        """Values of `data.ctrl` until the next call; shape (nu,).

        Args:
            model: MuJoCo model.
            data: Its data, which must not be changed.
            command: Velocity forward, to the left, and of turning to the left; shape (3,) [m/s, m/s, rad/s].
        """
