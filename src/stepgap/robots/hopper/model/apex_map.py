"""The hopper's Poincaré map at the apex (Eq. 10)."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import ArrayLike, NDArray

from stepgap.base.compiled import compiled
from stepgap.hybrid.integrator import Tolerance, make_trace
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.model.dynamics import Masses, masses_of
from stepgap.robots.hopper.model.hop import INVALID, OK, Tolerances, to_apex, to_midstance
from stepgap.robots.hopper.model.joint_control import JointLaw, joint_law
from stepgap.robots.hopper.model.leg import Leg
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.step import Array, Outcome, StepMap, StepSpace

SMALLEST_SHARE = 32  # Smallest number of steps for which an extra thread pays off
NUDGE = 8e-8  # Step of the finite differences that give the Jacobian, in half ranges
FINER = 0.01
"""Stance tolerance for the Jacobian relative to that for the map; errors are larger where a motor barely saturates."""


def _packed(masses: Masses, law: JointLaw, tolerances: Tolerances) -> Array:
    """Packs the constants into one array, which Python passes ten times faster than nested tuples."""
    return np.array([*masses.leg, *masses[1:], *law[1:], *tolerances.flight, *tolerances.stance])


@compiled
def _unpacked(constants):
    """Unpacks the constants into (masses, law, tolerances)."""
    numbers = to_fixed_tuple(constants, 24)  # pyright: ignore[reportCallIssue]  (Numba adds the first argument)
    leg = Leg(*numbers[:3])
    flight = Tolerance(*numbers[20:22])
    stance = Tolerance(*numbers[22:])
    return Masses(leg, *numbers[3:12]), JointLaw(leg, *numbers[12:20]), Tolerances(flight, stance)


@compiled
def _same_state(points, i):
    """Whether point i has the state of the previous point, so that both hops are equal up to mid-stance."""
    return i > 0 and points[i, 0] == points[i - 1, 0] and points[i, 1] == points[i - 1, 1]


# Constants that compiled code passes to compiled code are types of their own to Numba, so `False` would be another
# version of the function than `True`; `np.bool_(False)` is not.
@compiled
def _hop_all(constants, points, next_state, status):
    """Fills `next_state` (n, 2) and `status` (n,) for points (speed, height, fx, fy) of shape (n, 4)."""
    masses, law, tolerances = _unpacked(constants)
    trace = make_trace()
    landed = INVALID
    middle = (0.0, 0.0, 0.0, 0.0)
    for i in range(points.shape[0]):
        speed, height, force_x, force_y = points[i]
        if not _same_state(points, i):
            landed, middle = to_midstance(masses, law, tolerances, speed, height, trace, np.bool_(False))
        status[i] = landed if np.isfinite(force_x + force_y) else INVALID
        next_state[i] = np.nan
        if status[i] == OK:
            status[i], next_state[i, 0], next_state[i, 1] = to_apex(
                masses, law, tolerances, middle, force_x, force_y, trace, np.bool_(False)
            )


@compiled
def _differentiate_all(constants, nudge, points, jacobian):
    """Fills `jacobian` (n, 2, 4) by differences: neighbours at distance `nudge` (4,) retrace each point's steps."""
    masses, law, tolerances = _unpacked(constants)
    trace_down = make_trace()
    trace_up = make_trace()
    landed = INVALID
    middle = (0.0, 0.0, 0.0, 0.0)
    faster = middle
    higher = middle
    for i in range(points.shape[0]):
        speed, height, force_x, force_y = points[i]
        if not _same_state(points, i):
            landed, middle = to_midstance(masses, law, tolerances, speed, height, trace_down, np.bool_(False))
            if landed == OK:
                _, faster = to_midstance(masses, law, tolerances, speed + nudge[0], height, trace_down, np.bool_(True))
                _, higher = to_midstance(masses, law, tolerances, speed, height + nudge[1], trace_down, np.bool_(True))
        if landed != OK:
            continue
        status, next_speed, next_height = to_apex(
            masses, law, tolerances, middle, force_x, force_y, trace_up, np.bool_(False)
        )
        if status != OK:
            continue
        starts = (faster, higher, middle, middle)
        for j in range(4):
            more_x = nudge[2] if j == 2 else 0.0
            more_y = nudge[3] if j == 3 else 0.0
            _, neighbour_speed, neighbour_height = to_apex(
                masses, law, tolerances, starts[j], force_x + more_x, force_y + more_y, trace_up, np.bool_(True)
            )
            jacobian[i, 0, j] = (neighbour_speed - next_speed) / nudge[j]
            jacobian[i, 1, j] = (neighbour_height - next_height) / nudge[j]


