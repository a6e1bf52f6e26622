"""`examples/c_controller/main.c`, compiled here, plans as Python does, deployment after deployment."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.export.controller.c_source import c_source
from stepgap.step import StepRecord, StepStatus
from tests.export.controller.learned import SPACE, learned

MAIN = Path(__file__).parents[1] / "examples" / "c_controller" / "main.c"
COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


def test_it_plans_section_after_section(tmp_path: Path) -> None:
    controller = learned("gp_on_linear")
    source = c_source(controller, "controller")
    (tmp_path / "controller.c").write_text(source.code)
    (tmp_path / "controller.h").write_text(source.header)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-I."]
    subprocess.run([str(COMPILER), *flags, str(MAIN), "controller.c", "-o", "robot", "-lm"], cwd=tmp_path, check=True)
    states = SPACE.state_centre + SPACE.state_scale * np.random.default_rng(3).uniform(-1, 1, (8, 2))
    target = SPACE.state_centre
    with subprocess.Popen([tmp_path / "robot"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as robot:
        assert robot.stdin
        assert robot.stdout
        beliefs = controller.beliefs
        for deployment in range(2):
            guess = before = SPACE.command_centre
            phase = np.nan
            for number in range(4):
                state, yaw = states[4 * deployment + number], 0.4 * number
                if number:
                    record = StepRecord(before, guess, guess, state, StepStatus.OK)
                    beliefs = controller.after(beliefs, record, phase)
                elif deployment:
                    assert beliefs
                    beliefs = beliefs.redeployed()
                phase, present = yaw, controller.map_by(beliefs, yaw)
                plan = replace(controller.controller, step_map=present)(state, target, guess)
                print(*state.tolist(), *target.tolist(), yaw, file=robot.stdin, flush=True)
                status, *command = map(float, robot.stdout.readline().split())
                assert status == StepStatus.OK
                np.testing.assert_allclose(command, plan.command, atol=1e-6)
                guess, before = np.array(command), state
            print(file=robot.stdin, flush=True)
        robot.stdin.close()
        assert robot.wait(10) == 0


@pytest.mark.skipif(shutil.which("mkoctfile") is None, reason="Octave cannot compile here")
def test_it_is_a_function_of_octave(tmp_path: Path) -> None:
    controller = learned("gp_on_linear")
    source = c_source(controller, "controller")
    (tmp_path / "controller.c").write_text(source.code)
    (tmp_path / "controller.h").write_text(source.header)
    function = MAIN.parent / "octave" / "step_controller.c"
    subprocess.run(["mkoctfile", "--mex", "-I.", str(function), "controller.c"], cwd=tmp_path, check=True)
    state, target = SPACE.state_centre, SPACE.state_centre + 0.5 * SPACE.state_scale
    calls = f"step_controller(); [c, s] = step_controller({state.tolist()}, {target.tolist()}, NaN);"
    refusal = "try, step_controller([1 2 3], [1 2], 0), catch wrong, disp(wrong.message), end"
    script = f"{calls} printf('%d %.17g %.17g\\n', s, c); {refusal}"
    printed = subprocess.run(["octave-cli", "--eval", script], cwd=tmp_path, capture_output=True, text=True).stdout
    answer, message = printed.splitlines()[:2]
    status, *command = map(float, answer.split())
    assert status == StepStatus.OK
    np.testing.assert_allclose(command, controller.controller(state, target).command, atol=1e-6)
    assert message == "step_controller: state must have 2 real numbers"
