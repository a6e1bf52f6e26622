"""`stepgap new`: every form makes a folder that runs at once, and the documentation shows what is in it."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.records.steps_csv import read_step_log
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


@pytest.fixture(autouse=True)
def started_without_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an environment of a user, however the tests were started."""
    monkeypatch.delenv("STEPGAP_GO", raising=False)


@pytest.mark.parametrize("form", ["equations", "mujoco"])
def test_the_documentation_shows_the_starters(form: str) -> None:
    page = (ROOT / "docs" / {"equations": "own_robot.md", "mujoco": "mujoco_robot.md"}[form]).read_text("utf-8")
    assert STARTERS.joinpath(f"{form}.py.txt").read_text("utf-8") in re.findall(r"```python\n(.*?)```", page, re.DOTALL)


def test_the_program_is_the_example() -> None:
    example = (ROOT / "examples" / "process" / "robot.py").read_text("utf-8")
    assert STARTERS.joinpath("process.py.txt").read_text("utf-8") == example


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_robot_with_equations_runs_and_its_tests_pass(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    made = stepgap("new", "juggler")
    assert (made.code, made.out) == (0, "juggler/README.md\n")
    assert made.err == "next: pip install -e juggler\nnext: stepgap run juggler/experiment.toml\n"
    hint = "run it by: pip install -e juggler && stepgap run juggler/experiment.toml"
    refused(stepgap("run", "--robot", "juggler"), "robot 'juggler': not installed, but there is a folder", hint)
    refused(stepgap("run", "juggler/experiment.toml"), hint)
    assert installed(Path("juggler").resolve(), monkeypatch) == "juggler"
    result = stepgap("run", "juggler/experiment.toml", "--out", "out", "--quiet")
    assert result.code == 0, result.err
    assert improved()
    assert 'robot = "juggler"' in Path("out/experiment.toml").read_text()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "juggler"]
    subprocess.run(command, check=True, env={"PYTHONPATH": "juggler", "PATH": ""})


