"""The verb `stepgap report`."""

from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.output_files import free_name
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.cli.options import Flag
from stepgap.cli.terminal import warn

REPORTS = "stepgap.reports"
"""Entry points of this group are `report.FolderReport`: reports of folders that are not those of runs."""


def report(folders: list[Path], /, *, out: Path | None = None, figures: Flag = False) -> None:
    """Regenerate the report of a run or of a sweep, or compare several runs on one page.

    Args:
        folders: Folder of the run or of the sweep, or the folders of several runs.
        out: New HTML file for a comparison. [default: comparison.html next to the first run, or the next free name]
        figures: Write each figure as PNG and as PDF into the folder figures/, too.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.run import Run
    from stepgap.report import FolderReport, compare_runs, write_report

    kinds = {
        name: load_plugin(REPORTS, "report", name, lambda found: isinstance(found, FolderReport), "a FolderReport")
        for name in plugin_names(REPORTS)
    }
    other = next(((name, folder) for folder in folders for name, kind in kinds.items() if kind.holds(folder)), None)
    if other and (len(folders) > 1 or out):
        rule = f"a {other[0]} has a report of its own, in its folder; give only: stepgap report {other[1]}"
        raise InputError(f"{other[1]}: {rule}")
    if len(folders) > 1 and figures:
        raise InputError("--figures: those of one report; the figures of a comparison are only on its page")
    if len(folders) > 1:
        page = out or free_name(folders[0].resolve().parent / "comparison.html")
        compare_runs(folders, page)
    elif out:
        raise InputError("--out: valid only with several runs; the report of one run is written into its folder")
    else:
        with progress_bar("report") as progress:
            run = Run(folders[0], on_replay=progress)
            page, left_out = kinds[other[0]].write(run.folder, figures) if other else write_report(run, figures)
        if left_out:
            warn(f"missing in the report: {'; '.join(left_out)}")
    print(page)
