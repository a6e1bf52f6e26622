"""Tables of tracking errors: by deployment next to published ones, and the number of steps until they are as small."""

from collections.abc import Iterable, Sequence

import numpy as np

from stepgap.experiment.bands import WINDOW, executed_steps_to_band, window_errors
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.summary import MEASURED, MEASURES, Deployment
from stepgap.records.text import decimal, unit_suffix, with_unit
from stepgap.report.html import safe, table
from stepgap.report.sentences import end_in_a_word
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array


def error_table(run: Run, row: int) -> str:
    """Errors of one state coordinate by deployment, next to published ones for the same reference."""
    quantity, published = run.space.state[row], run.compared_result
    entries = {deployment.iteration: deployment for deployment in run.deployments}
    known = [measure for measure in MEASURES if measure in MEASURED or _is_known(measure, row, entries.values())]
    decimals, lines = _decimals([entry.errors[measure][row] for entry in entries.values() for measure in MEASURES]), []
    for iteration in sorted(set(entries) | set(range(published.last + 1) if published else ())):
        entry = entries.get(iteration)
        counts = [entry.residual, str(entry.steps), end_in_a_word(run, entry)] if entry else ["–"] * 3
        ours = [entry.errors[measure][row] if entry else None for measure in known]
        theirs = [published.error(measure, iteration, row) for measure in MEASURED] if published else []
        texts = "".join(f"<td>{safe(count)}</td>" for count in counts)
        lines.append(
            f'<tr><th scope="row">{iteration}</th>{texts}{_cells(ours, "run", decimals)}{_cells(theirs, "paper")}</tr>'
        )
    return (
        f'<div class="wide"><table><caption>Error of {safe(with_unit(quantity))}</caption>'
        f"<thead>{_heads(run.plant, published, known)}</thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table></div>"
    )


def _is_known(measure: str, row: int, entries: Iterable[Deployment]) -> bool:
    """Whether the error is known of some deployment."""
    return any(np.isfinite(entry.errors[measure][row]) for entry in entries)


def _heads(plant: str, published: PublishedResult | None, known: Sequence[str]) -> str:
    """The two header rows: the source of the numbers, and the names of the columns."""
    sources = f'<th colspan="4"></th><th colspan="{len(known)}" scope="colgroup">this run: {safe(plant)}</th>'
    heads = ("deployment", "residual", "steps", "end", *map(_title, known))
    columns = "".join(f'<th scope="col">{head}</th>' for head in heads)
    if published:
        source = f"{safe(published.source)}: hardware"
        sources += f'<th colspan="{len(MEASURED)}" scope="colgroup" class="paper">{source}</th>'
        columns += "".join(f'<th scope="col" class="paper">{_title(measure)}</th>' for measure in MEASURED)
    return f"<tr>{sources}</tr>\n<tr>{columns}</tr>"


def _title(measure: str) -> str:
    """Heading of the column of a measure."""
    return measure.replace("_", " ").replace("rmse", "RMSE").replace("mae", "MAE")


def _decimals(errors: Sequence[float]) -> int | None:
    """Number of decimals with which the median error has three digits; None if it is larger than seven."""
    sizes = [abs(error) for error in errors if np.isfinite(error) and error]
    decimals = 2 - int(np.floor(np.log10(np.median(sizes)))) if sizes else 0
    return decimals if 0 <= decimals <= 7 else None


def _cells(values: Iterable[float | None], kind: str, decimals: int | None = None) -> str:
    """Table cells, with equal decimals if given; each `<data>` element holds the exact number."""
    cells = []
    for value in values:
        if value is None or not np.isfinite(value):
            cells.append(f'<td class="{kind} missing">–</td>')
        else:
            text = f"{value:g}" if decimals is None else f"{value:.{decimals}f}"
            text = text.replace("-", "−")
            cells.append(f'<td class="{kind}"><data value="{float(value)!r}">{text}</data></td>')
    return "".join(cells)


def band_table(run: Run) -> str:
    """Number of steps until the error stays as small as the published one; empty for other references."""
    published, state = run.compared_result, run.space.state
    if not published or not run.deployments:
        return ""
    limits = [f"{limit:g}{unit_suffix(each)} in {each.name}" for limit, each in zip(published.band, state, strict=True)]
    caption = (
        f"Steps to {published.source}'s band, exploratory ones included: until the RMSE of {WINDOW} consecutive "
        f"tracking steps stays at or below {' and '.join(limits)}, {published.source}'s errors after "
        f"{published.last} redeployments"
    )
    first, *others = map(with_unit, state)
    heads = ["deployment", "steps", "to the band", f"best {WINDOW} steps: {first}", *others]
    rows, steps, logs = [], 0, []
    for entry in run.deployments:
        log = run.steps.of_iteration(entry.iteration)
        to_band = steps_in_words([log], published.band, end_in_a_word(run, entry))
        rows.append([str(entry.iteration), str(entry.steps), to_band, *_best([log])])
        steps, logs = steps + entry.steps, [*logs, log]
    to_band = steps_in_words(logs, published.band, end_in_a_word(run, run.deployments[-1]))
    rows.append(["all", str(steps), to_band, *_best(logs)])
    return table(caption, heads, rows)


def steps_in_words(deployments: Sequence[Steps], band: Array, end: str) -> str:
    """Number of steps until the error stays in the band, for a table.

    Args:
        deployments: The deployments, in their order.
        band: Largest RMSE of each state coordinate; shape (n,).
        end: How the last deployment ended, as from `end_in_a_word`.
    """
    if end != "complete":
        return f"never: {end}"
    steps = executed_steps_to_band(deployments, band)
    return "never" if steps is None else str(steps)


def _best(deployments: Sequence[Steps]) -> list[str]:
    """Smallest error of 20 consecutive tracking steps, coordinate by coordinate."""
    errors = np.concatenate([steps.tracking_errors() for steps in deployments])
    if len(errors) < WINDOW:
        return ["–"] * errors.shape[1]
    return [decimal(error) for error in window_errors(errors).min(axis=0)]
