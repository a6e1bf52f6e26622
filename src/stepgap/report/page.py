"""`report.html`: results, model and settings of a run on one page."""

from collections.abc import Mapping
from typing import Any, Final

from stepgap.records import paper
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.bands import interval_coverage
from stepgap.report.drawing import Drawing
from stepgap.report.error_table import band_table, error_table
from stepgap.report.html import absence, bullets, page, paragraph, picture, safe, section
from stepgap.report.learnt import Learnt
from stepgap.report.learnt_table import coverage_table, learnt_sentences, learnt_tables
from stepgap.report.reference_gait import ReferenceGait, gait_sentences, gait_table
from stepgap.report.replay_view import REPLAY_SCRIPT, replay_view
from stepgap.report.run_context import RunContext
from stepgap.report.sentences import headline, sentences
from stepgap.report.settings_table import changed_settings

CONTENTS: Final = {
    "figures": "Figures",
    "numbers": "Numbers",
    "replay": "Replay",
    "learnt": "What was learnt",
    "gait": "Gait",
    "settings": "Settings and versions",
}
"""Parts of the page."""

LEFT_OUT_CAPTION: Final = (
    "Leave-one-out: each recorded error of the map as the model predicts it from all the others, at the same "
    "hyper-parameters. Left: on the line, prediction and record are equal. Right: their difference, in standard "
    "deviations of the prediction, noise included; the grey band should hold 95 % of the points, with no pattern along "
    "the hops. A point beyond ±4.5 is drawn there."
)

GAIT_CAPTION: Final = (
    "(a) The one-step reachable set within the command bounds, from the target in the middle. (b) Magnitudes of the "
    "Floquet multipliers (eigenvalues of the Jacobian of the Poincaré map) of the limit cycle at each target: below 1, "
    "an error dies out while the command stays the same; the step controller does not rely on that. The Jacobian of "
    "the corrected map is that of the learnt model, which is less accurate than the model's values."
)


def report_html(
    record: RunRecord,
    drawings: Mapping[str, Drawing | Missing],
    context: RunContext,
    learnt: Learnt | None,
    gait: ReferenceGait | Missing,
) -> str:
    """The whole page.

    Args:
        record: The run.
        drawings: Its figures by name: `tracking`, `errors`, `map_K`, `left_out`, `gait`; or why there is none.
        context: What is known of it besides its files.
        learnt: The last residual, if there is one.
        gait: Limit cycles at the targets, or why they are not known.
    """
    title = f"StepGap report: {record.folder.resolve().name}"
    links = "".join(f'<a href="#{name}">{words}</a>' for name, words in CONTENTS.items())
    plant = context.plant
    parts_by_name = {
        "figures": [picture(drawings[name], f"{name}-", text) for name, text in captions(record).items()],
        "numbers": [
            paragraph(_what_is_compared(record, plant)),
            *(error_table(record, row, plant) for row in range(len(record.space.state))),
            band_table(record),
        ],
        "replay": [replay_view(record, context.replay)],
        "learnt": [
            bullets(learnt_sentences(record, learnt)),
            learnt_tables(record, learnt),
            coverage_table(record),
            picture(drawings["left_out"], "left-out-", LEFT_OUT_CAPTION) if "left_out" in drawings else "",
        ],
        "gait": [absence("gait", gait)] if isinstance(gait, Missing) else [
            bullets(gait_sentences(gait)),
            picture(drawings["gait"], "gait-", GAIT_CAPTION) if "gait" in drawings else "",
            gait_table(gait),
        ],
        "settings": [_settings(record, context.defaults)],
    }  # fmt: skip
    top = (
        f'<h1>{safe(title)}</h1>\n<nav>{links}</nav>\n<p class="headline">{safe(headline(record))}</p>\n'
        f"{bullets(sentences(record, plant))}"
    )
    parts = [section(name, CONTENTS[name], *parts) for name, parts in parts_by_name.items()]
    return page(title, [top, *parts], REPLAY_SCRIPT if not isinstance(context.replay, Missing) else "")


