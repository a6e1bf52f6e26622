"""The physics model with the parameters that predict the recorded steps best."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from stepgap.learning.observations import Observations
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.step import Array, Outcome, StepMap, StepSpace

STATE_ERROR_SCALE = np.array([0.01, 0.002])
"""Error of the next speed [m/s] and height [m] with the cost of a parameter one prior standard deviation off."""

FAILED_STEP_COST = 10.0
"""Cost of a recorded step that fails with the tried parameters [scaled errors]."""


@dataclass(frozen=True, eq=False)
class AdjustedMap(StepMap):
    """A map with a constant error of its next state and of its commands.

    Attributes:
        base: The unchanged map.
        shift: Constant added to the next state; shape (n,).
        command_scale: Factor on the command.
    """

    base: StepMap
    shift: Array
    command_scale: float = 1.0

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the map."""
        return self.base.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""
        next_state, status = self.base.evaluate(state, self.command_scale * np.asarray(command, float))
        return Outcome(next_state + self.shift, status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails."""
        jacobian = self.base.jacobian(state, self.command_scale * np.asarray(command, float))
        return jacobian * np.repeat([1.0, self.command_scale], [len(self.space.state), len(self.space.command)])


@dataclass(frozen=True)
class PhysicalError:
    """Differences of a robot from its model that can be observed from one apex per hop.

    A motor offset has the effect of another landing angle and landing length, friction that of less torque.

    Attributes:
        body_mass: Relative error of the body's mass.
        leg_mass: Relative error of the links' masses and inertias.
        boom_vertical: Relative error of the boom's vertical inertia.
        boom_horizontal: Relative error of its horizontal inertia.
        torque: Relative error of every torque.
        landing_speed: Error of the speed at which the leg lands vertically [m/s].
        landing_length: Error of the leg's length at landing [m].
        rest_length: Error of the virtual spring's rest length [m].
    """

    body_mass: float = 0.2
    leg_mass: float = 0.2
    boom_vertical: float = 0.3
    boom_horizontal: float = 0.3
    torque: float = 0.2
    landing_speed: float = 0.1
    landing_length: float = 0.005
    rest_length: float = 0.005


PARAMETER_PRIOR_STD = PhysicalError()
"""Standard deviations of the prior: the defaults above."""


def identify(nominal: ApexMap, steps: Observations) -> AdjustedMap:
    """The physics model with parameters fitted to recorded steps by least squares with a weak prior."""
    prior_std = np.array([getattr(PARAMETER_PRIOR_STD, field.name) for field in fields(PARAMETER_PRIOR_STD)])
    next_state = nominal.evaluate(steps.state, steps.command).next_state + steps.error

    def residuals(scaled: Array) -> Array:
        step_map = with_error(nominal, PhysicalError(*(scaled * prior_std).tolist()))
        error = (next_state - step_map.evaluate(steps.state, steps.command).next_state) / STATE_ERROR_SCALE
        return np.concatenate([np.nan_to_num(error, nan=FAILED_STEP_COST).ravel(), scaled])

    limits = np.full(len(prior_std), 3.0)
    found = least_squares(residuals, np.zeros(len(prior_std)), bounds=(-limits, limits), diff_step=1e-3, max_nfev=30)
    return with_error(nominal, PhysicalError(*(found.x * prior_std).tolist()))


def with_error(nominal: ApexMap, error: PhysicalError) -> AdjustedMap:
    """Model of a robot with these differences from the nominal one."""
    gains, torque = nominal.gains, 1 + error.torque
    gains = replace(
        gains,
        stiffness=gains.stiffness * torque,
        position_gain=gains.position_gain * torque,
        damping_gain=gains.damping_gain * torque,
        speed_setpoint=gains.speed_setpoint + error.landing_speed,
        landing_length=gains.landing_length + error.landing_length,
        rest_length=gains.rest_length + error.rest_length,
    )
    base = ApexMap(erring_robot(nominal.robot, error), gains, nominal.bounds, nominal.tolerances)
    return AdjustedMap(base, np.zeros(len(nominal.space.state)), torque)


def erring_robot(robot: RobotParameters, error: PhysicalError) -> RobotParameters:
    """Robot with these differences from the nominal one."""
    legs = 1 + error.leg_mass
    return replace(
        robot,
        body_mass=robot.body_mass * (1 + error.body_mass),
        top_mass=robot.top_mass * legs,
        bottom_mass=robot.bottom_mass * legs,
        top_inertia=robot.top_inertia * legs,
        bottom_inertia=robot.bottom_inertia * legs,
        boom_inertia_vertical=robot.boom_inertia_vertical * (1 + error.boom_vertical),
        boom_inertia_horizontal=robot.boom_inertia_horizontal * (1 + error.boom_horizontal),
        torque_limit=robot.torque_limit * (1 + error.torque),
    )
