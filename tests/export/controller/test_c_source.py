"""The exported C code, compiled here, computes what Python computes: map, derivatives and plans."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.export.controller.c_source import KINDS as BELIEF_KINDS
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.portable_controller import PortableController
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.step import Array, StepFailed, StepStatus
from tests.base.test_names import HOSTILE
from tests.export.controller.learned import KINDS, SPACE, learned, steps

COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic")
SCALE = np.concatenate([SPACE.state_scale, SPACE.command_scale])
TOLERANCE = 1e-9
OPTIMISED_MAPS = ("gp",)
"""Maps whose code is optimised, for which the compiler takes five times as long; that of plans is optimised, too."""


READING = """
int controller_size(void);
int controller_alarm(const controller_filter *filter);
int controller_size(void) { return (int)sizeof(controller_filter); }
int controller_alarm(const controller_filter *filter) { return filter->alarm; }
"""
"""What is read of a filter here."""


class Compiled:
    """The functions of a controller in C; equal controllers are compiled once in a folder."""

    def __init__(self, controller: PortableController, parent: Path, optimisation: str):
        source = c_source(controller, "controller")
        folder = parent / (sha256(source.code.encode()).hexdigest() + optimisation)
        library = folder / "controller.so"
        if not library.exists():
            folder.mkdir()
            (folder / "controller.c").write_text(source.code + READING)
            (folder / "controller.h").write_text(source.header)
            output = ["-fPIC", "-shared", folder / "controller.c", "-o", library, "-lm"]
            command = [str(each) for each in (COMPILER, *STRICT, optimisation, *output)]
            subprocess.run(command, check=True, capture_output=True)
        self.n, self.m = len(controller.space.state), len(controller.space.command)
        self._library = ctypes.CDLL(str(library))
        self.filter = ctypes.create_string_buffer(self._library.controller_size())
        self._library.controller_filter_init(self.filter)

    @property
    def alarm(self) -> str | None:
        """What the latest step showed."""
        number = self.call("alarm", self.filter)
        return BELIEF_KINDS[number] if number else None

    def call(self, name: str, *arguments: Any) -> Any:
        """Calls a function with arrays, numbers and None; arrays are written in place."""
        passed = [
            each.ctypes.data_as(ctypes.c_void_p)
            if isinstance(each, np.ndarray)
            else ctypes.c_double(each)
            if isinstance(each, float)
            else each
            for each in arguments
        ]
        return getattr(self._library, f"controller_{name}")(*passed)

    def array(self, *shape_or_values: Any) -> Any:
        """An array from values or of a size."""
        (given,) = shape_or_values
        return np.full(given, np.nan) if isinstance(given, int) else np.ascontiguousarray(given, float)

    def map(self, state: Array, command: Array) -> tuple[int, Array, Array]:
        """Status, next state and standard deviation."""
        mean, std = self.array(self.n), self.array(self.n)
        given = self.filter, self.array(state), self.array(command), float("nan")
        return self.call("map", *given, mean, std), mean, std

    def plan(self, state: Array, target: Array, guess: Array | None, yaw: float) -> tuple[int, Array, Array, Array]:
        """Status, command, prediction and standard deviation; a target of several rows is planned ahead."""
        found = self.array(self.m), self.array(self.n), self.array(self.n)
        start, ahead = None if guess is None else self.array(guess), target.ndim == 2
        given = self.filter, self.array(state), self.array(target), *([len(target)] if ahead else [])
        return self.call("plan_ahead" if ahead else "plan", *given, start, yaw, *found), *found


@pytest.fixture(scope="module")
def compile_in(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Compiled]:
    folder = tmp_path_factory.mktemp("compiled")

    def compiled(controller: PortableController, *, optimised: bool = False) -> Compiled:
        return Compiled(controller, folder, "-O2" if optimised else "-O0")

    return compiled


@pytest.mark.parametrize("kind", [*KINDS, "an affine nominal map"])
def test_the_map_is_that_of_python(kind: str, compile_in: Callable[..., Compiled]) -> None:
    affine = kind not in KINDS
    controller = learned("quadratic" if affine else kind, failing=not affine, linear=affine)
    code = compile_in(controller, optimised=kind in OPTIMISED_MAPS)
    states, commands = steps(300)
    expected, status = controller.map.evaluate(states, commands)
    std = controller.map.std(states, commands)
    jacobians, std_gradients = controller.map.jacobian(states, commands), controller.map.std_gradient(states, commands)
    known = 0
    for row in range(300):
        found, mean, spread = code.map(states[row], commands[row])
        assert found == status[row]
        if found:
            continue
        known += 1
        assert np.abs((mean - expected[row]) / SPACE.state_scale).max() < TOLERANCE
        assert np.abs((spread - std[row]) / SPACE.state_scale).max() < TOLERANCE
        jacobian, std_gradient = code.array(8), code.array(8)
        given = code.filter, code.array(states[row]), code.array(commands[row]), float("nan")
        assert not code.call("jacobian", *given, jacobian, std_gradient)
        for rows, wanted in ((jacobian, jacobians[row]), (std_gradient, std_gradients[row])):
            error = (rows.reshape(2, 4) - wanted) * SCALE / SPACE.state_scale[:, None]
            assert np.abs(error).max() < 10 * TOLERANCE
    assert known > 100


@pytest.mark.parametrize("kind", ["none", "gp_on_linear"])
def test_plans_are_those_of_python(kind: str, compile_in: Callable[..., Compiled]) -> None:
    """Also where the search takes another way because of rounding, the expected squared distance is the same."""
    controller = learned(kind)
    code, rng, same = compile_in(controller, optimised=kind != "none"), np.random.default_rng(5), 0
    for _ in range(40):
        state, target = SPACE.state_centre + SPACE.state_scale * rng.uniform(-1, 1, (2, 2))
        guess = SPACE.command_centre + SPACE.command_scale * rng.uniform(-1, 1, 2)
        status, command, predicted, std = code.plan(state, target, guess, float("nan"))
        plan = controller.controller(state, target, guess)
        assert status == 0
        assert (SPACE.command_lower <= command).all()
        assert (command <= SPACE.command_upper).all()
        same += bool(np.abs((command - plan.command) / SPACE.command_scale).max() < 1e-7)
        costs = [
            np.sum(((mean - target) ** 2 + spread**2) / SPACE.state_scale**2)
            for mean, spread in ((predicted, std), (plan.predicted, plan.std))
        ]
        assert costs[0] == pytest.approx(costs[1], rel=1e-4, abs=1e-9)
    assert same >= 38


@pytest.mark.parametrize("evaluations", [60, 400])
def test_a_search_whose_start_makes_no_step_begins_again_in_the_middle(
    evaluations: int, compile_in: Callable[..., Compiled]
) -> None:
    """With few evaluations nothing else finds the way back; then only the status is the same as in Python."""
    controller = learned("none", failing=True)
    controller = replace(controller, settings=replace(controller.settings, evaluations=evaluations))
    code, rng, compared = compile_in(controller), np.random.default_rng(7), 0
    for _ in range(120):
        state, target = SPACE.state_centre + SPACE.state_scale * rng.uniform(-1, 1, (2, 2))
        guess = SPACE.command_centre + SPACE.command_scale * rng.uniform(-1, 1, 2)
        middle = controller.map.evaluate(state, SPACE.command_centre).status
        if controller.map.evaluate(state, guess).status == StepStatus.OK or middle != StepStatus.OK:
            continue
        plan = controller.controller(state, target, guess)
        status, command, _, _ = code.plan(state, target, guess, float("nan"))
        assert status == StepStatus.OK
        if evaluations == 400:
            np.testing.assert_allclose(command, plan.command, atol=1e-6 * SPACE.command_scale.max())
        compared += 1
    assert compared >= 10


def test_without_a_filter_the_command_is_that_of_the_nominal_map(compile_in: Callable[..., Compiled]) -> None:
    controller, middle = learned("posterior"), SPACE.state_centre
    code, plain = compile_in(controller), replace(controller, beliefs=None).controller(middle, middle).command
    command, state = code.array(2), code.array(middle)
    assert code.call("plan", None, state, state, None, 0.0, command, None, None) == UNCORRECTED
    np.testing.assert_allclose(command, plain, atol=1e-6 * SPACE.command_scale.max())
    assert code.call("map", None, state, command, 0.0, code.array(2), None) == StepStatus.INVALID
    assert code.call("jacobian", None, state, command, 0.0, code.array(8), None) == StepStatus.INVALID


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_a_number_never_becomes_a_command(bad: float, compile_in: Callable[..., Compiled]) -> None:
    controller = learned("gp_on_linear")
    code = compile_in(controller, optimised=True)
    good = SPACE.state_centre, SPACE.state_centre, SPACE.command_centre
    for index in range(6):
        state, target, guess = given = [each.copy() for each in good]
        given[index // 2][index % 2] = bad
        status, command, _, _ = code.plan(state, target, guess, 0.0)
        assert (SPACE.command_lower <= command).all()
        assert (command <= SPACE.command_upper).all()
        if np.isnan(target).any():
            assert status == StepStatus.OK, "NaN is no target"
        elif not np.isfinite(bad):
            assert status == (UNCORRECTED if index < 2 else StepStatus.INVALID)
            with pytest.raises((ValueError, StepFailed)):
                controller.controller(state, target, guess)


def test_it_is_clean_for_the_sanitizers(tmp_path: Path) -> None:
    controller = learned("gp_on_linear", failing=True)
    rules = replace(controller.settings, horizon=3, largest_change=0.5, surprise=0.3, make_up=3)
    source = c_source(replace(controller, settings=rules, farthest=np.array([8.0, 9.0])), "controller")
    (tmp_path / "controller.c").write_text(source.code)
    (tmp_path / "controller.h").write_text(source.header)
    (tmp_path / "main.c").write_text(MAIN)
    flags = ["-std=c99", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all"]
    files = [str(tmp_path / name) for name in ("controller.c", "main.c")]
    built = subprocess.run(
        [str(COMPILER), *flags, *files, "-o", str(tmp_path / "main"), "-lm"], capture_output=True, text=True
    )
    if "sanitize" in built.stderr or "libasan" in built.stderr or "libubsan" in built.stderr:
        pytest.skip("the compiler has no sanitizers")
    assert built.returncode == 0, built.stderr
    result = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
    assert int(result.stdout) > 75


MAIN = """
#include "controller.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static double number(double lower, double upper)
{
    switch (rand() % 40) {
    case 0: return NAN;
    case 1: return INFINITY;
    case 2: return 1e308;
    case 3: return -1e-308;
    default: return lower + (upper - lower) * rand() / RAND_MAX;
    }
}

