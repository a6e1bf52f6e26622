"""Consent to torque: a person at a terminal, not a pipe; with real processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-c", "from stepgap.cli.app import main; main()", "run", "--arm", "--plant", "ethercat"]
REFUSAL = "stepgap: --arm: standard input is not a terminal"


@pytest.mark.parametrize("given", [b"\n" * 20, b""])
def test_a_pipe_is_refused_before_anything_else_is_checked(tmp_path: Path, given: bytes) -> None:
    """Neither rig.toml nor the settings exist, which is not even noticed."""
    command = [*COMMAND, "none.toml", "--rig", "none.toml"]
    ended = subprocess.run(command, cwd=tmp_path, input=given, capture_output=True, timeout=600)
    assert ended.returncode == 2
    assert ended.stdout == b""
    assert ended.stderr.decode().startswith(REFUSAL)
    assert not list(tmp_path.iterdir())


def test_at_a_terminal_the_next_check_follows(tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    command = [*COMMAND, "--rig", "none.toml"]
    ended = subprocess.run(command, cwd=tmp_path, stdin=theirs, capture_output=True, timeout=600)
    os.close(ours)
    os.close(theirs)
    assert ended.returncode == 2
    assert "stepgap: none.toml: No such file or directory" in ended.stderr.decode()
