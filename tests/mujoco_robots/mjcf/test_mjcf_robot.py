"""Robots from MuJoCo models: sections against closed forms, gaps against edited models, and one that learns."""

# pyright: reportAttributeAccessIssue=false
# ruff: noqa: ARG002  (a robot gets what it may need)

import json
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant, MjcfRobot, MjcfSimulator
from stepgap.mujoco_robots.mjcf.section import Section, apex, next_foot, touchdown
from stepgap.robots.entry_points import load_robot
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.step import Array, Quantity, StepFailed, StepSpace, StepStatus
from tests.cli.command_line import Command, CommandResult
from tests.quick_runs import leave_out_report

BALL = """
<mujoco><option timestep="0.0005"/><worldbody>
  <geom name="floor" type="plane" size="9 9 1" solref="-2000 -10" solimp="0.99 0.99 0.001"/>
  <body name="ball" pos="0 0 0.1"><joint name="z" type="slide" axis="0 0 1"/><joint name="x" type="slide" axis="1 0 0"/>
    <geom name="foot" type="sphere" size="0.1" mass="2"/></body></worldbody>
  <actuator><motor name="lift" joint="z" gear="3"/></actuator></mujoco>
"""


@dataclass(frozen=True)
class Ball(MjcfRobot):
    """A ball that bounces; the force acts on it all the time."""

    name = "bouncing_ball"
    tick = 0.001
    at_touchdown: bool = False

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("height", "m", 0.2, 0.6),), (Quantity("lift", "N", -5.0, 5.0),))

    def mjcf_model(self) -> Any:
        return mujoco.MjModel.from_xml_string(BALL)

    def controller(self):
        def control(model: Any, data: Any, command: Array) -> None:
            data.ctrl[:] = command / 3

        return control

    def section(self) -> Section:
        return touchdown("foot") if self.at_touchdown else apex("z")

    def state(self, model: Any, data: Any) -> Array:
        return np.array([data.time if self.at_touchdown else data.qpos[0]])

    def place(self, model: Any, data: Any, state: Array) -> None:
        data.qpos[0] = state[0]


EXACT = replace(MjcfGap.none())


def test_touchdown_is_where_a_falling_ball_reaches_the_ground() -> None:
    simulate = MjcfSimulator(Ball(at_touchdown=True))
    for height, lift in ((0.3, 0.0), (0.5, 4.0), (0.25, -3.0)):
        found = simulate(np.array([height]), np.array([lift]))
        expected = sqrt(2 * height / (9.81 - lift / 2))
        np.testing.assert_allclose(found, [expected], atol=1.5 * Ball.tick)


def test_the_apex_is_the_highest_point_and_less_than_before() -> None:
    simulate = MjcfSimulator(Ball())
    heights = np.array([0.25, 0.35, 0.45])
    found = np.array([np.sum(simulate(np.array([height]), np.zeros(1))) for height in heights])
    assert (np.diff(found) > 0.02).all()
    assert (found / heights > 0.1).all()
    assert (found / heights < 0.99).all()


def test_without_a_gap_the_plant_takes_the_steps_of_the_nominal_map() -> None:
    robot = Ball(gap=EXACT)
    plant, simulate = MjcfPlant(robot, np.random.default_rng(0)), MjcfSimulator(robot)
    state = plant.start()
    for lift in (0.0, 3.0, -2.0):
        record = plant.take_step(np.array([lift]))
        expected = simulate(state, np.array([lift]))
        np.testing.assert_allclose(record.next_state, expected, atol=2e-3)
        state = record.next_state
        np.testing.assert_array_equal(record.true_next_state, record.next_state)