def test_a_robot_from_mujoco_has_a_step(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    from stepgap.robots.entry_points import load_robot

    assert stepgap("new", "springy", "--mujoco").code == 0
    robot = load_robot(installed(Path("springy").resolve(), monkeypatch))
    simulator = robot.nominal_maps()["simulator"]()
    assert np.isfinite(simulator([0.4, 0.62], [0.05, 0.0])).all()


HOPPING = """
<mujoco>
  <compiler meshdir="meshes"/>
  <include file="floor.xml"/>
  <asset><mesh file="hull.obj" scale="0.1 0.1 0.1"/></asset>
  <worldbody>
    <body name="trunk" pos="0 0 0.3">
      <freejoint/>
      <geom type="mesh" mesh="hull" mass="5" contype="0" conaffinity="0"/>
      <geom size="0.2" solref="-50000 0"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
</mujoco>
"""


def test_a_robot_from_a_model_has_its_parts_and_its_files(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    from stepgap.robots.entry_points import load_robot

    mine = Path("mine")
    (mine / "meshes").mkdir(parents=True)
    hull = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (mine / "meshes" / "hull.obj").write_text(hull)
    floor = '<geom name="floor" type="plane" size="9 9 1"/><body pos="9 0 3"><joint name="x"/><geom size="1"/></body>'
    (mine / "floor.xml").write_text(f"<mujoco><worldbody>{floor}</worldbody></mujoco>")
    (mine / "robot.xml").write_text(HOPPING.replace("solref", 'priority="1" solref'))
    made = stepgap("new", "my_bot", "--mjcf", "mine/robot.xml")
    assert (made.code, made.out) == (0, "my_bot/README.md\n")
    assert "stepgap: write the controller in my_bot/my_bot.py first" in made.err
    mine.rename("gone")
    Path("my_bot").rename("moved")
    file = Path("moved/my_bot.py")
    code = file.read_text()
    assert "class MyBot(MjcfRobot):" in code
    assert "JOINTS = ['x', '']" in code
    assert "'trunk': [2, 3]," in code
    assert "TOUCHING = [1, 3]" in code
    Path("moved").rename("my_bot")
    name = installed(Path("my_bot").resolve(), monkeypatch)
    result = stepgap("run", "my_bot/experiment.toml", "--out", "out")
    refused(result, "my_bot/my_bot.py, line", "NotImplementedError: write data.ctrl, in the order of ACTUATORS")
    monkeypatch.delitem(sys.modules, name)
    (Path("my_bot") / "my_bot.py").write_text(code.replace("raise NotImplementedError(", "len("))
    robot = load_robot(name)
    assert np.isfinite(robot.nominal_maps()["simulator"]()([0.1, 0.3], [0.0])).all()


@pytest.mark.filterwarnings("default::stepgap.base.errors.StepGapWarning")
def test_what_a_model_lacks_for_a_step_is_said(stepgap: Command) -> None:
    """A URDF is a robot without its world: MuJoCo fixes its first link in the air."""
    inertia = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"
    links = "".join(f"<link name='{name}'>{inertia}</link>" for name in ("trunk", "leg"))
    hip = "<joint name='hip' type='continuous'><parent link='trunk'/><child link='leg'/></joint>"
    Path("bare.urdf").write_text(f"<robot name='r'>{links}{hip}</robot>")
    made = stepgap("new", "bare", "--mjcf", "bare.urdf")
    assert made.code == 0
    assert "--mjcf bare.urdf has no actuators, such as <motor" in made.err
    assert "no joint that moves the robot, such as <freejoint/> in its first body; no ground" in made.err


def test_a_wrong_name_in_a_robot_is_one_line_with_its_location(
    stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert stepgap("new", "misspelt", "--mujoco").code == 0
    file = Path("misspelt/misspelt.py")
    file.write_text(file.read_text().replace('data.joint("spring")', 'data.joint("sprig")'))
    line = 1 + next(row for row, text in enumerate(file.read_text().splitlines()) if "sprig" in text)
    installed(Path("misspelt").resolve(), monkeypatch)
    result = stepgap("run", "misspelt/experiment.toml", "--out", "out")
    refused(
        result, f"misspelt/misspelt.py, line {line}: KeyError: Invalid name 'sprig'. Valid names: ['hip'", "--debug"
    )
    with pytest.raises(KeyError):
        stepgap("run", "misspelt/experiment.toml", "--out", "out", "--debug")


def test_in_a_clone_the_next_commands_are_typed_with_go(stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEPGAP_GO", "../my clone/go")
    go = "'../my clone/go'"
    install, run = f"{go} uv pip install -e tumbler", f"{go} stepgap run tumbler/experiment.toml"
    assert stepgap("new", "tumbler").err == f"next: {install}\nnext: {run}\n"
    refused(stepgap("run", "tumbler/experiment.toml"), f"run it by: {install} && {run}")
    run = f"{go} stepgap run other/experiment.toml -- python3 other/robot.py"
    assert stepgap("new", "other", "--process").err == f"next: {run}\n"


@pytest.mark.usefixtures("no_report")
def test_a_program_runs_without_installation(stepgap: Command) -> None:
    made = stepgap("new", "my robot", "--process")
    command = "stepgap run 'my robot/experiment.toml' -- python3 'my robot/robot.py'"
    assert (made.code, made.err) == (0, f"next: {command}\n")
    refused(stepgap("run", "--robot", "my robot"), f"run it by: {command}")
    program = [sys.executable, "my robot/robot.py"]
    result = stepgap("run", "my robot/experiment.toml", "--out", "out", "--quiet", "--", *program)
    assert result.code == 0, result.err
    assert improved()


@pytest.mark.usefixtures("no_report")
def test_a_log_is_enough(stepgap: Command) -> None:
    Path("targets.csv").write_text("speed,height\n" + 10 * "0.2,0.58\n")
    short = ["--reference", "targets.csv", "--learning.residual", "linear", "--quiet"]
    assert stepgap("new", "first", "--process").code == 0
    run = ["run", "first/experiment.toml", "--iterations", "0", "--explore", "30", "--out", "recorded", *short]
    assert stepgap(*run, "--", sys.executable, "first/robot.py").code == 0
    assert stepgap("new", "second", "--from", "recorded").code == 0
    practice = "it jumps to the recorded step that is nearest"
    assert [practice in Path(name, "README.md").read_text() for name in ("first", "second")] == [False, True]
    settings = tomllib.loads(Path("second/experiment.toml").read_text())
    assert settings["nominal"] == {"kind": "log", "file": "steps.csv"}
    first = tomllib.loads(Path("first/experiment.toml").read_text())
    assert settings["quantities"] == first["quantities"], "names, units and ranges are those of the run"
    run = ["run", "second/experiment.toml", "--iterations", "1", "--out", "out", *short]
    result = stepgap(*run, "--", sys.executable, "second/robot.py")
    assert result.code == 0, result.err


def test_a_log_of_another_program_is_enough(stepgap: Command) -> None:
    rng, speed, rows = np.random.default_rng(0), 0.2, ["v_mm;push;trial"]
    for number in range(30):
        push = rng.uniform(-1, 1)
        rows.append(f"{1000 * speed};{push if number != 7 else ''};{'a' if number < 20 else 'b'}")
        speed = 0.5 * speed + 0.1 + 0.1 * push
    Path("log.csv").write_text("\n".join(rows))
    Path("columns.toml").write_text(
        'state = ["speed=v_mm"]\ncommand = ["push"]\ndeployment = "trial"\n'
        'units = { v_mm = "m/s" }\nfactors = { v_mm = 1e-3 }\n'
    )
    assert stepgap("new", "mine", "--from", "log.csv", "--columns", "columns.toml").code == 0
    settings = read_experiment(Path("mine/experiment.toml"))
    (state,), (command,) = settings.robot.space.state, settings.robot.space.command
    steps = read_step_log(Path("mine/steps.csv"), settings.robot.space)
    # A new deployment begins after the row without a command, and with another trial; the last row of each has no next.
    assert [len(steps.of_iteration(number)) for number in steps.iterations] == [7, 11, 9]
    assert (state.unit, command.name) == ("m/s", "push")
    assert [state.lower, state.upper] == pytest.approx([steps.state.min(), steps.state.max()], abs=0.01)
    nominal = load_nominal(settings).map
    assert nominal([0.2], [0.3]) == pytest.approx(0.5 * 0.2 + 0.1 + 0.1 * 0.3, rel=1e-4), (
        "the log is that of a linear robot"
    )
    assert 'UNITS = {"state": {"speed": "m/s"}' in Path("mine/robot.py").read_text()


def test_columns_become_names_and_a_unit_that_is_none_is_refused(stepgap: Command) -> None:
    Path("log.csv").write_text('"h ""[m]""",u*/\n0,1\n1,1\n1,0\n0,2\n2,1\n1,3\n')
    columns = "state = ['h \"[m]\"']\ncommand = ['u*/']\n[units]\n'u*/' = "
    Path("columns.toml").write_text(f'{columns}"N·m"\n')
    assert stepgap("new", "x", "--from", "log.csv", "--columns", "columns.toml").code == 0
    space = read_experiment(Path("x/experiment.toml")).robot.space
    assert [(each.name, each.unit) for each in (*space.state, *space.command)] == [("h_m", ""), ("u", "N·m")]
    Path("columns.toml").write_text(f'{columns}"*/ int x; /*"\n')
    result = stepgap("new", "y", "--from", "log.csv", "--columns", "columns.toml")
    refused(result, "columns.toml: units.u*/ = '*/ int x; /*', but it must be a unit of at most 40 letters")


def test_the_name_of_a_part_is_no_code(stepgap: Command) -> None:
    hostile = ['"""; open("x", "w"); """', "\\", "'''", "\N{BULLET}\N{RIGHT-TO-LEFT OVERRIDE}", "class"]
    bodies = "".join(f"<body><joint name={quoteattr(name)}/><geom size='1'/></body>" for name in hostile)
    Path("mine.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>", "utf-8")
    assert stepgap("new", "parts", "--mjcf", "mine.xml").code == 0
    tree = ast.parse(Path("parts/parts.py").read_text("ascii"))
    assigned = {ast.unparse(each.targets[0]): each.value for each in tree.body if isinstance(each, ast.Assign)}
    assert ast.literal_eval(assigned["JOINTS"]) == hostile


def test_a_command_that_did_not_vary_in_the_log_is_named(stepgap: Command) -> None:
    rows = [f"{0.1 * (number % 7)},0.0,{0.05 * (number % 7) + 0.1}" for number in range(30)]
    Path("log.csv").write_text("\n".join(["v,u,v2", *rows]))
    made = stepgap("new", "mine", "--from", "log.csv", "--state", "v", "--command", "u", "--next", "v2")
    assert made.code == 0
    assert (
        "stepgap: --from log.csv: u did not vary in the log, so its effect is unknown: the map has none\n" in made.err
    )
    loaded = load_nominal(read_experiment(Path("mine/experiment.toml")))
    assert loaded.map.jacobian([0.3], [0.0]) == pytest.approx(np.array([[0.5, 0.0]]), rel=1e-3)
    assert [sentence.partition(": ")[2] for sentence in loaded.warnings] == [
        "u did not vary in the log, so its effect is unknown: the map has none"
    ]


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["there"], ["there: exists already; choose another name"]),
        (["json"], ["json: not the name of a new Python module: a module that is installed here has it; choose"]),
        (["numpy"], ["numpy: not the name of a new Python module: a module that is installed here has it"]),
        (["hopper"], ["hopper: not the name of a new Python module: a robot that is installed here has it"]),
        (
            ["my-robot"],
            ["my-robot: not the name", ": it must have only letters from a to z, digits and underscores; choose"],
        ),
        (["Übung"], ["Übung: not the name of a new Python module", "letters from a to z"]),
        (["robot_"], ["robot_: not the name", ": a letter must be first, and no underscore last; choose another"]),
        (["_robot"], ["_robot: not the name of a new Python module", ": a letter must be first"]),
        (["class"], ["class: not the name of a new Python module: it is a word of Python; choose another"]),
        (["x", "--mujoco", "--process"], ["--mujoco and --process: give only one of them"]),
        (["x", "--mjcf", "none.xml"], ["--mjcf none.xml: No such file", "give a MuJoCo model"]),
        (["x", "--mjcf", "wrong.xml"], ["--mjcf wrong.xml: "]),
        (["x", "--mjcf", "/dev/zero"], ["--mjcf /dev/zero: a pipe or a device"]),
        (["x", "--from", "none"], ["--from: ", "none: No such file", "give a run or its steps.csv"]),
        (["x", "--from", "wrong.xml"], ["--from: ", "name its columns"]),
        (["x", "--from", "log.csv"], ["log.csv, line 1: not the header of a step log", "name its columns"]),
        (["x", "--from", "log.csv", "--state", "v", "--target", "w"], ["--command: no column"]),
        (["x", "--from", "log.csv", "--state", "w", "--command", "u"], ["state 'w': no column 'w'; there is v, u [N]"]),
        (["x", "--from", "log.csv", "--state", "v", "--command", "u [N]"], ["fewer than 4 completed steps"]),
        (["x", "--from", "log.csv", "--state", "v", "--command", "u=u [N]"], ["fewer than 4 completed steps"]),
        (["x", "--state", "v"], ["--state: only with --from"]),
        (["there/file/x"], ["there/file/x: cannot be written"]),
    ],
)
def test_wrong_arguments_write_nothing(stepgap: Command, arguments: list[str], parts: list[str]) -> None:
    Path("there").mkdir()
    Path("there/file").touch()
    Path("wrong.xml").write_text("<mujoco><nonsense/></mujoco>")
    Path("log.csv").write_text("v,u [N]\n0,1\n1,1\n1,0\n")
    refused(stepgap("new", *arguments), *parts)
    assert sorted(path.name for path in Path().iterdir()) == ["log.csv", "there", "wrong.xml"]
