"""The reduced motion compared with the full motion of hip and leg."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import masses_of, terms
from stepgap.robots.hopper.model.joint_control import joint_law
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