def test_every_difference_is_in_the_model_or_in_the_steps() -> None:
    model = Ball().mjcf_model()
    scaled = replace(EXACT, mass_scale=1.1, payload=0.5, friction_scale=0.5, gear_scale=0.9, slope=0.1).of(model)
    text = BALL.replace('mass="2"', 'mass="2.7"').replace('gear="3"', 'gear="2.7"')
    expected = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_allclose(scaled.body_mass, expected.body_mass)
    np.testing.assert_allclose(scaled.actuator_gear, expected.actuator_gear)
    np.testing.assert_allclose(scaled.geom_friction[:, 0], 0.5 * model.geom_friction[:, 0])
    np.testing.assert_allclose(np.linalg.norm(scaled.opt.gravity), 9.81)
    assert scaled.opt.gravity[0] == pytest.approx(-9.81 * np.sin(0.1))
    damped = replace(EXACT, joint_friction=0.3).of(model)
    assert damped.dof_frictionloss.tolist() == [0.3, 0.0], "only joints with actuators"
    assert model.body_mass[1] == 2, "the model itself is not changed"
    base = MjcfPlant(Ball(gap=EXACT), np.random.default_rng(0))
    base.start()
    reference = base.take_step(np.array([4.0])).next_state
    for change in ({"delay": 0.05}, {"force_noise": 0.5}, {"state_noise": 0.1}):
        plant = MjcfPlant(Ball(gap=replace(EXACT, **change)), np.random.default_rng(0))
        plant.start()
        assert abs(plant.take_step(np.array([4.0])).next_state - reference)[0] > 1e-5, change


def test_a_repeated_step_leaves_the_plant_where_it_is() -> None:
    plants = [MjcfPlant(Ball(), np.random.default_rng(3)) for _ in range(2)]
    for plant in plants:
        plant.start()
    repeats = [plants[0].repeated(np.array([1.0]), np.random.default_rng(seed))[0] for seed in (1, 1, 2)]
    assert repeats[0] == repeats[1] != repeats[2]
    first, second = (plant.take_step(np.array([1.0])).next_state for plant in plants)
    assert first.tolist() == second.tolist()


def test_a_fall_and_a_wrong_command_are_statuses() -> None:
    class Falling(Ball):
        def failed(self, model: Any, data: Any) -> bool:
            return data.qpos[0] < 0.05

    plant = MjcfPlant(Falling(), np.random.default_rng(0))
    plant.start()
    record = plant.take_step(np.zeros(1))
    assert record.status == StepStatus.FELL
    assert np.isnan(record.next_state).all()
    plant.start()
    assert plant.take_step(np.array([np.nan])).status == StepStatus.INVALID

    class Floating(Ball):
        longest_step = 0.2

        def place(self, model: Any, data: Any, state: Array) -> None:
            data.qpos[0] = 5.0

    assert MjcfSimulator(Floating())(np.array([0.3]), np.zeros(1)) == StepStatus.NO_APEX


@pytest.mark.parametrize("solref", ["-2000 -100", "0.03 1"])
def test_a_softer_ground_sinks_in_proportion(solref: str) -> None:
    contact = f'size="0.1" solref="{solref}" solimp="0.99 0.99 0.001" mass'  # an impedance that does not vary
    text = BALL.replace("-2000 -10", solref).replace('size="0.1" mass', contact)
    sunk = []
    for softness in (1.0, 2.0):
        model = replace(EXACT, ground_softness=softness).of(mujoco.MjModel.from_xml_string(text))
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 6000)
        assert abs(data.qvel[0]) < 1e-6
        sunk.append(-data.qpos[0])
    assert sunk[1] / sunk[0] == pytest.approx(2, rel=0.02)


def test_a_lagging_motor_follows_a_step_exponentially() -> None:
    ticks: list[np.ndarray] = []
    robot = Ball(gap=replace(EXACT, motor_lag=0.02))
    plant = MjcfPlant(robot, np.random.default_rng(0), lambda rows, step: ticks.extend(map(np.array, rows)))
    plant.start()
    plant.take_step(np.array([3.0]))
    rows = np.array(ticks[1:])  # time, z, x, force
    np.testing.assert_allclose(rows[:, 3], 1 - np.exp(-rows[:, 0] / 0.02), atol=0.02)


def test_a_random_gap_is_valid_and_different(package: Path) -> None:
    robot = load_robot("spring_hopper")
    first, second = (robot.randomised(np.random.default_rng(seed)) for seed in (1, 2))
    assert first is not None
    assert first != second
    assert first == robot.randomised(np.random.default_rng(1))


