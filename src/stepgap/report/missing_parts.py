"""The missing parts of a report, with reasons."""

from collections.abc import Mapping

from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.learned import LearnedResidual
from stepgap.report.reference_gait import ReferenceGait
from stepgap.report.run_context import RunContext


def missing_parts(
    record: RunRecord, context: RunContext, learned: LearnedResidual | Missing, gait: ReferenceGait | Missing
) -> list[str]:
    """Lists the parts that are missing in the report of a run, each with the reason in brackets.

    Args:
        record: The run.
        context: Information that is not in the files of the run.
        learned: The last residual, or the reason why there is none.
        gait: Limit cycles at the targets, or the reason why they are not known.
    """
    found, last = [], record.shown_iterations[-1]
    if record.cut_off:
        found.append("the last line of steps.csv (it is cut off)")
    if not record.deployments:
        found.append("errors (no deployment is finished according to summary.json)")
    if isinstance(learned, Missing) and record.residual_of(last) != "none":
        found.append(f"the learned model ({learned.reason})")
    return [*found, *_by_reason({"settings": context.defaults, "gait": gait, "replay": context.replay})]


def _by_reason(parts: Mapping[str, object]) -> list[str]:
    """Missing parts; parts with the same reason are listed together."""
    reasons = {name: part.reason for name, part in parts.items() if isinstance(part, Missing)}
    lines = []
    for reason in dict.fromkeys(reasons.values()):
        *names, last = [name for name, other in reasons.items() if other == reason]
        lines.append(f"{', '.join(names)}{' and ' * bool(names)}{last} ({reason})")
    return lines
