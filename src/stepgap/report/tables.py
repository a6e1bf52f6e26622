"""Tables of numbers on a page: errors before and after learning and by deployment, computing times, and settings."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from stepgap.experiment.bands import WINDOW, executed_steps_to_band, window_errors
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.summary import MEASURED, MEASURES
from stepgap.records.text import decimal, unit_suffix, with_unit
from stepgap.report.html import paragraph, safe, table
from stepgap.report.sentences import end_in_a_word
from stepgap.report.verdict import Achievement
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array

DASH = "–"  # Mark of a missing value in a table


def column_table(caption: str, columns: Mapping[str, Sequence[str]]) -> str:
    """HTML table of columns by their heads, without those that have no value."""
    filled = {head: cells for head, cells in columns.items() if set(cells) != {DASH}}
    return table(caption, list(filled), list(zip(*filled.values(), strict=True)))


# Errors before and after learning


def summary_table(run: Run) -> str:
    """Table at the top of a report, with a row for each coordinate that has targets.

    It is empty if no deployment is finished.
    """
    if not run.deployments:
        return ""
    achieved = Achievement(run)
    rows = range(len(achieved.after))
    last = achieved.last.iteration
    compared = achieved.predicted or achieved.first.iteration != last
    after = "after: " if compared else ""
    about = "" if run.summary.noise_floor_measured else ", at most about"
    columns = {"coordinate": [with_unit(quantity) for quantity in run.space.state]}
    if compared:
        first = "the nominal map's predictions" if achieved.predicted else f"deployment {achieved.first.iteration}"
        columns[f"before: RMSE of {first}"] = list(map(decimal, achieved.before))
    columns[f"{after}RMSE of deployment {last} (95 % interval)"] = _with_ends(achieved.after, achieved.after_ends)
    columns["change"] = list(map(achieved.change_in_words, rows))
    columns[f"{after}steady RMSE"] = list(map(decimal, achieved.last.steady_rmse))
    columns[f"noise floor{about} (95 % interval)"] = _with_ends(achieved.floor, run.noise_floor_interval)
    periodic = run.steps.space.periodic
    has_phase = periodic is not None and np.isfinite(run.steps.phase).any()
    if periodic and has_phase and run.summary.noise_floor_measured and not achieved.is_without_noise:
        columns[f"noise alone, at one {periodic.name}"] = list(map(decimal, run.noise_floor_same_phase))
    columns["verdict"] = list(map(achieved.verdict_in_words, rows))
    return column_table("", {head: [cells[row] for row in achieved.rows] for head, cells in columns.items()})


def _with_ends(values: Array, ends: Array) -> list[str]:
    """Numbers with the ends of their intervals (2, n), where these are known."""
    cells = []
    for value, low, high in zip(values, *ends, strict=True):
        has_ends = np.isfinite([value, low, high]).all()
        cells.append(f"{decimal(value)} ({decimal(low)} to {decimal(high)})" if has_ends else decimal(value))
    return cells


# Errors by deployment


def error_table(run: Run, row: int) -> str:
    """Errors of one state coordinate by deployment, next to published ones for the same reference."""
    published = run.compared_result
    entries = {deployment.iteration: deployment for deployment in run.deployments}
    errors = {measure: [entry.errors[measure][row] for entry in run.deployments] for measure in MEASURES}
    shown = [measure for measure in MEASURES if measure in MEASURED or np.isfinite(errors[measure]).any()]
    decimals = _decimals(np.array(list(errors.values())))
    lines = []
    for iteration in sorted(set(entries) | set(range(published.last + 1) if published else ())):
        entry = entries.get(iteration)
        counts = [entry.residual, str(entry.steps), end_in_a_word(run, entry)] if entry else [DASH] * 3
        line = f'<tr><th scope="row">{iteration}</th>{"".join(f"<td>{safe(count)}</td>" for count in counts)}'
        line += _cells([entry.errors[measure][row] if entry else None for measure in shown], "run", decimals)
        if published:
            line += _cells([published.error(measure, iteration, row) for measure in MEASURED], "paper")
        lines.append(f"{line}</tr>")
    return (
        f'<div class="wide"><table><caption>Error of {safe(with_unit(run.space.state[row]))}</caption>'
        f"<thead>{_heads(run.plant, published, shown)}</thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table></div>"
    )


def _heads(plant: str, published: PublishedResult | None, measures: Sequence[str]) -> str:
    """The two header rows: the source of the numbers, and the names of the columns."""
    sources = f'<th colspan="4"></th><th colspan="{len(measures)}" scope="colgroup">this run: {safe(plant)}</th>'
    heads = ("deployment", "residual", "steps", "end", *map(_title, measures))
    columns = "".join(f'<th scope="col">{head}</th>' for head in heads)
    if published:
        source = f"{safe(published.source)}: hardware"
        sources += f'<th colspan="{len(MEASURED)}" scope="colgroup" class="paper">{source}</th>'
        columns += "".join(f'<th scope="col" class="paper">{_title(measure)}</th>' for measure in MEASURED)
    return f"<tr>{sources}</tr>\n<tr>{columns}</tr>"


def _title(measure: str) -> str:
    """Heading of the column of a measure."""
    return measure.replace("_", " ").replace("rmse", "RMSE").replace("mae", "MAE")


def _decimals(errors: Array) -> int | None:
    """Number of decimals with which the median error has three digits; None if it is larger than seven."""
    sizes = np.abs(errors[np.isfinite(errors) & (errors != 0)])
    decimals = 2 - int(np.floor(np.log10(np.median(sizes)))) if len(sizes) else 0
    return decimals if 0 <= decimals <= 7 else None


def _cells(values: Iterable[float | None], kind: str, decimals: int | None = None) -> str:
    """Table cells, with equal decimals if given; each `<data>` element holds the exact number."""
    cells = []
    for value in values:
        if value is None or not np.isfinite(value):
            cells.append(f'<td class="{kind} missing">{DASH}</td>')
            continue
        text = f"{value:g}" if decimals is None else f"{value:.{decimals}f}"
        text = text.replace("-", "−")
        cells.append(f'<td class="{kind}"><data value="{float(value)!r}">{text}</data></td>')
    return "".join(cells)


def band_table(run: Run) -> str:
    """Number of steps until the error stays as small as the published one; empty for other references."""
    published = run.compared_result
    if not published or not run.deployments:
        return ""
    state = run.space.state
    limits = [f"{limit:g}{unit_suffix(one)} in {one.name}" for limit, one in zip(published.band, state, strict=True)]
    caption = (
        f"Steps to {published.source}'s band, exploratory ones included: until the RMSE of {WINDOW} consecutive "
        f"tracking steps stays at or below {' and '.join(limits)}, {published.source}'s errors after "
        f"{published.last} redeployments"
    )
    first, *others = map(with_unit, state)
    heads = ["deployment", "steps", "to the band", f"best {WINDOW} steps: {first}", *others]
    logs = [run.steps.of_iteration(entry.iteration) for entry in run.deployments]
    ends = [end_in_a_word(run, entry) for entry in run.deployments]
    rows = []
    for entry, log, end in zip(run.deployments, logs, ends, strict=True):
        to_band = steps_in_words([log], published.band, end)
        rows.append([str(entry.iteration), str(entry.steps), to_band, *_best([log])])
    steps = sum(entry.steps for entry in run.deployments)
    rows.append(["all", str(steps), steps_in_words(logs, published.band, ends[-1]), *_best(logs)])
    return table(caption, heads, rows)


def steps_in_words(deployments: Sequence[Steps], band: Array, end: str) -> str:
    """Number of steps until the error stays in the band, for a table.

    Args:
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
        return [DASH] * errors.shape[1]
    return [decimal(error) for error in window_errors(errors).min(axis=0)]


