"""What shows a run to a person, found by name: its report, and the live page while it is running."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

from stepgap.base.plugins import load_plugin

if TYPE_CHECKING:  # a report is written without what builds plants
    from stepgap.experiment.loop import Observer
    from stepgap.plants.compiled_rig import Rows

DISPLAYS: Final = "stepgap.displays"
"""Entry points of this group show a run.

They are `report`, which is `report.run_report.write_report`; `figure`, which draws one figure of it; `summary`, its
first sentences and table; and `live`, a `LivePage`.
"""

REPORTS: Final = "stepgap.reports"
"""Entry points of this group are `FolderReport`: reports of folders that are not those of runs."""


class WrittenReport(NamedTuple):
    """A report on disk.

    Attributes:
        path: Path of the page.
        missing: Missing parts, each with the reason in brackets.
    """

    path: Path
    missing: tuple[str, ...]


@dataclass(frozen=True)
class FolderReport:
    """The report of folders of some kind other than runs, such as sweeps, for `stepgap report`.

    Attributes:
        holds: Whether a folder is of this kind.
        write: Writes the report of such a folder into it, and the files of its figures if the second argument is true.
    """

    holds: Callable[[Path], bool]
    write: Callable[[Path, bool], WrittenReport]


class LivePage(ABC):
    """A page that shows a run while it is running, between the entry into its context and the end of that."""

    @abstractmethod
    def on_ticks(self, rows: "Rows", step: int) -> None:
        """Passes ticks to the page: `plants.ticks.stream.OnTicks`."""

    @abstractmethod
    def observing(self, observer: "Observer") -> "Observer":
        """Observer that also tells the page."""

    @abstractmethod
    def stay(self) -> None:
        """Waits, at the end of the run, until the page is ended."""

    @abstractmethod
    def __enter__(self) -> Self:
        """Opens the page."""

    @abstractmethod
    def __exit__(self, *exc_info: object) -> None:
        """Closes the page."""


def load_display(name: str) -> Any:
    """The display of this name.

    Raises:
        InputError: It is not installed.
    """
    return load_plugin(DISPLAYS, "display", name, callable, "a function or a class")
