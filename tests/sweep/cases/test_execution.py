"""Execution of cases: failures are results, processes may end."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import sleep

import pytest

from stepgap.base import start_method
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.cases.execution import Processes, execute
from tests.sweep.cases.quick_cases import (
    Squares,
    end_at_one,
    fail_at_one,
    full_disk,
    sleep_after,
    square,
    square_of_caller,
)

PLAN = Squares(5, bad=3)


@pytest.fixture
def folder(tmp_path: Path) -> CaseFolder:
    return CaseFolder(tmp_path / "out", PLAN, join=False)


def outcomes(folder: CaseFolder) -> list[object]:
    return [found.failed or found.result for _, found in folder.results()]


def test_a_case_that_fails_does_not_stop_the_others(folder: CaseFolder) -> None:
    stored: list[int] = []
    with ThreadPoolExecutor(2) as executor:
        execute(PLAN, folder, range(5), fail_at_one, executor, 2, lambda number, _: stored.append(number))
    assert outcomes(folder) == [0, "ZeroDivisionError: one is bad", 4, "case 3: bad", 16]
    assert sorted(stored) == [0, 1, 2, 3, 4]


def test_a_first_case_that_cannot_be_described_does_not_stop_the_others(tmp_path: Path) -> None:
    plan = Squares(3, bad=0)
    folder = CaseFolder(tmp_path / "out", plan, join=False)
    with ThreadPoolExecutor(1) as executor:
        execute(plan, folder, range(3), square, executor, 1)
    assert outcomes(folder) == ["case 0: bad", 1, 4]


def test_a_case_that_ends_its_process_fails_and_the_others_go_on(folder: CaseFolder) -> None:
    with Processes(2) as executor:
        execute(PLAN, folder, range(5), end_at_one, executor, 2)
    reason = "its process ended, such as by a crash of compiled code or for lack of memory"
    assert outcomes(folder) == [0, reason, 4, "case 3: bad", 16]


def test_an_error_of_the_system_stops_the_execution(folder: CaseFolder) -> None:
    with ThreadPoolExecutor(1) as executor, pytest.raises(OSError, match="No space left"):
        execute(PLAN, folder, range(5), full_disk, executor, 1)
    assert outcomes(folder) == []


def test_calls_run_in_other_processes() -> None:
    with Processes(2) as executor:
        calls = [executor.submit(square_of_caller, number) for number in range(8)]
        assert [call.result()[0] for call in calls] == [number**2 for number in range(8)]
        assert os.getpid() not in {call.result()[1] for call in calls}
        with pytest.raises(ZeroDivisionError):
            executor.submit(divmod, 1, 0).result()


def test_shutdown_without_waiting_ends_calls_at_once(tmp_path: Path) -> None:
    executor = Processes(1)
    call = executor.submit(sleep_after, tmp_path / "mark")
    waiting = executor.submit(square_of_caller, 1)
    mark = tmp_path / "mark"
    while not (mark.exists() and mark.read_text()):
        sleep(0.01)
    executor.shutdown(wait=False)
    assert call.exception() is not None
    assert waiting.cancelled() or waiting.exception() is not None
    with pytest.raises(ProcessLookupError):
        os.kill(int(mark.read_text()), 0)


def test_no_process_outlives_the_one_that_started_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_method, "CONTEXT", get_context("spawn"))
    pid = os.fork()
    if pid == 0:  # as a client that is killed during a case
        try:
            Processes(1).submit(sleep_after, tmp_path / "mark")
            signal.pause()
        finally:
            os._exit(1)
    mark = tmp_path / "mark"
    while not (mark.exists() and mark.read_text()):
        sleep(0.01)
    worker = int(mark.read_text())
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    while Path(f"/proc/{worker}").exists() and "Z" not in Path(f"/proc/{worker}/stat").read_text().split(")")[1]:
        sleep(0.01)
