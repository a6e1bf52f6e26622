"""`stepgap new`: every form makes a folder that runs at once, and the documentation shows what is in it."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from tests.cli.command_line import Command, refused

ROOT = Path(__file__).parents[2]
STARTERS = files("stepgap.cli").joinpath("starters")


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The folder as `pip install -e` makes it known; returns the robot's name."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    ((group, points),) = project["entry-points"].items()
    ((name, value),) = points.items()
    info = folder / f"{name}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, name, raising=False)
    return name


def improved() -> bool:
    entries = json.loads(Path("out/summary.json").read_text())["iterations"]
    before, after = (np.array(list(entry["rmse"].values())) for entry in (entries[0], entries[1]))
    return bool((after < 0.5 * before).all())


@pytest.mark.parametrize("form", ["equations", "mujoco"])
def test_the_documentation_shows_the_starters(form: str) -> None:
    page = (ROOT / "docs" / {"equations": "own_robot.md", "mujoco": "mujoco_robot.md"}[form]).read_text("utf-8")
    assert STARTERS.joinpath(f"{form}.py.txt").read_text("utf-8") in re.findall(r"```python\n(.*?)```", page, re.DOTALL)


def test_the_program_is_the_example() -> None:
    example = (ROOT / "examples" / "process" / "robot.py").read_text("utf-8")
    assert STARTERS.joinpath("process.py.txt").read_text("utf-8") == example


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_robot_with_equations_runs_and_its_tests_pass(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    assert stepgap("new", "juggler") == (0, "juggler/README.md\n", "")
    assert installed(Path("juggler").resolve(), monkeypatch) == "juggler"
    result = stepgap("run", "juggler/experiment.toml", "--out", "out", "--quiet")
    assert result.code == 0, result.err
    assert improved()
    assert 'robot = "juggler"' in Path("out/experiment.toml").read_text()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "juggler"]
    subprocess.run(command, check=True, env={"PYTHONPATH": "juggler", "PATH": ""})


def test_a_robot_from_mujoco_has_a_step_and_one_from_a_model_has_its_parts(
    stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    from stepgap.robots.entry_points import load_robot

    assert stepgap("new", "springy", "--mujoco").code == 0
    robot = load_robot(installed(Path("springy").resolve(), monkeypatch))
    simulator = robot.nominal_maps()["simulator"]()
    assert np.isfinite(simulator([0.4, 0.62], [0.05, 0.0])).all()
    code = Path("springy/springy.py").read_text()
    model = code[code.index("<mujoco>") : code.index("</mujoco>") + 9]
    Path("mine.xml").write_text(model)
    assert stepgap("new", "own", "--mjcf", "mine.xml").code == 0
    assert Path("own/model.xml").read_text() == model
    assert "joints: x, z, hip, spring; actuators: hip, spring" in Path("own/own.py").read_text()
    own = load_robot(installed(Path("own").resolve(), monkeypatch))
    again = own.nominal_maps()["simulator"]()
    assert again([0.4, 0.62], [0.05, 0.0]).tolist() == simulator([0.4, 0.62], [0.05, 0.0]).tolist()


@pytest.mark.usefixtures("no_report")
def test_a_program_runs_without_installation(stepgap: Command) -> None:
    assert stepgap("new", "my robot", "--process").code == 0
    program = [sys.executable, "my robot/robot.py"]
    result = stepgap("run", "my robot/experiment.toml", "--out", "out", "--quiet", "--", *program)
    assert result.code == 0, result.err
    assert improved()


@pytest.mark.usefixtures("no_report")
def test_a_log_is_enough(stepgap: Command) -> None:
    assert stepgap("new", "first", "--process").code == 0
    run = ["run", "first/experiment.toml", "--iterations", "0", "--explore", "30", "--out", "recorded", "--quiet"]
    assert stepgap(*run, "--", sys.executable, "first/robot.py").code == 0
    assert stepgap("new", "second", "--from", "recorded").code == 0
    settings = tomllib.loads(Path("second/experiment.toml").read_text())
    assert settings["nominal"] == {"kind": "log", "file": "steps.csv"}
    first = tomllib.loads(Path("first/experiment.toml").read_text())
    assert settings["quantities"] == first["quantities"], "names, units and ranges are those of the run"
    result = stepgap(
        "run", "second/experiment.toml", "--out", "out", "--quiet", "--", sys.executable, "second/robot.py"
    )
    assert result.code == 0, result.err


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["there"], ["there: exists already; choose another name"]),
        (["json"], ["json: not the name of a new Python module"]),
        (["hopper"], ["hopper: not the name of a new Python module"]),
        (["my-robot"], ["my-robot: not the name of a new Python module", "letters, digits and underscores"]),
        (["x", "--mujoco", "--process"], ["--mujoco and --process: give only one of them"]),
        (["x", "--mjcf", "none.xml"], ["--mjcf: ", "none.xml: No such file"]),
        (["x", "--mjcf", "wrong.xml"], ["--mjcf wrong.xml: "]),
        (["x", "--from", "none"], ["--from: ", "none: No such file", "give a run or its steps.csv"]),
        (["x", "--from", "wrong.xml"], ["--from: "]),
        (["there/file/x"], ["there/file/x: cannot be written"]),
    ],
)
def test_wrong_arguments_write_nothing(stepgap: Command, arguments: list[str], parts: list[str]) -> None:
    Path("there").mkdir()
    Path("there/file").touch()
    Path("wrong.xml").write_text("<mujoco><nonsense/></mujoco>")
    refused(stepgap("new", *arguments), *parts)
    assert sorted(path.name for path in Path().iterdir()) == ["there", "wrong.xml"]
