"""Parts of `stepgap run` that take long and have tests of their own, left out for tests of other parts."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from stepgap.experiment.displays import WrittenReport
from stepgap.experiment.run import Run
from stepgap.records.summary import NoiseFloor
from stepgap.report import drawing
from stepgap.step import StepMap
from stepgap.sweep.cases import execution

EMPTY_SVG = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"></svg>'
"""A figure that was not drawn."""


def leave_out_repeats(patch: pytest.MonkeyPatch) -> None:
    """Replaces the measurement of the noise floor, which takes as long as a deployment."""

    def measure_noise_floor(_: object, step_map: StepMap, *__: object, **___: object) -> NoiseFloor:
        floor = np.full(len(step_map.space.state), 0.01)
        return NoiseFloor(floor, floor)

    patch.setattr("stepgap.experiment.plants.measure_noise_floor", measure_noise_floor)


def repeat_less(patch: pytest.MonkeyPatch) -> None:
    """The noise floor is measured at two phases instead of six."""
    patch.setattr("stepgap.experiment.noise_floor.PHASES", 2)


def leave_out_report(patch: pytest.MonkeyPatch) -> None:
    """A run writes an empty report."""

    def write_report(run: Run, figures: bool = False) -> WrittenReport:
        (run.folder / "report.html").touch()
        return WrittenReport(run.folder / "report.html", ())

    patch.setattr("stepgap.report.run_report.write_report", write_report)


def leave_out_sweep_report(patch: pytest.MonkeyPatch) -> None:
    """A sweep writes its tables and an empty report."""

    def report_sweep(folder: Path, figures: bool = False) -> WrittenReport:
        (folder / "report.html").touch()
        return WrittenReport(folder / "report.html", ())

    patch.setattr("stepgap.sweep.report.page.report_sweep", report_sweep)


def compute_in_a_thread(patch: pytest.MonkeyPatch) -> None:
    """Cases are computed in a thread of this process, which starts at once, instead of other processes."""
    patch.setattr(execution, "Processes", lambda count: ThreadPoolExecutor(1))


def leave_out_drawing(patch: pytest.MonkeyPatch) -> None:
    """Figures are made from their data but not drawn: those of the page are empty, and so are their files."""
    patch.setattr(drawing, "_lay_out", lambda figure: None)
    patch.setattr(drawing, "_saved", lambda figure, form: EMPTY_SVG if form == "svg" else b"")


def leave_out_figures(patch: pytest.MonkeyPatch) -> None:
    """Figures are not even made: those of the page are empty, and so are their files."""
    empty = drawing.Drawing(EMPTY_SVG.decode(), "[]", lambda form: b"")
    patch.setattr(drawing, "_drawn", lambda make: empty)


def leave_out_files_of_figures(patch: pytest.MonkeyPatch) -> None:
    """Figures are drawn for the page alone; their PNG and PDF files are empty."""
    saved = drawing._saved
    patch.setattr(drawing, "_saved", lambda figure, form: saved(figure, form) if form == "svg" else b"")
