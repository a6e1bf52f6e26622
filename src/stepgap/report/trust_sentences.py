"""What was found during deployments to be no longer true, in sentences."""

from typing import Final

from stepgap.experiment.run import Run
from stepgap.learning.alarm import Alarm

MOST_ALARMS: Final = 6
"""A deployment with more alarms gets a sentence on their number."""

_FOUND: Final = {
    "changed": "the robot was not the same as before: what had changed was learned from then on",
    "nominal": "the residual was worse than none, by the rules of a former version",
    "earlier": "the robot was again as before",
    "other_robot": "it was judged again which earlier runs are of this robot, by the rules of a former version",
}


def alarm_sentence(alarm: Alarm) -> str:
    """What an alarm means, as a sentence without a full stop."""
    return f"after step {alarm.step}, {_FOUND[alarm.source]} (docs/learning.md)"


def trust_sentences(run: Run) -> list[str]:
    """Sentences on the alarms of the finished deployments."""
    found = []
    for deployment in run.summary.deployments:
        name, alarms = f"Deployment {deployment.iteration}", deployment.alarms
        if len(alarms) > MOST_ALARMS:
            found.append(f"{name}: {len(alarms)} times the robot was found to be another one.")
        else:
            found += [f"{name}: {alarm_sentence(alarm)}." for alarm in alarms]
    return found
