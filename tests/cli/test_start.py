"""A stranger's folder: Python files in it are not executed by the program's own processes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stepgap.base.child_environment import environment_of_user, import_nothing_from_here

MODULES = ("struct", "multiprocessing", "random", "mujoco", "numpy", "stepgap")
"""Names that processes of the program import."""

TRAP = "from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\nraise SystemExit(3)\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(TRAP)
    return tmp_path


def run_program(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the installed program in the folder, as its user would."""
    program = Path(sys.executable).with_name("stepgap")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    return subprocess.run(
        [program, *arguments], cwd=folder, capture_output=True, text=True, timeout=300, check=False, env=environment
    )


def test_ctrl_c_while_modules_are_imported_is_one_line() -> None:
    script = "import sys, stepgap.cli.start\nraise KeyboardInterrupt"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.stderr, ended.returncode) == ("stepgap: stopped\n", -signal.SIGINT)


SPAWNING = "from stepgap.base.start_method import process_context\np = process_context().Process()\np.start()\np.join()"


def test_processes_of_the_program_import_nothing_of_the_current_folder(folder: Path) -> None:
    doctor = run_program(folder, "doctor")
    assert not sorted(folder.glob("*.ran")), doctor.stderr
    assert "numpy" in doctor.stdout


def test_processes_of_multiprocessing_import_nothing_of_the_current_folder(folder: Path) -> None:
    begin = "from stepgap.base.child_environment import import_nothing_from_here\nimport_nothing_from_here()\n"
    outcome = subprocess.run(
        [sys.executable, "-P", "-c", begin + SPAWNING], cwd=folder, capture_output=True, text=True, check=False
    )
    assert (outcome.returncode, sorted(folder.glob("*.ran"))) == (0, []), outcome.stderr


def test_programs_of_the_user_may_import_what_lies_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONSAFEPATH", "")  # so that the end of the test takes away what the program sets
    monkeypatch.delenv("PYTHONSAFEPATH")
    before = dict(os.environ)
    import_nothing_from_here()
    assert os.environ["PYTHONSAFEPATH"]
    assert environment_of_user() == before
    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    import_nothing_from_here()
    assert environment_of_user()["PYTHONSAFEPATH"] == "1"
