"""How long a run fits models and chooses commands, recorded while it runs, for the file `times.json`."""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from stepgap.experiment.loop import Observer
from stepgap.records.missing import Missing
from stepgap.records.summary import Deployment
from stepgap.records.times_file import read_times, statistics_of, write_times


@dataclass(frozen=True, eq=False)
class TimeRecorder:
    """Keeps the times of a run, and writes them after each deployment.

    Attributes:
        folder: The run folder; times of deployments that are not executed again are kept from its file.
    """

    folder: Path
    _measured: dict[int, dict[str, list[float]]] = field(default_factory=dict)

    def observing(self, observer: Observer) -> Observer:
        """An observer that also records times."""

        def on_time(iteration: int, part: str, seconds: float) -> None:
            self._measured.setdefault(iteration, {}).setdefault(part, []).append(seconds)
            observer.on_time(iteration, part, seconds)

        def on_deployment(deployment: Deployment) -> None:
            self._write(deployment.iteration)
            observer.on_deployment(deployment)

        return replace(observer, on_time=on_time, on_deployment=on_deployment)

    def _write(self, iteration: int) -> None:
        """Adds the times of a deployment that was executed now; one that was taken from the record keeps its own."""
        if "planning" not in (measured := self._measured.get(iteration, {})):
            return
        known = read_times(self.folder)
        times = {} if isinstance(known, Missing) else known
        times[iteration] = {part: statistics_of(seconds) for part, seconds in measured.items()}
        with suppress(OSError):  # a run does not end because its times cannot be kept
            write_times(self.folder, times)
