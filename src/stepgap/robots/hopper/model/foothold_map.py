"""The hopper's map with one more output: the stride, from the foothold of a hop to the next one.

It follows from the apexes before and after the hop, so the equations of motion are not solved again. From touchdown to
take-off the hip moves over the foot, then it flies to the next touchdown, at which the leg is in the landing posture:

    stride = −r(v) + T (v + v′)/2 + v′ (t_up + t_down) + r(v′)

with the foot at r(v) before the hip at touchdown, the duration T of a stance, and speeds v and v′ of the two apexes.
"""

from dataclasses import dataclass
from functools import cached_property
from math import asin, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.model.dynamics import Masses, masses_of
from stepgap.robots.hopper.model.leg import knee_angle, leg_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.step import Array, Outcome, StepMap, StepSpace


@dataclass(frozen=True)
class FootholdMap(StepMap):
    """Map [speed, height, ·], [fx, fy] → next [speed, height, stride]; the last number of a state has no effect.

    Attributes:
        apexes: Map of speed and height, such as `ApexMap`.
        robot: The robot.
        gains: Its joint controller.
        bounds: Range of the command.
        ground: With footholds.
    """

    apexes: StepMap
    robot: RobotParameters
    gains: Gains
    bounds: CommandBounds
    ground: UnevenGround

    @cached_property
    def _space(self) -> StepSpace:
        return self.bounds.space(self.ground)

    @cached_property
    def _masses(self) -> Masses:
        return masses_of(self.robot)

    @cached_property
    def _toe(self) -> tuple[float, float]:
        """Distance of the landing foot from the hip [m], and its angle from the leg's axis [rad]."""
        leg = leg_of(self.robot)
        length = self.gains.landing_length
        beta = asin(leg.top / leg.bottom * sin(knee_angle(leg, length)))
        x = leg.foot * sin(beta)
        y = length + leg.foot * cos(beta)
        return sqrt(x**2 + y**2), float(np.arctan2(x, y))

    @property
    def space(self) -> StepSpace:
        """State [speed, height, stride], command [fx, fy]."""
        return self._space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; state (…, 3) and command (…, 2) broadcast."""
        state = np.asarray(state, float)
        next_apex, status = self.apexes.evaluate(state[..., :2], command)
        speed = state[..., 0]
        next_speed = next_apex[..., 0]
        stance, flight = self._times(next_apex[..., 1])
        stride = self._ahead(next_speed) - self._ahead(speed) + stance * (speed + next_speed) / 2 + flight * next_speed
        return Outcome(np.concatenate([next_apex, stride[..., None]], axis=-1), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, 3, 5), NaN where the step fails."""
        state = np.asarray(state, float)
        next_apex = self.apexes.evaluate(state[..., :2], command).next_state
        of_apexes = self.apexes.jacobian(state[..., :2], command)
        stance, flight = self._times(next_apex[..., 1])
        per_height = next_apex[..., 0] * 2 * self._masses.y / self._masses.weight / flight * 2
        per_speed = self._ahead_by(next_apex[..., 0]) + stance / 2 + flight
        stride = per_speed[..., None] * of_apexes[..., 0, :] + per_height[..., None] * of_apexes[..., 1, :]
        stride[..., 0] += stance / 2 - self._ahead_by(state[..., 0])
        rows = np.concatenate([of_apexes, stride[..., None, :]], axis=-2)
        return np.insert(rows, 2, 0.0 * rows[..., 0], axis=-1)

    def _times(self, height: Array) -> tuple[float, Array]:
        """Duration of a stance, half a period of mass and spring, and that of a flight with an apex at a height [s]."""
        distance, _ = self._toe
        rise = np.maximum(height - distance, 1e-6)
        stance = pi * sqrt(self._masses.y / self.gains.stiffness)
        return stance, 2 * np.sqrt(2 * rise * self._masses.y / self._masses.weight)

    def _ahead(self, speed: Array) -> Array:
        """How far the foot is before the hip at the touchdown after an apex with a speed [m]."""
        distance, angle = self._toe
        return distance * np.sin(self.gains.speed_gain * (speed - self.gains.speed_setpoint) + angle)

    def _ahead_by(self, speed: Array) -> Array:
        """Derivative of `_ahead` by the speed [s]."""
        distance, angle = self._toe
        return (
            distance
            * self.gains.speed_gain
            * np.cos(self.gains.speed_gain * (speed - self.gains.speed_setpoint) + angle)
        )
