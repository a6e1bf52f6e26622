"""How long planning and fitting took, in a table and in a sentence."""

from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.records.text import decimal
from stepgap.report.html import table


def times_table(run: Run) -> str:
    """Table of the times by deployment; empty if they are not known."""
    if isinstance(run.times, Missing):
        return ""
    heads = ["deployment", "fit before it [s]"]
    heads += [f"{part} [ms]: {name}" for part in ("planning", "learning") for name in ("median", "95 %", "largest")]
    rows = []
    for iteration, parts in sorted(run.times.items()):
        fit = decimal(parts["fit"]["total"]) if "fit" in parts else "–"
        numbers = [
            decimal(1e3 * parts[part][name]) if part in parts else "–"
            for part in ("planning", "learning")
            for name in ("median", "p95", "largest")
        ]
        rows.append([str(iteration), fit, *numbers])
    return table(
        "Computing times on the machine of the run, for each step to plan its command and to learn",
        heads,
        rows,
    )


def times_in_words(run: Run) -> list[str]:
    """Sentence on the times of the last deployment; none if they are not known."""
    if isinstance(run.times, Missing) or not run.times:
        return []
    last = max(run.times)
    parts, found = run.times[last], []
    if "planning" in parts:
        planning = parts["planning"]
        middle, most = (decimal(1e3 * planning[name], 2) for name in ("median", "largest"))
        found.append(f"planning a step took {middle} ms in the median, {most} ms at most")
    if "fit" in parts:
        found.append(f"the fit before it {decimal(parts['fit']['total'], 2)} s")
    return [f"In deployment {last}, {', and '.join(found)}."] if found else []
