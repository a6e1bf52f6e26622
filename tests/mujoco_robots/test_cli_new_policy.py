"""`stepgap new --policy`: with metadata the folder runs at once, without them it says what is to be filled in."""

import json
import tomllib
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

import stepgap
from stepgap import verbs
from stepgap.mujoco_robots.cli.new_policy import step_seconds
from stepgap.mujoco_robots.velocity.policy.policy_settings import read_policy_settings
from tests.cli.command_line import Command, refused
from tests.mujoco_robots.velocity.policy.networks import TERMS, WHEELS, cart_xml, driving, mjlab_metadata, write_network

QUICK = ("--iterations", "1", "--learning.early_stop", "false", "--weights.vy", "0", "--quiet")


@pytest.fixture(autouse=True)
def started_without_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an environment of a user, however the tests were started."""
    monkeypatch.delenv("STEPGAP_GO", raising=False)


def targets() -> Path:
    rows = [f"{vx},{wz}" for vx, wz in ((0.2, 0.0), (0.5, 0.2), (0.3, -0.2), (0.1, 0.1)) for _ in range(3)]
    Path("targets.csv").write_text("\n".join(["vx,wz", *rows, ""]))
    return Path("targets.csv").resolve()


def rmse(folder: str) -> np.ndarray:
    entries = json.loads(Path(folder, "summary.json").read_text())["iterations"]
    return np.array([[entry["rmse"][name] for name in ("vx", "wz")] for entry in entries])


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_a_policy_with_metadata_runs_at_once_and_is_corrected(
    stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_network(Path("walk.onnx"), driving(), mjlab_metadata())
    Path("cart.xml").write_text(cart_xml())
    made = stepgap("new", "my cart", "--policy", "walk.onnx", "--mjcf", "cart.xml")
    assert (made.code, made.out) == (0, "my cart/README.md\n")
    assert "the gait of the model: it has no strict period" in made.err, "a cart does not step"
    assert made.err.endswith("next: stepgap run 'my cart/experiment.toml'\n")
    assert "It had no ground and no position servos" in Path("my cart/README.md").read_text()
    Path("walk.onnx").rename("gone.onnx")
    Path("elsewhere").mkdir()
    reference = targets()
    monkeypatch.chdir("elsewhere")
    result = stepgap("run", "../my cart/experiment.toml", "--reference", reference, "--out", "../out", *QUICK)
    assert result.code == 0, result.err
    before, after = rmse("../out")
    assert np.linalg.norm(after) < 0.7 * np.linalg.norm(before)
    again = stepgap("run", "../out/experiment.toml", "--out", "../again", "--quiet")
    assert again.code == 0, again.err
    assert Path("../again/steps.csv").read_bytes() == Path("../out/steps.csv").read_bytes()


def test_a_policy_without_metadata_says_what_is_missing_until_it_is_filled_in(stepgap: Command) -> None:
    write_network(Path("walk.onnx"), driving())
    Path("cart.xml").write_text(cart_xml())
    made = stepgap("new", "cart", "--policy", "walk.onnx", "--mjcf", "cart.xml")
    assert made.code == 0
    assert (
        "fill in action_scale, observation, stiffness in cart/policy.toml first: they are not in walk.onnx" in made.err
    )
    file = Path("cart/policy.toml")
    refused(stepgap("run", "cart/experiment.toml", "--out", "out"), "cart/policy.toml: action_scale: missing")
    text = file.read_text().replace("# action_scale = []", "action_scale = [1.0]")
    text = text.replace("stiffness = []", "stiffness = [2.0]").replace("damping = []", "damping = [0.8]")
    file.write_text(text.replace("# observation = [", "observation = [", 1))
    settings = read_policy_settings(file)
    assert settings.observation == TERMS
    assert settings.joints == WHEELS
    assert "# Time between two actions [s], as in the training.\n# Check it: no file says it.\nperiod = 0.02\n" in text


def test_a_policy_of_a_robot_with_more_joints_says_that_the_joints_are_to_be_filled_in(stepgap: Command) -> None:
    four = {"default_joint_pos", "joint_stiffness", "joint_damping"}
    said = {key: f"{text},{text[:5]}" if key in four else text for key, text in mjlab_metadata().items()}
    write_network(Path("walk.onnx"), np.zeros((5, 27)), said | {"joint_names": f"{','.join(WHEELS)},waist"})
    Path("cart.xml").write_text(cart_xml())
    made = stepgap("new", "cart", "--policy", "walk.onnx", "--mjcf", "cart.xml")
    assert "fill in joints in cart/policy.toml first" in made.err, made
    text = Path("cart/policy.toml").read_text()
    assert "Fill in the joints of the 5 actions; the model has these 4:" in text
    assert "The training names joints that the model does not have: waist" in text
    assert "\ndefault_joint_pos = [0.0, 0.0, 0.0, 0.0, 0.0]" in text


def test_a_policy_with_the_file_of_its_training_beside_it_needs_nothing(stepgap: Command) -> None:
    Path("run/exported").mkdir(parents=True)
    Path("run/params").mkdir()
    write_network(Path("run/exported/policy.onnx"), driving())
    names = ["base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos_rel", "joint_vel_rel", "last_action"]
    terms = "".join(f"  {name}: {{scale: [0.5], clip: null, history_length: 1}}\n" for name in names)
    Path("run/params/deploy.yaml").write_text(
        "commands: {base_velocity: {ranges: {lin_vel_x: [-0.1, 0.7], ang_vel_z: [2, 3]}}}\n"
        "joint_ids_map: [0, 1, 2, 3]\nstep_dt: 0.02\nstiffness: [2, 2, 2, 2]\ndamping: [.8, .8, .8, .8]\n"
        "default_joint_pos: [0, 0, 0, 0]\nactions:\n  JointPositionAction: {clip: null, scale: [1, 1, 1, 1], "
        f"offset: [0, 0, 0, 0]}}\nobservations:\n{terms}  velocity_commands: {{scale: [1.0, 1.0, 1.0]}}\n"
    )
    Path("cart.xml").write_text(cart_xml())
    made = stepgap("new", "cart", "--policy", "run/exported/policy.onnx", "--mjcf", "cart.xml")
    assert made.code == 0, made.err
    assert "fill in" not in made.err
    walk = tomllib.loads(Path("cart/experiment.toml").read_text())["walk"]
    assert walk["vx"] == {"lower": -0.1, "upper": 0.7, "command_lower": -0.1, "command_upper": 0.7}
    assert walk["wz"] == {"lower": 2.0, "upper": 3.0, "command_lower": 2.0, "command_upper": 3.0}
    assert "vy" not in walk
    settings = read_policy_settings(Path("cart/policy.toml"))
    assert settings.observation == TERMS
    assert settings.scale.joint_vel == (0.5,)
    assert settings.scale.command == (1.0,)
    assert "# Its settings are from run/exported/../params/deploy.yaml." in Path("cart/policy.toml").read_text()


def test_texts_of_others_do_not_leave_their_place(stepgap: Command) -> None:
    said = mjlab_metadata() | {"observation_names": 'base_ang_vel,evil\nperiod = 1\n"""', "run_path": "\x00"}
    said |= {"joint_names": "a\nperiod = 1,b,c,d"}
    write_network(Path("walk.onnx"), driving(), said)
    named = cart_xml().replace("front_left", "a&#10;b = 1&#34;]")
    Path("cart.xml").write_text(named)
    made = stepgap("new", "cart", "--policy", "walk.onnx", "--mjcf", "cart.xml")
    assert made.code == 0, made.err
    refused(stepgap("run", "cart/experiment.toml", "--out", "out"), "cart/policy.toml: joints: missing")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--policy", "walk.onnx"], ["--policy walk.onnx: also give the MuJoCo model of its robot, by --mjcf"]),
        (["--policy", "walk.onnx", "--mjcf", "cart.xml", "--process"], ["--policy and --process: give only one"]),
        (["--policy", "cart.xml", "--mjcf", "cart.xml"], ["--policy cart.xml: onnxruntime cannot load it"]),
        (["--policy", "none.onnx", "--mjcf", "cart.xml"], ["--policy none.onnx: No such file"]),
        (["--policy", "walk.onnx", "--mjcf", "walk.onnx"], ["--mjcf walk.onnx: ", "give a MuJoCo model (MJCF)"]),
        (
            ["--policy", "walk.onnx", "--mjcf", "fixed.xml"],
            ["--policy walk.onnx, --mjcf fixed.xml: its first body has no free"],
        ),
        (["--policy", "walk.onnx", "--mjcf", "empty.xml"], ["--mjcf empty.xml: its first body has no free joint"]),
        (["--policy", "plain.onnx", "--mjcf", "fixed.xml"], ["--mjcf fixed.xml: its first body has no free joint"]),
        (["--policy", "walk.onnx", "--mjcf", "space.xml"], ["--mjcf space.xml: it has no gravity"]),
        (
            ["--policy", "small.onnx", "--mjcf", "cart.xml"],
            [": policy.toml: observation: its terms have 24", "policy.onnx wants 23"],
        ),
    ],
)
def test_wrong_files_leave_no_folder(stepgap: Command, options: list[str], words: list[str]) -> None:
    write_network(Path("walk.onnx"), driving(), mjlab_metadata())
    write_network(Path("small.onnx"), driving()[:, 1:], mjlab_metadata())
    Path("cart.xml").write_text(cart_xml())
    write_network(Path("plain.onnx"), driving())
    Path("fixed.xml").write_text(cart_xml().replace("<freejoint/>", ""))
    Path("empty.xml").write_text("<mujoco/>")
    Path("space.xml").write_text(cart_xml().replace("<option", '<option gravity="0 0 0"'))
    refused(stepgap("new", "cart", *options), *words)
    assert not Path("cart").exists()