# Computing times


def times_table(run: Run) -> str:
    """Table of the computing times by deployment; empty if they are not known."""
    if isinstance(run.times, Missing):
        return ""
    heads = ["deployment", "fit before it [s]"]
    heads += [f"{part} [ms]: {name}" for part in ("planning", "learning") for name in ("median", "95 %", "largest")]
    rows = []
    for iteration, parts in sorted(run.times.items()):
        cells = [str(iteration), decimal(parts["fit"]["total"]) if "fit" in parts else DASH]
        for part in ("planning", "learning"):
            names = ("median", "p95", "largest")
            cells += [decimal(1e3 * parts[part][name]) for name in names] if part in parts else [DASH] * 3
        rows.append(cells)
    caption = "Computing times on the machine of the run, for each step to plan its command and to learn"
    return table(caption, heads, rows)


def times_in_words(run: Run) -> list[str]:
    """Sentence on the computing times of the last deployment; none if they are not known."""
    if isinstance(run.times, Missing) or not run.times:
        return []
    last = max(run.times)
    parts = run.times[last]
    phrases = []
    if "planning" in parts:
        middle, most = (decimal(1e3 * parts["planning"][name], 2) for name in ("median", "largest"))
        phrases.append(f"planning a step took {middle} ms in the median, {most} ms at most")
    if "fit" in parts:
        phrases.append(f"the fit before it {decimal(parts['fit']['total'], 2)} s")
    return [f"In deployment {last}, {', and '.join(phrases)}."] if phrases else []


# Settings that differ: from their defaults, or between runs


def flat_settings(settings: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Values of nested tables as short texts, by their dotted names."""
    flat: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            flat |= flat_settings(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = _format(value)
    return flat


def differing(columns: Sequence[Mapping[str, str]]) -> list[list[str]]:
    """Names and values of the settings that are not equal in all columns, in the order of their first occurrence."""
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [[name, *(column.get(name, DASH) for column in columns)] for name in names]
    return [row for row in rows if len(set(row[1:])) > 1]


def changed_settings(settings: Mapping[str, Any], defaults: Mapping[str, Any], owner: str = "this run") -> str:
    """HTML table of the settings of a run, or of another `owner`, that differ from their defaults."""
    rows = differing([flat_settings(settings), flat_settings(defaults)])
    if not rows:
        return paragraph("All settings are the defaults.")
    return table("Settings that differ from their defaults", ["setting", owner, "default"], rows)


def _format(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_format, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:.12g}"
    text = str(value) or "(empty)"
    return text if len(text) <= 80 else f"{text[:77]}…"
