"""The robots of `benchmarks/trust.py`: a robot is drawn by its number, and can be pushed and changed between its steps.

Each has a reference with segments of random targets, drawn by the same number, among them rest and changes that one
step cannot make.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import own_priors
from benchmarks.velocity_robots import (
    STROLLER_SPACE,
    WALKER_SPACE,
    Go1,
    Stroller,
    VelocityBody,
    VelocityPlant,
    Walker,
    as_commanded,
)
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.learning.prior import Prior
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant, MjcfRobot
from stepgap.mujoco_robots.monopod.robot import Monopod
from stepgap.mujoco_robots.quadruped.robot import Quadruped
from stepgap.plants.plant import Plant
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import TwinPlant, TwinSimulation
from stepgap.step import StepMap, StepSpace


class LivePlant(NamedTuple):
    """A plant, and what can happen to it between its steps.

    Attributes:
        plant: The plant.
        push: Adds to its forward speed [m/s].
        change: Changes the robot for the rest of the deployment, as a load does.
    """

    plant: Plant
    push: Callable[[float], None]
    change: Callable[[], None]


class TrustRobot(NamedTuple):
    """A robot.

    Attributes:
        nominal: Its nominal map.
        reference: Targets of all steps.
        live: Makes the plant of a deployment from its random generator.
        priors: Priors over robots with which its runs begin.
    """

    nominal: StepMap
    reference: Reference
    live: Callable[[np.random.Generator], LivePlant]
    priors: Sequence[Prior] = ()


def segments(
    names: Sequence[str],
    first: Sequence[float],
    levels: Sequence[Sequence[float]],
    steps: int,
    rng: np.random.Generator,
) -> Reference:
    """Random targets, each for 6 to 10 steps.

    Args:
        names: Names of the state coordinates.
        first: Targets of the first 8 steps.
        levels: Targets from which each coordinate is drawn.
        steps: Number of steps.
        rng: Draws lengths and targets.
    """
    found, start = [(1, tuple(first))], 9
    while start <= steps:
        found.append((start, tuple(float(rng.choice(level)) for level in levels)))
        start += int(rng.integers(6, 11))
    return Reference.from_segments(names, found, steps)


def hopper(number: int) -> TrustRobot:
    """A random twin of the hopper; its load is 15 % of its mass."""
    robot, rng = Hopper().randomised(random_stream(number)), random_stream(number, 1)
    simulation = TwinSimulation(robot.parameters, robot.gap, robot.control, random_stream(number, 2))
    loaded = replace(robot.gap, body_mass_scale=1.15 * robot.gap.body_mass_scale)

    def live(rng: np.random.Generator) -> LivePlant:
        _, twin = simulation.direct_rig(rng)
        return LivePlant(TwinPlant(twin, robot.control()), twin.push, lambda: twin.become(loaded))

    levels = (0.0, 0.05, 0.2, 0.3, 0.392), (0.55, 0.58, 0.61, 0.629)
    reference = segments(("speed", "height"), (0.0, 0.55), levels, 80, rng)
    return TrustRobot(robot.apex_map(), reference, live, own_priors(robot))


class LoadedPlant(MjcfPlant):
    """A plant of a robot from MJCF that can be pushed and loaded."""

    def push(self, speed: float) -> None:
        """Adds to the first velocity of the model [m/s]."""
        self._stepper._data.qvel[0] += speed

    def load(self) -> None:
        """Adds 15 % to its mass, and takes 7 % of its forces away."""
        gap = self._robot.gap
        heavier = replace(gap, mass_scale=1.15 * gap.mass_scale, gear_scale=0.93 * gap.gear_scale)
        self._stepper._model = heavier.of(self._robot.mjcf_model())


@cache
def _nominal(kind: type[MjcfRobot]) -> StepMap:
    """The first nominal map of a robot, which does not depend on its gap; cached, since the monopod's is simulated."""
    return next(iter(kind().nominal_maps().values()))()


def _from_mjcf(robot: MjcfRobot, reference: Reference) -> TrustRobot:
    def live(rng: np.random.Generator) -> LivePlant:
        plant = LoadedPlant(robot, rng)
        return LivePlant(plant, plant.push, plant.load)

    return TrustRobot(_nominal(type(robot)), reference, live, own_priors(robot))


def quadruped(number: int) -> TrustRobot:
    """A random quadruped that pronks."""
    levels = (0.25, 0.35, 0.5, 0.65, 0.75), (0.39, 0.41, 0.43)
    reference = segments(("speed", "height"), (0.5, 0.41), levels, 80, random_stream(number, 1))
    return _from_mjcf(Quadruped().randomised(random_stream(number)), reference)


def monopod(number: int) -> TrustRobot:
    """A random monopod."""
    levels = (0.0, 0.2, 0.4, 0.6), (0.69, 0.7, 0.72), (0.0, 0.15)
    reference = segments(("speed", "height", "offset"), (0.2, 0.7, 0.0), levels, 60, random_stream(number, 1))
    return _from_mjcf(Monopod().randomised(random_stream(number)), reference)


def _commanded(
    space: StepSpace,
    make: Callable[[np.random.Generator], VelocityBody],
    levels: Sequence[Sequence[float]],
    number: int,
) -> TrustRobot:
    def live(rng: np.random.Generator) -> LivePlant:
        body = make(random_stream(number))
        return LivePlant(VelocityPlant(space, body, rng), body.push, body.change)

    first = np.eye(len(space.state))[0] * 0.3
    reference = segments(space.state_names, first.tolist(), levels, 80, random_stream(number, 1))
    return TrustRobot(as_commanded(space), reference, live)


SPEEDS = (0.0, 0.12, 0.3, 0.55, 0.8)
"""Forward targets of robots that are commanded velocities [m/s]; one step does not lead from the last to the second."""


def robots(policy: Path | None) -> Mapping[str, Callable[[int], TrustRobot]]:
    """The robots by name, each made from its number.

    Args:
        policy: Folder of the policy of the Go1; without one, that robot is left out.
    """
    sideways, turns = (-0.15, 0.0, 0.15), (-0.4, -0.12, 0.0, 0.12, 0.4)
    found: dict[str, Callable[[int], TrustRobot]] = {
        "walker": partial(_commanded, WALKER_SPACE, Walker, (SPEEDS, turns)),
        "stroller": partial(_commanded, STROLLER_SPACE, Stroller, (SPEEDS, sideways, turns)),
        "hopper": hopper,
        "quadruped": quadruped,
        "monopod": monopod,
    }
    if policy:
        found["go1"] = partial(_commanded, STROLLER_SPACE, partial(Go1, policy), (SPEEDS, sideways, turns))
    return found
