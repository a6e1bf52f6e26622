"""The reduced motion compared with the full motion of hip and leg, and with conservation laws."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stepgap.base.compiled import compiled
from stepgap.hybrid.integrator import TIME_OUT, Tolerance, integrate, make_trace
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import energy, impact, masses_of, terms
from stepgap.robots.hopper.model.joint_control import JointLaw, joint_law
from stepgap.robots.hopper.model.leg import foot, four_bar, leg_of
from stepgap.robots.hopper.model.reduced import (
    Hip,
    Stance,
    flight_motion,
    flight_of,
    hip_in_flight,
    piece_guards,
    stance_motion,
)
from tests.robots.hopper.model.reference_hop import Hopper

UNEQUAL = RobotParameters(boom_inertia_vertical=3.0, top_mass=0.2, torque_limit=1e9)
ROBOTS = [RobotParameters(torque_limit=1e9), UNEQUAL]
FINE = Tolerance(1e-13, 1e-14)


@compiled
def integrated(system, time, state, time_limit, tolerance, h, trace):
    """`integrate`, compiled with a cache; without one, each process would compile it again."""
    return integrate(system, time, state, time_limit, tolerance, h, trace)


def random_motions(seed: int, count: int):
    """Random full states (x, y, α₁, α₂, ẋ, ẏ, α̇₁, α̇₂)."""
    rng = np.random.default_rng(seed)
    lower, upper = [0, 0.3, -0.9, 0.1, -1, -3, -10, -20], [0, 1.5, 0.9, 2.4, 1, 3, 10, 20]
    return rng.uniform(lower, upper, (count, 8))


def parts(motion):
    """Hip and leg of a full state."""
    return Hip(motion[1], motion[4], motion[5]), (motion[2], motion[3], motion[6], motion[7])


def close(found, expected, relative=1e-12) -> bool:
    """Whether arrays are equal relative to their largest entry."""
    return np.abs(np.subtract(found, expected)).max() <= relative * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("robot", ROBOTS)
def test_in_flight_the_leg_moves_as_in_the_full_motion(robot) -> None:
    hopper, masses, law = Hopper(robot, Gains()), masses_of(robot), joint_law(robot, Gains())
    for motion in random_motions(0, 300):
        hip, leg = parts(motion)
        rate, found, clearance, torques = flight_motion(flight_of(masses, law, 1.0, 0.0, hip, leg), 0.0, leg)
        expected = hopper.flight_rate(motion)
        assert close(rate, expected[[2, 3, 6, 7]])
        assert close(found, hip)
        assert clearance == pytest.approx(hopper.foot(motion[:4], motion[4:])[1], abs=1e-12)
        force = hopper.flight_force(motion)[2:]
        assert close(torques, [(force[0] + force[1]) / 2, (force[0] - force[1]) / 2])


@pytest.mark.parametrize("robot", ROBOTS)
def test_in_stance_the_leg_moves_as_in_the_full_motion(robot) -> None:
    hopper, masses, law = Hopper(robot, Gains()), masses_of(robot), joint_law(robot, Gains())
    rng, leg_lengths = np.random.default_rng(1), leg_of(robot)
    for motion in random_motions(2, 300):
        _, leg = parts(motion)
        toe = foot(leg_lengths, four_bar(leg_lengths, leg[1]), leg[0])
        motion[4:6] = -toe.x_1 * leg[2] - toe.x_2 * leg[3], -toe.y_1 * leg[2] - toe.y_2 * leg[3]
        motion[:2] = -toe.x, -toe.y
        command = rng.normal(0, 20, 2)
        rate, hip, force, _ = stance_motion(Stance(masses, law, 1.0, command[0], command[1], 0.0, 0.0), leg)
        acceleration, ground = hopper.stance(motion, command)
        assert close(rate, [leg[2], leg[3], *acceleration[2:]])
        assert close(hip, motion[[1, 4, 5]])
        assert force == pytest.approx(ground[1], rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_hip_follows_from_the_leg_during_a_whole_flight(robot) -> None:
    hopper, masses, law = Hopper(robot, Gains()), masses_of(robot), joint_law(robot, Gains())
    start = np.array([0.0, 2.0, 0.1, 0.8, 0.3, 1.5, 3.0, -5.0])
    path = solve_ivp(lambda _, s: hopper.flight_rate(s), (0, 0.2), start, "DOP853", [0.05, 0.2], rtol=1e-12, atol=1e-13)
    flight = flight_of(masses, law, 1.0, 0.0, *parts(start))
    for time, motion in zip(path.t, path.y.T, strict=True):
        hip, leg = parts(motion)
        m = terms(masses, four_bar(masses.leg, leg[1]), *leg)
        assert close(hip_in_flight(flight, m, time, leg), hip, 1e-11)


def test_saturated_motors_give_their_limit_until_the_law_requests_less() -> None:
    robot = RobotParameters(torque_limit=3.0)
    hopper, masses, law = Hopper(robot, Gains()), masses_of(robot), joint_law(robot, Gains())
    seen = set()
    for motion in random_motions(3, 300):
        hip, leg = parts(motion)
        flight = flight_of(masses, law, 1.0, 0.0, hip, leg)
        torques = flight_motion(flight, 0.0, leg)[3]
        modes = [float(np.sign(torque)) if abs(torque) > 3.0 else 0.0 for torque in torques]
        flight = flight._replace(mode_1=modes[0], mode_2=modes[1])
        assert close(flight_motion(flight, 0.0, leg)[0], hopper.flight_rate(motion)[[2, 3, 6, 7]])
        assert min(piece_guards(flight, 1.0, hip, leg, torques)[4:]) >= 0.0
        seen.add(tuple(modes))
    assert len(seen) == 9


def without_torque() -> JointLaw:
    """Torque law of motors without torque."""
    return joint_law(RobotParameters(), Gains())._replace(
        stiffness=0.0, position_gain=0.0, damping_gain=0.0, torque_limit=1e9
    )


@pytest.mark.parametrize("seed", range(3))
def test_without_torque_flight_keeps_energy(seed) -> None:
    rng, masses = np.random.default_rng(seed), masses_of(RobotParameters())
    hip, leg = Hip(3.0, 0.5, -1.0), tuple(rng.uniform([-0.3, 0.9, -2, -2], [0.3, 1.3, 2, 2]))
    flight = flight_of(masses, without_torque(), -1.0, 0.0, hip, leg)

    def kept(time, leg):
        hip = flight_motion(flight, time, leg)[1]
        return energy(masses, np.array([0, hip.height, *leg[:2]]), np.array([hip.speed_x, hip.speed_y, *leg[2:]]))

    time, end, event, _ = integrated(flight, 0.0, leg, 0.1, FINE, 1e-4, make_trace())
    assert event == TIME_OUT
    assert kept(time, end) == pytest.approx(kept(0.0, leg), rel=1e-11)


def test_in_stance_energy_with_the_spring_is_kept_until_the_command() -> None:
    """With the motors as an ideal spring, energy + ½ K₂ (ℓ − ℓ₀)² is constant.

    The toe is not on the leg axis, so the motors are a spring along the axis only without a toe.
    """
    robot = RobotParameters(foot_length=0.0)
    masses, law, leg = masses_of(robot), joint_law(robot, Gains()), leg_of(robot)
    angles = 0.04, float(law.landing_angle)
    bar = four_bar(leg, angles[1])
    m, toe = terms(masses, bar, *angles, 0.0, 0.0), foot(leg, bar, angles[0])
    start = (*angles, *impact(m, toe, 0.3, -1.0, 0.0, 0.0)[2:])
    stance = Stance(masses, law, -1.0, 0.0, 0.0, 0.0, 0.0)

    def kept(state):
        hip = stance_motion(stance, state)[1]
        spring = 0.5 * law.stiffness * (four_bar(leg, state[1]).length - law.rest_length) ** 2
        q, qd = [0, hip.height, *state[:2]], [hip.speed_x, hip.speed_y, *state[2:]]
        return energy(masses, np.array(q), np.array(qd)) + spring

    _, end, event, _ = integrated(stance, 0.0, start, 1.0, FINE, 1e-4, make_trace())
    assert event == 1  # mid-stance
    assert stance_motion(stance, end)[1].speed_y == pytest.approx(0, abs=1e-12)
    assert kept(end) == pytest.approx(kept(start), abs=1e-10)
