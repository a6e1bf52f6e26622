"""The method on one page: the error of the model is learned from 60 hops of a heavier robot with a softer leg."""

import numpy as np

from stepgap import (
    ApexMap,
    CorrectedMap,
    Gains,
    ModelPlant,
    Observations,
    RobotParameters,
    StepController,
    fit_residual,
)

nominal = ApexMap()
real = ApexMap(robot=RobotParameters(body_mass=1.08 * 1.466), gains=Gains(stiffness=0.93 * 2500))
rng = np.random.default_rng(0)
targets = np.repeat(rng.uniform([0.05, 0.55], [0.35, 0.62], (12, 2)), 5, axis=0)


def deploy(step_map):
    """Tracks the targets; returns the records of the steps."""
    controller, records = StepController(step_map), []
    with ModelPlant(real, np.array([0.2, 0.58]), np.array([0.004, 0.0015]), rng) as plant:
        state = plant.start()
        for target in targets:
            records.append(plant.take_step(controller(state, target).command))
            state = records[-1].next_state
    return records


def rmse(records):
    """Tracking error of speed [m/s] and height [m]."""
    return np.sqrt(np.mean((np.array([record.next_state for record in records]) - targets) ** 2, axis=0))


first = deploy(nominal)
state, command = np.array([r.state for r in first]), np.array([r.requested for r in first])
error = np.array([r.next_state for r in first]) - nominal(state, command)
corrected = CorrectedMap(nominal, fit_residual("gp", Observations(nominal.space, state, command, error)))
second = deploy(corrected)
print("without GP: speed {:.4f} m/s, height {:.4f} m".format(*rmse(first)))
print("with GP:    speed {:.4f} m/s, height {:.4f} m".format(*rmse(second)))
