"""The page `report.html`: results, model and settings of a run."""

from collections.abc import Mapping, Sequence
from typing import Final
from urllib.parse import quote

import numpy as np

from stepgap.control.reference import SETTLING_STEPS
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised
from stepgap.report.analysis import Analysis
from stepgap.report.diagnosis_sentences import diagnosis_sentences, trust_sentences
from stepgap.report.figures import DrawnFigure
from stepgap.report.gait_text import (
    gait_sentences,
    gait_table,
    growth_sentences,
    measured_sentences,
    measured_table,
    reach_sentences,
)
from stepgap.report.html import absence, bullets, page, paragraph, picture, safe, section, table
from stepgap.report.learned_table import coverage_table, learned_sentences, learned_tables
from stepgap.report.reasons import Reason
from stepgap.report.replay_view import REPLAY_SCRIPT, replay_view
from stepgap.report.sentences import floor_sentences, headline, published_sentence, recorded, sentences
from stepgap.report.tables import band_table, changed_settings, error_table, summary_table, times_in_words, times_table

CONTENTS: Final = {
    "figures": "Figures",
    "numbers": "Numbers",
    "diagnosis": "Diagnosis",
    "replay": "Replay",
    "learned": "What was learned",
    "gait": "Gait",
    "settings": "Settings and versions",
    "files": "Files",
}
"""Sections of the page, with their titles."""

FILES: Final = {
    "steps.csv": "one row for each step: state, command, next state, prediction",
    "summary.json": "errors of each deployment, noise floor, versions",
    "times.json": "how long fits and the choice of commands took",
    "experiment.toml": "all settings, to repeat the experiment",
    "models/*.json": "residual at the start of a deployment",
    "figures/*.pdf": "figure of this page",
    "replay/*.npz": "motion in a deployment",
    "ticks/*.mcap": "ticks of a deployment",
}
"""Files of a run folder, by pattern, with their content."""


def report_html(analysis: Analysis, figures: Sequence[DrawnFigure]) -> str:
    """HTML of the report.

    Args:
        analysis: The run, and what was computed from it.
    """
    run = analysis.run
    title = f"StepGap report: {run.folder.resolve().name}"
    pictures = {
        name: [
            picture(figure.drawing, figure.prefix, figure.caption, figure is figures[0])
            for figure in figures
            if figure.section == name
        ]
        for name in CONTENTS
    }
    parts_by_name = {
        "numbers": _numbers(run),
        "diagnosis": [bullets(_diagnosis(analysis))],
        "replay": [replay_view(run, analysis.replay)],
        "learned": [
            bullets([*learned_sentences(analysis), *trust_sentences(run)]),
            learned_tables(run, analysis.learned),
            coverage_table(run),
        ],
        "gait": _gait(analysis, pictures.pop("gait")),
        "settings": [_settings(run)],
        "files": [_file_list(run)],
    }
    parts = [
        section(name, heading, *parts_by_name.get(name, []), *pictures.get(name, []))
        for name, heading in CONTENTS.items()
    ]
    script = REPLAY_SCRIPT if not isinstance(analysis.replay, Missing) else ""
    return page(title, [_top(analysis, title), *parts], script)


def run_summary(run: Run) -> str:
    """HTML of what a run achieved: a sentence, a table, and what was unusual.

    Raises:
        InputError: A file of the run is not valid.
    """
    return _summary(Analysis(run.checked()))


def _summary(analysis: Analysis) -> str:
    run = analysis.run
    unusual = bullets([*sentences(run), *growth_sentences(analysis.loops)])
    first = f'<p class="headline">{safe(headline(run))}</p>\n{summary_table(run)}'
    return f"{first}{_reasons(analysis.reasons)}{unusual}"


def _reasons(why: Sequence[Reason]) -> str:
    """The causes as a list: what was seen, what to do, and the command for it."""
    items = [
        f"<li>{safe(reason.sentence)} <strong>{safe(reason.advice)}</strong>"
        f"{f'<br><code>{safe(reason.command)}</code>' if reason.command else ''}</li>"
        for reason in why
    ]
    return f'<h2 class="why">Why, and what next</h2>\n<ol>{"".join(items)}</ol>' if items else ""


def _top(analysis: Analysis, title: str) -> str:
    """The first screen: the result in a sentence and a table."""
    links = "".join(f'<a href="#{name}">{heading}</a>' for name, heading in CONTENTS.items())
    note = " ".join([recorded(analysis.run), *times_in_words(analysis.run)])
    called = paragraph(analysis.run.called) if analysis.run.called else ""
    return f'<h1>{safe(title)}</h1>\n{called}<nav>{links}</nav>\n{_summary(analysis)}<p class="note">{safe(note)}</p>'


