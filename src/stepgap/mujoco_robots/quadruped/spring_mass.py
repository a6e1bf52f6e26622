"""Template of a pronk: a point mass on a massless spring leg under the same control law.

The spring-loaded inverted pendulum (R. Blickhan, The spring-mass model for running and hopping, 1989) with a step
command: a parabola to touchdown, stance with the spring, from mid-stance on with thrust and command, and a parabola to
the next apex. Real legs have masses, which stop when the feet touch the ground; the mass loses velocity then.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.compiled import compiled
from stepgap.learning.residual import join_points
from stepgap.mujoco_robots.quadruped.model import TOE_RADIUS, TOTAL_MASS
from stepgap.mujoco_robots.quadruped.pronk import PronkGains, foot_placement, virtual_force
from stepgap.step import Array, Outcome, StepMap, StepSpace, StepStatus, difference_jacobian


def landing_velocity(model: Any, data: Any, feet: Sequence[str]) -> Array:
    """Velocity (x, z) of the centre of mass just after the feet have stopped, by that before; shape (2, 2).

    All joints but x and z are at rest before. The impact is plastic: v⁺ = v⁻ − M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v⁻, where J is the
    Jacobian of the feet (Y. Hurmuzlu and D. B. Marghitu, Rigid body collisions of planar kinematic chains, 1994).

    Args:
        model: A model whose first two joints move it along x and z.
        data: Its data, in the posture of the landing.
        feet: Names of the geoms that touch the ground.
    """
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((len(feet), 3, model.nv))
    whole = np.zeros((3, model.nv))
    for foot, rows in zip(feet, jacobian, strict=True):
        mujoco.mj_jacGeom(model, data, rows, None, model.geom(foot).id)
    stopped = jacobian[:, [0, 2]].reshape(-1, model.nv)
    impulses = np.zeros_like(stopped)
    mujoco.mj_solveM(model, data, impulses, stopped)  # rows of J M⁻¹, because M is symmetric
    change = impulses.T @ np.linalg.pinv(stopped @ impulses.T) @ stopped
    mujoco.mj_jacSubtreeCom(model, data, whole, 1)
    return (whole[[0, 2]] @ (np.eye(model.nv) - change))[:, :2]


GRAVITY = 9.81
TIME_STEP = 0.002  # Size of an integration step [s]
LONGEST_STANCE = 0.5  # Time in which stance must end [s]

_OK, _FELL, _NO_TAKE_OFF, _INVALID = (
    int(status) for status in (StepStatus.OK, StepStatus.FELL, StepStatus.NO_TAKE_OFF, StepStatus.INVALID)
)


@final
@dataclass(frozen=True, eq=False, repr=False)
class SpringMassMap(StepMap):
    """(speed, height) of an apex, (fx, fz) → (speed, height) of the next apex.

    Attributes:
        quantities: Names, units and ranges.
        gains: Gains of the control law.
        landing: Velocity of the mass after touchdown, (x, z), by that before; shape (2, 2).
        mass: Mass of the robot [kg].
    """

    quantities: StepSpace
    gains: PronkGains
    landing: Array
    mass: float = TOTAL_MASS

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next apexes and status codes; state (…, 2) and command (…, 2) broadcast."""
        points = join_points(state, command)
        flat = np.ascontiguousarray(points.reshape(-1, 4))
        next_state = np.full((len(flat), 2), np.nan)
        status = np.full(len(flat), _INVALID)
        _step_all(self.gains.law, self.landing, self.mass, flat, next_state, status)
        return Outcome(next_state.reshape(*points.shape[:-1], 2), status.reshape(points.shape[:-1]))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Central differences; the map is smooth to 1e-10."""
        return difference_jacobian(self, state, command)


@compiled
def _step_all(law, landing, mass, points, next_state, status):
    """Fills the next state and the status code of every point (speed, height, fx, fz)."""
    for row in range(len(points)):
        speed, height, force_x, force_z = points[row]
        if np.isfinite(speed + height + force_x + force_z):
            status[row], next_state[row, 0], next_state[row, 1] = spring_mass_step(
                law, landing, mass, speed, height, force_x, force_z
            )


@compiled
def spring_mass_step(law, landing, mass, speed, height, force_x, force_z):
    """(status code, speed, height) at the next apex; NaN for a step that fails."""
    ahead, below = foot_placement(law, speed)
    drop = height - TOE_RADIUS + below
    if drop <= 0.0:
        return _FELL, np.nan, np.nan
    fall = -np.sqrt(2.0 * GRAVITY * drop)
    x_rate = landing[0, 0] * speed + landing[0, 1] * fall
    z_rate = landing[1, 0] * speed + landing[1, 1] * fall
    state = (-ahead, -below, x_rate, z_rate)  # the mass relative to the foot, which stands still
    for thrusts in (False, True):
        state, ended = _stance_phase(law, mass, state, thrusts, force_x, force_z)
        if not ended or state[1] < 0.25 * law.rest_length:
            return _FELL, np.nan, np.nan
    if state[3] <= 0.0:
        return _NO_TAKE_OFF, np.nan, np.nan
    return _OK, state[2], state[1] + TOE_RADIUS + state[3] ** 2 / (2.0 * GRAVITY)


@compiled
def _stance_phase(law, mass, state, thrusts, force_x, force_z):
    """State (x, z and their rates, relative to the foot) at the end of a phase of stance, and whether it ended."""
    for _ in range(int(LONGEST_STANCE / TIME_STEP)):
        after = _runge_kutta(law, mass, state, thrusts, force_x, force_z, TIME_STEP)
        if _guard(law, after, thrusts) <= 0.0:
            return _at_event(law, mass, state, after, thrusts, force_x, force_z), True
        state = after
    return state, False


@compiled
def _guard(law, state, thrusts):
    """Positive in a phase, zero at its end: mid-stance, where the leg is shortest, and take-off at its rest length."""
    x, z, x_rate, z_rate = state
    if thrusts:
        return law.rest_length - np.sqrt(x * x + z * z)
    return -(x * x_rate + z * z_rate)


@compiled
def _at_event(law, mass, before, after, thrusts, force_x, force_z):
    """State at the zero of the guard within a step, by regula falsi (Illinois) over the size of the step."""
    low = 0.0
    high = TIME_STEP
    guard_low = _guard(law, before, thrusts)
    guard_high = _guard(law, after, thrusts)
    state = after
    for _ in range(50):
        if abs(guard_high) < 1e-13 or abs(high - low) < 1e-15:
            break
        size = high - guard_high * (high - low) / (guard_high - guard_low)
        state = _runge_kutta(law, mass, before, thrusts, force_x, force_z, size)
        guard = _guard(law, state, thrusts)
        if guard * guard_high < 0.0:
            low = high
            guard_low = guard_high
        else:
            guard_low *= 0.5
        high = size
        guard_high = guard
    return state


@compiled
def _rates(law, mass, state, thrusts, force_x, force_z):
    x, z, x_rate, z_rate = state
    length_rate = (x * x_rate + z * z_rate) / np.sqrt(x * x + z * z)
    body_x, body_z = virtual_force(law, -x, -z, length_rate, thrusts, force_x, force_z)
    return x_rate, z_rate, body_x / mass, body_z / mass - GRAVITY


@compiled
def _runge_kutta(law, mass, state, thrusts, force_x, force_z, size):
    """State after a step of the classical Runge–Kutta method."""
    first = _rates(law, mass, state, thrusts, force_x, force_z)
    second = _rates(law, mass, _moved(state, first, 0.5 * size), thrusts, force_x, force_z)
    third = _rates(law, mass, _moved(state, second, 0.5 * size), thrusts, force_x, force_z)
    fourth = _rates(law, mass, _moved(state, third, size), thrusts, force_x, force_z)
    return (
        state[0] + size / 6.0 * (first[0] + 2.0 * second[0] + 2.0 * third[0] + fourth[0]),
        state[1] + size / 6.0 * (first[1] + 2.0 * second[1] + 2.0 * third[1] + fourth[1]),
        state[2] + size / 6.0 * (first[2] + 2.0 * second[2] + 2.0 * third[2] + fourth[2]),
        state[3] + size / 6.0 * (first[3] + 2.0 * second[3] + 2.0 * third[3] + fourth[3]),
    )


@compiled
def _moved(state, rates, size):
    return (
        state[0] + size * rates[0],
        state[1] + size * rates[1],
        state[2] + size * rates[2],
        state[3] + size * rates[3],
    )