def test_a_network_whose_numbers_are_beside_it_becomes_one_file(stepgap: Command) -> None:
    Path("two").mkdir()
    whole = onnx.load(write_network(Path("two/walk.onnx"), driving(), mjlab_metadata()))
    onnx.save(whole, "two/walk.onnx", save_as_external_data=True, location="walk.onnx.data", size_threshold=0)
    Path("cart.xml").write_text(cart_xml())
    made = stepgap("new", "cart", "--policy", "two/walk.onnx", "--mjcf", "cart.xml")
    assert made.code == 0, made.err
    Path("two/walk.onnx.data").rename("gone")
    copy = onnx.load("cart/policy.onnx")
    assert numpy_helper.to_array(copy.graph.initializer[0]).tolist() == driving().T.astype(np.float32).tolist()
    words = "--policy two/walk.onnx: some of its numbers are in another file, 'walk.onnx.data', which is not beside it"
    remedy = "onnx.save(onnx.load('walk.onnx'), 'one_file.onnx')"
    refused(stepgap("new", "other", "--policy", "two/walk.onnx", "--mjcf", "cart.xml"), words, remedy)


def test_a_model_that_names_files_of_the_user_leaves_no_folder(stepgap: Command) -> None:
    write_network(Path("walk.onnx"), driving(), mjlab_metadata())
    Path("home").mkdir()
    Path("home/id_rsa").write_text("secret")
    Path("model").mkdir()
    texture = "<asset><texture name='t' type='2d' file='../home/id_rsa'/></asset><worldbody>"
    Path("model/cart.xml").write_text(cart_xml().replace("<worldbody>", texture))
    for options in (["--policy", "walk.onnx", "--mjcf", "model/cart.xml"], ["--mjcf", "model/cart.xml"]):
        refused(stepgap("new", "cart", *options), "--mjcf model/cart.xml: <texture t file='../home/id_rsa'>: this is ")
        assert not Path("cart").exists()


@pytest.mark.parametrize(("period", "seconds"), [(0.667, 0.667), (0.25, 0.5), (0.3, 0.6), (1.2, 1.2)])
def test_a_step_has_whole_periods_of_the_gait(period: float, seconds: float) -> None:
    """The mean velocity of three quarters of a period depends on where in the gait it begins."""
    known = {"observation": ["base_ang_vel", "phase_sin"], "gait_period": period}
    assert step_seconds(known) == pytest.approx(seconds)
    assert step_seconds({"observation": ["base_ang_vel"], "gait_period": period}) == 0.5


def test_a_policy_runs_from_python_in_two_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of docs/notebook_policy.md, with shorter walks."""
    monkeypatch.chdir(tmp_path)
    write_network(Path("policy.onnx"), driving(), mjlab_metadata())
    Path("robot.xml").write_text(cart_xml())
    verbs.new("dog", policy="policy.onnx", mjcf="robot.xml")
    run = stepgap.run("dog/experiment.toml", targets=np.full((4, 3), 0.1), iterations=0, progress=False)
    assert len(run.steps) == 4
