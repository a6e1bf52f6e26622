"""A robot other than the hopper: a spring-mass runner, whose model has no losses, learns to track speed and height.

The model is a point mass on a massless spring that lands at the commanded angle and pushes with an added stiffness
after its largest compression (SLIP; Blickhan, The spring-mass model for running and hopping, 1989). The real robot is
heavier and softer, and its leg has damping and friction.
"""

from dataclasses import astuple, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numba import guvectorize, njit

from stepgap import (
    ModelPlant,
    Outcome,
    Plants,
    Quantity,
    Reference,
    Setup,
    StepMap,
    StepSpace,
    StepStatus,
    difference_jacobian,
    run_experiment,
)

GRAVITY = 9.81


@njit
def motion(z, robot, push, phase):
    """Rates of z = (x, y, ẋ, ẏ) with the foot at the origin, and the guard, which is positive until the phase ends."""
    mass, stiffness, rest_length, damping, friction = robot
    length = np.hypot(z[0], z[1])
    rate = (z[0] * z[2] + z[1] * z[3]) / length
    force = (stiffness + push) * (rest_length - length) - damping * rate - friction * phase
    thrust = force / (mass * length)
    return np.array([z[2], z[3], thrust * z[0], thrust * z[1] - GRAVITY]), (force if phase > 0 else -rate)


@njit
def integrate(z, robot, push, phase):
    """State at the end of compression (phase −1) or extension (phase 1), by Runge–Kutta steps that are halved there."""
    step = 2e-3
    while step > 1e-12 and z[1] > 0:
        k1 = motion(z, robot, push, phase)[0]
        k2 = motion(z + step / 2 * k1, robot, push, phase)[0]
        k3 = motion(z + step / 2 * k2, robot, push, phase)[0]
        k4 = motion(z + step * k3, robot, push, phase)[0]
        following = z + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if motion(following, robot, push, phase)[1] > 0:
            z = following
        else:
            step /= 2
    return z


@guvectorize(["f8[:], f8[:], f8[:], f8[:], i8[:]"], "(n),(m),(p)->(n),()")
def hop(state, command, robot, next_state, status):
    """Step from apex to apex; NumPy broadcasts it over leading axes."""
    x, y = -robot[2] * np.sin(command[0]), robot[2] * np.cos(command[0])
    next_state[:], status[0] = np.nan, StepStatus.FELL
    if not np.isfinite(state.sum() + command.sum()):
        status[0] = StepStatus.INVALID
    elif state[1] > y:
        z = np.array([x, y, state[0], -np.sqrt(2 * GRAVITY * (state[1] - y))])
        z = integrate(integrate(z, robot, 0.0, -1.0), robot, command[1], 1.0)
        if z[1] > 0:
            status[0] = StepStatus.OK if z[3] > 0 else StepStatus.NO_TAKE_OFF
        if status[0] == StepStatus.OK:
            next_state[0], next_state[1] = z[2], z[1] + z[3] ** 2 / (2 * GRAVITY)


@dataclass(frozen=True)
class SpringRunner(StepMap):
    """Map [speed, height], [angle, push] → next [speed, height]; SI units."""

    mass: float = 10.0
    stiffness: float = 3000.0
    rest_length: float = 0.5
    damping: float = 0.0
    friction: float = 0.0

    space = StepSpace(
        state=(Quantity("speed", "m/s", 0.8, 1.6), Quantity("height", "m", 0.54, 0.66)),
        command=(Quantity("angle", "rad", 0.0, 0.45), Quantity("push", "N/m", -900.0, 900.0)),
    )
    jacobian = difference_jacobian

    def evaluate(self, state, command):
        return Outcome(*hop(state, command, np.array(astuple(self))))


def make_plant(rng):
    """Plant of the real robot, whose noise is drawn from `rng`."""
    real = SpringRunner(mass=10.6, stiffness=2850.0, damping=6.0, friction=4.0)
    return ModelPlant(real, np.array([1.0, 0.58]), np.array([0.01, 0.002]), rng)


stairs = [(1, (1.0, 0.58)), (13, (1.2, 0.6)), (25, (1.4, 0.6)), (37, (1.2, 0.62)), (49, (1.0, 0.6))]
reference = Reference.from_segments(("speed", "height"), stairs, 60)
if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        setup = Setup(SpringRunner(), Plants(make_plant), reference)
        for deployment in run_experiment(setup, Path(folder)):
            print("deployment {}: speed {:.4f} m/s, height {:.4f} m".format(deployment.iteration, *deployment.rmse))
