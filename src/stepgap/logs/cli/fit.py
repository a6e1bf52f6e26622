"""The verb `stepgap fit`."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, format_by_name, write_new
from stepgap.cli.options import NO_COLUMNS, ColumnNames, Integer, Overrides

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.logs.columns import Columns
    from stepgap.logs.fits.fit import Comparison

    Source = tuple[Columns | None, str | None, Path | None, Sequence[tuple[str, str]]]
    """How logs are read: meaning of their columns, nominal next states, settings of the experiment."""


@Parameter(name="*")
@dataclass(frozen=True)
class Results:
    """Files that a fit writes.

    Attributes:
        out: New JSON file for all numbers.
        plot: New file for a figure of predicted against actual errors.
        save: New model file for the residual that predicts best, fitted to all steps (docs/model_file.md).
        predictions: New CSV file for the predictions by the model of --load, with a row for each step.
    """

    out: Path | None = None
    plot: Path | None = None
    save: Path | None = None
    predictions: Path | None = None

    def check(self) -> None:
        """Raises InputError if one of the files cannot be written."""
        for option in fields(self):
            if file := getattr(self, option.name):
                check_new(file, f"--{option.name}")
        if self.plot:
            format_by_name(self.plot)


NO_RESULTS = Results()


def fit(
    *log: Path,
    test: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    columns: Path | None = None,
    names: ColumnNames = NO_COLUMNS,
    nominal: Literal["map", "predicted", "target", "state"] | None = None,
    experiment: Path | None = None,
    folds: Integer | None = None,
    load: Path | None = None,
    results: Results = NO_RESULTS,
    overrides: Overrides = None,
) -> None:
    """Fit every residual to recorded steps, score it on held-out steps, and summarise how much can be learned.

    Args:
        log: Folders of runs or their steps.csv; or logs of any origin (docs/logs.md), if their columns are named.
        test: Logs on which the residuals are scored; then they are fitted to all others. [default: parts of LOG are
            held out in turn]
        columns: TOML file that names columns; its keys are the options from here to --step, and units and factors.
        nominal: Source of the nominal next state: the robot's map, the predictions, the target, or the state.
        experiment: TOML file of settings of the robot's map. [default: the settings of the runs]
        folds: Number of contiguous blocks that are held out in turn. [default: whole deployments, or 10 blocks of a
            single one]
        load: Model file of a run or of --save, with which LOG is predicted; then nothing is fitted.
    """
    from stepgap.logs.columns import read_columns
    from stepgap.logs.tables.ros_bags import is_ros2_folder

    if not log:
        raise InputError("LOG: none given; give folders of runs, or logs and the names of their columns")
    if given := [*names.given(), *(["columns"] if columns else [])]:
        for folder in filter(Path.is_dir, log):
            if (folder / "steps.csv").is_file():
                raise InputError(f"{folder}: a run, whose columns are known; leave out --{', --'.join(given)}")
            if not is_ros2_folder(folder):
                raise InputError(f"{folder}: a folder that is not a run, which has a steps.csv; give the log's file")
    if test and folds is not None:
        raise InputError("--folds: nothing is held out of LOG if --test is given; leave one of them out")
    if results.predictions and not load:
        raise InputError("--predictions: they are those of a saved model; give it by --load")
    unused = {"test": test, "folds": folds, "plot": results.plot, "save": results.save}
    if load and (of_fits := [name for name, value in unused.items() if value is not None]):
        raise InputError(f"--load: nothing is fitted to LOG; leave out --{', --'.join(of_fits)}")
    results.check()
    source = (read_columns(columns, names.given()), nominal, experiment, overrides or [])
    if load:
        _apply(load, log, source, results)
    else:
        _compare(log, test, source, folds, results)


def _apply(model: Path, log: tuple[Path, ...], source: "Source", results: Results) -> None:
    """Predicts the steps of logs by a saved model."""
    from stepgap.logs.fits.application_results import (
        application_report,
        describe_application,
        prediction_table,
        show_application,
    )
    from stepgap.logs.fits.fit import check_count, read_nominal_errors
    from stepgap.logs.fits.fit_results import describe_suspicious
    from stepgap.logs.fits.model_application import LEAST_PREDICTED, MOST_PREDICTED, apply_model
    from stepgap.logs.fits.suspicious import far_rows, improbable_rows

    data = read_nominal_errors(log, *source)
    check_count(log, data, LEAST_PREDICTED, MOST_PREDICTED)
    applied = apply_model(model, data)
    rows = far_rows(data.steps) | improbable_rows(data.observed, data.steps.follows, applied.validation)
    scored = apply_model(model, data.without(rows)) if rows else applied
    print(describe_application(applied))
    if rows:
        print(describe_suspicious(data.named(rows)))
    show_application(scored, sys.stdout, applied if rows else None)
    if results.out:
        report = application_report(log, scored, applied, data.named(rows))
        write_new(results.out, "--out", json.dumps(report, indent=1))
    if results.predictions:
        write_new(results.predictions, "--predictions", prediction_table(applied))


def _compare(
    log: tuple[Path, ...], test: list[Path] | None, source: "Source", folds: int | None, results: Results
) -> None:
    """Fits every residual and scores it on held-out steps."""
    from stepgap.base.blas import one_blas_thread
    from stepgap.cli.progress import progress_bar
    from stepgap.learning.residual_fit import names_without_lagged_inputs
    from stepgap.logs.fits.fit import choose_folds, compare, read_fit_data, read_test_data
    from stepgap.logs.fits.fit_results import describe_fit_data, describe_suspicious, show_validation, verdict

    kinds = names_without_lagged_inputs()
    data = read_fit_data(log, *source)
    tested = read_test_data(data, log, test, *source) if test else None
    print(describe_fit_data(data, choose_folds(data.steps, folds), tested), flush=True)
    with one_blas_thread(), progress_bar("fits") as progress:
        found = compare(kinds, data, tested, folds, progress)
    if found.suspicious:
        print(describe_suspicious(found.suspicious))
    show_validation(found.data.observed.space.state, found.validation, sys.stdout)
    print(verdict(found))
    _write(results, log, found)


def _write(results: Results, log: tuple[Path, ...], found: "Comparison") -> None:
    """Writes the requested files."""
    from stepgap.logs.fits.fit import best_model
    from stepgap.logs.fits.fit_results import fit_report
    from stepgap.report.own_style import own_style

    if results.out:
        write_new(results.out, "--out", json.dumps(fit_report(log, found), indent=1))
    if results.save:
        write_new(results.save, "--save", best_model(found.data, found.validation))
    if results.plot:
        with own_style():
            from stepgap.logs.fits.fit_files import fit_picture

            picture = fit_picture(found.data.observed.space.state, found.validation, format_by_name(results.plot))
        write_new(results.plot, "--plot", picture)
