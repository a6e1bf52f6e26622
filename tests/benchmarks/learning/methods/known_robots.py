"""Steps of robots whose maps are known, for tests of learning methods."""

import numpy as np

from stepgap.learning.steps import LoggedStep, Steps
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.step import StepMap, StepRecord, StepStatus

NOMINAL = ApexMap()


def steps_of(truth: StepMap, count: int, noise: float = 0.0, iteration: int = 0) -> Steps:
    """Random steps of a map."""
    rng = np.random.default_rng(iteration)
    steps: list[LoggedStep] = []
    for number in range(1, count + 1):
        state = rng.uniform([0.05, 0.56], [0.35, 0.62])
        command = rng.uniform([-8, -12], [4, 4])
        next_state = truth(state, command) + noise * rng.standard_normal(2) * [0.01, 0.002]
        record = StepRecord(state, command, command, next_state, StepStatus.OK)
        steps.append(LoggedStep(iteration, number, state, state, np.zeros(2), record))
    return Steps(NOMINAL.space, steps)
