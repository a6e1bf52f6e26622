"""The report of a sweep, with its number of planned cases, its state coordinates, and the default settings."""

from pathlib import Path

from stepgap.base.errors import InputError, message_of
from stepgap.experiment.displays import FolderReport, WrittenReport
from stepgap.experiment.settings import Experiment, experiment_table, read_experiment
from stepgap.records.missing import Missing
from stepgap.robots.entry_points import load_robot
from stepgap.sweep.report.page import SweepContext, write_sweep_report
from stepgap.sweep.results_table import RESULTS
from stepgap.sweep.sweep import SWEEP_FILE
from stepgap.sweep.sweep_file import read_sweep


def is_sweep(folder: Path) -> bool:
    """Whether a folder holds a sweep, not a run."""
    return not (folder / "steps.csv").exists() and any((folder / name).exists() for name in (RESULTS, SWEEP_FILE))


def report_sweep(folder: Path, figures: bool = False) -> WrittenReport:
    """Writes the report of a sweep with all available information.

    Args:
        folder: Folder of the sweep.
        figures: Whether to write the files of the figures, too.

    Raises:
        InputError: The content of a file is wrong, or the report cannot be written.
    """
    if not (folder / RESULTS).is_file():
        raise InputError(f"{folder / RESULTS}: no such file; this makes it: stepgap sweep --out {folder} --resume")
    try:
        return write_sweep_report(folder, _context(folder), figures)
    except (ValueError, OSError) as error:
        raise InputError(message_of(error)) from None


def _planned(folder: Path) -> int | Missing:
    """Number of cases of the whole sweep."""
    try:
        return len(read_sweep(folder / SWEEP_FILE))
    except InputError:
        return Missing(f"without a valid {SWEEP_FILE} the number of planned cases is not known")


def _context(folder: Path) -> SweepContext:
    """What is known of the base experiment; its robot only if its settings are valid in this version."""
    path = folder / "experiment.toml"
    planned = _planned(folder)
    try:
        settings = read_experiment(path, recorded=True) if path.is_file() else Experiment()
    except InputError:
        return SweepContext(planned, experiment_table(Experiment()))
    defaults = experiment_table(Experiment(load_robot(settings.robot.name)))
    return SweepContext(planned, defaults, settings.space.state)


SWEEP_REPORT = FolderReport(is_sweep, report_sweep)  # Reports of sweeps, for `stepgap report`
