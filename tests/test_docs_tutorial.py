"""The commands and code of docs/tutorial.md, one after the other, with three steps to each speed instead of six."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from tests.cli.command_line import Command

PAGE = (Path(__file__).parent.parent / "docs" / "tutorial.md").read_text("utf-8")
SHORTER = PAGE.replace("in range(6)", "in range(3)")


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_the_tutorial_runs(stepgap: Command, capfd: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for language, block in re.findall(r"```(\w+)\n(.*?)```", SHORTER, re.DOTALL):
        if language == "python":
            exec(compile(block, "tutorial.md", "exec"), names)  # noqa: S102  (our own page)
        else:
            _, _, *arguments = shlex.split(block)
            assert stepgap(*arguments, *(["--quiet"] if arguments[0] == "run" else [])).code == 0
    assert len(names["run"].steps) == 30
    assert (names["rmse"](names["run"], 1) < names["rmse"](names["run"], 0)).all()
    assert names["other"].settings.learning.residual == "linear"
    for name in ("prediction_errors.png", "learned.png", "comparison.html"):
        assert Path(name).stat().st_size
