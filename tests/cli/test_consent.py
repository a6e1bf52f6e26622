"""Consent to torque: a person at a terminal, not a pipe."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.command_line import Command, refused

ARM = ("run", "--arm", "--plant", "ethercat", "--rig", "none.toml")
REFUSAL = "stepgap: --arm: standard input is not a terminal"


@pytest.fixture
def read_from(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Makes a file descriptor the standard input of this process."""
    before = os.dup(0)

    def read_from(descriptor: int) -> None:
        os.dup2(descriptor, 0)
        monkeypatch.setattr(sys, "stdin", os.fdopen(0, closefd=False))

    yield read_from
    os.dup2(before, 0)
    os.close(before)


def test_a_pipe_is_refused_before_anything_else_is_checked(tmp_path: Path) -> None:
    """Neither rig.toml nor the settings exist, which is not even noticed."""
    command = [sys.executable, "-c", "from stepgap.cli.app import main; main()", *ARM, "none.toml"]
    ended = subprocess.run(command, cwd=tmp_path, input=b"\n" * 20, capture_output=True, timeout=600)
    assert ended.returncode == 2
    assert ended.stdout == b""
    assert ended.stderr.decode().startswith(REFUSAL)
    assert not list(tmp_path.iterdir())


def test_a_pipe_that_has_ended_is_refused(stepgap: Command, read_from: Callable[[int], None], tmp_path: Path) -> None:
    ours, theirs = os.pipe()
    os.close(theirs)
    read_from(ours)
    refused(stepgap(*ARM, "none.toml"), REFUSAL)
    os.close(ours)
    assert not list(tmp_path.iterdir())


def test_at_a_terminal_the_next_check_follows(stepgap: Command, read_from: Callable[[int], None]) -> None:
    ours, theirs = os.openpty()
    read_from(theirs)
    refused(stepgap(*ARM), "stepgap: none.toml: No such file or directory")
    os.close(ours)
    os.close(theirs)
