"""What is recorded while a run goes on, besides its steps: ticks for its report, and `times.json`."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from stepgap.experiment.loop import Observer
from stepgap.learning.steps import LoggedStep
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.stream import OnTicks, numbered, thinned
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.missing import Missing
from stepgap.records.summary import Deployment
from stepgap.records.times_file import read_times, statistics_of, write_times
from stepgap.step import Array


class TickRecorder:
    """Keeps the ticks of deployment 0 and of the latest one, as far as they were executed since its creation.

    Args:
        units: Columns of the ticks with their units.
        every: Interval of the kept ticks; 1 keeps every tick.
    """

    def __init__(self, units: Mapping[str, str], every: int):
        self._units = units
        self._every = every
        self._executed = 0
        self._before = 0
        self._kept: dict[int, TickTable] = {}
        self._begin()

    @property
    def kept(self) -> Mapping[int, TickTable]:
        """Kept ticks by number of the deployment: the fields of a tick, and `step`, the number of its step."""
        return self._kept

    def on_ticks(self, rows: Rows, step: int) -> None:
        """Called with ticks at their end, and the number of their step in the deployment."""
        self._keep(rows, step)

    def observing(self, observer: Observer) -> Observer:
        """Observer that calls the given one and counts steps and deployments."""

        def on_step(logged: LoggedStep) -> None:
            self._executed += logged.planned  # the plant's first step is part of its start
            self._before = logged.step - self._executed
            observer.on_step(logged)

        def on_deployment(deployment: Deployment) -> None:
            self._finish(deployment.iteration)
            observer.on_deployment(deployment)

        return replace(observer, on_step=on_step, on_deployment=on_deployment)

    def _begin(self) -> None:
        rows = self._rows = list[Array]()

        def keep(kept: Rows, step: int) -> None:
            rows.append(numbered(kept, step))

        self._executed = 0
        self._keep: OnTicks = thinned(keep, self._every)

    def _finish(self, iteration: int) -> None:
        """Keeps the ticks of a deployment, if there are any; a deployment that was recorded earlier has none."""
        if self._rows:
            rows = np.concatenate(self._rows)
            rows[:, -1] += self._before
            self._kept = {number: ticks for number, ticks in self._kept.items() if number == 0}
            self._kept[iteration] = TickTable({**self._units, "step": ""}, rows)
        self._begin()


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
        recorded = read_times(self.folder)
        times = {} if isinstance(recorded, Missing) else recorded
        times[iteration] = {part: statistics_of(seconds) for part, seconds in measured.items()}
        with suppress(OSError):  # a run does not end because its times cannot be kept
            write_times(self.folder, times)
