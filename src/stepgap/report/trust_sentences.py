"""What was found during deployments to be no longer true, in sentences."""

from functools import reduce
from typing import Final

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.learning.learner import Learner
from stepgap.learning.trust import Alarm

MOST_ALARMS: Final = 6
"""A deployment with more alarms gets a sentence on their number."""

_FOUND: Final = {
    "changed": "the robot was not the same as before: how it differs was estimated from then on",
    "nominal": "the residual was worse than none: the robot was compared with the nominal map from then on",
    "earlier": "the robot was again as before",
}


def alarm_sentence(alarm: Alarm) -> str:
    """What an alarm means, as a sentence without a full stop."""
    return f"after step {alarm.step}, {_FOUND[alarm.source]} (docs/never_worse.md)"


def trust_sentences(run: Run) -> list[str]:
    """Sentences on the alarms of the deployments that are shown, as far as their learners are known."""
    found = []
    for iteration in run.shown_iterations:
        try:
            learner = run.learner(iteration)
        except InputError:
            continue
        steps = run.recorded.of_iteration(iteration).completed()
        alarms = reduce(Learner.after, steps, learner).alarms
        if len(alarms) > MOST_ALARMS:
            found.append(f"Deployment {iteration}: {len(alarms)} times the robot was found to be another one.")
        else:
            found += [f"Deployment {iteration}: {alarm_sentence(alarm)}." for alarm in alarms]
    return found
