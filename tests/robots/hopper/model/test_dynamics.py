"""Equations of motion, impact, torque laws and leg compared with SymPy's derivation from the links' positions."""

import numpy as np
import pytest

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import (
    energy,
    flight_acceleration,
    impact,
    masses_of,
    stance_acceleration,
    terms,
)
from stepgap.robots.hopper.model.joint_control import flight_torque, joint_law, landing_posture, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar, knee_angle, leg_of
from tests.robots.hopper.model.lagrangian import oracle

ROBOT, COUNT = RobotParameters(), 1000
MASSES, LEG = masses_of(ROBOT), leg_of(ROBOT)
MOTORS = np.array([[1, 1], [1, -1]])


def random_states(seed: int, count: int = COUNT):
    """Configurations and rates; the leg bent and anywhere up to 1.2 rad from the vertical."""
    rng = np.random.default_rng(seed)
    q = rng.uniform([-2, 0.1, -1.2, 0.05], [2, 1.5, 1.2, 2.8], (count, 4))
    return zip(q, rng.normal(0, [2, 3, 10, 20], (count, 4)), strict=True)


def model(q, qd):
    """Mass matrix, bias, foot Jacobian and J̇q̇ of the model, assembled from their named entries."""
    bar = four_bar(LEG, q[3])
    m, toe = terms(MASSES, bar, q[2], q[3], qd[2], qd[3]), foot(LEG, bar, q[2])
    mass = np.array([[m.x, 0, m.x_1, m.x_2], [0, m.y, m.y_1, m.y_2], [m.x_1, m.y_1, m.a, 0], [m.x_2, m.y_2, 0, m.d]])
    bias = np.array([m.n_x, m.n_y, m.n_1, m.n_2])
    jacobian = np.array([[1, 0, toe.x_1, toe.x_2], [0, 1, toe.y_1, toe.y_2]])
    mixed, second = np.array([toe.x_12, toe.y_12]), np.array([toe.x_22, toe.y_22])
    drift = -np.array([toe.x, toe.y]) * qd[2] ** 2 + 2 * mixed * qd[2] * qd[3] + second * qd[3] ** 2
    return m, toe, mass, bias, jacobian, drift


def assert_close(found, expected, relative: float = 1e-9) -> None:
    """Asserts equality relative to the largest entry of the array."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert np.abs(found - expected).max() <= relative * max(1.0, np.abs(expected).max())


def pinned(mass, jacobian, force, drift):
    """Solution of [[M, −Jᵀ], [J, 0]] (·, P) = (force, drift), the paper's own form."""
    left = np.block([[mass, -jacobian.T], [jacobian, np.zeros((2, 2))]])
    return np.linalg.solve(left, np.concatenate([force, drift]))


def test_terms_agree_with_the_lagrangian() -> None:
    mass_of, bias_of, jacobian_of, drift_of, energy_of, foot_of = oracle(ROBOT)
    for q, qd in random_states(0):
        _, toe, mass, bias, jacobian, drift = model(q, qd)
        assert_close(mass, mass_of(q, qd))
        assert_close(bias, bias_of(q, qd))
        assert_close(jacobian, jacobian_of(q, qd))
        assert_close(drift, drift_of(q, qd))
        assert_close(energy(MASSES, q, qd), energy_of(q, qd))
        assert_close(q[:2] + np.array([toe.x, toe.y]), foot_of(q, qd))


@pytest.mark.parametrize("robot", [ROBOT, RobotParameters(top_mass=0.4, bottom_mass=0.3, boom_inertia_vertical=0.0)])
def test_accelerations_ground_force_and_impact_solve_the_papers_full_systems(robot) -> None:
    rng, masses = np.random.default_rng(2), masses_of(robot)
    mass_of, bias_of, jacobian_of, drift_of, _, _ = oracle(robot)
    for q, qd in random_states(3, 500):
        torque = rng.normal(0, 20, 2)
        m, toe = terms(masses, four_bar(LEG, q[3]), *q[2:], *qd[2:]), foot(LEG, four_bar(LEG, q[3]), q[2])
        mass, jacobian = mass_of(q, qd), jacobian_of(q, qd)
        force = np.array([0, 0, *MOTORS @ torque]) - bias_of(q, qd)
        assert_close(flight_acceleration(m, *torque), np.linalg.solve(mass, force))
        expected = pinned(mass, jacobian, force, -drift_of(q, qd))
        assert_close(stance_acceleration(m, toe, *qd[2:], *torque), expected)
        assert_close(impact(m, toe, *qd), pinned(mass, jacobian, mass @ qd, [0, 0])[:4])


def test_stance_torque_causes_the_intended_force_on_the_body() -> None:
    """A leg of almost no mass at rest: the ground returns what the torques command; the hip is pushed by it."""
    light = RobotParameters(top_mass=1e-12, bottom_mass=1e-12, top_inertia=1e-14, bottom_inertia=1e-14)
    masses, gains = masses_of(light), Gains(stiffness=700.0, rest_length=0.3)
    law, rng = joint_law(light, gains), np.random.default_rng(8)
    for q, _ in random_states(9, 300):
        command = rng.normal(0, 30, 2)
        bar = four_bar(LEG, q[3])
        toe = foot(LEG, bar, q[2])
        torque = stance_torque(law, bar, toe, np.sin(q[2]), np.cos(q[2]), *command)
        motion = stance_acceleration(terms(masses, bar, q[2], q[3], 0.0, 0.0), toe, 0.0, 0.0, *torque)
        length = 0.11 * np.cos(q[3]) + np.sqrt(0.2**2 - (0.11 * np.sin(q[3])) ** 2)
        wanted = -700.0 * (length - 0.3) * np.array([-np.sin(q[2]), np.cos(q[2])]) + command
        assert_close(motion[4:], wanted, 1e-7)
        assert_close([masses.x * motion[0], masses.y * motion[1] + masses.weight], wanted, 1e-7)


def test_flight_torque_is_a_servo_on_the_leg_angles() -> None:
    gains = Gains(speed_gain=0.3, speed_setpoint=0.15, landing_length=0.25, position_gain=30.0, damping_gain=0.6)
    law, knee = joint_law(ROBOT, gains), knee_angle(LEG, 0.25)
    assert landing_posture(law, 0.4) == pytest.approx((0.3 * 0.25, knee))
    assert four_bar(LEG, knee).length == pytest.approx(0.25, abs=1e-15)
    generalised = MOTORS @ flight_torque(law, 0.3, 1.0, 2.0, -3.0, 0.4)
    assert generalised == pytest.approx([-30 * (0.3 - 0.075) - 0.6 * 2.0, -30 * (1.0 - knee) + 0.6 * 3.0])


def test_knee_angle_inverts_the_leg_length() -> None:
    for alpha_2 in np.random.default_rng(10).uniform(0.02, np.pi - 0.02, COUNT):
        assert knee_angle(LEG, four_bar(LEG, alpha_2).length) == pytest.approx(alpha_2, abs=1e-11)
    assert knee_angle(LEG, 0.31) == pytest.approx(0, abs=1e-7)
    assert knee_angle(LEG, 0.09) == pytest.approx(np.pi, abs=1e-7)
