import re
import signal
from pathlib import Path

import pytest
from hypothesis import settings

from stepgap.cli.app import main
from tests.cli.command_line import Command, Said

settings.register_profile("no deadline", deadline=None)  # no test depends on how busy the machine is
settings.load_profile("no deadline")

# A shell that starts tests in the background has them ignore Ctrl-C, and so would every process that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def stepgap(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Runs a command line in an empty folder, as the shell sees it, everything compiled already."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Said:
        capfd.readouterr()
        try:
            main([str(argument) for argument in arguments])
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        err = re.sub(r"^stepgap: compiling for this machine.*\n", "", err, count=1)  # depends on the cache
        return Said(code, str(out), str(err))

    return run
