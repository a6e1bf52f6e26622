"""Identification from every tick: it finds the differences of a twin that are parameters of the MuJoCo model."""

from dataclasses import replace

import mujoco.sysid
import numpy as np
import pytest

from benchmarks.learning.methods import tick_identification as sysid
from benchmarks.learning.methods.physical_parameters import PhysicalError, erring_robot, with_error
from benchmarks.learning.methods.tick_identification import (
    BEFORE,
    HIP_ERROR_SCALE,
    HIP_FIT,
    PRIOR_STDS,
    errors,
    identify_values,
    physical_error,
    record_windows,
)
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.tick_row import Tick
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.true_state import TrueState
from stepgap.robots.hopper.twin.twin import Twin

NOMINAL = ApexMap()
ROBOT = NOMINAL.robot
COMMANDS = [(0.0, -4.0), (4.0, -2.0), (-6.0, -6.0), (2.0, 0.0), (-2.0, -8.0), (5.0, -4.0)]
HEAVIER, FRICTION = 0.15, 0.4
TRUE_VALUES = dict.fromkeys(PRIOR_STDS, 0.0) | {"body_mass": HEAVIER, "boom_friction": FRICTION, "torque_lag": 1e-5}
needs_the_toolbox = pytest.mark.skipif(not hasattr(mujoco.sysid, "optimize"), reason="needs stepgap[sysid]")

SENSORS = Twin(ROBOT, RealityGap.none(), np.random.default_rng(0)).sensor_model


@pytest.fixture(scope="module")
def recorded() -> tuple[list[Tick], list[TrueState]]:
    """Hops of a twin heavier than its model, on a boom with friction, and the truth after each tick."""
    ticks, truth = list[Tick](), list[TrueState]()

    def record(rows: Rows, _step: int) -> None:
        ticks.extend(map(Tick.of, rows))
        truth.append(twin.true_state())

    gap = replace(RealityGap.none(), body_mass_scale=1 + HEAVIER, boom_friction=FRICTION)
    twin = Twin(ROBOT, gap, np.random.default_rng(0))
    plant = RigPlant(twin, HopperControl(ROBOT, NOMINAL.gains, NOMINAL.bounds), on_ticks=record, at_once=1)
    plant.start()
    for command in COMMANDS:
        plant.take_step(np.array(command))
    plant.stop()
    return ticks, truth


def test_windows_start_as_the_robot_really_moved(recorded: tuple[list[Tick], list[TrueState]]) -> None:
    ticks, truth = recorded
    windows = record_windows(ticks, SENSORS, 60)
    forces = np.array([tick.reading.contact_force for tick in ticks])
    landings = [k for k in range(HIP_FIT, len(ticks)) if forces[k] > 0 and not forces[k - HIP_FIT : k].any()]
    assert len(windows.start) == len(landings) == 1 + len(COMMANDS)
    for start, landing in zip(windows.start, landings, strict=True):
        true = truth[landing - BEFORE - 1]
        np.testing.assert_allclose(start[0, :2], true.hip, atol=1e-4)
        np.testing.assert_allclose(start[1, :2], true.hip_rate, atol=1e-3)
        np.testing.assert_allclose(start[0, 2:], true.leg, atol=1e-3)  # the leg still follows the speed
        np.testing.assert_allclose(start[1, 2:], true.leg_rate, atol=0.1)


def masses(robot: RobotParameters, torque: float) -> np.ndarray:
    """Quantities that the motion determines: mass, and inertia at the hip forward and up, per torque."""
    mass = robot.body_mass + 2 * (robot.top_mass + robot.bottom_mass)
    booms = np.array([0.0, robot.boom_inertia_horizontal, robot.boom_inertia_vertical])
    return (mass + booms / robot.boom_length**2) / torque


@needs_the_toolbox
def test_with_the_true_parameters_the_model_moves_as_recorded(recorded: tuple[list[Tick], list[TrueState]]) -> None:
    windows = record_windows(recorded[0], SENSORS, 250)
    found = errors(ROBOT, windows, TRUE_VALUES)
    assert found.shape == (windows.hip.size,)
    assert HIP_ERROR_SCALE * np.sqrt(np.mean(found**2)) < 1.5e-3
    light = errors(ROBOT, windows, TRUE_VALUES | {"body_mass": 0.0})
    assert np.linalg.norm(light) > 10 * np.linalg.norm(found)


@needs_the_toolbox
def test_mass_and_friction_are_recovered(
    recorded: tuple[list[Tick], list[TrueState]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sysid, "HIP_ERROR_SCALE", 0.002)  # this twin has smaller model errors
    values = identify_values(ROBOT, recorded[0], SENSORS)
    found, true = physical_error(NOMINAL, values), PhysicalError(HEAVIER, 0, 0, 0, 0, 0, 0, 0)
    np.testing.assert_allclose(
        masses(erring_robot(ROBOT, found), 1 + found.torque), masses(erring_robot(ROBOT, true), 1.0), rtol=0.02
    )
    assert values["boom_friction"] == pytest.approx(FRICTION, rel=0.15)
    state, command = np.array([[0.15, 0.57], [0.3, 0.6]]), np.array([[-3.0, -5.0], [1.0, 0.0]])
    target, before, after = (
        step_map.evaluate(state, command).next_state
        for step_map in (with_error(NOMINAL, true), NOMINAL, with_error(NOMINAL, found))
    )
    assert np.linalg.norm(after - target) < 0.2 * np.linalg.norm(before - target)


def test_offsets_of_the_motors_become_postures() -> None:
    offset = 0.01
    found = physical_error(
        NOMINAL, dict.fromkeys(PRIOR_STDS, 0.0) | {"motor_offset_1": offset, "motor_offset_2": offset}
    )
    # both readings are too large: the leg leans back as much, as if it landed vertically at a higher speed
    assert found == PhysicalError(0, 0, 0, 0, 0, offset / NOMINAL.gains.speed_gain, 0, 0)
    found = physical_error(
        NOMINAL, dict.fromkeys(PRIOR_STDS, 0.0) | {"motor_offset_1": offset, "motor_offset_2": -offset}
    )
    # the knees appear too bent: the leg is longer
    assert found.landing_length == found.rest_length == pytest.approx(0.0011, abs=1e-4)
    assert found.landing_speed == 0
