"""The disk cache: it detects changes, works without a folder, and can be read by every program."""

import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from stepgap.base.compiled import KEPT_VERSIONS, generic
from stepgap.hybrid.motion import axpy

SOURCE = Path(__file__).parents[2] / "src"

CALLER = """
from stepgap.base.compiled import compiled, from_python
from robot.inner import value
from robot.numbers import FACTOR

@from_python
@compiled
def doubled(x):
    return FACTOR * value(x)
"""
CALLEE = """
from stepgap.base.compiled import compiled

@compiled
def value(x):
    return x + {}
"""
MOTION = """
from typing import NamedTuple
from stepgap.base.compiled import implements
from stepgap.hybrid.integrator import Tolerance, integrate, make_trace
from stepgap.hybrid.motion import rate_and_guards, rate, rate_jacobian

class Ball(NamedTuple):
    gravity: float

@implements(rate, Ball)
def _rate(system, state):
    return state[2], state[3], -system.gravity, 0.0

@implements(rate_and_guards, Ball)
def _rate_and_guards(system, time, state):
    return rate(system, state), (state[0],)

@implements(rate_jacobian, Ball)
def _jacobian(system, state, here):
    return None

def duration():
    start = (1.0, 0.0, 0.0, 0.0)
    return round(integrate(Ball(2.0), 0.0, start, 9.0, Tolerance(1e-6, 1e-6), 0.1, make_trace())[0], 9)
"""


WARM = """
import json, os, sys, tempfile, traceback
import numba
numba.njit(lambda x: x)(1.0)
for line in sys.stdin:
    code, folder, environment, output = json.loads(line)
    child = os.fork()
    if child == 0:
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        os.dup2(1, 2)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[:0] = environment["PYTHONPATH"].split(os.pathsep)
        sys.dont_write_bytecode, tempfile.tempdir = True, None
        try:
            exec(code, {})
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        sys.stdout.flush()
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""A program that runs code in a copy of itself, which has imported Numba but nothing of ours.

A new interpreter would import Numba and prepare the compiler again, which takes longer than what is tested.
Bytecode is not written because that of a file that changes twice within a second would remain the old one.
"""

Run = Callable[..., str]


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    """Output of code in a process of its own that finds packages in a folder; a variable that is None is unset."""
    command = [sys.executable, "-W", "error", "-c", WARM]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as warm:
        assert warm.stdin
        assert warm.stdout
        requests, answers = warm.stdin, warm.stdout

        def run_code(code: str, folder: Path, **environment: str | None) -> str:
            changed = {
                "PYTHONPATH": os.pathsep.join([str(SOURCE), str(folder)]),
                "NUMBA_CACHE_DIR": str(folder / "cache"),
                **environment,
            }
            everything = {name: value for name, value in {**os.environ, **changed}.items() if value is not None}
            output = folder / "output.txt"
            print(json.dumps([code, str(folder), everything, str(output)]), file=requests, flush=True)
            assert answers.readline() == "0\n", output.read_text()
            return output.read_text().strip()

        yield run_code


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package `robot` of a compiled function that calls another file's, and uses a third file's number."""
    package = tmp_path / "robot"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "outer.py").write_text(CALLER)
    (package / "inner.py").write_text(CALLEE.format(1.0))
    (package / "numbers.py").write_text("FACTOR = 2.0\n")
    (package / "motion.py").write_text(MOTION)
    return package


CALL = "from robot.outer import doubled; doubled(1.0); print(doubled(1.0), sum(doubled.stats.cache_hits.values()))"
REPORTED = """
from stepgap.base.compiling import on_compilation
from robot.outer import doubled
with on_compilation(lambda *_: print("compiling")):
    print(doubled(1.0), doubled(2))
