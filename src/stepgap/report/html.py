"""`report.html`: one file to mail, which fetches nothing; its figures are inline vector graphics.

Whatever comes from a file is untrusted and passes `safe`; a content security policy forbids scripts and fetching.
"""

import re
from collections.abc import Iterable, Sequence
from html import escape
from io import StringIO
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from stepgap.control.reference import paper_reference
from stepgap.report import paper
from stepgap.report.figures import coverage
from stepgap.report.run_folder import RunRecord
from stepgap.report.summary import MEASURES
from stepgap.report.words import headline, sentences

STYLE: Final = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; max-width: 66rem; margin: 2rem auto;
  padding: 0 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.5rem; } .headline { font-size: 1.2rem; font-weight: 600; }
h1, p, li, caption, figcaption { overflow-wrap: anywhere; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: 0.8rem 0 0.3rem; }
td, th { padding: 0.2rem 0.4rem; text-align: right; border-bottom: 1px solid #ddd; vertical-align: bottom; }
th[scope=colgroup] { text-align: center; }
.paper { background: #f3f3f3; } .missing { color: #767676; }
figure { margin: 1.5rem 0; } figure svg { width: 100%; height: auto; } figcaption { font-size: 0.9rem; color: #444; }
pre { overflow-x: auto; background: #f6f6f6; padding: 0.8rem; font-size: 0.8rem; } summary { cursor: pointer; }
"""

POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def report_html(record: RunRecord, figures: Sequence[Figure], plant: str) -> str:
    """The whole page.

    Args:
        record: The run.
        figures: Tracking, errors, then the map of each state coordinate.
        plant: What executed the steps, in words.
    """
    title = safe(f"StepGap report: {record.folder.resolve().name}")
    drawn = [
        f"<figure>{inline_svg(figure, f'f{number}-')}<figcaption>{safe(text)}</figcaption></figure>"
        for number, (figure, text) in enumerate(zip(figures, captions(record), strict=True))
    ]
    body = [
        f'<h1>{title}</h1>\n<p class="headline">{safe(headline(record))}</p>',
        _list(sentences(record, plant)),
        "<h2>Figures</h2>",
        *drawn,
        f"<h2>Numbers</h2>\n<p>{safe(_what_is_compared(record, plant))}</p>",
        *(_table(record, row, plant) for row in range(len(record.space.state))),
        f"<h2>Settings</h2>\n{_settings(record)}",
    ]
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{STYLE}</style>"
    )
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n' + "\n".join(body) + "\n</body></html>\n"


def safe(text: str) -> str:
    """Text that HTML takes for text, without control characters."""
    shown = "".join(
        letter if letter.isprintable() or letter in "\n\t" else "\N{REPLACEMENT CHARACTER}" for letter in text
    )
    return escape(shown)


def inline_svg(figure: Figure, prefix: str) -> str:
    """The figure as an `<svg>` element to be put into a page.

    Args:
        figure: What to draw.
        prefix: Begins every identifier, so that they are unique in the page and the same at every writing.
    """
    text = StringIO()
    figure.savefig(text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    svg = text.getvalue()
    svg = re.sub(r"<!--.*?-->\n?", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    names: dict[str, str] = {}

    def rename(match: re.Match[str]) -> str:
        return match[1] + names.setdefault(match[2], f"{prefix}{len(names)}")

    svg = re.sub(r'(\bid="|href="#|url\(#)([^")]+)', rename, svg)
    return svg.replace("<svg ", '<svg role="img" ', 1)


def captions(record: RunRecord) -> list[str]:
    """What each figure shows, in the order of `report_html`."""
    hardware = record.space.state_names == paper.STATE_NAMES
    beside = " The paper's points are of its hardware: its Fig. 5, and its Fig. 4 for deployment 0." if hardware else ""
    found = [
        "Tracking without and with the learnt correction, as in the paper's Fig. 4: the state at the end of each step "
        "in the first and the last deployment, and the reference.",
        f"Tracking error by deployment, as in the paper's Fig. 5.{beside}",
    ]
    for row, quantity in enumerate(record.space.state):
        last = record.shown[-1]
        held = [_held(record, iteration, row) for iteration in record.steps.iterations]
        like = f", as in the paper's Fig. {6 + row}" if hardware else ""
        text = f"The map of {quantity.name}{like}. (a) Its mean with 95 % band, noise included, and the measured next "
        text += f"state, in deployment {last}."
        if any(held):
            text += f" The band, drawn before the step was taken, held {', '.join(filter(None, held))}."
        text += " (b) Standard deviation of the prediction in the first and the last redeployment."
        if hardware:
            before, after = paper.LARGEST_STD[quantity.name]
            text += f" On the paper's hardware it was at most about {before:g}, then {after:g} {quantity.unit}."
        found.append(text)
    return found


def _held(record: RunRecord, iteration: int, row: int) -> str:
    """How many measurements of a deployment the band held; empty where there was no band."""
    inside, known = coverage(record.steps.of_iteration(iteration), row)
    return f"{inside} of {known} measurements ({100 * inside / known:.0f} %) in deployment {iteration}" if known else ""


def _what_is_compared(record: RunRecord, plant: str) -> str:
    words = (
        f"This run was executed by the {plant}. Errors are next state − target. Steady: from 4 steps after a change of "
        "the target on; transient: the first 4 steps from each change on."
    )
    if record.space.state_names != paper.STATE_NAMES:
        return words
    targets, wanted = record.steps.of_iteration(record.shown[-1]).target, paper_reference().targets
    same = len(targets) <= len(wanted) and np.array_equal(targets, wanted[: len(targets)])
    which = "the paper's reference" if same else "another reference than the paper's: compare trends, not numbers"
    return (
        f"{words} The paper's numbers are of its hardware, another machine: 227 steps per deployment, read off its "
        f"Figs. 4 and 5. This run tracked {which}."
    )


def _table(record: RunRecord, row: int, plant: str) -> str:
    """Errors of one state coordinate by deployment, the paper's beside them."""
    quantity, hardware = record.space.state[row], record.space.state_names == paper.STATE_NAMES
    entries = {deployment.iteration: deployment for deployment in record.deployments}
    places, lines = _places([entry.errors[measure][row] for entry in entries.values() for measure in MEASURES]), []
    for iteration in sorted(set(entries) | set(range(paper.LAST_ITERATION + 1) if hardware else ())):
        entry = entries.get(iteration)
        counts = [entry.residual, str(entry.steps), str(entry.falls)] if entry else ["–"] * 3
        ours = [entry.errors[measure][row] if entry else None for measure in MEASURES]
        theirs = [paper.paper_error(measure, quantity.name, iteration) for measure in MEASURES] if hardware else []
        texts = "".join(f"<td>{safe(count)}</td>" for count in counts)
        lines.append(
            f'<tr><th scope="row">{iteration}</th>{texts}{_cells(ours, "run", places)}{_cells(theirs, "paper")}</tr>'
        )
    caption = f"Error of {quantity.name}{f' [{quantity.unit}]' if quantity.unit else ''}"
    return (
        f'<div class="wide"><table><caption>{safe(caption)}</caption>'
        f"<thead>{_heads(plant, hardware)}</thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table></div>"
    )


def _heads(plant: str, hardware: bool) -> str:
    """The two rows above the numbers: whose they are, and which."""
    whose = f'<th colspan="4"></th><th colspan="{len(MEASURES)}" scope="colgroup">this run: {safe(plant)}</th>'
    measures = [measure.replace("_", " ").replace("rmse", "RMSE").replace("mae", "MAE") for measure in MEASURES]
    which = "".join(f'<th scope="col">{head}</th>' for head in ("deployment", "residual", "hops", "falls", *measures))
    if hardware:
        whose += f'<th colspan="{len(MEASURES)}" scope="colgroup" class="paper">the paper: hardware</th>'
        which += "".join(f'<th scope="col" class="paper">{measure}</th>' for measure in measures)
    return f"<tr>{whose}</tr>\n<tr>{which}</tr>"


def _places(errors: Sequence[float]) -> int | None:
    """Decimals that leave the median error three digits; None where that would be an unreadable number of them."""
    sizes = [abs(error) for error in errors if np.isfinite(error) and error]
    places = 2 - int(np.floor(np.log10(np.median(sizes)))) if sizes else 0
    return places if 0 <= places <= 7 else None


def _cells(values: Iterable[float | None], kind: str, places: int | None = None) -> str:
    """Table cells, all with the same decimals if given; the exact number stands in each `<data>`."""
    cells = []
    for value in values:
        if value is None or not np.isfinite(value):
            cells.append(f'<td class="{kind} missing">–</td>')
        else:
            text = f"{value:g}" if places is None else f"{value:.{places}f}"
            text = text.replace("-", "−")
            cells.append(f'<td class="{kind}"><data value="{float(value)!r}">{text}</data></td>')
    return "".join(cells)


def _settings(record: RunRecord) -> str:
    facts = [] if record.summary.seed is None else [f"seed: {record.summary.seed}"]
    facts += [f"{name}: {version}" for name, version in record.summary.versions]
    if record.settings is None:
        return f"{_list(facts)}<p>The folder holds no experiment.toml.</p>"
    opened = "<details><summary>experiment.toml: every setting, reruns the experiment</summary>"
    return f"{_list(facts)}{opened}<pre>{safe(record.settings)}</pre></details>"


def _list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{safe(line)}</li>' for line in lines)}</ul>" if lines else ""
