"""The noise floor, the standard deviation of repeated steps, on twins with known sources of noise."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.normal import std_interval_95
from stepgap.control.reference import Reference
from stepgap.experiment import noise_floor
from stepgap.experiment.noise_floor import PHASES, REPEATS, _pooled, measure_noise_floor
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.summary import NoiseFloor
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import CommandBounds, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.simulation import TwinPlant
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array, StepRecord, StepStatus
from tests.control.maps import LossyHopper, NeverWorks

ROBOT, NOMINAL = RobotParameters(), ApexMap()
REFERENCE = Reference.from_segments(("speed", "height"), [(1, (0.1, 0.55)), (5, (0.2, 0.58))], steps=9)
ONE_TARGET = Reference.from_segments(("speed", "height"), [(1, (0.2, 0.58))], steps=5)
SILENT = replace(RealityGap(), torque_noise=0.0, ground_roughness=0.0, ground_slope=0.0, boom_tilt=0.0)


def measured(gap: RealityGap, seed: int = 1, reference: Reference = REFERENCE) -> NoiseFloor:
    ground = GroundProfile(gap, ROBOT.boom_length, np.random.default_rng(0))

    def make(rng: np.random.Generator) -> TwinPlant:
        return TwinPlant(Twin(ROBOT, gap, rng, ground=ground), Hopper().control())

    return measure_noise_floor(make, NOMINAL, reference, np.random.default_rng(seed))


def test_a_twin_without_noise_on_an_even_floor_repeats_itself() -> None:
    found = measured(SILENT, reference=ONE_TARGET)
    np.testing.assert_allclose([found.any_phase, found.same_phase], 0, atol=1e-15)


def test_noise_and_yaw_contribute_and_the_seed_determines_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy, tilted = replace(SILENT, torque_noise=0.02), replace(SILENT, boom_tilt=0.01)
    with_noise, with_tilt = measured(noisy), measured(tilted, reference=ONE_TARGET)
    np.testing.assert_allclose(with_noise.same_phase, with_noise.any_phase, rtol=0.4)
    assert with_noise.same_phase[0] > 1e-3
    assert with_tilt.any_phase[0] > 1e-3
    np.testing.assert_allclose(with_tilt.same_phase, 0, atol=1e-15)
    monkeypatch.setattr(noise_floor, "SETTLING", 1)
    monkeypatch.setattr(noise_floor, "PHASES", 2)
    first, again, other = (measured(noisy, seed, ONE_TARGET).any_phase.tolist() for seed in (1, 1, 2))
    assert first == again != other


def test_components_of_variance_are_recovered() -> None:
    rng, yaw_std, noise_std = np.random.default_rng(3), np.array([0.02, 0.001]), np.array([0.01, 0.003])
    groups = [
        rng.normal(size=2)
        + yaw_std * rng.normal(size=(PHASES, 1, 2))
        + noise_std * rng.normal(size=(PHASES, REPEATS, 2))
        for _ in range(2000)
    ]
    found = _pooled(groups, 2)
    np.testing.assert_allclose(found.same_phase, noise_std, rtol=0.03)
    np.testing.assert_allclose(found.any_phase, np.hypot(yaw_std, noise_std), rtol=0.03)
    assert found.steps == 2000 * PHASES * REPEATS


@pytest.mark.parametrize("ratio", [1.0, 5.0])
def test_intervals_contain_the_noise_floor_as_often_as_they_say(ratio: float) -> None:
    """Also where half of the targets have `ratio` times the noise and the yaw dependence of the others."""
    rng, runs, targets, yaw_std, noise_std = np.random.default_rng(5), 800, 20, 0.01, 0.01
    factors = np.where(np.arange(targets) % 2, ratio, 1.0)
    inside = np.zeros(2)
    for _ in range(runs):
        yaw, noise = rng.normal(size=(targets, PHASES, 1, 1)), rng.normal(size=(targets, PHASES, REPEATS, 1))
        found = _pooled([*(factors[:, None, None, None] * (yaw_std * yaw + noise_std * noise))], 1)
        true = np.sqrt(np.mean(factors**2)) * np.array([np.hypot(yaw_std, noise_std), noise_std])
        for row, (std, freedom) in enumerate(
            [(found.any_phase, found.any_phase_freedom), (found.same_phase, found.same_phase_freedom)]
        ):
            low, high = std_interval_95(std, freedom)[:, 0]
            inside[row] += low <= true[row] <= high
    np.testing.assert_allclose(inside / runs, 0.95, atol=0.025)


def test_the_noise_floor_is_proportional_to_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise_floor, "PHASES", 8)
    floors = [
        measured(replace(SILENT, torque_noise=noise), reference=ONE_TARGET).same_phase for noise in (0.004, 0.012)
    ]
    assert floors[1][0] / floors[0][0] == pytest.approx(3, rel=0.2)


def test_a_robot_that_cannot_hop_has_no_noise_floor() -> None:
    robot = Hopper(command=CommandBounds(fy_lower=-200, fy_upper=-190))

    def make(rng: np.random.Generator) -> TwinPlant:
        return TwinPlant(Twin(ROBOT, SILENT, rng), robot.control())

    for maker in (make, lambda rng: None):
        found = measure_noise_floor(maker, NeverWorks(), REFERENCE, np.random.default_rng(0))
        assert np.isnan([found.any_phase, found.same_phase]).all()
        assert found.steps == 0


STAIRS = Reference.from_segments(("speed", "height"), [(k, (0.05 * k, 0.55)) for k in range(1, 9)], steps=8)


class Stumbling(ModelPlant):
    """Falls at one of the targets."""

    def take_step(self, command: Array) -> StepRecord:
        record = super().take_step(command)
        return replace(record, status=StepStatus.FELL) if abs(record.next_state[0] - 0.3) < 0.02 else record


def test_any_number_of_threads_gives_the_same_and_a_fall_costs_one_target() -> None:
    robot, told = LossyHopper(), list[tuple[int, int]]()

    def measured_by(threads: int) -> NoiseFloor:
        return measure_noise_floor(
            lambda rng: Stumbling(robot, (0.0, 0.55), noise=0.001, rng=rng),
            robot,
            STAIRS,
            np.random.default_rng(0),
            lambda done, total: told.append((done, total)),
            threads=threads,
        )

    one, three = measured_by(1), measured_by(3)
    assert one.any_phase.tolist() == three.any_phase.tolist()
    assert told == 2 * [(done, 8) for done in range(9)]
    assert one.steps == 7 * PHASES * REPEATS
    np.testing.assert_allclose(one.any_phase, 0.001, rtol=0.3)


def test_threads_end_when_the_measurement_is_interrupted() -> None:
    robot, begun, interrupted = LossyHopper(), list[object](), threading.Event()
    first = np.random.default_rng(0).spawn(1)[0].bit_generator.state

    def make(rng: np.random.Generator) -> ModelPlant:
        begun.append(rng)
        if rng.bit_generator.state != first:  # in whichever order the threads come here
            interrupted.wait()
        return ModelPlant(robot, (0.0, 0.55), noise=0.001, rng=rng)

    def stop(done: int, total: int) -> None:
        if done:
            interrupted.set()
            raise KeyboardInterrupt

    threads = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        measure_noise_floor(make, robot, STAIRS, np.random.default_rng(0), stop, threads=2)
    assert threading.active_count() == threads
    assert len(begun) < len(STAIRS)
