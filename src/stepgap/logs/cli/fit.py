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
    from stepgap.logs.fits.fit import FitData
    from stepgap.logs.fits.validation import Validation

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
    """

    out: Path | None = None
    plot: Path | None = None
    save: Path | None = None

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
    """
    from stepgap.logs.columns import read_columns
    from stepgap.logs.tables.bags import is_ros2_folder

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
    results.check()
    source = (read_columns(columns, names.given()), nominal, experiment, overrides or [])
    _compare(log, test, source, folds, results)


def _compare(
    log: tuple[Path, ...], test: list[Path] | None, source: "Source", folds: int | None, results: Results
) -> None:
    """Fits every residual and scores it on held-out steps."""
    from stepgap.base.blas import one_blas_thread
    from stepgap.cli.progress import progress_bar
    from stepgap.learning.entry_points import names_by_complexity
    from stepgap.logs.fits.fit import (
        best_model,
        choose_folds,
        compare,
        read_fit_data,
        read_test_data,
        without_suspicious,
    )
    from stepgap.logs.fits.fit_results import (
        best_sentence,
        describe_fit_data,
        describe_suspicious,
        fit_report,
        show_validation,
    )

    data = read_fit_data(log, *source)
    tested = read_test_data(data, log, test, *source) if test else None
    print(describe_fit_data(data, choose_folds(data.steps, folds), tested), flush=True)
    data, suspicious = without_suspicious(data)
    if tested:
        tested, of_tested = without_suspicious(tested)
        tested = tested.in_space(data.observed.space)
        suspicious |= of_tested
    if suspicious:
        print(describe_suspicious(suspicious), flush=True)
    with one_blas_thread(), progress_bar("fits") as progress:
        validation = compare(names_by_complexity(), data, tested, folds, progress)
    show_validation(data.observed.space.state, validation, sys.stdout)
    print(best_sentence(validation.best))
    if results.out:
        write_new(results.out, "--out", json.dumps(fit_report(log, data, validation, suspicious), indent=1))
    if results.save:
        write_new(results.save, "--save", best_model(data, validation))
    if results.plot:
        _draw(results.plot, data, validation)


def _draw(file: Path, data: "FitData", validation: "Validation") -> None:
    """Writes the figure."""
    from stepgap.report.own_style import own_style

    with own_style():
        from stepgap.logs.fits.fit_files import fit_picture

        picture = fit_picture(data.observed.space.state, validation, format_by_name(file))
    write_new(file, "--plot", picture)