def test_several_processes_sample_the_same_surrogate(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.robots.nominal_maps.surrogate_map.MOST_SAMPLES", 128)
    settings = read_experiment(None, [("robot", "spring_hopper")])
    found = []
    for least_duration in (1e9, 0.0):
        monkeypatch.setattr("stepgap.experiment.nominal.WORTH_PROCESSES", least_duration)
        found.append(load_nominal(settings).file)
    assert found[0] == found[1]


@pytest.mark.usefixtures("no_repeats")
def test_the_robot_of_the_page_learns(package: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stepgap.robots.nominal_maps.surrogate_map.MOST_SAMPLES", 512)
    (reference,) = (make() for make in load_robot("spring_hopper").references().values())
    rows = [reference.names, *reference.targets[:16].tolist()]
    Path("targets.csv").write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
    options = ("--reference", "targets.csv", "--out", "out", "--iterations", "1", "--quiet")
    result = stepgap("run", "--robot", "spring_hopper", *options)
    assert result.code == 0, result.err
    assert "512 simulated steps, error of the surrogate: speed 0.002" in result.err
    before, after = json.loads(Path("out/summary.json").read_text())["iterations"]
    assert after["falls"] == 0
    for name in ("speed", "height"):
        assert after["rmse"][name] < 0.4 * before["rmse"][name]
    settings = read_experiment(Path("out/experiment.toml"))
    assert (settings.nominal.kind, Path(settings.nominal.file).name) == ("simulator", "nominal_map.json")
    with monkeypatch.context() as patch:
        leave_out_report(patch)
        again = stepgap("run", "--resume", "--out", "out", "--quiet")
    assert (again.code, "simulated steps" in again.err) == (0, False), "the surrogate is read, not fitted again"
    motion = Path("out/replay/deployment_1.npz")
    recorded = motion.read_bytes()
    motion.unlink()
    assert stepgap("report", "out") == CommandResult(0, "out/report.html\n", "")
    assert motion.read_bytes() == recorded, "the deployment is simulated again to the same motion"
    result = stepgap("export", "out", "--to", "mcap", "--iteration", "1")
    assert (result.code, Path(result.out.strip()).name) == (0, "ticks_1.mcap")


STEPPING = """
<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
  <geom name="floor" type="plane" size="9 9 1" contype="0" conaffinity="0"/>
  <body pos="0 0.1 0.02"><joint name="l" type="slide" axis="0 0 1"/><geom name="left" size="0.02" mass="1"/></body>
  <body pos="0 -0.1 0.02"><joint name="r" type="slide" axis="0 0 1"/><geom name="right" size="0.02" mass="1"/></body>
  </worldbody><actuator><motor joint="l"/></actuator></mujoco>
"""


@dataclass(frozen=True)
class Walker(MjcfRobot):
    """Feet that are lifted in turn, 0.3 s each, with an overlap of 0.1 s in which both are on the ground."""

    name = "walker"
    tick = 0.001
    longest_step = 1.5
    ends: Any = None
    bounces: bool = False

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("time", "s", 0.0, 2.0),), (Quantity("none", "", -1.0, 1.0),))

    def mjcf_model(self) -> Any:
        return mujoco.MjModel.from_xml_string(STEPPING)

    def controller(self):
        def control(model: Any, data: Any, command: Array) -> None:
            phase = (data.time + 0.05) % 0.8
            for joint, begin in (("r", 0.1), ("l", 0.5)):
                swing = (phase - begin) / 0.3
                lift = np.sin(np.pi * swing) if 0 < swing < 1 else -0.01
                if self.bounces and 0.1 < swing - 1 < 0.2:
                    lift = 0.5
                data.joint(joint).qpos, data.joint(joint).qvel = 0.02 * lift, 0.0

        return control

    def section(self) -> Section:
        return self.ends

    def state(self, model: Any, data: Any) -> Array:
        return np.array([data.time])

    def place(self, model: Any, data: Any, state: Array) -> None:
        data.joint("l").qpos = -0.0002
        data.joint("r").qpos = 0.0


def ends_of_steps(section: Section, bounces: bool = False) -> list[float]:
    """Times at which the first steps end; NaN for one that does not."""
    plant = MjcfPlant(Walker(gap=EXACT, ends=section, bounces=bounces), np.random.default_rng(0))
    plant.start()
    return [plant.take_step(np.zeros(1)).next_state[0] for _ in range(4)]


@pytest.mark.parametrize("bounces", [False, True])
def test_a_step_of_a_walker_ends_where_another_foot_touches_down(bounces: bool) -> None:
    found = ends_of_steps(next_foot("left", "right"), bounces)
    np.testing.assert_allclose(found, [0.35, 0.75, 1.15, 1.55], atol=0.005)
    np.testing.assert_array_equal(found, ends_of_steps(next_foot("right", "left"), bounces))
    np.testing.assert_array_equal(found, ends_of_steps(next_foot(1, 2), bounces))


