"""`stepgap run --plant process`: the examples in C and Python through the whole experiment, failures and resuming."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stepgap.records.steps_csv import read_step_log
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import StepStatus
from tests.cli.command_line import Command, refused

EXAMPLES = Path(__file__).parents[2] / "examples" / "process"
SPACE = CommandBounds().space()
FAILING = """
import runpy, sys
sys.argv = ["robot.py"]
lines, step, kind = sys.stdin, int({at}), {kind!r}
class Watched:
    def __iter__(self):
        for line in lines:
            if f'"step": {{step}},' in line:
                if kind == "exit": raise SystemExit(4)
                if kind == "text": print("motor 2 is hot", flush=True); continue
                if kind == "nan": print('{{"step": %d, "next": {{"speed": NaN, "height": 0.6}}, "status": "ok"}}' % step, flush=True); continue
            yield line
sys.stdin = Watched()
runpy.run_path({example!r}, run_name="__main__")
"""  # noqa: E501
IN_MILLIMETRES = """
def in_mm(state):
    return {"speed": state["speed"], "height": 1000 * state["height"]}
"""


@pytest.fixture
def run(stepgap: Command):
    """`stepgap run` of a short experiment with a program."""
    targets = "".join(f"{target}\n" for target in ["0,0.55"] * 5 + ["0.2,0.58"] * 15 + ["0.3,0.6"] * 10)
    Path("targets.csv").write_text(f"speed,height\n{targets}")
    settings = ["--reference", "targets.csv", "--learning.early_stop", "false", "--iterations", 2]
    return lambda *program: stepgap("run", "--plant", "process", *settings, "--out", "out", "--", *program)


def rmse() -> list[list[float]]:
    summary = json.loads(Path("out/summary.json").read_text())
    return [list(entry["rmse"].values()) for entry in summary["iterations"]]


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")
def test_the_example_in_c_learns(run) -> None:
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", "-o", "hopper", EXAMPLES / "hopper.c", "-lm"], check=True)
    result = run("./hopper")
    assert (result.code, result.out) == (0, "out/report.html\n"), result.err
    assert "replay (plant 'process': the motion between the steps is not recorded)" in result.err
    errors = np.array(rmse())
    assert errors.shape == (3, 2)
    assert (errors[2] < 0.35 * errors[0]).all()
    assert "plant &#x27;process&#x27;" in Path("out/report.html").read_text()


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("exit", "the program ended with code 4"),
        ("text", "'motor 2 is hot': the answer must be one JSON object per line"),
        ("nan", "NaN is not a JSON number"),
    ],
)
def test_a_failing_program_ends_the_run_which_keeps_its_steps(run, stepgap: Command, kind: str, message: str) -> None:
    """It says nothing of the robot, so it is no fall; the run is resumed with a program that is right."""
    Path("robot.py").write_text(FAILING.format(at=12, kind=kind, example=str(EXAMPLES / "robot.py")))
    result = run(sys.executable, "robot.py")
    assert result.code == 1, result.err
    assert "stepgap: step 12: " in result.err
    assert message in result.err
    end = f"no fall of the robot; resume with: stepgap run --out out --resume -- {sys.executable} robot.py"
    assert result.err.splitlines()[-1].endswith(end)
    log = read_step_log(Path("out/steps.csv"), SPACE)
    assert (len(log), {*log.status}) == (11, {StepStatus.OK})
    assert not Path("out/summary.json").exists()
    if kind == "exit":
        arguments = ["--out", "out", "--resume", "--quiet", "--", sys.executable, EXAMPLES / "robot.py"]
        assert stepgap("run", *arguments).code == 0
        deployments = json.loads(Path("out/summary.json").read_text())["iterations"]
        assert [(each["steps"], each["falls"]) for each in deployments] == [(11, 0), (30, 0), (30, 0)]


def test_a_program_that_never_starts_leaves_no_run(run) -> None:
    for _ in range(2):
        result = run("/bin/true")
        assert (result.code, result.out) == (1, ""), result.err
        assert result.err.splitlines()[-1] == "stepgap: the program ended with code 0"
        assert not list(Path("out").iterdir())


@pytest.mark.usefixtures("no_report")
def test_a_program_in_millimetres_is_warned_of_once_per_deployment(run) -> None:
    code = (EXAMPLES / "robot.py").read_text().replace('"state": state}', '"state": in_mm(state)}')
    code = code.replace('"next": state', '"next": in_mm(state)').replace(
        "def main()", f"{IN_MILLIMETRES}\n\ndef main()"
    )
    Path("robot.py").write_text(code)
    result = run(sys.executable, "robot.py")
    assert result.code == 0, result.err
    warnings = [line for line in result.err.splitlines() if "check the unit" in line]
    assert [line.partition(", height was about 5")[0] for line in warnings] == [
        f"stepgap: In the first 5 steps of deployment {number}" for number in range(3)
    ]
    assert "but its range of use is 0.52 to 0.64 m:" in warnings[0]


@pytest.mark.usefixtures("no_report")
def test_an_interrupted_run_is_resumed_with_the_program(run, stepgap: Command) -> None:
    assert run(sys.executable, EXAMPLES / "robot.py").code == 0
    whole = Path("out/steps.csv").read_text().splitlines(keepends=True)
    Path("out/summary.json").unlink()
    Path("out/steps.csv").write_text("".join(whole[:40]))
    refused(stepgap("run", "--out", "out", "--resume"), "--plant process: give the robot's program after two dashes")
    result = stepgap("run", "--out", "out", "--resume", "--quiet", "--", sys.executable, EXAMPLES / "robot.py")
    assert result.code == 0, result.err
    text = Path("out/steps.csv").read_text()
    assert text.startswith("".join(whole[:40])), "no recorded step is lost"
    assert read_step_log(Path("out/steps.csv"), SPACE).iterations[-1] == 2


def test_wrong_use_is_one_line(stepgap: Command) -> None:
    refused(stepgap("run", "--plant", "process"), "--plant process: give the robot's program after two dashes")
    refused(stepgap("run", "--", "./robot"), "-- ./robot: plant 'twin' runs no program; add --plant process")
    refused(
        stepgap("run", "--plant", "process", "--rig", "rig.toml", "--", "./robot"), "--arm, --rig: only for real rigs"
    )
    refused(stepgap("run", "--process.step", "0"), "--process.step = 0.0, but it must be a positive number of seconds")
    for program, message in (
        ("./robot", "-- ./robot: cannot be started: no such program; give its path, or a name in PATH"),
        ("tcp:99999", "-- tcp:99999: there is no such port; it must be 1 to 65535"),
    ):
        refused(stepgap("run", "--plant", "process", "--out", "x", "--", program), message)
        assert not Path("x").exists(), "the corrected command is not refused"
    closed = stepgap("run", "--plant", "process", "--out", "y", "--quiet", "--", "tcp:1")
    assert "127.0.0.1:1: " in closed.err
    Path("e.toml").write_text('plant = "process"\nprogram = "./robot"\n')
    refused(stepgap("run", "e.toml"), "e.toml: program: unknown key")


@pytest.mark.usefixtures("no_report")
def test_a_program_that_walks_needs_nothing_but_settings(stepgap: Command) -> None:
    walks = [f"{vx},{vy},{wz}" for vx, vy, wz in [(0.4, 0, 0), (0.4, 0, 0.3), (0.2, 0.1, 0), (0.6, -0.1, -0.2)]] * 3
    Path("targets.csv").write_text("\n".join(["vx,vy,wz", *(walk for walk in walks for _ in range(3))]) + "\n")
    options = ["--robot", "velocity", "--reference", "targets.csv", "--iterations", 1, "--out", "out"]
    result = stepgap("run", "--plant", "process", *options, "--", sys.executable, EXAMPLES / "walker.py")
    assert result.code == 0, result.err
    errors = np.array(rmse())
    assert errors[1, 0] < 0.6 * errors[0, 0]
