"""The progress display of a run on a terminal: always one line that says what is being done."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from stepgap.cli import progress as module
from stepgap.cli.progress import RunProgress
from stepgap.learning.steps import LoggedStep
from stepgap.records.summary import Deployment
from stepgap.step import StepRecord, StepStatus
from tests.control.maps import LossyHopper

SPACE = LossyHopper().space


ERR, NONE = np.full(2, 0.01), np.empty((0, 2))


def logged(iteration: int, step: int) -> LoggedStep:
    state, command = SPACE.state_centre, SPACE.command_centre
    record = StepRecord(state, command, command, state + 0.01, StepStatus.OK)
    return LoggedStep(iteration, step, state, state, np.zeros(2), record)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """What a terminal of 120 columns receives."""
    text = io.StringIO()
    monkeypatch.setattr(module, "screen", lambda _: Console(file=text, force_terminal=True, width=120))
    return text


def shown(progress: RunProgress, terminal: io.StringIO) -> str:
    """The line that is displayed now."""
    terminal.truncate(0)
    progress._bars.refresh()
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue()).split("\n")
    assert len(lines) == 1
    return lines[0]


def test_deployments_and_what_is_between_them_have_a_line(terminal: io.StringIO) -> None:
    with RunProgress(SPACE, steps=4, iterations=1) as progress:
        observer = progress.observer
        observer.on_phase("learning", 0, 0)
        assert "learning" in shown(progress, terminal)
        for step in (1, 2, 3):
            observer.on_step(logged(0, step))
        line = shown(progress, terminal)
        assert "deployment 0 of 1" in line
        assert "3/4" in line
        assert "speed 0.0100 m/s" in line
        observer.on_deployment(Deployment(0, "none", 4, 0, ERR, ERR, ERR, ERR, ERR, ERR, 0, NONE, NONE))
        observer.on_phase("learning", 0, 0)
        assert "learning" in shown(progress, terminal)
        observer.on_step(logged(1, 1))
        assert "deployment 1 of 1" in (line := shown(progress, terminal))
        assert "1/4" in line
        observer.on_phase("measuring the noise floor", 5, 20)
        assert "measuring the noise floor" in (line := shown(progress, terminal))
        assert "5/20" in line


def test_a_coordinate_that_stays_away_from_its_targets_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with RunProgress(SPACE, steps=6, iterations=0) as progress:
        for number in range(1, 7):
            step = logged(0, number)
            low = step.record.next_state - [0.0, 0.3]
            progress.observer.on_step(replace(step, record=replace(step.record, next_state=low)))
        progress.observer.on_deployment(Deployment(0, "none", 6, 0, ERR, ERR, ERR, ERR, ERR, ERR, 0, NONE, NONE))
    assert "In all 6 steps of deployment 0, height ended below all targets, 0.290 to 0.290 m" in capsys.readouterr().err


def test_the_step_before_the_first_planned_one_does_not_count(terminal: io.StringIO) -> None:
    with RunProgress(SPACE, steps=4, iterations=0) as progress:
        progress.observer.on_step(replace(logged(0, 0), target=np.full(2, np.nan)))
        progress.observer.on_step(logged(0, 1))
        assert "1/4" in shown(progress, terminal)
