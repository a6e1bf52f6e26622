"""The verb that says what there is to learn."""

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stepgap.base.output_files import check_new, write_new
from stepgap.base.settings_file import InputError
from stepgap.cli.app import Overrides


def fit(
    *log: Path,
    columns: Path | None = None,
    state: str | None = None,
    next_state: Annotated[str | None, Parameter(name="--next")] = None,
    command: str | None = None,
    target: str | None = None,
    predicted: str | None = None,
    deployment: str | None = None,
    step: str | None = None,
    nominal: Literal["map", "predicted", "target", "state"] | None = None,
    experiment: Path | None = None,
    folds: int | None = None,
    out: Path | None = None,
    plot: Path | None = None,
    save: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Fit every residual to recorded steps, score it on steps held out, and say what there is to learn.

    Args:
        log: Folders of runs or their steps.csv; or CSV files of any origin, if their columns are named.
        columns: TOML file that names columns; its keys are the options from here to --step, and units and factors.
        state: Columns of the state before the step, as NAME,NAME or as NAME=COLUMN,NAME=COLUMN.
        next_state: Columns of the state after it; without them that of the following row.
        command: Columns of the command.
        target: Columns of the target; without --command it stands for the command.
        predicted: Columns of the nominal next state.
        deployment: Column that tells deployments apart.
        step: Column that counts the steps; rows belong together where it goes up by one.
        nominal: What stands for the nominal next state: the hopper's map, the predictions, the target, the state.
        experiment: TOML file of settings of the hopper's map; without it those of the runs.
        folds: Hold out so many contiguous blocks; without it whole deployments, or 10 blocks of a single one.
        out: JSON file for all numbers.
        plot: Picture of predicted against actual errors.
        save: JSON file for the best residual, fitted to all steps.
    """
    from threadpoolctl import threadpool_limits

    from stepgap.cli.progress import shown_count
    from stepgap.experiment.fit import best_residual, choose_folds, describe_lesson, fit_report, read_lesson, verdicts
    from stepgap.experiment.fit import show_validation as show
    from stepgap.learning.residual_fit import names_without_features
    from stepgap.learning.validation import validate
    from stepgap.records.columns import read_columns
    from stepgap.report.fit import FORMATS, fit_picture

    if not log:
        raise InputError("LOG: none given; give folders of runs, or CSV files and what their columns hold")
    for option, file in (("--out", out), ("--plot", plot), ("--save", save)):
        if file:
            check_new(file, option)
    form = plot.suffix[1:].lower() if plot else ""
    if plot and form not in FORMATS:
        raise InputError(f"{plot}: the name must end with one of .{', .'.join(FORMATS)}")
    given = {"state": state, "next": next_state, "command": command, "target": target, "predicted": predicted}
    given |= {"deployment": deployment, "step": step}
    mapping = read_columns(columns, {name: text for name, text in given.items() if text is not None})
    lesson = read_lesson(log, mapping, nominal, experiment, overrides or [])
    parts = choose_folds(lesson.steps, folds)
    print(describe_lesson(lesson, parts), flush=True)
    with threadpool_limits(limits=1, user_api="blas"), shown_count("fits") as tell:
        validation = validate(names_without_features(), lesson.steps, parts, tell)
    show(lesson.steps.space.state, validation, sys.stdout)
    print(verdicts(lesson.steps.space.state, validation))
    if out:
        write_new(out, "--out", json.dumps(fit_report(log, lesson, validation), indent=1))
    if plot:
        write_new(plot, "--plot", fit_picture(lesson.steps.space.state, validation, form))
    if save:
        write_new(save, "--save", json.dumps(best_residual(lesson.steps, validation).to_dict()))
