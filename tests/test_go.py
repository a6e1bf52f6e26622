"""`./go` sets `.venv` up: users' packages at first, developers' as well once a command needs them.

The set-up runs as it is, but with a program in place of uv: it writes down what it was asked to install, and makes an
empty environment. As with uv, `pip sync` removes what is not in the lock, which includes the project itself. A file
`broken` makes the installation of a lock fail; one that is `killed` ends `./go` in the middle of it.
"""

import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
LOCKS = ["requirements.lock", "requirements-dev.lock"]

NETWORK = {"UV_DEFAULT_INDEX": "none", "SSL_CERT_FILE": "none"}
"""Settings that `./go` would otherwise ask pip for, which takes a second."""

UV = r"""#!/bin/sh
case "$1 $2" in
"venv --quiet")
    mkdir -p .venv/bin .venv/lib/python3/site-packages
    ln -s "$PYTHON" .venv/bin/python
    for name in stepgap pytest; do printf '#!/bin/sh\necho "$0 runs"\n' >.venv/bin/$name; chmod +x .venv/bin/$name; done
    echo made >>uv.log
    ;;
"pip sync" | "pip install")
    case "$*" in
    *.lock*)
        lock=$(printf '%s\n' "$@" | grep '\.lock$')
        echo "${lock##*/}" >>../uv.log
        if [ -e ../broken ]; then exit 2; fi
        if [ $2 = sync ]; then mv bin/stepgap bin/removed; fi
        mkdir -p "lib/python3/site-packages/$(cat "$lock").dist-info"
        if [ -e ../killed ]; then kill -9 $PPID; fi
        ;;
    *--editable*) mv bin/removed bin/stepgap ;;
    esac
    ;;
*) exit 3 ;;
esac
"""


