"""StepGap's controllers in the Gymnasium environment `stepgap/Step-v0`: an episode, learning, and an episode again."""

import gymnasium
import numpy as np

import stepgap.gym
from stepgap import (
    CautiousController,
    Learner,
    LearningSettings,
    LoggedStep,
    Reference,
    StepController,
    StepRecord,
    Steps,
    StepStatus,
)

stairs = [(1, (0.1, 0.56)), (10, (0.2, 0.58)), (19, (0.3, 0.6)), (28, (0.2, 0.58))]
reference = Reference.from_segments(("speed", "height"), stairs, 36)
env = gymnasium.make(stepgap.gym.STEP_ID, reference=reference)
space, nominal = env.unwrapped.space, env.unwrapped.nominal


def episode(plan, seed, iteration):
    """Runs the controller for one episode; returns its steps and the root-mean-square tracking error."""
    observation, _ = env.reset(seed=seed)
    steps, errors, done = [], [], False
    while not done:
        state, target = np.split(observation, 2)
        planned = plan(state, target)
        observation, _, failed, truncated, info = env.step(space.point_of(planned.command))
        next_state, status = observation[:2], StepStatus[info["status"].upper()]
        done = failed or truncated
        errors.append(next_state - target)
        record = StepRecord(state, info["command"], info["applied"], next_state, status)
        steps.append(LoggedStep(iteration, len(errors), target, planned.predicted, np.zeros(2), record))
    return steps, np.sqrt(np.mean(np.square(errors), axis=0))


steps, first = episode(StepController(nominal), 0, 0)
learner = Learner.start(nominal, Steps(space, steps), LearningSettings(), 1)
_, second = episode(CautiousController(learner.step_map(), nominal, learner.failures), 1, 1)
print("nominal map: speed {:.4f} m/s, height {:.4f} m".format(*first))
print("corrected:   speed {:.4f} m/s, height {:.4f} m".format(*second))
env.close()
