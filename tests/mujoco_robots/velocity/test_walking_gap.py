"""The gap of walking robots against statics."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import WalkingGap

MODEL = TrottingRobot().mjcf_model()
NONE = WalkingGap.none()


def force(model: mujoco.MjModel, angles: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Forces of the servos at rest."""
    data = mujoco.MjData(model)
    data.qpos[7:], data.ctrl[:] = angles, control
    mujoco.mj_forward(model, data)
    return data.actuator_force.copy()


def test_without_differences_the_model_is_the_same() -> None:
    same = NONE.of(MODEL)
    for name in (
        "body_mass",
        "body_ipos",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_forcerange",
        "dof_damping",
    ):
        np.testing.assert_array_equal(getattr(same, name), getattr(MODEL, name))


def test_a_load_moves_the_centre_of_mass_to_that_of_both() -> None:
    place = np.array([0.1, -0.05, 0.06])
    loaded = replace(NONE, payload=2.0, payload_x=0.1, payload_y=-0.05, payload_z=0.06).of(MODEL)
    mass = MODEL.body_mass[1]
    assert loaded.body_mass[1] == pytest.approx(mass + 2.0)
    np.testing.assert_allclose(loaded.body_ipos[1] * (mass + 2.0), mass * MODEL.body_ipos[1] + 2.0 * place)


def test_a_weaker_servo_holds_the_same_position_with_less_force() -> None:
    weak = replace(NONE, gear_scale=0.8).of(MODEL)
    angles, control = np.full(12, 0.1), np.full(12, 0.12)
    np.testing.assert_allclose(force(weak, angles, control), 0.8 * force(MODEL, angles, control))
    np.testing.assert_allclose(force(weak, angles, angles), 0.0, atol=1e-12)
    np.testing.assert_allclose(weak.actuator_forcerange, 0.8 * MODEL.actuator_forcerange)


def test_an_individual_has_its_own_zeros_and_strengths_of_its_motors() -> None:
    gap = replace(NONE, joint_offset=0.02, motor_spread=0.1, individual=3.0)
    angles = np.zeros(12)
    offsets = gap.of(MODEL).actuator_biasprm[:, 0] / gap.of(MODEL).actuator_gainprm[:, 0]
    np.testing.assert_allclose(force(gap.of(MODEL), offsets, angles), 0.0, atol=1e-9)
    assert 0.005 < offsets.std() < 0.04
    scale = gap.of(MODEL).actuator_gainprm[:, 0] / MODEL.actuator_gainprm[:, 0]
    assert (np.abs(scale - 1) <= 0.1).all()
    assert np.ptp(scale) > 0.02
    np.testing.assert_array_equal(gap.of(MODEL).actuator_biasprm, gap.of(MODEL).actuator_biasprm)
    other = replace(gap, individual=4.0).of(MODEL)
    assert np.abs(other.actuator_biasprm - gap.of(MODEL).actuator_biasprm).max() > 0.1


def test_random_gaps_are_other_individuals_within_the_ranges() -> None:
    gaps = [WalkingGap.random(np.random.default_rng(number)) for number in range(20)]
    assert len({gap.individual for gap in gaps}) == 20
    assert all(gap.individual == int(gap.individual) and 0 <= gap.payload <= 3 for gap in gaps)
    with pytest.raises(ValueError, match="individual"):
        WalkingGap(individual=0.5)
