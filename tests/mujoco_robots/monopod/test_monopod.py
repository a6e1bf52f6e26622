"""The monopod against kinematics of MuJoCo, momentum and symmetry; and that it hops, and turns upright."""

# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.hopping import COMPRESSION, FLIGHT, THRUST
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfSimulator, MjcfStepper
from stepgap.mujoco_robots.monopod.robot import (
    IN_PLACE,
    LEG,
    LONGEST_STRIDE,
    LOWER_LEG_MASS,
    MONOPOD_SPACE,
    TORSO_MASS,
    UPPER_LEG_MASS,
    HoppingGains,
    Monopod,
    body_rotation,
    hip_angles,
    hopping,
    tilt,
)
from stepgap.robots.entry_points import load_robot
from stepgap.step import Array, StepStatus

ROBOT, LAW = Monopod(), HoppingGains().law
RNG = np.random.default_rng(7)
STATES = MONOPOD_SPACE.state_centre + MONOPOD_SPACE.state_scale * RNG.uniform(-1, 1, (8, 8))


def placed(state: Array) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = ROBOT.mjcf_model()
    data = mujoco.MjData(model)
    ROBOT.place(model, data, state)
    mujoco.mj_forward(model, data)
    return model, data


def test_it_is_found_by_its_name_and_has_its_mass() -> None:
    assert isinstance(load_robot("monopod"), Monopod)
    assert ROBOT.mjcf_model().body_mass.sum() == pytest.approx(TORSO_MASS + UPPER_LEG_MASS + LOWER_LEG_MASS)


@pytest.mark.parametrize("state", STATES)
def test_place_and_state_are_inverse_and_the_foot_is_where_it_lands(state: Array) -> None:
    model, data = placed(state)
    np.testing.assert_allclose(ROBOT.state(model, data), state, atol=1e-12)
    gain = LAW.neutral_time + LAW.velocity_gain
    foot = data.geom("foot").xpos - data.xpos[1]
    np.testing.assert_allclose(foot[:2], gain * state[[0, 3]], atol=1e-12)
    assert np.linalg.norm(foot) == pytest.approx(LEG)
    np.testing.assert_allclose(body_rotation(data.qpos[3:7]), data.xmat[1].reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(tilt(data.xmat[1].reshape(3, 3)), state[4:6], atol=1e-12)


def test_the_foot_points_to_its_place_whatever_the_heading_and_not_too_far() -> None:
    model, data = placed(IN_PLACE)
    for quaternion in RNG.normal(size=(6, 4)) * 0.3 + [1, 0, 0, 0]:
        data.qpos[3:7] = quaternion / np.linalg.norm(quaternion)
        data.qpos[7:9] = hip_angles(LAW, body_rotation(data.qpos[3:7]), 0.4, -0.2, 0.01, 0.02)
        mujoco.mj_kinematics(model, data)
        gain = LAW.neutral_time + LAW.velocity_gain
        expected = [gain * 0.4 + 0.01, gain * -0.2 + 0.02]
        np.testing.assert_allclose((data.geom("foot").xpos - data.xpos[1])[:2], expected, atol=1e-12)
    data.qpos[3:7], data.qpos[7:9] = [1, 0, 0, 0], hip_angles(LAW, np.eye(3), 9.0, 9.0, 0.0, 0.0)
    mujoco.mj_kinematics(model, data)
    assert np.hypot(*(data.geom("foot").xpos - data.xpos[1])[:2]) == pytest.approx(LONGEST_STRIDE)


@pytest.mark.parametrize("axis", [0, 1])
def test_in_stance_the_hip_turns_the_body_upright_and_the_leg_is_a_spring(axis: int) -> None:
    """The torque on the body is what is left of its moment of inertia times its acceleration about a pinned leg."""
    state = IN_PLACE.copy()
    state[4 + axis] = 0.05
    model, data = placed(state)
    efforts, command = np.zeros(3), np.array([0.01, 0.01, 7.0])
    position, velocity = data.qpos.copy(), data.qvel.copy()
    position[9], velocity[2] = -0.02, -0.5
    assert hopping(LAW, FLIGHT, True, position, velocity, command, efforts) == COMPRESSION
    assert efforts[2] == pytest.approx(LAW.stiffness * 0.02)
    velocity[8] = 0.1
    assert hopping(LAW, COMPRESSION, True, position, velocity, command, efforts) == THRUST
    assert efforts[2] == pytest.approx(LAW.stiffness * 0.02 - LAW.damping * 0.1 + LAW.thrust + 7.0)
    data.ctrl[:2] = efforts[:2]
    model.opt.gravity[:] = 0
    mujoco.mj_forward(model, data)
    assert data.qacc[3 + axis] < 0, "the tilt is accelerated to zero"
    assert abs(data.qacc[4 - axis]) < 0.05 * abs(data.qacc[3 + axis])
    assert hopping(LAW, THRUST, False, position, velocity, command, efforts) == FLIGHT


def test_a_step_is_symmetric_to_the_middle_plane() -> None:
    """What points to the left changes its sign with what pointed to the left before."""
    simulate = MjcfSimulator(ROBOT)
    mirror = np.array([1, 1, -1, -1, -1, 1, -1, 1])
    for state in 0.4 * (STATES - MONOPOD_SPACE.state_centre) + MONOPOD_SPACE.state_centre:
        command = np.array([-0.005, 0.01, 5.0])
        one, other = simulate(state, command), simulate(mirror * state, command * [1, -1, 1])
        np.testing.assert_allclose(one, mirror * other, atol=1e-6)


def test_angular_momentum_is_kept_in_flight() -> None:
    stepper = MjcfStepper(ROBOT, MjcfGap.none(), np.random.default_rng(0))
    stepper.place(np.array([0.4, 0.72, 0.0, 0.2, 0.03, -0.05, 0.1, 0.2]))
    model, data = stepper._model, stepper._data
    momenta = []
    for _ in range(40):
        stepper._tick(np.array([0.01, -0.02, 0.0]))
        mujoco.mj_subtreeVel(model, data)
        momenta.append(data.subtree_angmom[1].copy())
        assert data.ncon == 0
    np.testing.assert_allclose(momenta, np.broadcast_to(momenta[0], (40, 3)), atol=2e-3)


def test_it_hops_with_random_commands_and_comes_to_rest_without() -> None:
    stepper = MjcfStepper(ROBOT, ROBOT.gap, np.random.default_rng(3))
    stepper.place(IN_PLACE)
    rng = np.random.default_rng(5)
    for _ in range(25):
        assert stepper.step(rng.uniform(-0.2, 0.2, 3) * MONOPOD_SPACE.command_scale) == StepStatus.OK
    for _ in range(15):
        assert stepper.step(np.zeros(3)) == StepStatus.OK
    assert np.abs(stepper.state[[0, 3]]).max() < 0.05
    assert np.abs(stepper.state[4:6]).max() < 0.02


def test_the_linear_map_is_the_model_near_a_hop_in_place() -> None:
    linear, simulate = ROBOT.nominal_maps()["linear"](), MjcfSimulator(ROBOT)
    rng = np.random.default_rng(9)
    for _ in range(6):
        state = IN_PLACE + 0.08 * MONOPOD_SPACE.state_scale * rng.uniform(-1, 1, 8)
        command = 0.08 * MONOPOD_SPACE.command_scale * rng.uniform(-1, 1, 3)
        np.testing.assert_allclose(
            (linear(state, command) - simulate(state, command)) / MONOPOD_SPACE.state_scale, 0, atol=0.08
        )
