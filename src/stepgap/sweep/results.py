"""The table of a sweep, made from the results of its cases."""

from collections.abc import Callable, Iterator
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.files import write_whole
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.results_table import RESULTS, columns_of, rows_of, table_text
from stepgap.sweep.sweep import Sweep

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all items."""


def write_results(sweep: Sweep, folder: CaseFolder, progress: Progress = lambda done, total: None) -> Path:
    """Writes the table of all finished cases and returns its path.

    Raises:
        InputError: The result of a case is not valid.
        OSError: A file cannot be read or written.
    """
    path = folder.path / RESULTS
    with folder.alone():
        write_whole(path, table_text(columns_of(sweep.names, sweep.space), _rows(sweep, folder, progress)))
    return path


def _rows(sweep: Sweep, folder: CaseFolder, progress: Progress) -> Iterator[list[str]]:
    for number, found in folder.results(progress):
        try:
            yield from rows_of(number, sweep.settings(number), found.result, found.failed, sweep.space)
        except ValueError as error:
            remedy = "remove this file and continue with --resume"
            raise InputError(f"{folder.result_path(number)}: {error}; {remedy}") from None
