"""The compiled run of the twin: to the last bit the single calls of sensors, control, drives and physics."""

from collections.abc import Callable

import numpy as np
import pytest

from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import Mode, Order, TickControl
from stepgap.rigs.rig import Rig, RigFault, Torques
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import NO_COMMAND, HopperControl
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import OVERSPEED, Twin
from stepgap.step import StepRecord, StepStatus
from tests.plants.single_ticks import SingleTicks

ROBOT, WIDE = RobotParameters(), CommandBounds(fx_lower=-80.0, fx_upper=80.0, fy_lower=-90.0, fy_upper=20.0)
CONTROL = HopperControl(ROBOT, Gains(), WIDE)
ORDER = Order(Mode.STEP, 1.0, NO_COMMAND)


UNEVEN = UnevenGround(stair_height=0.02, stair_length=0.1, slope=0.05, roughness=0.002, patch_stiffness=0.3)


def twin(seed: int = 0, gap: RealityGap | None = None, hold: float = 0.3, ground: UnevenGround = FLAT_GROUND) -> Twin:
    gap, rng = gap or RealityGap(), np.random.default_rng(seed)
    return Twin(ROBOT, gap, rng, hold=hold, ground=GroundProfile(gap, ROBOT.boom_length, rng, ground))


def hops(rig: Rig, commands: np.ndarray, at_once: int = 32) -> tuple[np.ndarray, list[StepRecord], str]:
    """All ticks and steps until the robot falls, in two deployments."""
    rows, records = [], []
    with RigPlant(rig, CONTROL, lambda got, step: rows.extend(got), at_once) as plant:
        for _ in range(2):
            plant.start()
            for command in commands:
                records.append(plant.take_step(command))
                if records[-1].status != StepStatus.OK:
                    records.append(plant.take_step(command))  # again, although the robot fell
                    break
        return np.array(rows), records, plant.fault


@pytest.mark.parametrize(
    ("gap", "sizes"),
    [(RealityGap(), (1, 7, 10_000)), (RealityGap.none(), (7,)), (RealityGap(torque_limit=9.0), (7,))],
    ids=["", "none", "weak"],
)
@pytest.mark.parametrize(
    "commands", [[(-5.0, -5.0), (2.0, -8.0), (-7.0, 3.0)], [(80.0, -90.0)] * 10], ids=["", "falls"]
)
def test_it_is_the_single_calls(gap: RealityGap, sizes: tuple[int, ...], commands: list[tuple[float, float]]) -> None:
    rng = np.random.default_rng(3)
    asked = np.array(commands) + rng.normal(0, 0.5, (len(commands), 2))
    singly, expected, fault = hops(SingleTicks(twin(5, gap)), asked)
    assert (expected[-1].status == StepStatus.OK) == (len(commands) == 3)
    for at_once in sizes:
        rows, records, message = hops(twin(5, gap), asked, at_once)
        np.testing.assert_array_equal(rows, singly)
        assert message == fault
        assert len(records) == len(expected)
        for record, other in zip(records, expected, strict=True):
            np.testing.assert_equal(vars(record), vars(other))


def test_it_is_the_single_calls_on_uneven_ground() -> None:
    commands = np.array([(-5.0, -5.0), (2.0, 5.0), (-7.0, 3.0)])
    rows, records, _ = hops(twin(5, ground=UNEVEN), commands, 7)
    singly, expected, _ = hops(SingleTicks(twin(5, ground=UNEVEN)), commands)
    np.testing.assert_array_equal(rows, singly)
    assert len(records) == len(expected) == 6


@pytest.mark.parametrize("hold", [0.0, 0.001, 0.05])
def test_the_hip_is_released_after_the_same_tick(hold: float) -> None:
    commands = np.array([(-5.0, -5.0)])
    np.testing.assert_array_equal(
        hops(twin(1, hold=hold), commands)[0], hops(SingleTicks(twin(1, hold=hold)), commands)[0]
    )


