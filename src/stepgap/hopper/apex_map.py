"""The hopper's Poincaré map at the apex (Eq. 10)."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from stepgap.hopper.dynamics import masses_of
from stepgap.hopper.hop import Tolerances, hop
from stepgap.hopper.joint_control import joint_law
from stepgap.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.hybrid.compiled import compiled
from stepgap.hybrid.integrator import Tolerance
from stepgap.step import Array, Outcome, StepMap, StepSpace, difference_jacobian

SMALLEST_SHARE = 16
"""Fewest steps worth a thread of their own."""


@compiled
def _hop_all(masses, law, tolerances, points, next_state, reason):
    for i in range(points.shape[0]):
        reason[i] = hop(masses, law, tolerances, points[i, 0], points[i, 1], points[i, 2], points[i, 3], next_state[i])


@dataclass(frozen=True)
class ApexMap(StepMap):
    """Map [speed, height], [fx, fy] → next [speed, height] of the physics model.

    The relative error, to the value or half its range of use, is below 1e-6 with the default tolerances, also where
    torques saturate. Large batches run on all cores.

    Attributes:
        robot: The robot.
        gains: Its joint controller.
        bounds: Range of the command.
        tolerances: Local errors of the integration.

    Raises:
        ValueError: A length is out of the leg's reach, or command bounds are reversed.
    """

    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    bounds: CommandBounds = field(default_factory=CommandBounds)
    tolerances: Tolerances = Tolerances(flight=Tolerance(1e-5, 1e-7), stance=Tolerance(1e-10, 1e-10))

    def __post_init__(self) -> None:
        joint_law(self.robot, self.gains)
        self.bounds.space()

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self.bounds.space()

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next apexes and reason codes; state (…, 2) and command (…, 2) broadcast.

        Raises:
            ValueError: The last axis of state or command has not two numbers.
        """
        state, command = np.asarray(state, float), np.asarray(command, float)
        if state.shape[-1:] != (2,) or command.shape[-1:] != (2,):
            raise ValueError(
                f"state {state.shape} and command {command.shape} must end with the axes (speed, height) and (fx, fy)"
            )
        leading = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
        points = np.empty((*leading, 4))
        points[..., :2], points[..., 2:] = state, command
        points = points.reshape(-1, 4)
        next_state, reason = np.full((len(points), 2), np.nan), np.zeros(len(points), dtype=np.int64)
        constants = masses_of(self.robot), joint_law(self.robot, self.gains), self.tolerances
        shares = max(1, min(os.cpu_count() or 1, len(points) // SMALLEST_SHARE))
        if shares == 1:
            _hop_all(*constants, points, next_state, reason)
        else:
            with ThreadPoolExecutor(shares) as pool:
                parts = zip(*(np.array_split(array, shares) for array in (points, next_state, reason)), strict=True)
                for job in [pool.submit(_hop_all, *constants, *part) for part in parts]:
                    job.result()
        return Outcome(next_state.reshape(*leading, 2), reason.reshape(leading))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next speed, next height)/∂(speed, height, fx, fy) by central differences; shape (…, 2, 4)."""
        return difference_jacobian(self, state, command)
