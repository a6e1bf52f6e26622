"""The page `report.html`: results, model and settings of a run."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from stepgap.control.reference import SETTLING_STEPS
from stepgap.experiment.bands import interval_coverage
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.diagnosis_sentences import diagnosis_sentences
from stepgap.report.drawing import Drawing
from stepgap.report.error_table import band_table, error_table
from stepgap.report.file_list import file_list
from stepgap.report.gait_table import gait_sentences, gait_table, measured_loops, measured_sentences, measured_table
from stepgap.report.html import absence, bullets, page, paragraph, picture, safe, section
from stepgap.report.learned import LearnedResidual
from stepgap.report.learned_table import coverage_table, learned_sentences, learned_tables
from stepgap.report.reference_gait import ReferenceGait
from stepgap.report.replay_view import REPLAY_SCRIPT, replay_view
from stepgap.report.run_context import RunContext
from stepgap.report.sentences import capitalised, headline, sentences
from stepgap.report.settings_table import changed_settings
from stepgap.report.units import unit_suffix

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

LEFT_OUT_CAPTION: Final = (
    "Leave-one-out: each recorded error of the map, predicted by the model from all the others, with the same "
    "hyper-parameters. Left: on the line, prediction and record are equal. Right: their difference, in standard "
    "deviations of the prediction, noise included; the grey band should contain 95 % of the points, without a trend "
    "over the steps. Points beyond ±4.5 are drawn at the edge."
)

FARTHER: Final = (
    " It is larger where state and command are farther from recorded ones, often after a change of the target."
)
"""Reason for changes of the standard deviation from step to step."""

JUMPS: Final = (
    " It jumps where the estimate of the periodic disturbance begins or ceases to be used, or where it follows "
    "changes faster or more slowly than before."
)
"""Further reason, for robots with a periodic context that is measured."""

SURFACE_CAPTION: Final = (
    "The learned correction, the expected error of the nominal map, and its standard deviation without noise, for each "
    "state coordinate over the two inputs that change it most. All other inputs have their values at {}; inputs from "
    "the step before are zero. Points: recorded steps to which the model was fitted, with any values of the other "
    "inputs. Far from the points the correction is extrapolated."
)

CLOSED_LOOP: Final = (
    " Closed loop: with the step controller of the corrected map. Bars: 95 % intervals of the largest magnitude, from "
    "the uncertainty of the gradient of the learned model."
)
"""Further part of the caption of the limit cycles, if there is a corrected map."""


def report_html(
    record: RunRecord,
    drawings: Mapping[str, Drawing | Missing],
    context: RunContext,
    learned: LearnedResidual | Missing,
    gait: ReferenceGait | Missing,
) -> str:
    """HTML of the report.

    Args:
        record: The run.
        drawings: Figures by name (`tracking`, `commands`, `errors`, `map_K`, `left_out`, `gait`), or the reasons why
            there are none.
        context: Information that is not in the files of the run.
        learned: The last residual, or the reason why there is none.
        gait: Limit cycles at the targets, or the reason why they are not known.
    """
    title = f"StepGap report: {record.folder.resolve().name}"
    links = "".join(f'<a href="#{name}">{heading}</a>' for name, heading in CONTENTS.items())
    plant, loops = context.plant, measured_loops(record)
    parts_by_name = {
        "figures": [picture(drawings[name], f"{name}-", text) for name, text in captions(record).items()],
        "numbers": [
            paragraph(_comparison_note(record, plant)),
            *(error_table(record, row, plant) for row in range(len(record.space.state))),
            band_table(record),
        ],
        "diagnosis": [bullets(diagnosis_sentences(record, context.nominal))],
        "replay": [replay_view(record, context.replay)],
        "learned": [
            bullets(learned_sentences(record, learned)),
            learned_tables(record, learned),
            coverage_table(record),
            picture(drawings["surface"], "surface-", _surface_caption(gait)) if "surface" in drawings else "",
            picture(drawings["left_out"], "left-out-", LEFT_OUT_CAPTION) if "left_out" in drawings else "",
        ],
        "gait": [measured_table(loops), absence("gait", gait)] if isinstance(gait, Missing) else [
            bullets(gait_sentences(gait)),
            measured_table(loops),
            picture(drawings["gait"], "gait-", _gait_caption(gait)) if "gait" in drawings else "",
            gait_table(gait),
        ],
        "settings": [_settings(record, context.defaults)],
        "files": [file_list(record)],
    }  # fmt: skip
    top = (
        f'<h1>{safe(title)}</h1>\n<nav>{links}</nav>\n<p class="headline">{safe(headline(record))}</p>\n'
        f"{bullets([*sentences(record, plant), *measured_sentences(loops)])}"
    )
    parts = [section(name, CONTENTS[name], *parts) for name, parts in parts_by_name.items()]
    return page(title, [top, *parts], REPLAY_SCRIPT if not isinstance(context.replay, Missing) else "")


def captions(record: RunRecord) -> dict[str, str]:
    """Captions of the figures of the steps, by name of the figure."""
    several = record.shown_iterations[0] != record.shown_iterations[-1]
    which = "in the first and the last deployment" if several else f"in deployment {record.shown_iterations[0]}"
    how = "without and with the learned correction" if several else "of a single deployment"
    found = {
        "tracking": f"Tracking {how}, drawn like the paper's Fig. 4: the state at the end of each step {which}, and "
        "the reference.",
        "commands": f"Requested commands {which}. Dotted: their bounds. Triangles: limits of the robot removed a part.",
        "errors": "Tracking error by deployment, drawn like the paper's Fig. 5, on logarithmic axes.",
    }
    found["state_errors"] = (
        f"Errors in deployment {record.shown_iterations[-1]} against the state at the start of each step and the "
        "command. Errors that depend on a coordinate show what the map, or the controller, does not take into account. "
        "Where the map predicted that the target would be reached, the two errors are equal: dots are in circles."
    )
    if theirs := record.compared_result:
        found["errors"] += f" {capitalised(theirs.source)}'s points are from its hardware: {theirs.origin}."
    for row in range(len(record.space.state)):
        found[f"map_{row}"] = _map_caption(record, row)
    return found


def _map_caption(record: RunRecord, row: int) -> str:
    quantity, last = record.space.state[row], record.shown_iterations[-1]
    unsure = [number for number in record.shown_iterations if record.steps.of_iteration(number).std[:, row].any()]
    held = [_held(record, iteration, row) for iteration in record.steps.iterations]
    band = " with 95 % band, noise included," if last in unsure else ""
    reasons = FARTHER + (JUMPS if np.isfinite(record.steps.phase).any() else "")
    text = (
        f"Map of {quantity.name}, drawn like the paper's Figs. 6 and 7. (a) Its mean{band} and the measured next "
        f"state, in deployment {last}."
    )
    if any(held):
        text += f" The band, predicted before the step, contains {', '.join(filter(None, held))}."
    if len(unsure) > 1:
        text += f" (b) Its standard deviation, noise included, in deployments {unsure[0]} and {unsure[-1]}.{reasons}"
    elif unsure:
        text += f" (b) Its standard deviation, noise included, in deployment {unsure[0]}.{reasons}"
    else:
        text += " (b) The map gave no standard deviation, because nothing had been learned yet."
    theirs = record.compared_result
    if theirs and theirs.largest_std and unsure:
        before, after = (f"{std[row]:g}{unit_suffix(quantity)}" for std in theirs.largest_std)
        text += (
            f" On {theirs.source}'s hardware it was at most about {before} in its first and {after} in its last "
            "redeployment."
        )
    return text


def _gait_caption(gait: ReferenceGait) -> str:
    return (
        f"(a) The one-step reachable set within the command bounds, from the state {_central_target(gait)}, the target "
        "nearest to the median of all. (b) Magnitudes of the Floquet multipliers (eigenvalues of the derivative of the "
        "next state with respect to the state) of the limit cycle at each target; below 1, an error decays. Open loop: "
        "at a constant command; the step controller does not need this stability."
        f"{CLOSED_LOOP if gait.has_closed_loop else ''}"
    )


def _surface_caption(gait: ReferenceGait | Missing) -> str:
    if isinstance(gait, Missing):
        return SURFACE_CAPTION.format("the median of these steps")
    return SURFACE_CAPTION.format(
        f"the limit cycle of the target {_central_target(gait)}, the nearest to the median of all"
    )


def _central_target(gait: ReferenceGait) -> str:
    """The target from which the reachable sets start, with units."""
    parts = zip(gait.centre, gait.space.state, strict=True)
    return ", ".join(f"{quantity.name} {value:.4g} {quantity.unit}".rstrip() for value, quantity in parts)


def _held(record: RunRecord, iteration: int, row: int) -> str:
    """Number of measurements of a deployment within the band, as text; empty where there was no band."""
    inside, known = (int(counts[row]) for counts in interval_coverage(record.steps.of_iteration(iteration)))
    return f"{inside} of {known} measurements ({100 * inside / known:.0f} %) in deployment {iteration}" if known else ""


def _comparison_note(record: RunRecord, plant: str) -> str:
    note = (
        f"This run was executed by the {plant}. Errors are next state − target, without those of exploratory steps. "
        f"Transient: the first {SETTLING_STEPS} steps with each new target; steady: all later steps with it. Steps "
        "with the first target of the reference are neither, since they include the start. RMSE and MAE include them, "
        "so they may be smaller than both parts."
    )
    theirs = record.published
    if theirs is None:
        return note
    if record.compared_result:
        return (
            f"{note} The run tracked {theirs.source}'s reference. {capitalised(theirs.source)}'s numbers are from its "
            f"hardware, a different robot: {theirs.origin}."
        )
    return (
        f"{note} The run tracked another reference than {theirs.source}'s, so {theirs.source}'s errors are not shown."
    )


def _settings(record: RunRecord, defaults: Mapping[str, Any] | Missing) -> str:
    facts = [] if record.summary.seed is None else [f"seed: {record.summary.seed}"]
    facts += [f"{name}: {version}" for name, version in record.summary.versions]
    if record.settings is None:
        return f"{bullets(facts)}<p>The folder contains no experiment.toml.</p>"
    if isinstance(defaults, Missing):
        changed = absence("comparison with the default settings", defaults)
    else:
        changed = changed_settings(record.settings.table, defaults)
    opened = "<details><summary>experiment.toml: all settings, to repeat the experiment</summary>"
    return f"{bullets(facts)}{changed}{opened}<pre>{safe(record.settings.text)}</pre></details>"
