"""`stepgap view` and `run --view`, and what ends them."""

import shutil
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from itertools import product
from pathlib import Path
from threading import Timer, main_thread
from time import sleep

import pytest

from stepgap.experiment.loop import Observer
from stepgap.learning.steps import LoggedStep
from stepgap.view.address import HERE
from stepgap.view.live import LiveView
from tests.cli.command_line import Command, refused
from tests.shared_run import TARGETS

SENSITIVE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
"""Code that enables Ctrl-C, which is ignored where the tests run in the background."""

PROGRAM = [sys.executable, "-c", f"{SENSITIVE}; from stepgap.cli.app import main; main()"]


def opened(url: str, process: subprocess.Popen) -> bytes:
    """The page at an address, as soon as a process serves it."""
    while True:
        try:
            with urllib.request.urlopen(url) as answer:
                return answer.read(1000)
        except urllib.error.URLError:
            assert process.poll() is None, "the page has ended"
            sleep(0.05)


def free_port() -> int:
    """A port that no page of another test uses; one could take the default port after this page has released it."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def test_it_serves_the_page_until_ctrl_c(run_folder: Path) -> None:
    pipe = subprocess.PIPE
    with subprocess.Popen([*PROGRAM, "view", run_folder], stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stderr
        line = next(line for line in process.stderr if "open http://" in line)
        assert b"<html" in opened(line.split()[2], process)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert (process.returncode, out, err) == (0, "", "")


def test_opening_it_to_others_warns(stepgap: Command, run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is terminated after its first frame."""
    monkeypatch.setattr("stepgap.view.watch.sleep", lambda _: signal.raise_signal(signal.SIGTERM))
    result = stepgap("view", run_folder, "--host", "0.0.0.0")
    assert (result.code, result.out) == (0, "")
    address, warning = result.err.splitlines()
    assert address.startswith("stepgap: open http://0.0.0.0:")
    assert "warning: --host 0.0.0.0 opens the page to everyone" in warning


def test_wrong_input_is_one_line(stepgap: Command, run_folder: Path, tmp_path: Path) -> None:
    refused(stepgap("view", tmp_path / "none"), "none", "experiment.toml")
    refused(stepgap("view", run_folder, "--deployment", "7"), "--deployment 7", "0, 1")
    refused(stepgap("view", run_folder, "--port", "70000"), '"70000" for --port', "65536")
    refused(stepgap("view", run_folder, "--host", "no.such.host.invalid"), "--host", "no such address")
    refused(stepgap("view", run_folder, "--ring", "no-such-ring"), "no-such-ring")


NAMES, CONTENTS = ["steps.csv", "experiment.toml"], [b"\x00\xff rubbish", b"{}", b""]


@pytest.mark.parametrize(("name", "content"), list(product(NAMES, CONTENTS))[:-1])  # an empty file of settings is one
def test_broken_files_are_one_line(
    stepgap: Command, run_folder: Path, tmp_path: Path, name: str, content: bytes
) -> None:
    copy = shutil.copytree(run_folder, tmp_path / "copy")
    (copy / name).write_bytes(content)
    refused(stepgap("view", copy), name)


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_run_is_the_same_with_a_page_that_dies(
    stepgap: Command, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page is killed after the first step; all recorded bytes equal those of a run without a page."""
    observing = LiveView.observing

    def killing(live: LiveView, observer: Observer) -> Observer:
        observed = observing(live, observer)

        def on_step(logged: LoggedStep) -> None:
            live._process.kill()
            observed.on_step(logged)

        return replace(observed, on_step=on_step)

    monkeypatch.setattr(LiveView, "observing", killing)
    (tmp_path / "targets.csv").write_text(TARGETS)
    arguments = ["--reference", tmp_path / "targets.csv", "--out", tmp_path / "run", "--seed", "5"]
    result = stepgap("run", *arguments, "--iterations", "1", "--quiet", "--view")
    assert (result.code, result.out.strip()) == (0, str(tmp_path / "run" / "report.html"))
    assert (tmp_path / "run" / "steps.csv").read_bytes() == (run_folder / "steps.csv").read_bytes()


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_run_shows_its_page_and_ctrl_c_ends_both_when_it_is_over(
    stepgap: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, stay = free_port(), LiveView.stay
    url = f"http://{HERE}:{port}"

    def interrupted(live: LiveView) -> None:
        assert b"<html" in opened(url, live._process)
        key = Timer(0.1, signal.pthread_kill, (main_thread().ident, signal.SIGINT))
        key.start()
        try:
            stay(live)
        finally:
            key.cancel()

    monkeypatch.setattr(LiveView, "stay", interrupted)
    (tmp_path / "targets.csv").write_text("speed,height\n0.1,0.56\n")
    arguments = ["--reference", tmp_path / "targets.csv", "--out", tmp_path / "run", "--iterations", "0"]
    result = stepgap("run", *arguments, "--view", "--port", port)
    assert (result.code, result.out.strip()) == (0, str(tmp_path / "run" / "report.html"))
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url)


@pytest.mark.usefixtures("package", "no_repeats")
def test_a_robot_is_shown_without_a_run(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = []
    monkeypatch.setattr("stepgap.view.watch.watch", lambda server, page, go_on: (shown.append(page), server.stop()))
    result = stepgap("view", "--robot", "pitching", "--port", free_port())
    assert result.code == 0, result.err
    (page,) = shown
    assert (page.iteration, len(page._source.steps(0))) == (0, 37)
    assert not list(Path().iterdir())
    refused(stepgap("view"), "give the folder of a run, or a robot by --robot NAME")
    refused(stepgap("view", "out", "--robot", "ball"), "a run is shown with its own settings")
