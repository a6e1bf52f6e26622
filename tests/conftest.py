import os
import re
import signal
from pathlib import Path

import pytest
from hypothesis import settings

from stepgap.cli.app import main
from tests.cli.command_line import Command, Said
from tests.quick_runs import leave_out_files_of_figures, leave_out_repeats, leave_out_report

settings.register_profile("no deadline", deadline=None)  # no test depends on how busy the machine is
settings.load_profile("no deadline")

# A shell that starts tests in the background has them ignore Ctrl-C, and so would every process that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)


MOST_WORKERS = 8
"""Processes that share the tests of `-n auto`, at most: each needs a few seconds and 300 MB for its imports."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One process for each core that may be used; this one alone on a single core, or where files are named."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    names_files = any(Path(argument.partition("::")[0]).is_file() for argument in config.args)
    return 0 if cores == 1 or names_files else min(cores, MOST_WORKERS)


@pytest.fixture
def no_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_repeats(monkeypatch)


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_report(monkeypatch)


@pytest.fixture
def svg_only(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_files_of_figures(monkeypatch)


@pytest.fixture
def stepgap(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Runs a command line in an empty folder, as the shell sees it, everything compiled already."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Said:
        capfd.readouterr()
        try:
            main([str(argument) for argument in arguments])
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        err = re.sub(r"^stepgap: compiling for this machine.*\n", "", err, count=1)  # depends on the cache
        return Said(code, str(out), str(err))

    return run