def test_a_walker_has_no_touchdown_of_all_feet_but_one_of_each() -> None:
    assert np.isnan(ends_of_steps(touchdown("left", "right"))).all()
    np.testing.assert_allclose(ends_of_steps(touchdown("left")), [0.75, 1.55, 2.35, 3.15], atol=0.005)


def test_feet_that_swing_together_are_one() -> None:
    found = ends_of_steps(next_foot(("left", "left"), ("right",)))
    np.testing.assert_allclose(found, [0.35, 0.75, 1.15, 1.55], atol=0.005)
    with pytest.raises(ValueError, match="be at least two"):
        next_foot("left")


WITH_ANTENNA = BALL.replace(
    "</worldbody>",
    "<body name='antenna' pos='0 1 1'><joint name='antenna' axis='0 1 0'/><geom type='capsule' size='0.002' "
    "mass='0.002' fromto='0 0 0 0.05 0 0.1' contype='0' conaffinity='0'/></body></worldbody>",
).replace("</actuator>", "<motor name='antenna' joint='antenna'/></actuator>")


@dataclass(frozen=True)
class Antenna(Ball):
    """The ball, and beside it an antenna so light that a damper of its controller diverges."""

    gap: MjcfGap = EXACT
    damper: float = 0.0

    def mjcf_model(self) -> Any:
        return mujoco.MjModel.from_xml_string(WITH_ANTENNA)

    def controller(self):
        def control(model: Any, data: Any, command: Array) -> None:
            data.ctrl[:] = command[0] / 3, -self.damper * data.joint("antenna").qvel[0]

        return control


def test_a_simulation_that_mujoco_would_reset_is_an_unstable_step() -> None:
    sound = MjcfPlant(Antenna(damper=0.001), np.random.default_rng(0))
    plant = MjcfPlant(Antenna(damper=0.1), np.random.default_rng(0))
    height = sound.start()
    assert sound.take_step(np.zeros(1)).status == StepStatus.OK
    assert sound.fault == ""
    for _ in range(2):  # a plant that is started again begins anew
        plant.start()
        assert plant.fault == ""
        record = plant.take_step(np.zeros(1))
        assert record.status == StepStatus.UNSTABLE
        assert np.isnan([record.next_state, record.true_next_state]).all()
        assert "unstable after 0.0" in plant.fault
        assert "the acceleration of joint 'antenna' grew without bound" in plant.fault
        assert "time step of 0.0005 s; lower gains" in plant.fault
    model = SimulatorMap(Antenna().space, MjcfSimulator(Antenna(damper=0.1)))
    assert model.evaluate(height, np.zeros(1)).status == StepStatus.UNSTABLE
    with pytest.raises(StepFailed, match="unstable: the simulation became unstable; lower gains"):
        model(height, np.zeros(1))


def test_a_control_signal_that_mujoco_would_leave_out_is_no_step() -> None:
    plant = MjcfPlant(Antenna(damper=np.nan), np.random.default_rng(0))
    plant.start()
    assert plant.take_step(np.zeros(1)).status == StepStatus.UNSTABLE
    assert plant.fault.endswith("s the control signal of actuator 'antenna' was nan; correct the controller")


@pytest.mark.parametrize(
    ("memory", "words"), [("20K", "forces of contacts were left out"), ("30K", "MuJoCo cannot compute")]
)
def test_a_model_without_memory_for_its_contacts_takes_no_step(memory: str, words: str) -> None:
    crate = "<body pos='{} 3 0.5'><freejoint/><geom type='box' size='.06 .06 .06'/></body>"
    crates = "".join(crate.format(0.1 * number) for number in range(4))
    text = BALL.replace("<worldbody>", f"<size memory='{memory}'/><worldbody>").replace(
        "</worldbody>", f"{crates}</worldbody>"
    )

    class Crates(Ball):
        def mjcf_model(self) -> Any:
            return mujoco.MjModel.from_xml_string(text)

    plant = MjcfPlant(Crates(gap=EXACT), np.random.default_rng(0))
    plant.start()
    assert plant.take_step(np.zeros(1)).status == StepStatus.UNSTABLE
    assert words in plant.fault
    assert "size memory" in plant.fault
