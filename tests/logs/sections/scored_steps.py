"""Extracted steps beside the truth of their log."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.step_extraction import ExtractedSteps, extract_steps
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array
from tests.logs.sections.hopping_logs import Change, HoppingLog, hopping, write


@dataclass(frozen=True)
class Score:
    """What was found in a log.

    Attributes:
        found: Sections that belong to a true one, of all.
        duplicated: Sections more than one that belong to a true one, or to none.
        silent: Duplicated sections without a doubt.
        steps: Steps that were written, of all.
        wrong: Steps that were written and are wrong.
        errors: Errors of speed and height of the steps that were written; shape (steps, 2).
        standardised: Their ratios to the standard errors.
        refused: Whether the whole log was refused.
    """

    found: int
    duplicated: int
    silent: int
    steps: int
    wrong: int
    errors: Array
    standardised: Array
    refused: bool


def score(log: HoppingLog, steps: ExtractedSteps) -> Score:
    """Compares extracted steps with the truth."""
    times, sections = log.apexes[:, 0], steps.sections
    nearest = np.abs(times[:, None] - sections.time).argmin(axis=0)
    belongs = np.abs(times[nearest] - sections.time) < 0.05
    _, first = np.unique(np.where(belongs, nearest, -1), return_index=True)
    extra = np.ones(len(sections.time), bool)
    extra[first] = False
    extra |= ~belongs
    doubtful = np.array([bool(doubt) for doubt in sections.doubts])
    kept = np.zeros(0, int) if steps.refusal else steps.kept
    spread, wrong = log.apexes[:, 1:].std(axis=0), 0
    errors, ratios = np.zeros((0, 2)), np.zeros((0, 2))
    for k in kept:
        apart = sections.state[k] - log.apexes[nearest[k], 1:]
        ratio = apart / sections.std[k]
        follows = belongs[k] and belongs[k + 1] and nearest[k + 1] == nearest[k] + 1
        planned = steps.values["command"][k, 0] == nearest[k]
        off = (np.abs(ratio) > 5) & (np.abs(apart) > spread / 20)
        wrong += bool(not follows or not planned or off.any())
        errors, ratios = np.vstack([errors, apart]), np.vstack([ratios, ratio])
    return Score(
        len(np.unique(nearest[belongs])), int(extra.sum()), int((extra & ~doubtful).sum()), len(kept), wrong, errors,
        ratios, bool(steps.refusal),
    )  # fmt: skip


def trial(changes: Sequence[Change], rule: str, hops: int, seed: int, folder: Path) -> Score | str:
    """Score of one log; or why it was refused."""
    rng = np.random.default_rng(seed)
    log = hopping(hops, rng)
    for change in changes:
        log = change(log, rng)
    write(log, folder, rng)
    settings = SectionSettings(
        height="height", phase="phase" if rule == "phase" else "", force=("force",) if rule == "force" else (),
        state=("speed=rate(forward)", "height"), command=("number",),
    )  # fmt: skip
    try:
        return score(log, extract_steps(str(folder / "log.csv"), folder / "plan.csv", settings))
    except RecordError as error:
        return str(error)
