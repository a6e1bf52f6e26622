"""Every quantity that can be the hopper's step command: its effect in model, twin and control, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.settings import read_experiment
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.model.sampled_map import SampledApexMap
from stepgap.robots.hopper.parameters import KNOB_UNITS, CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.robots.hopper.model.reference_hop import Hopper as ReferenceHopper
from tests.robots.hopper.model.reference_hop import reference_hop

START = np.array([0.25, 0.58])
NAMES = [name for name in KNOB_UNITS if name not in ("fx", "fy")]
STANCE = ("thrust_rest_length", "thrust_stiffness", "rest_length", "stiffness")


def with_command(name: str) -> CommandBounds:
    return CommandBounds(pair=(name, "fy"))


@pytest.mark.parametrize("name", STANCE)
def test_a_command_of_the_spring_is_the_same_gain_for_one_step(name: str) -> None:
    change = 0.4 * getattr(CommandBounds(), name)
    under = ApexMap(bounds=with_command(name))(START, [change, -8.0])
    gains = Gains()
    changed = ApexMap(gains=replace(gains, **{name: getattr(gains, name) + change}))(START, [0.0, -8.0])
    np.testing.assert_array_equal(under, changed)


@pytest.mark.parametrize("name", ["rest_length", "stiffness"])
def test_a_command_of_the_whole_stance_has_the_effect_of_the_reference(name: str) -> None:
    change = 0.5 * getattr(CommandBounds(), name)
    hopper = ReferenceHopper(RobotParameters(), replace(Gains(), **{name: getattr(Gains(), name) + change}))
    status, expected = reference_hop(hopper, START, np.array([0.0, -8.0]))
    assert status == StepStatus.OK
    np.testing.assert_allclose(ApexMap(bounds=with_command(name))(START, [change, -8.0]), expected, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_of_the_map_are_differences(name: str) -> None:
    apex_map = ApexMap(bounds=with_command(name))
    command, step = np.array([0.0, -8.0]), np.array([0.01 * apex_map.space.command_scale[0], 0.0])
    found = apex_map.jacobian(START, command)[:, 2] * step[0]
    differences = (apex_map(START, command + step) - apex_map(START, command - step)) / 2
    np.testing.assert_allclose(found, differences, atol=1e-6 * apex_map.space.state_scale.max())


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_with_one_state_is_its_single_steps(name: str) -> None:
    apex_map = ApexMap(bounds=with_command(name))
    commands = apex_map.space.command_at(np.array([[-0.5, 0.0], [0.5, 0.0], [np.nan, 0.0], [0.5, -0.5]]))
    batch = apex_map.evaluate(START, commands)
    for row, command in enumerate(commands):
        single = apex_map.evaluate(START, command)
        np.testing.assert_array_equal(batch.next_state[row], single.next_state)
        assert batch.status[row] == single.status
    assert batch.status.tolist() == [StepStatus.OK, StepStatus.OK, StepStatus.INVALID, StepStatus.OK]
    alone = [apex_map.jacobian(START, command) for command in commands]
    np.testing.assert_array_equal(apex_map.jacobian(START, commands), alone)


@pytest.mark.parametrize("name", NAMES)
def test_with_short_ticks_the_sampled_map_is_the_map(name: str) -> None:
    bounds = with_command(name)
    command = bounds.space().command_at(np.array([0.3, -0.4]))
    sampled = SampledApexMap(bounds=bounds, tick=5e-5)(START, command)
    np.testing.assert_allclose(sampled, ApexMap(bounds=bounds)(START, command), atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_twin_without_differences_moves_as_the_map(name: str) -> None:
    """The command comes some 40 ms after the apex, when the twin's control finds it; the map has it at the apex.

    So that the leg of the twin has not quite come to rest at touchdown.
    """
    robot = Hopper(command=with_command(name), gap=RealityGap.none())
    apex_map, found = robot.apex_map(), []
    for share in (-0.3, 0.3):
        twin = Twin(robot.parameters, robot.gap, np.random.default_rng(0), start_speed=0.25)
        with RigPlant(twin, robot.control()) as plant:
            plant.start()
            record = plant.take_step(apex_map.space.command_at(np.array([share, -0.4])))
        assert record.status == StepStatus.OK
        np.testing.assert_array_equal(record.applied, record.command)
        found.append((record.next_state, apex_map(record.state, record.command)))
    (low, low_map), (high, high_map) = found
    scale = apex_map.space.state_scale
    np.testing.assert_allclose((high - low) / scale, (high_map - low_map) / scale, atol=0.05 if name in STANCE else 0.1)
    assert np.abs((high - low) / scale).max() > 0.05


@pytest.mark.parametrize(("name", "in_time"), [("thrust_stiffness", True), ("speed_setpoint", False)])
def test_a_command_of_the_landing_is_not_taken_after_touchdown(name: str, in_time: bool) -> None:
    robot = Hopper(command=with_command(name), gap=RealityGap.none())
    twin = Twin(robot.parameters, robot.gap, np.random.default_rng(0), start_speed=0.25)
    with RigPlant(twin, robot.control()) as plant:
        plant.start()
        control = robot.control().control(twin)
        taken = set[bool]()
        applied = (0.0, 0.0)
        for tick in range(700):
            torques, flags = control.tick(1e-3 * tick, twin.read(), Order(Mode.STEP, 1.0, (np.nan, np.nan)), applied)
            applied = twin.write(torques)
            if control.state.phase == Phase.COMPRESSION:
                taken.add(bool(flags & TickFlag.TAKES_COMMAND))
    assert taken == {in_time}


def test_a_command_that_is_lost_to_limits_is_not_counted_as_applied() -> None:
    robot = Hopper(command=with_command("thrust_rest_length"), gap=replace(RealityGap.none(), torque_limit=8.0))
    twin = Twin(robot.parameters, robot.gap, np.random.default_rng(0), start_speed=0.25)
    with RigPlant(twin, robot.control()) as plant:
        plant.start()
        record = plant.take_step(np.array([0.01, 10.0]))
    assert record.applied[0] < record.command[0] - 1e-4
    assert record.applied[1] < record.command[1] - 0.1


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('pair = ["fx", "fz"]', "pair = ['fx', 'fz'], but it must have two different names of fx, fy, thrust"),
        ('pair = ["fx", "fx"]', "have two different names"),
        ('pair = ["fx"]', "have two different names"),
        ("speed_setpoint = 0.0", "speed_setpoint = 0.0, but it must be positive"),
        (
            'pair = ["rest_length", "fx"]\nrest_length = 0.1',
            "rest_length = 0.1, but with this change gains.rest_length",
        ),
    ],
)
def test_what_is_no_command_is_refused(table: str, message: str, tmp_path) -> None:
    file = tmp_path / "experiment.toml"
    file.write_text(f"[command]\n{table}\n")
    with pytest.raises(InputError, match="command") as caught:
        read_experiment(file, [])
    assert message in str(caught.value)


def test_on_uneven_ground_the_command_must_act_late() -> None:
    bounds = with_command("speed_setpoint")
    with pytest.raises(ValueError, match="planned at touchdown"):
        Hopper(command=bounds, ground=UnevenGround(measured_heights=True)).check()
    Hopper(command=with_command("thrust_stiffness"), ground=UnevenGround(measured_heights=True)).check()
    assert Hopper(command=bounds).prior() is None
    assert Hopper(ground=UnevenGround(footholds=True)).prior() is None  # it has another state
    assert Hopper(command=bounds).published() is None


def test_a_landing_angle_needs_less_friction_than_a_force() -> None:
    """The same change of the speed, by either; the floor pulls with P_x, by Eq. 4, which the law does not know."""
    force, angle = Hopper(), Hopper(command=with_command("speed_setpoint"))
    by_force, by_angle = (
        robot.loads(START, np.array([change, -8.0])) for robot, change in ((force, 8.0), (angle, 8.0 * 0.018))
    )
    assert by_angle["friction"] < 0.5 * by_force["friction"]
    assert by_angle["torque [N·m]"] == pytest.approx(by_force["torque [N·m]"], rel=0.1)
