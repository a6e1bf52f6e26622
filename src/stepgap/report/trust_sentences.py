"""What was found during deployments to be no longer true, in sentences."""

from typing import Final

from stepgap.experiment.run import Run

MOST_ALARMS: Final = 6  # A deployment with more alarms gets a sentence on their number


def trust_sentences(run: Run) -> list[str]:
    """Sentences on the alarms of the finished deployments."""
    found = []
    for deployment in run.summary.deployments:
        name = f"Deployment {deployment.iteration}"
        alarms = deployment.alarms
        if len(alarms) > MOST_ALARMS:
            found.append(f"{name}: {len(alarms)} times the robot was found to be another one.")
        else:
            found += [f"{name}: {alarm.sentence}." for alarm in alarms]
    return found
