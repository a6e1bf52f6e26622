import fcntl
import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from cyclopts import App
from hypothesis import settings
from threadpoolctl import threadpool_limits

from stepgap.base.compiled import cache_folder
from stepgap.cli.app import main
from stepgap.cli.verbs import command_line
from stepgap.hybrid.motion import axpy
from tests.cli.command_line import Command, CommandResult
from tests.compiled_hops import compile_hops
from tests.hardware.realtime.warm_start import start_realtime_from_warm_server
from tests.quick_bus import leave_out_spinning
from tests.quick_disk import leave_out_waiting_for_the_disk
from tests.quick_runs import (
    compute_in_a_thread,
    leave_out_drawing,
    leave_out_figures,
    leave_out_files_of_figures,
    leave_out_repeats,
    leave_out_report,
)
from tests.robots.plug_in import install
from tests.shared_run import run_folder as run_folder  # a fixture
from tests.warm_process import start_processes_from_a_warm_server

settings.register_profile("no deadline", deadline=None)  # no test depends on how busy the machine is
settings.load_profile("no deadline")

# Hundreds of processes import the package; without bytecode on disk each would compile all of it first.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A shell that starts tests in the background has them ignore Ctrl-C and SIGQUIT, and `nohup` the end of the terminal;
# so would every process that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGQUIT, signal.SIG_DFL)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


MOST_WORKERS = 8
"""Processes that share the tests of `-n auto`, at most: each needs a few seconds and 300 MB for its imports."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """As many as there are cores; none on a single core, or where files are named."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    names_files = any(Path(argument.partition("::")[0]).is_file() for argument in config.args)
    return 0 if cores == 1 or names_files else min(cores, MOST_WORKERS)


def pytest_configure() -> None:
    """Matrices of tests are small, and tests fill the cores already: further threads of BLAS would only wait."""
    threadpool_limits(limits=1, user_api="blas")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of processes that tests start
    os.environ.setdefault("MUJOCO_GL", "disable")  # MuJoCo would start a process to look for OpenGL
    leave_out_waiting_for_the_disk()
    leave_out_spinning()
    start_processes_from_a_warm_server()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Of several processes the first compiles what most tests need; the others wait, and find it in the cache.

    The name of the folder of compiled functions is the digest of their sources.
    """
    folder = cache_folder()
    if hasattr(session.config, "workerinput") and folder is not None:
        function: Any = axpy
        compiled = Path(function.stats.cache_path).parent / "compiled-for-tests"
        with (folder / "tests.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not compiled.exists():
                compile_hops()
                compiled.touch()


def pytest_runtest_setup() -> None:
    """Ctrl-C ends a wait, as at the start of a program.

    A library in C may change that for all later tests of the process: OpenTURNS, when it is imported, has Ctrl-C resume
    a wait (SA_RESTART), and a test that waits for a process and is to be interrupted then waits for ever.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """What was imported stays until the end; the garbage collector need not look at it again and again."""
    gc.freeze()


@pytest.fixture
def in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    compute_in_a_thread(monkeypatch)


@pytest.fixture
def warm_realtime(monkeypatch: pytest.MonkeyPatch) -> None:
    """Real-time processes start at once, as copies of a fork server."""
    start_realtime_from_warm_server(monkeypatch)


@pytest.fixture
def no_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_repeats(monkeypatch)


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_report(monkeypatch)


@pytest.fixture
def every_format() -> None:
    """Reports draw the files of their figures too, which takes three times as long as the figures of the page."""


@pytest.fixture
def drawn_page() -> None:
    """Reports draw the figures of their page, which takes ten times as long as to make them."""


@pytest.fixture
def made_figures() -> None:
    """Reports make their figures from their data, which takes as long as all else of a page, but do not draw them."""


@pytest.fixture(autouse=True)
def _figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports of tests that ask for none of these have empty figures."""
    if "every_format" in request.fixturenames:
        return
    if "drawn_page" in request.fixturenames:
        leave_out_files_of_figures(monkeypatch)
    elif "made_figures" in request.fixturenames:
        leave_out_drawing(monkeypatch)
    else:
        leave_out_figures(monkeypatch)


@pytest.fixture
def stepgap(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Runs a command line in an empty folder, as the shell sees it, everything compiled already."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object, verbs: Callable[[str], App] = command_line) -> CommandResult:
        capfd.readouterr()
        try:
            main([str(argument) for argument in arguments], verbs)
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        err = re.sub(r"^stepgap: compiling for this machine.*\n", "", err, count=1)  # depends on the cache
        return CommandResult(code, str(out), str(err))

    return run


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The packages with robots, a verb and plants of the documentation, on the search path."""
    folder = tmp_path_factory.mktemp("package")
    install(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        for name in ("ball_robot", "spring_hopper", "authority_verb", "ball_plants"):
            patch.delitem(sys.modules, name, raising=False)
        yield folder