def test_it_mixes_with_single_calls_and_with_forks() -> None:
    """The random numbers are the same, whoever takes them."""
    mixed, single = twin(2), twin(2)
    controls = [CONTROL.control(rig) for rig in (mixed, single)]
    times, applied = [0.0, 0.0], list[Torques]([(0.0, 0.0), (0.0, 0.0)])
    for rig in (mixed, single):
        rig.connect()

    def by_hand(index: int, rig: Twin) -> None:
        torques, _ = controls[index].tick(times[index], rig.read(), ORDER, applied[index])
        applied[index], times[index] = rig.write(torques), times[index] + 1e-3

    for count in (3, 500, 20, 600):
        run = mixed.run(controls[0], times[0], ORDER, applied[0], count)
        assert 1 <= len(run.rows) <= count
        assert run.applied
        times[0], applied[0] = run.time, run.applied
        for _ in run.rows:
            by_hand(1, single)
        by_hand(0, mixed)
        by_hand(1, single)
        assert mixed.read() == single.read()
    forks = [rig.fork(np.random.default_rng(4)) for rig in (mixed, single)]
    run = forks[0].run(controls[0], times[0], ORDER, applied[0], 50)
    for _ in run.rows:
        by_hand(1, forks[1])
    assert forks[0].read() == forks[1].read() != mixed.read()


@pytest.mark.parametrize("at_once", [1, 7, 10_000])
def test_a_fault_while_it_runs_is_that_of_the_single_calls(at_once: int) -> None:
    """The motors become so strong after some hops that they exceed the largest speed."""
    gap = RealityGap(torque_scale=40.0, delay=0.0)
    singly, expected, fault = broken_off(SingleTicks(twin(3, gap)), 1)
    rows, record, message = broken_off(twin(3, gap), at_once)
    np.testing.assert_array_equal(rows, singly)
    assert (record, message) == (expected, fault)


def broken_off(rig: Rig, at_once: int) -> tuple[np.ndarray, str, str]:
    """All ticks of a robot that breaks off in its first hop, the error, and the message of the rig."""
    rows = []
    plant = RigPlant(rig, CONTROL, lambda got, step: rows.extend(got), at_once)
    with pytest.raises(RigFault) as error:
        plant.start()
    plant.stop()
    return np.array(rows), str(error.value), plant.fault


def test_at_least_one_tick_runs_at_once() -> None:
    with pytest.raises(ValueError, match="at_once = 0, but it must be at least 1"):
        RigPlant(twin(), CONTROL, at_once=0)


def break_force(rig: Twin) -> None:
    rig._views.touch[0] = np.nan


def break_motion(rig: Twin) -> None:
    rig._views.qpos[0] = np.nan


def break_speed(rig: Twin) -> None:
    rig._views.qvel[rig._motors[0]] = 2 * OVERSPEED


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (break_force, "a sensor value is not finite: HopperReading("),
        (break_motion, "the motion is no longer within the boom's reach"),
        (break_speed, f"a motor turned faster than {OVERSPEED:g} rad/s"),
    ],
)
def test_a_fault_ends_the_run_with_the_torque_off(fault: Callable[[Twin], None], message: str) -> None:
    rig = twin()
    with RigPlant(rig, CONTROL) as plant:
        plant.start()
        fault(rig)
        record = plant.take_step(np.array([-5.0, -5.0]))
        assert record.status == StepStatus.STOPPED
        assert plant.fault.startswith(message)
        assert np.isnan(record.next_state).all()
        assert not rig._views.ctrl.any()
        assert rig.run(CONTROL.control(rig), 0.0, ORDER, (0.0, 0.0), 5).fault in (message, "the twin is not connected")


def test_it_runs_the_control_of_a_hopper_only() -> None:
    class Other:
        pass

    rig = twin()
    control: TickControl = Other()  # pyright: ignore[reportAssignmentType]
    with pytest.raises(TypeError, match="needs a HopControl, not Other"):
        rig.run(control, 0.0, ORDER, (0.0, 0.0), 5)
    assert rig.run(CONTROL.control(rig), 0.0, ORDER, (0.0, 0.0), 5).fault == "the twin is not connected"