def captions(record: RunRecord) -> dict[str, str]:
    """What each figure of the steps shows."""
    several, like_paper = record.shown_iterations[0] != record.shown_iterations[-1], record.like_paper
    which = "in the first and the last deployment" if several else f"in deployment {record.shown_iterations[0]}"
    how = "without and with the learnt correction" if several else "of a single deployment"
    found = {
        "tracking": f"Tracking {how}, drawn like the paper's Fig. 4: the state at the end of each step {which}, and "
        "the reference.",
        "errors": "Tracking error by deployment, drawn like the paper's Fig. 5, on logarithmic axes.",
    }
    if like_paper:
        found["errors"] += " The paper's points are of its hardware: its Fig. 5, and its Fig. 4 for deployment 0."
    for row in range(len(record.space.state)):
        found[f"map_{row}"] = _map_caption(record, row)
    return found


def _map_caption(record: RunRecord, row: int) -> str:
    quantity, last = record.space.state[row], record.shown_iterations[-1]
    like = f", drawn like the paper's Fig. {6 + row}" if record.space.state_names == paper.STATE_NAMES else ""
    unsure = [number for number in record.shown_iterations if record.steps.of_iteration(number).std[:, row].any()]
    held = [_held(record, iteration, row) for iteration in record.steps.iterations]
    band = " with 95 % band, noise included," if last in unsure else ""
    text = f"The map of {quantity.name}{like}. (a) Its mean{band} and the measured next state, in deployment {last}."
    if any(held):
        text += f" The band, drawn before the step was taken, held {', '.join(filter(None, held))}."
    if len(unsure) > 1:
        text += f" (b) Standard deviation of the prediction in deployments {unsure[0]} and {unsure[-1]}."
    elif unsure:
        text += f" (b) Standard deviation of the prediction in deployment {unsure[0]}."
    else:
        text += " (b) The map gave no standard deviation, since it had not learnt yet."
    if record.like_paper and unsure:
        before, after = paper.LARGEST_STD[quantity.name]
        text += (
            f" On the paper's hardware it was at most about {before:g} {quantity.unit} in its first and {after:g} "
            f"{quantity.unit} in its fourth redeployment."
        )
    return text


def _held(record: RunRecord, iteration: int, row: int) -> str:
    """How many measurements of a deployment the band held; empty where there was no band."""
    inside, known = interval_coverage(record.steps.of_iteration(iteration), row)
    return f"{inside} of {known} measurements ({100 * inside / known:.0f} %) in deployment {iteration}" if known else ""


def _what_is_compared(record: RunRecord, plant: str) -> str:
    words = (
        f"This run was executed by the {plant}. Errors are next state − target. Steady: from 4 steps after a change of "
        "the target on; transient: the first 4 steps from each change on."
    )
    if record.like_paper:
        return (
            f"{words} The run tracked the paper's reference. The paper's numbers are of its hardware, another machine: "
            "227 steps per deployment, read off its Figs. 4 and 5."
        )
    if record.space.state_names == paper.STATE_NAMES:
        return f"{words} The run tracked another reference than the paper's, so the paper's errors are not shown."
    return words


def _settings(record: RunRecord, defaults: Mapping[str, Any] | Missing) -> str:
    facts = [] if record.summary.seed is None else [f"seed: {record.summary.seed}"]
    facts += [f"{name}: {version}" for name, version in record.summary.versions]
    if record.settings is None:
        return f"{bullets(facts)}<p>The folder holds no experiment.toml.</p>"
    if isinstance(defaults, Missing):
        changed = absence("comparison with the default settings", defaults)
    else:
        changed = changed_settings(record.settings.table, defaults)
    opened = "<details><summary>experiment.toml: every setting, reruns the experiment</summary>"
    return f"{bullets(facts)}{changed}{opened}<pre>{safe(record.settings.text)}</pre></details>"
