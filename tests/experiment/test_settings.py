"""Settings: read with strict checks, refused with the rule, and written so that they are read back unchanged."""

import json
import math
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.experiment import settings
from stepgap.experiment.inputs import load_reference, write_experiment
from stepgap.experiment.settings import METHODS, Experiment, NominalSettings, read_experiment
from stepgap.experiment.settings_text import described_settings
from stepgap.learning.settings import GONE_SETTINGS, LearningSettings
from stepgap.robots.entry_points import load_robot
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.parameters import CommandBounds, Gains
from stepgap.robots.hopper.robot import Hopper, as_hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.robot import Robot
from stepgap.sweep.sweep import with_changes

SPACE = CommandBounds().space()


def hopper_of(experiment: Experiment) -> Hopper:
    return as_hopper(experiment.robot, "")


def test_without_a_file_it_is_the_papers_experiment() -> None:
    assert read_experiment(None) == Experiment()
    assert (load_reference(Experiment(), SPACE).targets == paper_reference().targets).all()


def test_only_the_robot_that_a_file_names_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def load(name: str) -> Robot:
        made.append(name)
        return load_robot(name)

    monkeypatch.setattr(settings, "load_robot", load)
    path = tmp_path / "experiment.toml"
    path.write_text('robot = "quadruped"\nseed = 3\n', encoding="utf-8")
    assert read_experiment(path) == Experiment(load_robot("quadruped"), seed=3)
    assert set(made) == {"quadruped"}


@pytest.mark.parametrize(
    "experiment",
    [
        Experiment(),
        Experiment(Hopper(gains=Gains(stiffness=2400.1 / 3), gap=RealityGap.none()), seed=2**63 - 1),
        Experiment(Hopper(command=CommandBounds(-1, 1, -2, 2)), learning=LearningSettings("none", 0, 0.5)),
        Experiment(weights={"height": 0.25}),
    ],
)
def test_what_is_written_is_read_back(tmp_path: Path, experiment: Experiment) -> None:
    write_experiment(tmp_path, experiment, paper_reference())
    path = tmp_path / "experiment.toml"
    assert read_experiment(path) == experiment
    text = path.read_bytes()
    write_experiment(tmp_path, read_experiment(path), paper_reference())
    assert path.read_bytes() == text


def test_every_setting_is_written(tmp_path: Path) -> None:
    write_experiment(tmp_path, Experiment(), paper_reference())
    text = (tmp_path / "experiment.toml").read_text()

    def names(settings: Any) -> list[str]:
        values = [(field.name, getattr(settings, field.name)) for field in fields(settings)]
        return [name for key, value in values for name in (names(value) if is_dataclass(value) else [key])]

    for name in names(Experiment()):
        assert f"\n{name} = " in f"\n{text}" or f"\n[{name}]\n" in text


def test_a_reference_is_copied_into_the_folder(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "hops.csv").write_text("height,speed\n0.55,0.1\n0.58,0.30000000000000004\n")
    (tmp_path / "mine" / "e.toml").write_text('reference = "hops.csv"\n')
    experiment = read_experiment(tmp_path / "mine" / "e.toml")
    reference = load_reference(experiment, SPACE)
    (tmp_path / "run").mkdir()
    write_experiment(tmp_path / "run", experiment, reference)
    again = load_reference(read_experiment(tmp_path / "run" / "experiment.toml"), SPACE)
    assert again.targets.tobytes() == reference.targets.tobytes()
    (tmp_path / "run").rename(tmp_path / "moved")
    assert len(load_reference(read_experiment(tmp_path / "moved" / "experiment.toml"), SPACE)) == 2


