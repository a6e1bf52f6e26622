"""The noise floor of the twin: the standard deviation of the next state when a step is repeated.

A controller that knows neither the noise nor the yaw cannot track better on average; a controller that estimates the
disturbance (`learning.disturbance`) can.
"""

from copy import deepcopy
from math import tau

import numpy as np

from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array, StepFailed, StepMap, StepStatus

REPEATED_TARGETS = 20
"""Largest number of targets of the reference at which a step is repeated; they are spread evenly."""

SETTLING = 6
"""Number of steps towards a target before the repeated one."""

REPEATS = 12
"""Number of repetitions of a step."""


def measure_noise_floor(
    plant: RigPlant, twin: Twin, step_map: StepMap, reference: Reference, rng: np.random.Generator
) -> Array:
    """Pooled standard deviation of the next state when the twin repeats a step [state units]; shape (n,).

    The repetitions have the same command, the same true motion of robot, boom and drives at the apex, and the same
    memory of the control, hence the same measured state. The torque noise, including its present value, and the yaw are
    drawn again: the floor is turned by a random angle, because the yaw is not part of the state. The standard deviation
    is that of the measured next state. Where the yaw-dependent disturbance is estimated, tracking errors may be a
    little smaller.

    Args:
        plant: Plant of the twin.
        twin: The twin in `plant`.
        step_map: Map whose step controller leads to the targets.
        reference: Reference whose targets are held.
        rng: Draws noise and yaw of the repeated steps.

    Returns:
        NaN where no step could be repeated twice.
    """
    starts = np.unique([0, *reference.changes])
    chosen = starts[np.unique(np.linspace(0, len(starts) - 1, REPEATED_TARGETS).round().astype(int))]
    controller, deviations, degrees_of_freedom = StepController(step_map), [np.zeros((0, len(reference.names)))], 0
    with plant:
        state = plant.start()
        for target in reference.targets[chosen]:
            for _ in range(SETTLING):
                record = plant.take_step(_command(controller, state, target))
                state = record.next_state
                if record.status != StepStatus.OK:
                    return _pooled(deviations, degrees_of_freedom)
            command = _command(controller, state, target)
            found = np.array([repeated(plant, twin, command, rng, rng.uniform(0, tau)) for _ in range(REPEATS)])
            found = found[np.isfinite(found).all(axis=1)]
            if len(found) > 1:
                deviations.append(found - found.mean(axis=0))
                degrees_of_freedom += len(found) - 1
    return _pooled(deviations, degrees_of_freedom)


def repeated(plant: RigPlant, twin: Twin, command: Array, rng: np.random.Generator, floor_yaw: float = 0.0) -> Array:
    """Next state of a copy of the plant that takes a step with new noise; the plant itself stays at the apex.

    Args:
        plant: Plant of the twin.
        twin: The twin in `plant`.
        command: Command of the step; shape (m,).
        rng: Draws the copy's noise.
        floor_yaw: Angle by which the floor is turned under the copy [rad].
    """
    return deepcopy(plant, {id(twin): twin.fork(rng, floor_yaw=floor_yaw)}).take_step(command).next_state


def _command(controller: StepController, state: Array, target: Array) -> Array:
    """Command as in `deploy`."""
    try:
        return controller(state, target).command
    except StepFailed:
        return controller.step_map.space.command_centre


def _pooled(deviations: list[Array], degrees_of_freedom: int) -> Array:
    squares = np.sum(np.vstack(deviations) ** 2, axis=0)
    return np.sqrt(squares / degrees_of_freedom) if degrees_of_freedom else np.full_like(squares, np.nan)
