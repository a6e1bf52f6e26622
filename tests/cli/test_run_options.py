"""Options of `run` that save a file: one target, a name and a note, the report in the browser."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stepgap as library
from stepgap.experiment.run import Run
from stepgap.export.controller.passport import passport_of
from tests.cli.command_line import Command, refused

pytestmark = pytest.mark.usefixtures("package")

BALL = ("run", "--robot", "ball", "--iterations", "1", "--quiet")


@pytest.mark.usefixtures("no_report")
def test_one_target_is_a_reference_without_a_file(stepgap: Command) -> None:
    Path("six.csv").write_text("height\n" + 6 * "0.7\n")
    by_file = stepgap(*BALL, "--reference", "six.csv", "--out", "by_file")
    by_option = stepgap(*BALL, "--target", "height=0.7", "--steps", "6", "--out", "by_option")
    assert (by_file.code, by_option.code) == (0, 0)
    for name in ("steps.csv", "summary.json", "reference.csv", "experiment.toml"):
        assert Path("by_option", name).read_text() == Path("by_file", name).read_text()
    steps = Path("by_option", "steps.csv")
    whole = steps.read_text()
    steps.write_text("".join(whole.splitlines(keepends=True)[:4]))
    assert stepgap("run", "--out", "by_option", "--resume", "--quiet").code == 0
    assert steps.read_text() == whole


def test_a_target_is_a_setting_from_python_and_of_a_linear_map() -> None:
    run = library.run("ball", reference="height=0.7,steps=5", method="rls", iterations=0, progress=False)
    assert np.array_equal(run.steps.target, np.full((5, 1), 0.7))
    run = library.run("ball", targets=[[0.7]] * 5, method="rls", iterations=0, progress=False)
    assert np.array_equal(run.steps.target, np.full((5, 1), 0.7))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--steps 3", ["--steps: valid only with --target"]),
        ("--target height=0.7 --reference x.csv", ["--target, --reference: give only one of them"]),
        ("--target 0.7", ["--target 0.7: it must be names with numbers"]),
        ("--target speed=0.7", ["target speed=0.7: no name 'speed'; it must be of height"]),
        ("--target height=nan", ["finite numbers, such as height=0.6"]),
        ("--target height=0.7 --steps 0", ["steps must be an integer between 1 and 5000"]),
        ("--target height=0.7 --steps 5001", ["steps must be an integer between 1 and 5000"]),
    ],
)
def test_a_wrong_target_is_named(stepgap: Command, arguments: str, parts: list[str]) -> None:
    refused(stepgap(*BALL, *arguments.split()), *parts)


def test_a_run_has_a_name_and_a_note(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a display, --open says so, and the path of the report is printed all the same."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    words = ("--name", "ball 3", "--note", "a <new> spring")
    named = stepgap(*BALL, "--target", "height=0.7", *words, "--out", "a", "--open")
    assert (named.code, named.out) == (0, "a/report.html\n")
    assert "--open: there is no display here" in named.err
    page = Path("a/report.html").read_text()
    assert re.search(r"</h1>\s*<p>ball 3: a &lt;new&gt; spring</p>", page)
    assert passport_of(Run(Path("a")), None)["name"] == "ball 3"
    assert passport_of(Run(Path("a")), None, "other")["name"] == "other"
    assert stepgap(*BALL, "--target", "height=0.7", "--out", "b").code == 0
    assert not re.search(r"</h1>\s*<p>ball", Path("b/report.html").read_text())
    assert stepgap("compare", "a", "b", "--out", "both.html").code == 0
    assert "(ball 3: a &lt;new&gt; spring)" in Path("both.html").read_text()


def test_a_page_is_opened_by_the_browser_of_the_environment(tmp_path: Path) -> None:
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" >{tmp_path}/opened\n')
    browser.chmod(0o755)
    program = "from pathlib import Path; from stepgap.cli.terminal import open_page; open_page(Path('my report.html'))"
    environment = {**os.environ, "BROWSER": f"{browser} %s"}
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True)
    assert (tmp_path / "opened").read_text() == f"{(tmp_path / 'my report.html').resolve().as_uri()}\n"
