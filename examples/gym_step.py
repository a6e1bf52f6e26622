"""StepGap's controllers in the Gymnasium environment `stepgap/Step-v0`: an episode, learning, and an episode again."""

import gymnasium
import numpy as np

import stepgap.gym
from stepgap import Reference, StepController, StepRecord
from stepgap.control.cautious_controller import CautiousController
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.step import StepStatus

stairs = [(1, (0.1, 0.56)), (10, (0.2, 0.58)), (19, (0.3, 0.6)), (28, (0.2, 0.58))]
reference = Reference.from_segments(("speed", "height"), stairs, 36)
env = gymnasium.make(stepgap.gym.STEP_ID, reference=reference)
space, nominal = env.unwrapped.space, env.unwrapped.nominal


def episode(plan, seed, iteration):
    """Closes the loop for one episode; returns its steps and the root-mean-square tracking error."""
    seen, _ = env.reset(seed=seed)
    steps, errors, over = [], [], False
    while not over:
        state, target = np.split(seen, 2)
        planned = plan(state, target)
        seen, _, fell, at_end, info = env.step(space.point_of(planned.command))
        over, status = fell or at_end, StepStatus[info["status"].upper()]
        errors.append(seen[:2] - target)
        record = StepRecord(state, info["command"], info["applied"], seen[:2], status, info.get("yaw", np.nan))
        steps.append(LoggedStep(iteration, len(errors), target, planned.predicted, np.zeros(2), record))
    return steps, np.sqrt(np.mean(np.square(errors), axis=0))


steps, first = episode(StepController(nominal), 0, 0)
learner = Learner.start(nominal, StepLog(space, steps), LearningSettings(), 1)
_, second = episode(CautiousController(learner.step_map(), nominal, learner.failures), 1, 1)
print("model's map: speed {:.4f} m/s, height {:.4f} m".format(*first))
print("corrected:   speed {:.4f} m/s, height {:.4f} m".format(*second))
env.close()