def _numbers(run: Run) -> list[str]:
    return [
        paragraph(_comparison_note(run)),
        *map(paragraph, floor_sentences(run)),
        *(error_table(run, row) for row in run.steps.tracking().tracked),
        band_table(run),
        times_table(run),
    ]


def _diagnosis(analysis: Analysis) -> list[str]:
    """The diagnosis without the causes that the first screen has."""
    causes = [reason.sentence for reason in analysis.reasons]
    reach = [] if isinstance(analysis.gait, Missing) else reach_sentences(analysis.gait)
    texts = [*diagnosis_sentences(analysis.run), *reach]
    return [text for text in texts if not any(text in cause or cause in text for cause in causes)]


def _gait(analysis: Analysis, pictures: Sequence[str]) -> list[str]:
    """Limit cycles as the maps have them, if they are known, and the motion around them as it was measured."""
    gait = analysis.gait
    loops = analysis.loops
    cycles = [] if isinstance(gait, Missing) else gait_sentences(gait)
    rest = [absence("gait", gait), *pictures] if isinstance(gait, Missing) else [*pictures, gait_table(gait)]
    return [bullets([*cycles, *measured_sentences(loops)]), measured_table(loops), *rest]


def missing_parts(analysis: Analysis) -> list[str]:
    """Lists the parts that are missing in the report of a run, each with the reason in brackets."""
    run = analysis.run
    parts = []
    if run.cut_off:
        parts.append("the last line of steps.csv (it is cut off)")
    if not run.deployments:
        parts.append("errors (no deployment is finished according to summary.json)")
    if isinstance(analysis.learned, Missing) and run.residual_name(run.shown_iterations[-1]) != "none":
        parts.append(f"the learned model ({analysis.learned.reason})")
    return [*parts, *_by_reason({"settings": run.defaults, "gait": analysis.gait, "replay": analysis.replay})]


def _by_reason(parts: Mapping[str, object]) -> list[str]:
    """Missing parts; parts with the same reason are listed together."""
    reasons = {name: part.reason for name, part in parts.items() if isinstance(part, Missing)}
    lines = []
    for reason in dict.fromkeys(reasons.values()):
        *names, last = [name for name, other in reasons.items() if other == reason]
        lines.append(f"{', '.join(names)}{' and ' * bool(names)}{last} ({reason})")
    return lines


def _comparison_note(run: Run) -> str:
    explored = ", without those of exploratory steps" * bool((run.steps.number < 1).any())
    note = f"This run was executed by the {run.plant}. Errors are next state − target{explored}."
    if any(np.isfinite(entry.errors["transient_rmse"]).any() for entry in run.deployments):
        note += (
            f" Transient: the first {SETTLING_STEPS} steps with each new target; steady: all later steps with it. "
            "Steps with the first target of the reference are neither, since they include the start. RMSE and MAE "
            "include them, so they may be smaller than both parts."
        )
    theirs = run.published
    if theirs is None:
        return note
    if run.compared_result:
        return (
            f"{note} The run tracked {theirs.source}'s reference. {capitalised(theirs.source)}'s numbers are from its "
            f"hardware, a different robot: {theirs.origin}. {published_sentence(theirs)}"
        )
    return (
        f"{note} The run tracked another reference than {theirs.source}'s, so {theirs.source}'s errors are not shown."
    )


def _settings(run: Run) -> str:
    facts = [] if run.summary.seed is None else [f"seed: {run.summary.seed}"]
    facts += [f"{name}: {version}" for name, version in run.summary.versions]
    file = run.settings_file
    if isinstance(file, Missing):
        return f"{bullets(facts)}{paragraph(f'{capitalised(file.reason)}.')}"
    if isinstance(run.defaults, Missing):
        changed = absence("comparison with the default settings", run.defaults)
    else:
        changed = changed_settings(file.table, run.defaults)
    opened = "<details><summary>experiment.toml: all settings, to repeat the experiment</summary>"
    return f"{bullets(facts)}{changed}{opened}<pre>{safe(file.text)}</pre></details>"


def _file_list(run: Run) -> str:
    """Table of the files in the run folder, each with a relative link."""
    rows = [
        [path.relative_to(run.folder).as_posix(), content]
        for pattern, content in FILES.items()
        for path in sorted(run.folder.glob(pattern))
        if path.is_file()
    ]
    links = {name: quote(name) for name, _ in rows}
    note = paragraph("The links lead to files beside this page, in the folder of the run.")
    return f'{note}<div class="left">{table("", ["file", "content"], rows, links)}</div>'
