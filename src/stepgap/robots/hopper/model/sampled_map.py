"""The hopper's Poincaré map with torques held from tick to tick, the sampled form of the paper's continuous map."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.compiled import compiled
from stepgap.base.ranges import require
from stepgap.hybrid.integrator import Tolerance, make_trace
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.model.apex_map import as_points, on_all_cores
from stepgap.robots.hopper.model.dynamics import masses_of
from stepgap.robots.hopper.model.joint_control import joint_law
from stepgap.robots.hopper.model.sampled_hop import sampled_hop
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.step import Array, Outcome, StepMap, StepSpace, difference_jacobian

TICKS = (1e-5, 2e-3)
"""Shortest and longest tick [s]; the servo of the default gains is unstable with longer ones."""
DIFFERENCE = 0.05
"""Step of the Jacobian's differences, in half ranges; far longer than the effect of one tick more or less in stance."""


@compiled
def _hop_all(masses, law, tick, tolerance, points, next_state, status):
    trace = make_trace()
    for i in range(points.shape[0]):
        speed, height, command_1, command_2 = points[i]
        status[i], next_state[i, 0], next_state[i, 1] = sampled_hop(
            masses, law, tick, tolerance, speed, height, command_1, command_2, trace
        )


@dataclass(frozen=True)
class SampledApexMap(StepMap):
    """Apex map with torques that change only once per tick, first at the apex; otherwise as `ApexMap`.

    Touchdown and mid-stance fall somewhere within a tick, so the map has small jumps where they pass from one tick
    to the next.

    Attributes:
        robot: The robot.
        gains: Its joint controller.
        bounds: Range of the command.
        tick: Time for which torques are held [s].
        tolerance: Local error of the integration within a tick.
        ground: As of `ApexMap`.

    Raises:
        ValueError: A length is out of the leg's reach, or the tick is out of its range.
    """

    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    bounds: CommandBounds = field(default_factory=CommandBounds)
    tick: float = 1e-3
    tolerance: Tolerance = Tolerance(1e-7, 1e-8)
    ground: UnevenGround = FLAT_GROUND

    def __post_init__(self) -> None:
        joint_law(self.robot, self.gains, self.bounds)
        require(TICKS[0] <= self.tick <= TICKS[1], "tick", self.tick, f"lie between {TICKS[0]:g} and {TICKS[1]:g} s")

    @property
    def space(self) -> StepSpace:
        """State [speed, height], and the command."""
        return self.bounds.space(self.ground)

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next apexes and status codes; state (…, 2) and command (…, 2) broadcast.

        Raises:
            ValueError: The last axis of state or command does not have length 2.
        """
        points, leading = as_points(state, command)
        next_state, status = np.full((len(points), 2), np.nan), np.zeros(len(points), dtype=np.int64)
        constants = masses_of(self.robot), joint_law(self.robot, self.gains, self.bounds), self.tick, self.tolerance
        on_all_cores(_hop_all, constants, points, next_state, status)
        return Outcome(next_state.reshape(*leading, 2), status.reshape(leading))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next speed, next height)/∂(speed, height, command) by differences that average over jumps; (…, 2, 4)."""
        return difference_jacobian(self, state, command, DIFFERENCE)