@dataclass(frozen=True, repr=False)
class ApexMap(StepMap):
    """Map [speed, height], [fx, fy] → next [speed, height] of the physics model.

    With the default tolerances the error, relative to the value or to half its range, is below 1e-6, also where torques
    saturate. Large batches run on all cores.

    Attributes:
        robot: The robot.
        gains: Its joint controller.
        bounds: Range of the command.
        tolerances: Local errors of the integration.
        ground: Where it is measured, the height is that above the ground of the hop, which does not change the map.

    Raises:
        ValueError: A length is out of the leg's reach, or command bounds are reversed.
    """

    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    bounds: CommandBounds = field(default_factory=CommandBounds)
    tolerances: Tolerances = Tolerances(flight=Tolerance(5e-3, 5e-4), stance=Tolerance(2e-7, 2e-7))
    ground: UnevenGround = FLAT_GROUND

    def __post_init__(self) -> None:
        joint_law(self.robot, self.gains)
        self.bounds.space()

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self._space

    @cached_property
    def _space(self) -> StepSpace:
        return self.bounds.space(self.ground)

    @cached_property
    def _constants(self) -> Array:
        return _packed(masses_of(self.robot), joint_law(self.robot, self.gains), self.tolerances)

    @cached_property
    def _finer_constants(self) -> Array:
        flight, stance = self.tolerances
        finer = Tolerances(flight, Tolerance(FINER * stance.relative, FINER * stance.absolute))
        return _packed(masses_of(self.robot), joint_law(self.robot, self.gains), finer)

    @cached_property
    def _nudge(self) -> Array:
        return NUDGE * np.concatenate([self.space.state_scale, self.space.command_scale])

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next apexes and status codes; state (…, 2) and command (…, 2) broadcast.

        Consecutive points with the same state share the first half of their hops.

        Raises:
            ValueError: The last axis of state or command does not have length 2.
        """
        points, leading = as_points(state, command)
        next_state = np.empty((len(points), 2))
        status = np.empty(len(points), np.int64)
        on_all_cores(_hop_all, (self._constants,), points, next_state, status)
        return Outcome(next_state.reshape(*leading, 2), status.reshape(leading))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next speed, next height)/∂(speed, height, fx, fy); shape (…, 2, 4), NaN where the step fails.

        Includes the derivatives of the events and of the impact; costs less than five evaluations.

        Raises:
            ValueError: The last axis of state or command does not have length 2.
        """
        points, leading = as_points(state, command)
        jacobian = np.full((len(points), 2, 4), np.nan)
        on_all_cores(_differentiate_all, (self._finer_constants, self._nudge), points, jacobian)
        return jacobian.reshape(*leading, 2, 4)


def as_points(state: ArrayLike, command: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    """Points (speed, height, fx, fy) of shape (n, 4), and the leading shape of state and command."""
    state = np.asarray(state, float)
    command = np.asarray(command, float)
    if state.shape[-1:] != (2,) or command.shape[-1:] != (2,):
        raise ValueError(
            f"state {state.shape} and command {command.shape} must end with the axes (speed, height) and (fx, fy)"
        )
    leading = np.broadcast(state, command).shape[:-1]
    points = np.empty((*leading, 4))
    points[..., :2] = state
    points[..., 2:] = command
    return points.reshape(-1, 4), leading


def on_all_cores(kernel: Callable[..., None], constants: tuple[object, ...], *arrays: NDArray[Any]) -> None:
    """Splits the arrays along their first axis and runs a kernel on each part in a separate thread."""
    size = len(arrays[0])
    shares = min(os.cpu_count() or 1, size // SMALLEST_SHARE) if size >= 2 * SMALLEST_SHARE else 1
    if shares == 1:
        kernel(*constants, *arrays)
        return
    with ThreadPoolExecutor(shares) as pool:
        parts = zip(*(np.array_split(array, shares) for array in arrays), strict=True)
        for job in [pool.submit(kernel, *constants, *part) for part in parts]:
            job.result()
