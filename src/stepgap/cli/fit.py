"""The verb `stepgap fit`."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, write_new
from stepgap.cli.options import NO_COLUMNS, ColumnNames, Integer, Overrides

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.experiment.fit import FitData
    from stepgap.learning.validation import Validation


@Parameter(name="*")
@dataclass(frozen=True)
class Results:
    """Files that a fit writes.

    Attributes:
        out: New JSON file for all numbers.
        plot: New file for a figure of predicted against actual errors.
        save: New JSON file for the residual with the largest weight, fitted to all steps.
    """

    out: Path | None = None
    plot: Path | None = None
    save: Path | None = None

    def check(self) -> None:
        """Raises InputError if one of the files cannot be written."""
        from stepgap.report.fit import PICTURE_FORMATS

        for option, file in (("--out", self.out), ("--plot", self.plot), ("--save", self.save)):
            if file:
                check_new(file, option)
        if self.plot and _format_of(self.plot) not in PICTURE_FORMATS:
            raise InputError(f"{self.plot}: the name must end with one of .{', .'.join(PICTURE_FORMATS)}")


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
        experiment: TOML file of settings of the robot's map and of learning. [default: the settings of the runs]
        folds: Number of contiguous blocks that are held out in turn. [default: whole deployments, or 10 blocks of a
            single one]
    """
    from threadpoolctl import threadpool_limits

    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.fit import choose_folds, read_fit_data, read_test_data
    from stepgap.experiment.fit_results import describe_fit_data, show_validation, verdicts
    from stepgap.learning.residual_fit import names_without_lagged_inputs
    from stepgap.learning.validation import validate, validate_on
    from stepgap.records.columns import read_columns

    if not log:
        raise InputError("LOG: none given; give folders of runs, or logs and the names of their columns")
    if given := [*names.given(), *(["columns"] if columns else [])]:
        for run in (one for one in log if one.is_dir() and not (one / "metadata.yaml").is_file()):  # no ROS 2 bag
            raise InputError(f"{run}: a run, whose columns are known; leave out --{', --'.join(given)}")
    if test and folds is not None:
        raise InputError("--folds: nothing is held out of LOG if --test is given; leave one of them out")
    results.check()
    meaning, kinds = read_columns(columns, names.given()), names_without_lagged_inputs()
    data = read_fit_data(log, meaning, nominal, experiment, overrides or [])
    tested = read_test_data(data, log, test, meaning, nominal, experiment, overrides or []) if test else None
    parts = choose_folds(data.steps, folds)
    print(describe_fit_data(data, parts, tested), flush=True)
    with threadpool_limits(limits=1, user_api="blas"), progress_bar("fits") as progress:
        if tested is None:
            validation = validate(kinds, data.steps, parts, data.learning, progress)
        else:
            validation = validate_on(kinds, data.steps, tested, data.learning, progress)
    show_validation(data, validation, sys.stdout)
    follows = (data.steps if tested is None else tested).follows
    print(verdicts(data.steps.space.state, validation, follows))
    _write(results, log, data, validation)


def _write(results: Results, log: tuple[Path, ...], data: "FitData", validation: "Validation") -> None:
    """Writes the requested files."""
    from stepgap.experiment.fit import best_residual
    from stepgap.experiment.fit_results import fit_report
    from stepgap.report.fit import fit_picture

    if results.out:
        write_new(results.out, "--out", json.dumps(fit_report(log, data, validation), indent=1))
    if results.plot:
        picture = fit_picture(data.steps.space.state, validation, _format_of(results.plot))
        write_new(results.plot, "--plot", picture)
    if results.save:
        write_new(results.save, "--save", json.dumps(best_residual(data, validation).to_dict()))


def _format_of(picture: Path) -> str:
    return picture.suffix[1:].lower()
