"""The verb `stepgap report`."""

from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.cli.options import Flag
from stepgap.cli.terminal import open_page, warn


def report(folder: Path, /, *others: Path, figures: Flag = False, open: Flag = False) -> None:
    """Regenerate the report of a run or of a sweep.

    Args:
        folder: Folder of the run or of the sweep.
        others: None: several runs are compared by `stepgap compare`.
        figures: Write each figure as PNG and as PDF into the folder figures/, too.
        open: Open the report in the browser.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.displays import REPORTS, FolderReport
    from stepgap.experiment.run import Run
    from stepgap.report.run_report import write_report

    if others:
        raise InputError(f"a report is that of one run; compare several by: stepgap compare {folder} {others[0]}")
    kinds = [
        load_plugin(REPORTS, "report", name, lambda kind: isinstance(kind, FolderReport), "a FolderReport")
        for name in plugin_names(REPORTS)
    ]
    other = next((kind for kind in kinds if kind.holds(folder)), None)
    with progress_bar("report") as progress:
        run = Run(folder, on_replay=progress)
        page, left_out = other.write(folder, figures) if other else write_report(run, figures)
    if left_out:
        warn(f"missing in the report: {'; '.join(left_out)}")
    print(page, flush=True)
    if open:
        open_page(page)
