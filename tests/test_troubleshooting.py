"""The page of troubleshooting quotes messages that exist, and names settings that exist."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.step import ADVICE

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
QUOTED = re.findall(r"^> (.*)$", PAGE, re.MULTILINE)
SETTING = re.compile(r"`((?:gains|gap|control|learning)\.[a-z_0-9]+)")


def strings(file: Path) -> Iterator[str]:
    """The string literals of a source file, with a line break for every value that is inserted."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "\n" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.fixture(scope="module")
def messages() -> str:
    folders = ("cli", "report", "experiment", "plants", "records", "base", "hardware", "logs")
    files = [file for name in folders for file in sorted((ROOT / "src" / "stepgap" / name).rglob("*.py"))]
    return "\n".join(text for file in files for text in strings(file))


def test_it_quotes_messages_that_exist(messages: str) -> None:
    parts = [part for quoted in QUOTED for part in quoted.split("…") if len(part) > 3]
    assert len(parts) > 20
    for part in parts:
        assert part in messages or part.strip() in messages, part


def test_its_statuses_are_those_of_a_failed_step() -> None:
    assert re.findall(r"^\| `([a-z_]+)` \|", PAGE, re.MULTILINE) == [status.label for status in ADVICE]


def test_its_settings_exist() -> None:
    names = sorted(set(SETTING.findall(PAGE)))
    assert len(names) >= 8
    settings: Experiment = read_experiment(None, [])
    for name in names:
        table, key = name.split(".")
        owner = settings if hasattr(settings, table) else settings.robot
        assert hasattr(getattr(owner, table), key), name
