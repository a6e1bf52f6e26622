"""The contract of all plants, and tests of each one."""

import numpy as np
import pytest

from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.tick.tick_row import TickRow
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepFailed, StepStatus
from tests.plants.single_ticks import SingleTicks

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
COMMAND = np.array([-4.0, -3.0])
CONTROL = HopperControl(ROBOT, GAINS, BOUNDS)


def model_plant(seed):
    return ModelPlant(ApexMap(), np.array([0.2, 0.58]), np.array([0.005, 0.002]), np.random.default_rng(seed))


def twin_plant(seed, gap=RealityGap(), tick=1e-3, **start):  # noqa: B008  (frozen)
    return RigPlant(Twin(ROBOT, gap, np.random.default_rng(seed), tick=tick, **start), CONTROL)


@pytest.fixture(params=[model_plant, twin_plant])
def make_plant(request):
    return request.param


def test_steps_are_chained_and_record_command_and_applied_command(make_plant):
    with make_plant(0) as plant:
        state = plant.start()
        assert state.shape == (2,)
        for _ in range(3):
            record = plant.take_step(COMMAND)
            assert record.status == StepStatus.OK
            np.testing.assert_array_equal(record.state, state)
            np.testing.assert_array_equal(record.command, COMMAND)
            np.testing.assert_array_equal(record.applied, COMMAND)
            assert np.isfinite(record.next_state).all()
            state = record.next_state


def test_the_yaw_after_a_step_is_that_of_the_boom():
    twin = Twin(ROBOT, RealityGap(), np.random.default_rng(0), start_speed=0.3)
    with RigPlant(twin, CONTROL) as plant:
        plant.start()
        for _ in range(3):
            yaw = plant.take_step(COMMAND).context["yaw"]
            assert abs(yaw - twin.true_state().boom[0]) < 2 * np.pi / 5000 + 1e-3  # a count, and a tick's way
            assert yaw > 0.1


def test_a_step_without_an_apex_and_a_map_have_no_yaw():
    with model_plant(0) as plant:
        plant.start()
        assert not plant.take_step(COMMAND).context
    with twin_plant(0) as plant:
        plant.start()
        assert not plant.take_step(np.array([np.nan, 0.0])).context


def test_same_seed_same_steps(make_plant):
    def deployment(seed):
        with make_plant(seed) as plant:
            return [plant.start(), *(plant.take_step(COMMAND).next_state for _ in range(2))]

    np.testing.assert_array_equal(deployment(3), deployment(3))
    assert not np.array_equal(deployment(3), deployment(4))


def test_a_command_beyond_its_bounds_is_applied_at_the_bound(make_plant):
    with make_plant(0) as plant:
        plant.start()
        record = plant.take_step(np.array([0.0, 30.0]))
        np.testing.assert_array_equal(record.command, [0.0, 30.0])
        np.testing.assert_array_equal(record.applied, [0.0, BOUNDS.fy_upper])


def test_a_command_that_is_not_finite_ends_the_deployment(make_plant):
    with make_plant(0) as plant:
        plant.start()
        record = plant.take_step(np.array([np.nan, 0.0]))
        assert record.status != StepStatus.OK
        assert np.isnan(record.next_state).all()


def test_starting_again_is_a_new_deployment(make_plant):
    with make_plant(0) as plant:
        plant.start()
        plant.take_step(COMMAND)
        plant.stop()
        plant.start()
        assert plant.take_step(COMMAND).status == StepStatus.OK
        plant.stop()
        plant.stop()


def test_without_any_gap_the_twin_hops_as_the_model():
    """The strongest test of both."""
    rng, nominal, errors = np.random.default_rng(11), ApexMap(), []
    with twin_plant(0, RealityGap.none(), tick=1e-4, start_height=0.6) as plant:
        state = plant.start()
        for _ in range(6):
            command = rng.uniform([-8, -16], [4, -4])
            try:
                predicted = nominal(state, command)
            except StepFailed:
                pytest.fail("the random command was not one the model survives")
            record = plant.take_step(command)
            errors.append(record.next_state - predicted)
            state = record.next_state
    speed_error, height_error = np.abs(errors).max(axis=0)
    assert speed_error < 0.006
    assert height_error < 0.003


