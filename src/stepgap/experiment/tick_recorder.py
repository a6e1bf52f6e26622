"""Recording of ticks during a run: the hop to which each tick belongs, and the ticks that the report will show."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepgap.experiment.loop import Observer
from stepgap.learning.step_log import LoggedStep
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.summary import Deployment
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.tick import TICK_UNITS
from stepgap.step import Array

_PHASE = list(TICK_UNITS).index("phase")


class HopCount:
    """Counts hops and deployments while they are executed.

    Attributes:
        iteration: Number of the deployment.
        hop: 0 is the hop after the release, k the k-th recorded step of the deployment.
    """

    def __init__(self) -> None:
        self.iteration, self.hop, self._phase = 0, 0, Phase.DESCENT

    def on_ticks(self, rows: Rows) -> Array:
        """Called with ticks at their end; returns the number of the hop of each, shape (k,).

        The first hop, which ends with the first apex, is not a recorded step.
        """
        phase = np.asarray(rows)[:, _PHASE]
        hops = np.full(len(phase), float(self.hop))
        if self.hop == 0:
            passed = np.flatnonzero((phase == Phase.DESCENT) & (np.append(self._phase, phase[:-1]) != Phase.DESCENT))
            if passed.size:
                hops[passed[0] + 1 :] = self.hop = 1
            self._phase = phase[-1]
        return hops

    def observing(self, observer: Observer) -> Observer:
        """Observer that first calls the given one, then counts the step or deployment."""

        def on_step(logged: LoggedStep) -> None:
            observer.on_step(logged)
            self.hop += 1

        def on_deployment(deployment: Deployment) -> None:
            observer.on_deployment(deployment)
            self.iteration, self.hop, self._phase = deployment.iteration + 1, 0, Phase.DESCENT

        return replace(observer, on_step=on_step, on_deployment=on_deployment)


class TickRecorder:
    """Keeps the ticks of deployment 0 and of the latest one, as far as they were executed since its creation.

    Args:
        every: Interval of the kept ticks; 1 keeps every tick.
    """

    def __init__(self, every: int):
        self._every, self._hops, self._count, self._before = every, HopCount(), 0, 0
        self._rows: list[Array] = []
        self._kept: dict[int, TickTable] = {}

    @property
    def kept(self) -> Mapping[int, TickTable]:
        """Kept ticks by number of the deployment: the fields of a tick, and `step`, the number of its step."""
        return self._kept

    def on_ticks(self, rows: Rows) -> None:
        """Called with ticks at their end."""
        kept = slice(-self._count % self._every, None, self._every)
        hops = self._hops.on_ticks(rows)
        self._rows.append(np.column_stack([np.asarray(rows)[kept], hops[kept]]))
        self._count += len(rows)

    def observing(self, observer: Observer) -> Observer:
        """Observer that calls the given one and counts steps and deployments."""

        def on_step(logged: LoggedStep) -> None:
            self._before = logged.step - self._hops.hop
            observer.on_step(logged)

        def on_deployment(deployment: Deployment) -> None:
            self._keep(deployment.iteration)
            observer.on_deployment(deployment)

        return self._hops.observing(replace(observer, on_step=on_step, on_deployment=on_deployment))

    def _keep(self, iteration: int) -> None:
        """Keeps the ticks of a deployment, if there are any; a deployment that was recorded earlier has none."""
        blocks, self._rows, self._count = self._rows, [], 0
        if not blocks:
            return
        rows = np.concatenate(blocks)
        rows[:, -1] += self._before
        self._kept = {number: ticks for number, ticks in self._kept.items() if number == 0}
        self._kept[iteration] = TickTable({**TICK_UNITS, "step": ""}, rows)
