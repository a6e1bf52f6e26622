"""Equations of motion, impact, torque laws and leg compared with independent derivations.

`lagrangian.oracle` is SymPy's from the links' positions; `tests.robots.hopper.model.tree` has MuJoCo's open tree.
"""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import (
    energy,
    flight_acceleration,
    impact,
    masses_of,
    pinned_mass,
    stance_acceleration,
    terms,
)
from stepgap.robots.hopper.model.joint_control import flight_torque, joint_law, landing_posture, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar, knee_angle, leg_of
from tests.robots.hopper.model.lagrangian import oracle
from tests.robots.hopper.model.tree import ideal_tree, tree_terms

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


def test_terms_agree_with_mujocos_open_tree_closed_by_its_tangent_map() -> None:
    tree = ideal_tree(ROBOT)
    for q, qd in random_states(1):
        _, _, mass, bias, _, _ = model(q, qd)
        tree_mass, tree_bias = tree_terms(tree, ROBOT, q, qd)
        assert_close(mass, tree_mass)
        assert_close(bias, tree_bias)


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


def test_mass_matrices_are_positive_definite() -> None:
    for q, qd in random_states(4):
        m, toe, mass, _, _, _ = model(q, qd)
        a, b, d = pinned_mass(m, toe)
        assert np.linalg.eigvalsh(mass).min() > 0
        assert np.linalg.eigvalsh([[a, b], [b, d]]).min() > 0


@pytest.mark.parametrize("phase", ["flight", "stance"])
def test_energy_changes_at_the_power_of_the_motors(phase) -> None:
    """Ė = ∂E/∂q q̇ + ∂E/∂q̇ q̈ by central differences along the motion; in stance the foot is at rest."""
    rng, h = np.random.default_rng(5), 1e-5
    for q, qd in random_states(6, 200):
        m, toe, *_ = model(q, qd)
        torque = rng.normal(0, 10, 2)
        if phase == "flight":
            acceleration = np.array(flight_acceleration(m, *torque))
        else:
            qd = np.array([-toe.x_1 * qd[2] - toe.x_2 * qd[3], -toe.y_1 * qd[2] - toe.y_2 * qd[3], qd[2], qd[3]])
            acceleration = np.array(stance_acceleration(m, toe, *qd[2:], *torque)[:4])
        size = h / max(1.0, np.abs(qd).max(), np.sqrt(np.abs(acceleration).max()))
        ends = [energy(MASSES, q + s * qd + 0.5 * s**2 * acceleration, qd + s * acceleration) for s in (-size, size)]
        power = qd[2:] @ MOTORS @ torque
        scale = 1 + np.abs(qd).max() * (np.abs(MASSES.weight) + np.abs(acceleration).max() * MASSES.x)
        assert (ends[1] - ends[0]) / (2 * size) == pytest.approx(power, abs=1e-6 * scale)


def test_impact_stops_the_foot_and_never_adds_energy() -> None:
    for q, qd in random_states(7):
        m, toe, mass, _, jacobian, _ = model(q, qd)
        after = np.array(impact(m, toe, *qd))
        assert np.abs(jacobian @ after).max() <= 1e-12 * max(1, np.abs(after).max())
        assert energy(MASSES, q, after) <= energy(MASSES, q, qd) + 1e-12 * (qd @ mass @ qd)
        assert_close(impact(m, toe, *after), after, 1e-11)  # a foot at rest has no impact


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


def test_leg_is_two_triangles_and_a_toe() -> None:
    """Knees ℓ₁ from the hip, bottom links ℓ₂ to a common joint on the leg axis, the toe ℓ₃ further along one."""
    for q, _ in random_states(11, 200):
        a1, a2 = q[2:]
        bar = four_bar(LEG, a2)
        toe = foot(LEG, bar, a1)
        joint = bar.length * np.array([np.sin(a1), -np.cos(a1)])
        knees = [LEG.top * np.array([np.sin(a), -np.cos(a)]) for a in (a1 + a2, a1 - a2)]
        assert [np.linalg.norm(joint - knee) for knee in knees] == pytest.approx([LEG.bottom] * 2)
        along = (joint - knees[1]) / LEG.bottom
        assert_close([toe.x, toe.y], joint + LEG.foot * along, 1e-14)
        axis = np.array([np.cos(a1), np.sin(a1)])
        assert axis @ ([toe.x, toe.y] - joint) > 0  # in front of the leg axis


def test_leg_derivatives_match_central_differences() -> None:
    h = 1e-6
    for q, _ in random_states(12, 200):
        a1, a2 = q[2:]
        bar = four_bar(LEG, a2)
        toe = foot(LEG, bar, a1)
        ahead, behind = four_bar(LEG, a2 + h), four_bar(LEG, a2 - h)
        assert (ahead.length - behind.length) / (2 * h) == pytest.approx(bar.d_length, abs=1e-8)
        assert (ahead.d_length - behind.d_length) / (2 * h) == pytest.approx(bar.dd_length, abs=1e-8)
        assert (ahead.sin_beta - behind.sin_beta) / (2 * h) == pytest.approx(bar.cos_beta * bar.d_beta, abs=1e-8)
        assert (ahead.d_beta - behind.d_beta) / (2 * h) == pytest.approx(bar.dd_beta, abs=1e-8)
        one = (np.array(foot(LEG, bar, a1 + h)) - np.array(foot(LEG, bar, a1 - h))) / (2 * h)
        two = (np.array(foot(LEG, ahead, a1)) - np.array(foot(LEG, behind, a1))) / (2 * h)
        assert one[:2] == pytest.approx([toe.x_1, toe.y_1], abs=1e-8)
        assert one[2:6] == pytest.approx([-toe.x, -toe.y, toe.x_12, toe.y_12], abs=1e-8)
        assert two[:6] == pytest.approx([toe.x_2, toe.y_2, toe.x_12, toe.y_12, toe.x_22, toe.y_22], abs=1e-8)


def test_boom_adds_inertia_but_no_weight() -> None:
    with_boom, without = masses_of(ROBOT), masses_of(replace(ROBOT, boom_inertia_vertical=0, boom_inertia_horizontal=0))
    assert with_boom.weight == without.weight == pytest.approx((1.466 + 2 * 0.043 + 2 * 0.047) * 9.81)
    assert with_boom.x - without.x == pytest.approx(ROBOT.boom_inertia_horizontal / ROBOT.boom_length**2)
    assert with_boom.y - without.y == pytest.approx(ROBOT.boom_inertia_vertical / ROBOT.boom_length**2)