def test_the_hop_after_the_release_is_a_step_from_the_height_at_which_the_robot_was_held():
    plant = twin_plant(0, RealityGap.none(), tick=1e-4)
    assert plant.first_step is None
    with plant:
        state = plant.start()
        first = plant.first_step
        assert first is not None
        assert first.next_state is state
        np.testing.assert_array_equal(first.state, [0.0, 0.55])
        np.testing.assert_array_equal(first.requested, [0.0, 0.0])
        predicted = ApexMap().evaluate(first.state, first.requested).next_state
        assert (np.abs(state - predicted) < [0.006, 0.003]).all()
        assert plant.take_step(COMMAND).state is state


def test_a_rig_whose_robot_is_lowered_by_hand_knows_no_first_step():
    class Lowered(SingleTicks):
        @property
        def released(self) -> tuple[float, ...]:
            return ()

    with RigPlant(Lowered(Twin(ROBOT, RealityGap(), np.random.default_rng(0))), CONTROL) as plant:
        plant.start()
        assert plant.first_step is None


def test_a_first_hop_that_fails_is_a_fault_with_advice():
    with twin_plant(0, RealityGap(torque_limit=1.0)) as plant, pytest.raises(RigFault, match="first step failed"):
        plant.start()  # motors too weak to carry the robot at all


def test_a_fall_is_a_record_with_a_status_and_the_next_deployment_works():
    ticks = []
    bounds = CommandBounds(fx_lower=-80.0, fx_upper=80.0, fy_lower=-90.0, fy_upper=20.0)
    rig = Twin(ROBOT, RealityGap(), np.random.default_rng(0))
    with RigPlant(rig, HopperControl(ROBOT, GAINS, bounds), on_ticks=lambda got, step: ticks.extend(got)) as plant:
        plant.start()
        records = [plant.take_step(np.array([70.0, -60.0]))]
        while records[-1].status == StepStatus.OK and len(records) < 10:
            records.append(plant.take_step(np.array([70.0, -60.0])))
        record = records[-1]
        assert record.status in (StepStatus.FELL, StepStatus.NO_TAKE_OFF, StepStatus.NO_APEX)
        assert np.isnan(record.next_state).all()
        ticks.clear()
        plant.start()
        assert plant.take_step(COMMAND).status == StepStatus.OK


def test_torque_that_the_drives_refuse_reduces_the_applied_command():
    weak = RealityGap(torque_limit=12.0)
    with twin_plant(0, weak) as plant:
        plant.start()
        record = plant.take_step(np.array([0.0, 15.0]))
    assert record.command[1] == 15.0
    assert record.applied[1] < 14.0


@pytest.mark.parametrize("sensor", HopperReading._fields)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_sensor_value_that_is_not_finite_stops_the_robot(sensor, bad):
    """Also the contact force, which enters no torque: without it no landing is detected."""
    rig = SingleTicks(Twin(ROBOT, RealityGap(), np.random.default_rng(0)))
    with RigPlant(rig, CONTROL) as plant:
        plant.start()
        rig.wrong = {sensor: bad}
        record = plant.take_step(COMMAND)
        assert (record.status, plant.fault[:30]) == (StepStatus.STOPPED, "a sensor value is not finite: ")
        with pytest.raises(RigFault):
            rig.write((0.0, 0.0))


def test_every_tick_is_reported_with_torques_within_the_limit():
    ticks = []
    rig = Twin(ROBOT, RealityGap(), np.random.default_rng(0))
    with RigPlant(rig, CONTROL, on_ticks=lambda got, step: ticks.extend(TickRow(*row) for row in got)) as plant:
        plant.start()
        plant.take_step(COMMAND)
    times = np.array([tick.time for tick in ticks])
    np.testing.assert_allclose(np.diff(times), 1e-3)
    applied = np.array([(tick.applied_1, tick.applied_2) for tick in ticks])
    assert np.abs(applied).max() <= min(ROBOT.torque_limit, RealityGap().torque_limit)
    assert {tick.phase for tick in ticks} == {*Phase}


def test_a_constant_command_without_noise_holds_its_limit_cycle():
    """An error that changes with time and not with state or command cannot be learned, and must not be in the twin."""
    quiet = RealityGap(torque_noise=0.0, ground_roughness=0.0, ground_slope=0.0)
    with twin_plant(0, quiet) as plant:
        plant.start()
        heights = [plant.take_step(np.array([-7.0, -6.0])).next_state[1] for _ in range(130)]
    early, late = np.mean(heights[60:80]), np.mean(heights[110:])
    # 0.05 m where the torque's delay grew after a minute; up to 0.006 m by a change of the command by 1e-9 N
    assert abs(late - early) < 0.015