print(sum(doubled.stats.cache_hits.values()))
"""


def test_another_checkout_of_the_same_content_does_not_compile_again(run: Run, package: Path) -> None:
    """Its files have other paths and other times."""
    cache, elsewhere = str(package.parent / "cache"), package.parent / "elsewhere"
    assert run(CALL, package.parent, NUMBA_CACHE_DIR=cache) == "4.0 0"
    shutil.copytree(package, elsewhere / "robot")
    for file in (elsewhere / "robot").iterdir():
        os.utime(file, (1e9, 1e9))
    shutil.rmtree(package)
    assert run(CALL, elsewhere, NUMBA_CACHE_DIR=cache) == "4.0 1"


def test_python_may_call_a_function_that_compiled_code_calls(run: Run, package: Path) -> None:
    """Compiled code calls a version without an entry for Python, which would end the process."""
    code = "from robot.outer import doubled; from robot.inner import value; print(doubled(1.0), value(1.0), value(2))"
    assert run(code, package.parent) == "4.0 2.0 3.0"
    assert run(code, package.parent) == "4.0 2.0 3.0"


def test_the_versions_that_were_not_used_for_longest_are_removed(run: Run, package: Path) -> None:
    cache = package.parent / "cache"
    for day in range(KEPT_VERSIONS + 3):
        old = cache / f"{day:016x}-{0:016x}"
        old.mkdir(parents=True)
        os.utime(old, (1e9, 1e9 + 86400 * day))
    (cache / "notes").mkdir()
    assert run(CALL, package.parent) == "4.0 0"
    kept = {entry.name for entry in cache.iterdir()}
    assert len(kept) == KEPT_VERSIONS + 1
    assert {"notes", f"{KEPT_VERSIONS + 2:016x}-{0:016x}"} < kept
    assert f"{3:016x}-{0:016x}" not in kept


def test_a_process_compiles_only_after_a_change_in_a_called_file_or_of_a_constant_and_reports_it(
    run: Run, package
) -> None:
    """The file of the constant has no compiled functions."""
    assert run(REPORTED, package.parent) == "compiling\n4.0 6.0\n0"
    assert run(REPORTED, package.parent) == "4.0 6.0\n2"
    (package / "inner.py").write_text(CALLEE.format(2.0))
    assert run(REPORTED, package.parent) == "compiling\n6.0 8.0\n0"
    (package / "numbers.py").write_text("FACTOR = 3.0\n")
    assert run(REPORTED, package.parent) == "compiling\n9.0 12.0\n0"


def test_system_types_of_one_program_do_not_break_another(run: Run, package, tmp_path) -> None:
    """The integrator's cache must not name a type that the next program cannot import.

    What is cached already, for the types of this project, need not be compiled once more.
    """
    function: Any = axpy
    cache, cached = str(tmp_path / "cache"), Path(function.stats.cache_path)
    if cached.is_dir():
        shutil.copytree(cached, Path(cache, cached.parent.name, cached.name))
    code = "from {}.motion import duration; print(duration())"
    assert run(code.format("robot"), package.parent) == "1.0"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    package.rename(elsewhere / "other_robot")
    assert run(code.format("other_robot"), elsewhere, NUMBA_CACHE_DIR=cache) == "1.0"


MADE = """
import numba
from numba.core.registry import cpu_target
numba.config.CPU_NAME = "generic"
from robot.outer import doubled
doubled(1.0)
print(*cpu_target.target_context.codegen().magic_tuple(), sep="\\n")
"""


@pytest.mark.parametrize(
    ("difference", "used"),
    [
        ({}, True),
        ({"machine": "another"}, False),
        ({"system": "another"}, False),
        ({"features": ["unheard-of"]}, False),
    ],
)
def test_code_that_a_wheel_brought_is_used_on_computers_that_it_fits(run: Run, package, difference, used) -> None:
    """As a release makes it: compiled for another processor than this one, with the name of a kind of processors."""
    target = run(MADE, package.parent).split("\n")
    (code,) = (package.parent / "cache").iterdir()
    objects = package / "objects" / code.name
    shutil.copytree(code, objects)
    made = {"machine": platform.machine(), "system": platform.system(), "features": [], "target": target}
    (objects / "target.json").write_text(json.dumps({**made, **difference}))
    cache = package.parent / "users"
    assert run(CALL, package.parent, NUMBA_CACHE_DIR=str(cache)) == ("4.0 1" if used else "4.0 0")
    assert bool(list(cache.rglob("*.nbc"))) != used


def test_code_beside_a_script_is_no_code_of_a_package(run: Run, package: Path) -> None:
    """A folder `objects` may be there for any reason, and pickled files of others are not read."""
    (package / "__init__.py").unlink()
    test_code_that_a_wheel_brought_is_used_on_computers_that_it_fits(run, package, {}, used=False)


@pytest.mark.parametrize("chosen", ["/dev/null/no", "robot/__init__.py"])
def test_a_chosen_folder_that_cannot_be_written_breaks_nothing(run: Run, package, chosen) -> None:
    assert run(CALL, package.parent, NUMBA_CACHE_DIR=chosen) == "4.0 0"


def test_without_a_writable_home_the_temporary_folder_is_used(run: Run, package) -> None:
    folders = {"NUMBA_CACHE_DIR": None, "XDG_CACHE_HOME": "/dev/null/no", "TMPDIR": str(package.parent)}
    assert run(CALL, package.parent, **folders) == "4.0 0"
    assert any((package.parent / "stepgap-cache").iterdir())


def test_without_a_home_it_works(run: Run, package) -> None:
    """A user without an entry in the password file, as in a container."""
    nobody = "import pathlib\ndef home(*_): raise RuntimeError('no home')\npathlib.Path.home = home\n"
    folders = {"NUMBA_CACHE_DIR": None, "XDG_CACHE_HOME": None, "TMPDIR": str(package.parent)}
    assert run(nobody + CALL, package.parent, **folders) == "4.0 0"


def test_a_function_without_a_file_is_compiled_without_cache(run: Run, tmp_path) -> None:
    code = "from stepgap.base.compiled import compiled\n@compiled\ndef twice(x):\n    return 2 * x\nprint(twice(2.0))"
    assert run(code, tmp_path) == "4.0"


def test_two_threads_that_ask_for_the_first_entry_at_the_same_time_do_not_make_python_ask_for_ever() -> None:
    function: Any = generic(lambda number: number + number)
    for _ in range(2):  # both have found no entry
        function._compile_for_args(1.5)
    function._compile_for_args = None
    assert function(1.5) == 3.0
