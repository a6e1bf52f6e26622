"""The commands and code of docs/steps.md, one after the other."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from stepgap.logs.sections.section_settings import read_section_settings
from tests.cli.command_line import Command

PAGE = (Path(__file__).parent.parent / "docs" / "steps.md").read_text("utf-8").partition("## How well it works")[0]
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)


def test_the_page_of_steps_runs(
    stepgap: Command, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stepgap.learning.entry_points.names_by_complexity", lambda: ("none", "constant", "linear"))
    printed, rules = list[str](), list[str]()
    for language, block in BLOCKS:
        if language == "python":
            exec(compile(block, "steps.md", "exec"), {})  # noqa: S102  (our own page)
            printed.append(capfd.readouterr().out)
        elif language == "sh":
            for line in block.splitlines():
                result = stepgap(*shlex.split(line)[2:])
                assert result.code == 0, result
                printed.append(result.out)
        else:
            Path("columns.toml").write_text(block)
            rules.append(read_section_settings(Path("columns.toml"), {}).rule)
    assert "40 sections, 39 of 39 steps" in printed[1]
    speed = re.search(r"^linear .* ([\d.]+) ± [\d.]+ %$", printed[2], re.MULTILINE)  # in the first table
    assert speed, printed[2]
    assert float(speed[1]) > 90, "the changes of speed are explained by state and command"
    assert printed[3] == "20 19\n"
    assert rules == ["phase", "every"]
    assert "state mean over a step" in printed[5]
    assert Path("walker/steps.csv").is_file()
    assert len(np.genfromtxt("steps.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")) == 39
