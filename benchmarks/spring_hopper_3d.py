"""A point mass on a spring leg that hops in three dimensions and turns: six states, four commands, no other library.

In the frame of its heading the foot lands ahead and beside the mass by the neutral point of the velocity and by the
command; in stance the leg is a damped spring, pushes from mid-stance on with a thrust, and turns the heading against
the ground by a torque (Raibert's machine with a massless leg, and a motor about the vertical).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.compiled import compiled
from stepgap.learning.residual import join_points
from stepgap.robots.map_simulation import MapSimulation
from stepgap.robots.robot import Robot
from stepgap.step import Array, Outcome, Quantity, StepMap, StepSpace, StepStatus, difference_jacobian

STATE = (
    Quantity("speed", "m/s", 0.0, 0.8),
    Quantity("height", "m", 0.62, 0.74),
    Quantity("offset", "m", -0.5, 0.5),
    Quantity("side_speed", "m/s", -0.4, 0.4),
    Quantity("yaw", "rad", -0.4, 0.4),
    Quantity("yaw_rate", "rad/s", -1.0, 1.0),
)
"""Forward speed and height at the apex; place to the left of a line, speed to the left, and heading with its rate."""

COMMAND = (
    Quantity("foot_x", "m", -0.05, 0.05),
    Quantity("foot_y", "m", -0.05, 0.05),
    Quantity("thrust", "N", -40.0, 40.0),
    Quantity("torque", "N*m", -2.0, 2.0),
)
"""Where the foot lands ahead and beside the neutral point, how hard the leg pushes, and the torque in stance."""

LEG, GRAVITY, NEUTRAL_TIME, VELOCITY_GAIN, TIME_STEP, MOST_STEPS = 0.5, 9.81, 0.085, 0.03, 0.002, 250


@dataclass(frozen=True)
class Machine:
    """Parameters of the machine; its differences from the model are another machine.

    Attributes:
        mass: Mass [kg].
        inertia: Moment of inertia about the vertical [kg·m²].
        stiffness: Stiffness of the leg [N/m].
        damping: Damping of the leg [N·s/m].
        thrust: Force from mid-stance on [N].
        yaw_damping: Friction torque of the foot per rate of the heading [N·m·s/rad].
        foot_offset: How far the foot lands beside where it is placed [m].
        twist: Torque of the leg about the vertical in stance [N·m].
    """

    mass: float = 10.0
    inertia: float = 0.35
    stiffness: float = 3500.0
    damping: float = 25.0
    thrust: float = 70.0
    yaw_damping: float = 1.0
    foot_offset: float = 0.0
    twist: float = 0.0


@dataclass(frozen=True)
class SpringHopperMap(StepMap):
    """The map from apex to apex.

    Attributes:
        quantities: State and command.
        machine: Its parameters.
    """

    quantities: StepSpace
    machine: Machine = field(default_factory=Machine)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; state (…, 6) and command (…, 4) broadcast."""
        points = join_points(state, command)
        flat = np.ascontiguousarray(points.reshape(-1, 10))
        next_state, fell = np.full((len(flat), 6), np.nan), np.ones(len(flat), bool)
        _steps(np.array(list(vars(self.machine).values())), flat, next_state, fell)
        status = np.where(fell, int(StepStatus.FELL), int(StepStatus.OK))
        return Outcome(next_state.reshape(*points.shape[:-1], 6), status.reshape(points.shape[:-1]))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Central differences."""
        return difference_jacobian(self, state, command)


@dataclass(frozen=True)
class SpringHopper3D(Robot):
    """The robot.

    Attributes:
        gap: The machine of the simulated robot.
        tracked: Names of the states that have targets.
    """

    gap: Machine = field(
        default_factory=lambda: Machine(
            mass=10.8,
            inertia=0.42,
            stiffness=3250.0,
            damping=32.0,
            thrust=76.0,
            yaw_damping=1.5,
            foot_offset=0.008,
            twist=0.15,
        )
    )
    tracked: tuple[str, ...] = ("speed", "height", "offset")

    name = "spring_hopper_3d"

    @property
    def space(self) -> StepSpace:
        """Six states and four commands."""
        return StepSpace(tuple(replace(each, weight=float(each.name in self.tracked)) for each in STATE), COMMAND)

    def nominal_maps(self):
        """The model."""
        return {"equations": lambda: SpringHopperMap(self.space)}

    def simulations(self):
        """Another machine, with noise of the measured states: 5 mm/s, 1 mm, 2 mm, 5 mm/s, 2 mrad, 10 mrad/s."""
        real = SpringHopperMap(self.space, self.gap)
        noise, start = [0.005, 0.001, 0.002, 0.005, 0.002, 0.01], [0.3, 0.68, 0.0, 0.0, 0.0, 0.0]
        return {"machine": lambda world: MapSimulation(real, start, noise)}


@compiled
def _steps(machine, points, next_state, fell):
    for row in range(len(points)):
        _step(machine, points[row], next_state[row], fell[row : row + 1])


@compiled
def _step(machine, point, after, fell):
    """Fills the next state and whether the step failed, for a point (state, command)."""
    _, inertia, _, _, _, yaw_damping, foot_offset, twist = machine
    speed, height, offset, side, yaw, yaw_rate, foot_x, foot_y, thrust, torque = point
    gain = NEUTRAL_TIME + VELOCITY_GAIN
    x, y = gain * speed + foot_x, gain * side + foot_y + foot_offset
    below = LEG * LEG - x * x - y * y
    if not below > 0.04 or not height > np.sqrt(below):
        return
    fall = np.sqrt(2.0 * (height - np.sqrt(below)) / GRAVITY)
    state = np.array([-x, -y, np.sqrt(below), speed, side, -GRAVITY * fall])  # the mass relative to the foot
    pushes, stance = False, 0.0
    for _ in range(MOST_STEPS):
        later = _moved(machine, state, pushes, thrust, TIME_STEP)
        length, rate = _length(later)
        part = 1.0
        if not pushes and rate > 0.0:
            pushes = True
        elif pushes and length >= LEG:
            before, _ = _length(state)
            part = (LEG - before) / (length - before)
            later = _moved(machine, state, pushes, thrust, part * TIME_STEP)
        state, stance = later, stance + part * TIME_STEP
        if part < 1.0 or state[2] < 0.2:
            break
    if not (part < 1.0 and state[5] > 0.0):
        return
    rise = state[5] / GRAVITY
    decay = np.exp(-yaw_damping / inertia * stance)
    steady = (torque + twist) / yaw_damping
    turned = yaw_rate * fall + steady * stance + (yaw_rate - steady) * (1.0 - decay) * inertia / yaw_damping
    rate_after = steady + (yaw_rate - steady) * decay
    turned += rate_after * rise
    forward = speed * fall + state[0] + x + state[3] * rise
    left = side * fall + state[1] + y + state[4] * rise
    c, s = np.cos(turned), np.sin(turned)
    after[0], after[3] = c * state[3] + s * state[4], c * state[4] - s * state[3]
    after[1] = state[2] + 0.5 * GRAVITY * rise * rise
    after[2] = offset + np.sin(yaw) * forward + np.cos(yaw) * left
    after[4], after[5] = yaw + turned, rate_after
    fell[0] = False


@compiled
def _length(state):
    """Length of the leg and its rate."""
    length = np.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    return length, (state[0] * state[3] + state[1] * state[4] + state[2] * state[5]) / length


@compiled
def _moved(machine, state, pushes, thrust, size):
    """State after a step of the classical Runge–Kutta method."""
    first = _rates(machine, state, pushes, thrust)
    second = _rates(machine, state + 0.5 * size * first, pushes, thrust)
    third = _rates(machine, state + 0.5 * size * second, pushes, thrust)
    fourth = _rates(machine, state + size * third, pushes, thrust)
    return state + size / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


@compiled
def _rates(machine, state, pushes, thrust):
    length, rate = _length(state)
    force = machine[2] * (LEG - length) - machine[3] * rate + (machine[4] + thrust if pushes else 0.0)
    found = np.empty(6)
    found[:3] = state[3:]
    found[3:] = force / (machine[0] * length) * state[:3]
    found[5] -= GRAVITY
    return found