int main(void)
{
    static controller_filter filter;
    int planned = 0;
    double before[2] = {0, 0};
    controller_filter_init(&filter);
    for (int i = 0; i < 150; i++) {
        double state[2] = {number(-0.2, 0.6), number(0.45, 0.7)}, target[2] = {number(0, 0.4), number(0.52, 0.64)};
        double next[2] = {number(0, 0.4), number(0.52, 0.64)}, yaw = number(-10, 10), command[2], predicted[2], std[2];
        double jacobian[8], std_gradient[8], ahead[8], *previous = i % 3 ? before : NULL;
        for (int k = 0; k < 8; k++) ahead[k] = k < 2 ? target[k] : k % 2 ? number(0.52, 0.64) : number(0, 0.4);
        planned += controller_plan_ahead(&filter, state, ahead, i % 5, previous, yaw, before, predicted, std) == 0;
        planned += controller_plan(&filter, state, target, NULL, yaw, command, predicted, std) == 0;
        if (!(command[0] >= -30 && command[0] <= 30 && command[1] >= -20 && command[1] <= 20)) return 1;
        double pose[3] = {number(-9, 9), number(-9, 9), number(-9, 9)};
        controller_filter_update_at(&filter, state, command, next, yaw, i % 2 ? pose : NULL);
        if (rand() % 20 == 0) controller_filter_restart(&filter);
        controller_jacobian(&filter, state, command, yaw, jacobian, std_gradient);
    }
    printf("%d", planned);
    return 0;
}
"""


@pytest.mark.parametrize("prefix", ["", "2nd", "a b", "while", "ünder", "x" * 40])
def test_a_prefix_must_be_an_identifier(prefix: str) -> None:
    with pytest.raises(InputError, match="C identifier"):
        c_source(learned("none"), prefix)


@pytest.mark.parametrize("text", HOSTILE)
def test_a_note_ends_neither_its_comment_nor_its_line(text: str) -> None:
    controller = replace(learned("none", linear=True), notes=(f"{text}\nint injected;\n@real@",))
    header = c_source(controller, "controller").header
    (line,) = [line for line in header.splitlines() if "injected" in line]
    assert line.isascii()
    assert line.isprintable()
    assert header.count("*/") == header.count("/*") == c_source(learned("none", linear=True), "c").header.count("*/")
    assert not any(part in line for part in ("??", "\\", "@", "double"))


@pytest.mark.parametrize("compiler", [name for name in ("gcc", "clang") if shutil.which(name)])
def test_a_double_of_32_bits_is_refused(compiler: str, tmp_path: Path) -> None:
    source = c_source(learned("none", linear=True), "controller")
    (tmp_path / "controller.c").write_text(source.code)
    (tmp_path / "controller.h").write_text(source.header)
    for flag in ("-Ddouble=float", "-fsingle-precision-constant")[: 1 if compiler == "clang" else 2]:
        command = [compiler, "-std=c99", flag, "-c", "controller.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode
        assert "double_has_64_bits" in done.stderr


FAST = ("-ffast-math", "-Ofast", "-ffinite-math-only", "-fno-honor-nans", "-fno-honor-infinities", "-fassociative-math")
"""Options with which NaN, infinity or the order of roundings do not count; some compilers do not know all of them."""

ANSWERS = """
#include <stdio.h>
#include <stdlib.h>
#include "controller.h"
/* Reads state, target and phase; prints the status of a plan and of an update, then the command. */
int main(void)
{
    static controller_filter filter;
    double x[5], command[2];
    char word[40];
    controller_filter_init(&filter);
    for (int k = 0; scanf("%39s", word) == 1; k = (k + 1) % 5) {
        x[k] = strtod(word, NULL);
        if (k < 4) continue;
        int status = controller_plan(&filter, x, x + 2, NULL, x[4], command, NULL, NULL);
        int updated = controller_filter_update(&filter, x, command, x + 2, x[4]);
        printf("%d %d %.6g %.6g\\n", status, updated, command[0], command[1]);
    }
    return 0;
}
"""
SECTIONS = (
    "0.1 0.56 0.2 0.58 nan  nan 0.58 0.3 0.6 0.1  0.2 inf 0.3 0.6 0.1  0.2 0.58 nan 0.6 0.1  0.2 0.58 0.3 0.6 inf"
)


@pytest.mark.parametrize("compiler", [name for name in ("gcc", "clang", "g++", "clang++") if shutil.which(name)])
def test_fast_arithmetic_is_refused_or_changes_nothing(compiler: str, tmp_path: Path) -> None:
    source = c_source(learned("quadratic"), "controller")
    for name, text in (("controller.c", source.code), ("controller.h", source.header), ("main.c", ANSWERS)):
        (tmp_path / name).write_text(text)
    language = ["-x", "c++"] if compiler.endswith("++") else ["-std=c99"]
    where: dict[str, Any] = {"cwd": tmp_path, "capture_output": True, "text": True}

    def compiled(name: str, *flags: str) -> str:
        return subprocess.run([compiler, *language, "-O2", *flags, "-c", name], check=False, **where).stderr

    def answers() -> list[str]:
        subprocess.run([compiler, "main.o", "controller.o", "-o", "answers", "-lm"], check=True, **where)
        return subprocess.run(["./answers"], input=SECTIONS, check=True, **where).stdout.splitlines()

    compiled("main.c")
    assert "error" not in compiled("controller.c", "-O0")
    wanted = answers()
    assert [line.split()[:2] for line in wanted] == [["0", "0"], *2 * [["9", "6"]], ["0", "6"], ["0", "0"]]
    for flag in FAST:
        message = compiled("controller.c", flag)
        if "compile this file without -ffast-math" not in message and "unrecognized" not in message:
            assert (flag, answers()) == (flag, wanted)
        else:
            assert flag not in FAST[:3] or "unrecognized" not in message