def test_options_override_the_file(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text("seed = 1\n[gains]\nstiffness = 2000\nspeed_gain = 0.3\n")
    overrides = [("gains.stiffness", "2400"), ("gap.boom-arc", "false"), ("learning.residual", "none"), ("seed", "7")]
    experiment = read_experiment(tmp_path / "e.toml", overrides)
    assert hopper_of(experiment).gains == Gains(stiffness=2400.0, speed_gain=0.3)
    assert (hopper_of(experiment).gap.boom_arc, experiment.learning.residual, experiment.seed) == (False, "none", 7)
    assert type(hopper_of(experiment).gains.stiffness) is float


def test_a_method_comes_before_single_keys(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text("method = 'paper'\n[learning]\ndrift = true\niterations = 2\n")
    found = read_experiment(tmp_path / "e.toml")
    learning, control, _ = METHODS["paper"]
    assert found.learning == replace(learning, drift=True, iterations=2)
    assert found.control == control
    assert read_experiment(tmp_path / "e.toml", [("method", "default")]).learning == LearningSettings()
    both = read_experiment(None, [("control.table", "9"), ("method", "paper")])
    assert both.control == replace(control, table=9)
    linear = read_experiment(tmp_path / "e.toml", [("method", "rls"), ("nominal.kind", "equations")]).nominal
    assert linear == NominalSettings("equations", linear=True)
    assert not read_experiment(None, [("nominal.linear", "false"), ("method", "rls")]).nominal.linear


def test_the_method_of_the_paper_has_none_of_our_rules() -> None:
    learning, control, _ = METHODS["paper"]
    ours = ("drift", "early_stop", "online")
    assert not any(getattr(learning, name) for name in ours)
    assert not any(getattr(control, name) for name in ("cautious", "viability", "avoid_failures"))
    assert (learning.residual, learning.iterations, learning.exploration) == ("fitrgp", 4, 0)


def test_a_table_needs_a_map_that_does_not_change() -> None:
    for change in (("learning.drift", "true"), ("learning.online", "true")):
        with pytest.raises(InputError, match="a table does not change during a deployment"):
            read_experiment(None, [("method", "paper"), ("control.table", "9"), change])


def test_a_random_robot_is_the_twin_of_that_number_in_a_sweep() -> None:
    """The number draws the same robot there, as the setting `twin`; single keys come after it."""
    drawn = with_changes(Experiment(), {"twin": 7})[0].robot
    for name in ("gap", "gap.preset"):
        assert read_experiment(None, [(name, "random:7")]).robot == drawn
    changed = read_experiment(None, [("gap.delay", "0.002"), ("gap", "random:7")])
    assert hopper_of(changed).gap == replace(hopper_of(Experiment(drawn)).gap, delay=0.002)


@pytest.mark.parametrize(
    ("robot", "name", "message"),
    [
        ("hopper", "random", "--gap = 'random', but it must be 'paper' or .* or 'random:NUMBER'"),
        ("hopper", "random:x", "--gap = 'random:x', but it must be"),
        ("quadruped", "paper", "--gap = 'paper', but it must be 'random:NUMBER'"),
        ("custom", "random:7", "gap"),
    ],
)
def test_a_random_robot_that_there_is_not_is_refused(robot: str, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_experiment(None, [("robot", robot), ("gap", name)])


@pytest.mark.parametrize(("key", "text"), [("name", "x" * 61), ("note", "two\nlines")])
def test_the_name_and_the_note_of_a_run_are_lines(key: str, text: str) -> None:
    with pytest.raises(InputError, match=f"--{key} = .* printable characters"):
        read_experiment(None, [(key, json.dumps(text))])


def test_a_preset_of_the_gap_comes_before_single_keys(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text("[gap]\ndelay = 0.002\npreset = 'none'\n")
    experiment = read_experiment(tmp_path / "e.toml", [("gap.torque_scale", "0.9")])
    assert hopper_of(experiment).gap == replace(RealityGap.none(), delay=0.002, torque_scale=0.9)
    assert hopper_of(read_experiment(tmp_path / "e.toml", [("gap.preset", "paper")])).gap == RealityGap()
    write_experiment(tmp_path, experiment, paper_reference())
    assert "preset" not in (tmp_path / "experiment.toml").read_text()
    assert hopper_of(read_experiment(tmp_path / "experiment.toml")).gap == hopper_of(experiment).gap


def test_options_that_are_valid_together_may_have_any_order() -> None:
    both = [("command.fx_lower", "40"), ("command.fx_upper", "50")]
    for overrides in (both, both[::-1]):
        assert hopper_of(read_experiment(None, overrides)).command == CommandBounds(fx_lower=40, fx_upper=50)
    longer = [("gains.rest_length", "0.5"), ("parameters.bottom_length", "0.45"), ("gains.landing_length", "0.4")]
    assert hopper_of(read_experiment(None, longer)).gains.rest_length == 0.5


WRONG = {
    "sed = 3": "sed: unknown key; did you mean seed?",
    "body_mass = 3": "body_mass: unknown key; did you mean [parameters] body_mass?",
    "body_mas = 3": "body_mas: unknown key; did you mean [parameters] body_mass?",
    "[gain]\nstiffness = 3": "gain: unknown key; did you mean gains?",
    "[gains]\nstifness = 3": "[gains] stifness: unknown key; did you mean stiffness?",
    "[gains]\nx = 3": "[gains] x: unknown key; the keys here are stiffness, rest_length",
    "[gains]\nstiffness = '3'": "[gains] stiffness = '3', but it must be a number",
    "[gains]\nstiffness = nan": "[gains] stiffness = nan, but it must be a number",
    "[gains]\nstiffness = true": "[gains] stiffness = true, but it must be a number",
    "[gains]\nstiffness = [1]": "[gains] stiffness = [1], but it must be a number",
    "[gains.stiffness]\nx = 1": "[gains] stiffness = {'x': 1}, but it must be a number",
    "[gains]\nstiffness = 1979-05-27": "but it must be a number",
    "gains = 3": "gains = 3, but it must be a table",
    "seed = 1.0": "seed = 1.0, but it must be an integer",
    "seed = '1'": "seed = '1', but it must be an integer",
    "seed = false": "seed = false, but it must be an integer",
    "seed = -1": "seed = -1, but it must lie between 0 and 2⁶³",
    f"seed = 0x{'f' * 9000}": "seed = a very large integer, but it must lie between",
    f"seed = {'9' * 9000}": "not TOML",
    f"[gains]\nstiffness = 1{'0' * 400}": "[gains] stiffness = a very large integer, but it must be a number",
    "[learning]\niterations = -1": "[learning] iterations = -1, but it must lie between 0 and 1000",
    "[learning]\niterations = 2.5": "[learning] iterations = 2.5, but it must be an integer",
    "[learning]\nresidual = 'cubic'": "[learning] residual = 'cubic', but it must be one of auto, constant, ",
    "[learning]\nresidual = 3": "[learning] residual = 3, but it must be a string",
    "[learning]\ntolerance = nan": "[learning] tolerance = nan, but it must be",
    "[learning]\nleast_gain = 0.1": "[learning] least_gain: this key is called tolerance now",
    "[learning]\ncalibration = 20": "[learning] calibration: this key is called exploration now",
    "[learning]\nfeature_map = 'identity'": "[learning] feature_map: gone, since feature maps did not lower the error",
    "[gap]\nboom_arc = 1": "[gap] boom_arc = 1, but it must be true or false",
    "[gap]\npreset = 'papre'": "[gap] preset = 'papre', but it must be 'paper' or 'none' or 'paper_1' or",
    "method = 'papr'": "method = 'papr', but it must be 'default' or 'paper' or 'integral' or 'rls' or 'affine'; did "
    "you mean 'paper'?",
    "metod = 'paper'": "metod: unknown key; did you mean method?",
    "[control]\ntable = 1": "[control] table = 1, but it must be 0, or lie between 2 and 41",
    "[gap]\npreset = [1]": "[gap] preset = [1], but it must be 'paper' or 'none' or 'paper_1' or",
    "[gap]\npreste = 'none'": "[gap] preste: unknown key; did you mean preset?",
    "[gap]\nground_friction = -1": "[gap] ground_friction = -1.0, but it must be positive",
    "[gap]\nground_friction = inf": "[gap] ground_friction = inf, but it must be finite with boom_arc = true",
    "[gap]\npreset = 'none'\nboom_arc = true": "[gap] ground_friction = inf, but it must be finite with boom_arc",
    "[parameters]\nbody_mass = -1": "[parameters] body_mass = -1.0, but it must be positive",
    "[parameters]\nbottom_length = 0.1": "[parameters] bottom_length = 0.1, but it must exceed top_length = 0.11",
    "[gains]\nlanding_length = 0.5": "[gains] landing_length = 0.5, but it must lie between 0.09 (leg folded)",
    "[gains]\nrest_length = 0.05": "[gains] rest_length = 0.05, but it must lie between",
    "[command]\nfx_lower = 40": "[command] fx_lower = 40.0, but it must lie below fx_upper = 30.0",
    "[weights]\nheigt = 1": "[weights] heigt = 1.0, but it must have the name of a state coordinate: speed, height",
    "[weights]\nheight = -1": "[weights] height = -1.0, but it must be a finite number from 0 on",
    "[weights]\nheight = inf": "[weights] height = inf, but it must be a finite number from 0 on",
    "[weights]\nheight = '1'": "[weights] height = '1', but it must be a number",
    "weights = 1": "weights = 1, but it must be a table",
    "[weights]\nspeed = 0\nheight = 0": "weights = {'speed': 0.0, 'height': 0.0}, but it must leave a weight above 0",
    "reference = 5": "reference = 5, but it must be a string",
    "[robot]\nbody_mass = 3": "robot: this table is called [parameters] now; robot = 'hopper' names the robot",
    "robot = 3": "robot = 3, but it must be one of ",
    "seed = ": "not TOML",
    "": "empty, as a file that was lost; for the defaults write a comment into it, or give none",
    "\n \n": "empty",
    '"\\u001b[2Jred" = 1': "unknown key",
    "seed = 1\nseed = 2": "not TOML",
    f"seed = {'[' * 5000}": "not TOML",
    "\x00": "not TOML",
}


@pytest.mark.parametrize("text", WRONG, ids=lambda text: text[:40])
def test_a_wrong_file_is_refused_with_the_rule(tmp_path: Path, text: str) -> None:
    path = tmp_path / "e.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_experiment(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert WRONG[text] in message
    assert len(message) < 1500


def all_numbers() -> list[str]:
    parts: tuple[Any, ...] = (Experiment(), Experiment().robot)
    tables = {field.name: getattr(part, field.name) for part in parts for field in fields(part)}
    del tables["robot"]
    found = [
        f"{table}.{field.name}"
        for table, settings in tables.items()
        if is_dataclass(settings)
        for field in fields(settings)
        if field.type is float or field.type == "float"
    ]
    assert len(found) > 50
    return found


@pytest.mark.parametrize("name", all_numbers())
def test_no_number_may_be_nan_and_few_may_be_infinite(name: str) -> None:
    for value in ("nan", "-inf"):
        with pytest.raises(InputError, match=f"^--{name} = {value}, but it must"):
            read_experiment(None, [(name, value)])
    table, key = name.split(".")
    may_be_infinite = name in ("learning.forgetting_time", "control.widening", "control.surprise") or (
        table == "gap" and math.isinf(getattr(RealityGap.none(), key))
    )
    if not may_be_infinite:
        with pytest.raises(InputError, match=f"^--{name} = inf, but it must"):
            read_experiment(None, [(name, "inf")])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("gains.stifness", "3", "--gains.stifness: unknown key; did you mean stiffness?"),
        ("gains.stiffness", "many", "--gains.stiffness = 'many', but it must be a number"),
        ("gains.stiffness", "3\nseed = 4", "--gains.stiffness = '3\\nseed = 4', but it must be a number"),
        ("gains.stiffness.x", "3", "--gains.stiffness = {'x': 3}, but it must be a number"),
        ("gains.", "3", "--gains.: unknown key"),
        (
            "gains.rest_length",
            "0.5",
            "--gains.rest_length = 0.5, but it must lie between 0.09 (leg folded)",
        ),
        ("learning.iterations", "-1", "--iterations = -1, but it must lie between 0 and 1000"),
        ("seed", "1.5", "--seed = 1.5, but it must be an integer"),
        ("command.fy_upper", "-30", "--command.fy_lower = -20.0, but it must lie below fy_upper = -30.0"),
    ],
)
def test_a_wrong_option_is_named(tmp_path: Path, name: str, value: str, message: str) -> None:
    (tmp_path / "e.toml").write_text("seed = 1\n")
    for path in (None, tmp_path / "e.toml"):
        with pytest.raises(InputError) as caught:
            read_experiment(path, [(name, value)])
        assert str(caught.value).startswith(message)


def test_in_a_recorded_run_settings_that_are_gone_are_ignored(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text('seed = 3\n[learning]\niterations = 2\nfeature_map = "linear"\n')
    found = read_experiment(tmp_path / "e.toml", recorded=True)
    assert found == Experiment(seed=3, learning=LearningSettings(iterations=2))
    with pytest.raises(InputError, match=r"^--learning\.feature_map: gone"):
        read_experiment(tmp_path / "e.toml", [("learning.feature-map", "linear")], recorded=True)


def test_former_settings_of_a_robot_are_read_where_they_had_no_effect(tmp_path: Path) -> None:
    """The step command of the hopper could once be another pair than the paper's."""
    (tmp_path / "e.toml").write_text(
        '[gains]\nthrust_stiffness = 0.0\n[command]\nfx_upper = 20.0\nstiffness = 800.0\npair = ["fx", "fy"]\n'
    )
    assert read_experiment(tmp_path / "e.toml") == read_experiment(None, [("command.fx_upper", "20.0")])
    (tmp_path / "e.toml").write_text('[command]\npair = ["speed_setpoint", "fy"]\n')
    for recorded in (False, True):
        with pytest.raises(
            InputError, match=r"\[command\] pair = \['speed_setpoint', 'fy'\], but this setting is gone"
        ):
            read_experiment(tmp_path / "e.toml", recorded=recorded)
    with pytest.raises(InputError, match=r"^--gains\.thrust_stiffness = 5, but this setting is gone"):
        read_experiment(None, [("gains.thrust_stiffness", "5")])


def test_no_setting_is_there_and_gone() -> None:
    assert not [name for name, _, _ in described_settings(Experiment()) if name in GONE_SETTINGS]


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text("seed = 3\n", encoding="utf-8-sig")
    assert read_experiment(tmp_path / "e.toml").seed == 3


def test_a_file_without_settings_is_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    (tmp_path / "huge.toml").write_text("#" * 2**20 + "\n")
    for name, message in [
        ("binary.toml", "this is not text"),
        ("huge.toml", "larger than 1048576 bytes"),
        ("none.toml", "No such file or directory; give an existing TOML file"),
        ("", "Is a directory"),
    ]:
        with pytest.raises(InputError, match=f"{name}: {message}"):
            read_experiment(tmp_path / name)
    with pytest.raises(InputError, match="/dev/zero: a pipe or a device, so it is not read"):
        read_experiment(Path("/dev/zero"))


@given(text=st.text(max_size=30))
def test_any_text_is_settings_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("any") / "e.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with suppress(InputError):
        read_experiment(path)
    with suppress(InputError):
        read_experiment(None, [("gains.stiffness", text)])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1: the header is ''"),
        (b"speed,height\n", "line 2: there is no step"),
        (b"pace\n0.1\n", "line 1: the header is 'pace'"),
        (b"speed,height\n0.1,inf\n", "line 2, column 'height': 'inf'"),
        (b"speed,height\n0.1\n", "line 2: 1 values"),
        (b"\xff\xfe\x01\n", "not text"),
        (b"speed,height\n" + b"1" * 200_000 + b",1\n", "it must be CSV"),
        (b"speed,height\n" + b"0.1,0.5\n" * 200_000, "larger than 1048576 bytes"),
    ],
)
def test_a_wrong_reference_is_refused_by_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "ref.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"ref\.csv") as caught:
        load_reference(Experiment(reference=str(path)), SPACE)
    assert message in str(caught.value)


def test_a_reference_without_end_is_refused() -> None:
    with pytest.raises(InputError, match="/dev/zero: a pipe or a device, so it is not read"):
        load_reference(Experiment(reference="/dev/zero"), SPACE)


def test_a_reference_that_is_missing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text('reference = "none.csv"\n')
    with pytest.raises(InputError, match=r"none\.csv: No such file .*reference must be 'paper', a CSV file"):
        load_reference(read_experiment(tmp_path / "e.toml"), SPACE)


def test_the_papers_reference_is_not_copied(tmp_path: Path) -> None:
    write_experiment(tmp_path, Experiment(), paper_reference())
    assert [path.name for path in tmp_path.iterdir()] == ["experiment.toml"]


def test_a_file_of_a_robot_is_found_beside_the_settings_and_goes_with_a_run(tmp_path):
    """The profile of a ground is relative to the file that names it, and is copied into the folder of a run."""
    (tmp_path / "floor.csv").write_text("place,height\n0,0\n1,0.01\n")
    (tmp_path / "own.toml").write_text('[ground]\nprofile = "floor.csv"\n')
    settings = read_experiment(tmp_path / "own.toml")
    assert as_hopper(settings.robot, "").ground.profile == str(tmp_path / "floor.csv")
    write_experiment(tmp_path / "run", settings, load_reference(settings, settings.space))
    (tmp_path / "floor.csv").unlink()
    again = read_experiment(tmp_path / "run" / "experiment.toml")
    assert as_hopper(again.robot, "").ground.largest_change == 0.01
    with pytest.raises(InputError, match=r"ground.profile: .*floor.csv"):
        write_experiment(tmp_path / "run", settings, load_reference(settings, settings.space))


def test_reading_the_names_of_presets_draws_no_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RealityGap, "random", None)
    assert settings.preset_names(Hopper())["gap"][-1] == "random:NUMBER"
    assert "gap" not in settings.preset_names(load_robot("custom"))


def test_a_warm_start_that_a_file_names_is_turned_off(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text("warm_start = 'run'\n")
    assert read_experiment(tmp_path / "e.toml").warm_start == str(tmp_path / "run")
    assert read_experiment(tmp_path / "e.toml", [("warm_start", "none")]).warm_start == ""
