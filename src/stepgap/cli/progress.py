"""Progress of a run on the terminal for people, and as JSON lines for programs."""

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Self

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from stepgap.cli.screen import screen
from stepgap.cli.terminal import printable, warn
from stepgap.experiment.exploration import worthwhile
from stepgap.experiment.loop import Observer, fails_no_later
from stepgap.experiment.outcome import COMPARED_STEPS, far_states, offset_sentences
from stepgap.learning.alarm import Alarm
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.records.steps_csv import values_of
from stepgap.records.summary import Deployment, deployment_entry
from stepgap.records.text import decimal, listed, unit_suffix
from stepgap.step import StepSpace, StepStatus, ending_of


@contextmanager
def progress_bar(description: str, quiet: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Shows a bar on a terminal, elsewhere nothing; yields the progress callback (done, total)."""
    with _bars(screen(sys.stderr), quiet) as bars:
        task = bars.add_task(description, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def _bars(console: Console, quiet: bool, *more: ProgressColumn) -> Progress:
    columns = TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(), TimeRemainingColumn()
    disabled = quiet or not console.is_terminal
    return Progress(*columns, *more, console=console, disable=disabled, transient=True, refresh_per_second=1)


class RunProgress:
    """Progress display of a run: on a terminal a bar per deployment with its error, elsewhere a line per deployment.

    In each deployment it warns of states that are far outside their ranges of use (`far_states`).

    Args:
        space: Names and units of the state.
        steps: Number of steps in a deployment.
        iterations: Largest number of redeployments.
        quiet: Whether to show nothing.
    """

    def __init__(self, space: StepSpace, steps: int, iterations: int, quiet: bool = False):
        self._space = space
        self._steps = steps
        self._iterations = iterations
        self._quiet = quiet
        self._console = screen(sys.stderr)
        self._bars = _bars(self._console, quiet, TextColumn("{task.fields[error]}"))
        self._task: TaskID | None = None
        self._description = ""
        self._last = 0
        self._deployments: list[Deployment] = []
        self._squares, self._counted = np.zeros((2, len(space.state)))
        self._executed: list[LoggedStep] = []

    @property
    def observer(self) -> Observer:
        """Observer whose callbacks update the display."""
        return Observer(
            self._on_step, self._on_deployment, self._on_fault, self._show, self._on_alarm,
            on_warning=self._on_warning, on_exploration=self._on_exploration,
        )  # fmt: skip

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, exc_type: object, *exc_info: object) -> None:
        self._bars.stop()
        if exc_type is None and self._last < self._iterations:
            reason = "stopped: the error no longer decreases (learning.tolerance)"
            if fails_no_later(self._deployments):
                reason = "stopped: three deployments failed, the last one no later than those before"
            self._say(reason)

    def _on_step(self, logged: LoggedStep) -> None:
        if not logged.planned:
            return
        if logged.record.status == StepStatus.OK:
            squares = np.square(logged.record.next_state - logged.target)
            measured = np.isfinite(squares)
            self._squares[measured] += squares[measured]
            self._counted += measured
        unknown = np.full_like(self._squares, np.nan)
        error = self._describe(np.sqrt(np.divide(self._squares, self._counted, out=unknown, where=self._counted > 0)))
        self._executed.append(logged)
        description = f"deployment {logged.iteration} of {self._iterations}"
        self._show(description, len(self._executed), self._steps, error)
        if len(self._executed) == COMPARED_STEPS:
            self._warn(far_states(Steps(self._space, self._executed)))

    def _say(self, sentence: str, style: str | None = None) -> None:
        """Prints a line, which without a terminal is not wrapped."""
        if not self._quiet:
            self._console.print(printable(sentence), soft_wrap=True, style=style)

    def _warn(self, sentences: Iterable[str]) -> None:
        for sentence in () if self._quiet else sentences:
            warn(sentence)

    def _on_deployment(self, deployment: Deployment) -> None:
        if len(self._executed) < COMPARED_STEPS:
            self._warn(far_states(Steps(self._space, self._executed)))
        if self._executed:
            self._warn(offset_sentences(Steps(self._space, self._executed)))
        status = self._executed[-1].record.status if self._executed else StepStatus.OK
        self._executed = []
        self._squares, self._counted = np.zeros((2, len(self._squares)))
        self._last = deployment.iteration
        self._deployments.append(deployment)
        end = f", then it {ending_of(status)}" if deployment.failed_steps else ""
        error = "" if np.isnan(deployment.rmse).all() else f", RMSE {self._describe(deployment.rmse)}"
        self._say(
            f"deployment {deployment.iteration} of {self._iterations} ({deployment.residual}): "
            f"{deployment.steps} {'step' if deployment.steps == 1 else 'steps'}{end}{error}"
        )

    def _on_alarm(self, alarm: Alarm) -> None:
        self._say(alarm.sentence)

    def _on_warning(self, sentence: str) -> None:
        self._warn([sentence])

    def _on_exploration(self, worths: Sequence[float]) -> None:
        worth = listed([f"{worth:.2f}" for worth in worths])
        made = worthwhile(worths)
        sentence = f"exploration: the next steps are worth {worth} squared errors of a step by noise"
        if made < len(worths):
            sentence += f", so {made or 'none'} {'is' if made < 2 else 'are'} made"
        self._say(sentence)

    def _on_fault(self, message: str) -> None:
        self._say(f"deployment aborted: {message}", style="bold")

    def _show(self, description: str, done: int, total: int, error: str = "") -> None:
        """Shows one bar, of a deployment or of what is done between two."""
        if self._task is None or description != self._description:
            if self._task is not None:
                self._bars.remove_task(self._task)
            self._task = self._bars.add_task(description, total=None, error="")
            self._description = description
        self._bars.update(self._task, completed=done, total=total or None, error=error)

    def _describe(self, rmse: np.ndarray) -> str:
        """The errors that are known, with their units."""
        return ", ".join(
            f"{quantity.name} {decimal(value)}{unit_suffix(quantity)}"
            for quantity, value in zip(self._space.state, rmse, strict=True)
            if np.isfinite(value)
        )


def print_event(event: str, **values: Any) -> None:
    """Prints one JSON object as a line without delay; a number that is not finite becomes null."""
    finite = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in values.items()
    }
    print(json.dumps({"event": event, **finite}, allow_nan=False), flush=True)


def printing_events(observer: Observer, space: StepSpace) -> Observer:
    """Observer that also prints a JSON line for every step, deployment and fault, for programs."""

    def on_step(logged: LoggedStep) -> None:
        print_event("step", **values_of(logged, space))
        observer.on_step(logged)

    def on_deployment(deployment: Deployment) -> None:
        print_event("deployment", **deployment_entry(deployment, space.state_names))
        observer.on_deployment(deployment)

    def on_fault(message: str) -> None:
        print_event("fault", message=message)
        observer.on_fault(message)

    return replace(observer, on_step=on_step, on_deployment=on_deployment, on_fault=on_fault)