class Clone:
    """A folder with `./go`, two locks and a program `uv`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copy(ROOT / "go", folder)
        for name in [*LOCKS, "pyproject.toml"]:
            (folder / name).write_text(f"first_{name}", "utf-8")
        programs = folder / "programs"
        programs.mkdir()
        (programs / "uv").write_text(UV, "utf-8")
        (programs / "uv").chmod(0o755)
        self.environment = {"PATH": f"{programs}:/usr/bin:/bin", "PYTHON": sys.executable, **NETWORK}
        for name in ("python3.13", "python3.12", "python3.11", "python3"):
            (programs / name).symlink_to(sys.executable)

    def run(self, *command: str) -> tuple[bool, list[str], str]:
        """Whether the command ran, what uv was asked for meanwhile, and what `./go` printed to stderr."""
        log = self.folder / "uv.log"
        log.unlink(missing_ok=True)
        outcome = subprocess.run(
            ["./go", *command], cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )
        ran = outcome.returncode == 0 and f".venv/bin/{command[0]} runs" in outcome.stdout
        return ran, log.read_text("utf-8").split() if log.exists() else [], outcome.stderr

    def touch(self, name: str) -> Path:
        (self.folder / name).write_text("", "utf-8")
        return self.folder / name


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    return Clone(tmp_path)


def test_a_users_command_installs_what_users_need_once(clone: Clone) -> None:
    ran, asked, output = clone.run("stepgap")
    assert (ran, asked) == (True, ["made", "requirements.lock"])
    assert "making .venv from requirements.lock" in output
    assert clone.run("stepgap") == (True, [], "")


def test_a_python_can_be_chosen(clone: Clone) -> None:
    clone.environment["STEPGAP_PYTHON"] = "python3.99"
    assert "Python 3.11 or newer is needed, and none of these is one: python3.99." in clone.run("stepgap")[2]
    (clone.folder / "programs" / "python3.99").symlink_to(sys.executable)
    assert clone.run("stepgap")[0]


def test_a_command_knows_how_it_was_started(clone: Clone) -> None:
    clone.run("stepgap")
    folder = clone.folder / "other"
    folder.mkdir()
    command = ["../go", "sh", "-c", "echo $STEPGAP_GO"]
    result = subprocess.run(command, cwd=folder, env=clone.environment, capture_output=True, text=True, check=True)
    assert result.stdout == "../go\n"


def test_a_developers_command_adds_the_rest_and_it_stays(clone: Clone) -> None:
    clone.run("stepgap")
    ran, asked, output = clone.run("pytest")
    assert (ran, asked) == (True, ["requirements-dev.lock"])
    assert "adding the packages of developers" in output
    assert clone.run("stepgap") == (True, [], "")
    assert clone.run("pytest") == (True, [], "")


def test_a_developer_gets_all_at_once(clone: Clone) -> None:
    assert clone.run("pytest")[:2] == (True, ["made", "requirements-dev.lock"])
    assert clone.run("stepgap") == (True, [], "")


@pytest.mark.parametrize("file", [*LOCKS, "pyproject.toml"])
@pytest.mark.parametrize("command", ["stepgap", "pytest"])
def test_a_change_brings_it_up_to_date_with_the_lock_that_it_has(clone: Clone, command: str, file: str) -> None:
    clone.run(command)
    (clone.folder / file).write_text("second", "utf-8")
    ran, asked, output = clone.run("stepgap")
    lock = LOCKS[command == "pytest"]
    if file == "requirements-dev.lock" and command == "stepgap":
        lock = None  # users do not have it
    assert (ran, asked) == (True, [lock] if lock else [])
    assert ("bringing .venv up to date" in output) == bool(lock)


def test_where_adding_fails_users_continue_and_the_next_attempt_adds(clone: Clone) -> None:
    clone.run("stepgap")
    broken = clone.touch("broken")
    ran, asked, output = clone.run("pytest")
    assert (ran, asked) == (False, ["requirements-dev.lock"])
    assert "could not be installed" in output
    assert clone.run("stepgap") == (True, [], "")
    broken.unlink()
    assert clone.run("pytest")[:2] == (True, ["requirements-dev.lock"])


def test_where_adding_is_killed_users_continue_and_the_next_attempt_starts_afresh(clone: Clone) -> None:
    clone.run("stepgap")
    killed = clone.touch("killed")
    assert not clone.run("pytest")[0]
    killed.unlink()
    assert clone.run("stepgap") == (True, [], "")
    assert clone.run("pytest")[:2] == (True, ["made", "requirements-dev.lock"])


@pytest.mark.parametrize("reason", ["broken", "killed"])
@pytest.mark.parametrize("command", ["stepgap", "pytest"])
def test_an_unfinished_set_up_starts_afresh(clone: Clone, command: str, reason: str) -> None:
    mark = clone.touch(reason)
    assert not clone.run(command)[0]
    mark.unlink()
    ran, asked, _ = clone.run(command)
    assert (ran, asked) == (True, ["made", LOCKS[command == "pytest"]])


def test_an_unfinished_update_starts_afresh(clone: Clone) -> None:
    clone.run("stepgap")
    (clone.folder / "requirements.lock").write_text("second", "utf-8")
    killed = clone.touch("killed")
    assert not clone.run("stepgap")[0]
    killed.unlink()
    assert clone.run("stepgap")[:2] == (True, ["made", "requirements.lock"])


def test_a_clone_that_was_moved_starts_afresh(clone: Clone) -> None:
    clone.run("stepgap")
    clone.folder = clone.folder.rename(clone.folder.with_name("moved"))
    clone.environment["PATH"] = f"{clone.folder / 'programs'}:/usr/bin:/bin"
    assert clone.run("stepgap")[:2] == (True, ["made", "requirements.lock"])


@pytest.mark.parametrize(
    ("command", "lock"),
    [
        ("python file.py", "requirements.lock"),
        ("python -m stepgap", "requirements.lock"),
        ("python file.py pytest", "requirements.lock"),
        ("python -m pytest tests", "requirements-dev.lock"),
        ("python -X dev benchmarks/kill_and_resume.py", "requirements-dev.lock"),
        ("python3 tests/robots/hopper/model/reference_answers.py", "requirements-dev.lock"),
        ("sh -c pytest", "requirements.lock"),
    ],
)
def test_programs_get_the_packages_that_they_import(clone: Clone, command: str, lock: str) -> None:
    assert clone.run(*command.split())[1] == ["made", lock]


def test_every_command_in_the_instructions_of_developers_is_known() -> None:
    """A program that users' packages do not have; `./go` has a list, so that a misspelt name installs nothing."""
    listed = re.search(r"^developer_commands='(.*)'$", (ROOT / "go").read_text("utf-8"), re.MULTILINE)
    assert listed
    texts = "\n".join(file.read_text("utf-8") for file in [ROOT / "CONTRIBUTING.md", *(ROOT / ".ci").iterdir()])
    named = set(re.findall(r"\./go ([a-z-]+)", texts)) - {"python", "sh", "stepgap", "uv"}
    assert named <= set(listed[1].split())


def test_the_list_of_commands_is_that_of_developers_packages() -> None:
    listed = re.search(r"^developer_commands='(.*)'$", (ROOT / "go").read_text("utf-8"), re.MULTILINE)
    assert listed
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["dependency-groups"]
    scripts = {
        script.name
        for wanted in [*groups["dev"], *groups["docs"], "coverage", "mkdocs"]
        for script in distribution(Requirement(wanted).name).entry_points.select(group="console_scripts")
    }
    scripts |= {"ruff"}  # a compiled program
    assert set(listed[1].split()) <= scripts
