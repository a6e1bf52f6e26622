"""The commands and code of docs/data.md, one after the other, on a small run."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from stepgap.robots.hopper.kinematics import TRUE_UNITS
from tests.cli.command_line import Command

PAGE = (Path(__file__).parent.parent / "docs" / "data.md").read_text("utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
SHORT = ["--reference", "short.csv"]


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_the_page_of_data_runs(stepgap: Command, capfd: pytest.CaptureFixture[str]) -> None:
    Path("short.csv").write_text("speed,height\n0.1,0.56\n0.2,0.58\n")
    assert stepgap("run", *SHORT, "--out", "runs/latest", "--iterations", 1, "--quiet").code == 0
    printed = ""
    for language, block in BLOCKS:
        if language == "python":
            exec(compile(block, "data.md", "exec"), {})  # noqa: S102  (our own page)
            printed += capfd.readouterr().out
        elif language == "matlab":
            assert_octave_runs(block)
        else:
            for line in block.splitlines():
                program, *arguments = shlex.split(line)[1:]
                if program == "stepgap":
                    more = [*SHORT, "--iterations", 0] if arguments[0] == "run" else []
                    result = stepgap(*arguments, *more)
                    assert result.code == 0, result
    for name in ("run.mat", "steps.csv", "steps_columns.csv", "ticks_1.mcap", "mjcf/scene.xml"):
        assert Path("runs/latest/export", name).is_file()
    assert Path("warm/warm_start.csv").is_file()
    assert "of the time on the ground" in printed
    assert re.search(r"^\[0\.\d+ +0\.\d+ *\]$", printed, re.MULTILINE), "the corrected next state"


def assert_octave_runs(block: str) -> None:
    octave = shutil.which("octave-cli")
    if octave:  # elsewhere SciPy alone reads the file, in test_cli_data.py
        outcome = subprocess.run([octave, "-q", "--eval", block], capture_output=True, text=True, check=False)
        assert outcome.stdout.startswith("speed of deployment 1: RMSE 0."), outcome.stderr


def test_it_names_every_column_that_is_true() -> None:
    for name in [*TRUE_UNITS, "step"]:
        assert f"`{name}`" in PAGE
