"""`stepgap completion`: the shells read its scripts and complete verbs, options and settings."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cli.command_line import Command, refused


@pytest.fixture
def script(stepgap: Command, request: pytest.FixtureRequest) -> Path:
    """The script for the shell in a file."""
    path = Path(f"stepgap.{request.param}")
    path.write_text(stepgap("completion", request.param).out)
    return path


@pytest.mark.parametrize("script", ["bash", "zsh", "fish"], indirect=True)
def test_the_shell_reads_the_script(script: Path) -> None:
    shell = shutil.which(script.suffix[1:])
    if not shell:
        pytest.skip(f"{script.suffix[1:]} is not installed")
    subprocess.run([shell, "-n", script], check=True)


@pytest.mark.parametrize("script", ["bash"], indirect=True)
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("stepgap docto", "doctor"),
        ("stepgap run --iterat", "--iterations"),
        ("stepgap run --gains.stif", "--gains.stiffness"),
        ("stepgap export --gains.stif", ""),
    ],
)
def test_bash_completes(script: Path, line: str, expected: str) -> None:
    words = line.split()
    code = f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _stepgap_or_setting"
    outcome = subprocess.run(
        ["bash", "--norc", "-c", f'{code}; echo "${{COMPREPLY[*]}}"'], capture_output=True, text=True, check=True
    )
    assert (outcome.stdout.strip(), outcome.stderr) == (expected, "")


@pytest.mark.parametrize("script", ["zsh"], indirect=True)
def test_zsh_is_given_the_settings_and_the_function(script: Path) -> None:
    text = script.read_text()
    assert "--gains.stiffness" in text
    assert text.endswith("compdef _stepgap_or_setting stepgap\n")


def test_an_unknown_shell_is_refused(stepgap: Command) -> None:
    refused(stepgap("completion", "ksh"), "ksh")
