"""The twin compared with closed-form kinematics, conservation laws, the exact plastic impact and its declared gaps."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import fields, replace
from math import acos, asin, cos, inf, nan, pi, sin
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.model import GroundProfile, build_model
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model

ROBOT = RobotParameters()
NONE = RealityGap.none()
LENGTH = Gains().landing_length
LANDING_ANGLE = acos((0.11**2 + LENGTH**2 - 0.2**2) / (2 * 0.11 * LENGTH))
SILENT = {"touchdown_force", "takeoff_length"}
"""Fields that change only the sensor model."""


def along(angle):
    """Direction of a link at an angle from the downward vertical (forward, up)."""
    return np.array([np.sin(angle), -np.cos(angle)])


def leg_points(alpha_1, alpha_2):
    """Knees (front, rear), joint, foot and the four centres of mass relative to the hip, in closed form."""
    robot = ROBOT
    beta = np.arcsin(robot.top_length * np.sin(alpha_2) / robot.bottom_length)
    front, rear = (robot.top_length * along(alpha_1 + side * alpha_2) for side in (1, -1))
    length = robot.top_length * np.cos(alpha_2) + robot.bottom_length * np.cos(beta)
    joint = length * along(alpha_1)
    foot = joint + robot.foot_length * along(alpha_1 + beta)
    links = {
        alpha_1 + alpha_2: (robot.top_mass, robot.top_inertia, robot.top_com * along(alpha_1 + alpha_2)),
        alpha_1 - alpha_2: (robot.top_mass, robot.top_inertia, robot.top_com * along(alpha_1 - alpha_2)),
        alpha_1 - beta: (robot.bottom_mass, robot.bottom_inertia, front + robot.bottom_com * along(alpha_1 - beta)),
        alpha_1 + beta: (robot.bottom_mass, robot.bottom_inertia, rear + robot.bottom_com * along(alpha_1 + beta)),
    }
    return front, rear, joint, foot, links


def derivative(function, q, direction):
    """Complex-step derivative."""
    return np.imag(function(np.asarray(q) + 1e-30j * np.asarray(direction))) / 1e-30


def mass_matrix(q):
    """Mass matrix in (x, y, α₁, α₂), from the links' velocities; no code of the library."""
    boom = [ROBOT.boom_inertia_horizontal, ROBOT.boom_inertia_vertical]
    matrix = np.diag([*(ROBOT.body_mass + np.array(boom) / ROBOT.boom_length**2), 0, 0])

    def pose(q):
        links = leg_points(q[2], q[3])[4]
        return np.array([[*(q[:2] + com), angle] for angle, (_, _, com) in links.items()])

    jacobian = np.stack([derivative(pose, q, unit) for unit in np.eye(4)], axis=-1)
    for link, (mass, inertia, _) in zip(jacobian, leg_points(q[2], q[3])[4].values(), strict=True):
        matrix += mass * link[:2].T @ link[:2] + inertia * np.outer(link[2], link[2])
    return matrix


def foot_jacobian(q):
    """∂foot/∂q; shape (2, 4)."""
    return np.stack([derivative(lambda q: q[:2] + leg_points(q[2], q[3])[3], q, unit) for unit in np.eye(4)], axis=-1)


def generalised(state):
    """(x, y, α₁, α₂) and its rate."""
    (a, b), (da, db) = state.leg, state.leg_rate
    return np.array([*state.hip, (a + b) / 2, (a - b) / 2]), np.array([*state.hip_rate, (da + db) / 2, (da - db) / 2])


def energy(q, qd):
    """Mechanical energy [J]; the boom has no weight."""
    links = leg_points(q[2], q[3])[4].values()
    weight = ROBOT.body_mass * q[1] + sum(mass * (q[1] + com[1]) for mass, _, com in links)
    return 0.5 * qd @ mass_matrix(q) @ qd + ROBOT.gravity * weight


class Servo:
    """Controller that holds the top links at α₁ ± α₂, stiff enough for hopping."""

    def __init__(self, twin: Twin, alpha_2: float = LANDING_ANGLE, stiffness: float = 20.0, damping: float = 0.4):
        self.twin, self.target = twin, np.array([alpha_2, -alpha_2])
        self.stiffness, self.damping = stiffness, damping
        self.last = None

    def tick(self) -> HopperReading:
        reading = self.twin.read()
        angle = np.array(reading[:2]) * 2 * pi / self.twin.sensor_model.motor_counts
        rate = 0 if self.last is None else (angle - self.last) / self.twin.sensor_model.tick
        self.last = angle
        torque = self.stiffness * (self.target - angle) - self.damping * rate
        self.twin.write(tuple(torque.tolist()))
        return reading


def make(gap: RealityGap = NONE, seed: int = 0, **options: Any) -> Twin:
    twin = Twin(ROBOT, gap, np.random.default_rng(seed), **options)
    twin.connect()
    return twin


def run(twin: Twin, ticks: int, **options) -> list[HopperReading]:
    servo = Servo(twin, **options)
    return [servo.tick() for _ in range(ticks)]


# Geometry and inertia


@pytest.mark.parametrize("seed", range(5))
def test_leg_has_the_closed_form_kinematics(seed: int):
    rng = np.random.default_rng(seed)
    alpha_1, alpha_2 = rng.uniform([-0.6, 0.2], [0.6, 1.4])
    beta = asin(ROBOT.top_length * sin(alpha_2) / ROBOT.bottom_length)
    model = build_model(ROBOT, NONE, 1e-4)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, 0.5, alpha_1 + alpha_2, -alpha_2 - beta, alpha_1 - alpha_2, alpha_2 + beta
    mujoco.mj_kinematics(model, data)
    front, rear, joint, foot, _ = leg_points(alpha_1, alpha_2)
    for found, expected in (
        (data.body("front_bottom").xpos, front),
        (data.body("rear_bottom").xpos, rear),
        (data.site("front_joint").xpos, joint),
        (data.site("rear_joint").xpos, joint),
        (data.geom("foot").xpos, foot),
    ):
        np.testing.assert_allclose(found, [0.3 + expected[0], 0, 0.5 + expected[1]], atol=1e-12)


def test_foot_moves_sideways_as_the_boom_pitches():
    twin = make(replace(NONE, boom_arc=True, ground_friction=0.5), start_height=0.6)
    pitch = asin((0.6 - twin.sensor_model.pivot_height) / ROBOT.boom_length)
    foot = twin.true_state().foot
    depth = -leg_points(0, LANDING_ANGLE)[3][1]
    assert foot[1] == pytest.approx(-ROBOT.boom_length * cos(pitch) - depth * sin(pitch), abs=1e-9)
    assert foot[2] == pytest.approx(0.6 - depth * cos(pitch), abs=1e-9)


def test_flight_conserves_energy_and_momentum_of_the_declared_masses():
    twin = make(tick=1e-4, start_height=0.6, start_speed=0.2, hold=0.0)
    for _ in range(100):
        twin.write((1.0, -0.4))
    values = []
    for _ in range(1500):
        twin.write((0.0, 0.0))
        q, qd = generalised(twin.true_state())
        values.append((energy(q, qd), (mass_matrix(q) @ qd)[0]))
    total, momentum = np.array(values).T
    moved = np.ptp(momentum)
    assert moved < 4e-5 * abs(momentum[0])
    assert np.ptp(total) < 2e-5  # of 10 J, with a kinetic energy of several


def test_body_falls_as_if_gravity_were_weaker():
    twin = make(tick=1e-4, start_height=0.6, hold=0.02)
    servo = Servo(twin, stiffness=2000.0, damping=2.0)
    while twin.true_state().held:
        servo.tick()
    start = twin.true_state()
    for _ in range(1500):
        servo.tick()
    state = twin.true_state()
    mass = ROBOT.body_mass + 2 * (ROBOT.top_mass + ROBOT.bottom_mass)
    acceleration = ROBOT.gravity * mass / (mass + ROBOT.boom_inertia_vertical / ROBOT.boom_length**2)
    assert acceleration == pytest.approx(5.2, abs=0.05)
    assert (start.hip_rate[1] - state.hip_rate[1]) / 0.15 == pytest.approx(acceleration, rel=2e-3)


@pytest.mark.parametrize(("gap", "tick", "error"), [(NONE, 1e-4, 1e-6), (RealityGap(), 1e-3, 5e-6)])
def test_four_bar_stays_closed(gap: RealityGap, tick: float, error: float):
    twin = make(gap, tick=tick, start_height=0.45, hold=0.05)
    servo = Servo(twin)
    worst, data = 0.0, twin._scratch
    for _ in range(round(0.5 / tick)):
        servo.tick()
        twin.true_state()  # computes the positions in `data`
        worst = max(worst, float(np.linalg.norm(data.site("front_joint").xpos - data.site("rear_joint").xpos)))
    assert worst < error


# Ground


@pytest.mark.parametrize("stiffness", [5e3, 5e4, 5e5])
def test_soft_ground_yields_by_load_over_stiffness(stiffness: float):
    gap = replace(NONE, ground_stiffness=stiffness, ground_damping_ratio=0.2)
    twin = make(gap, start_height=LENGTH + 0.051, hold=10.0)
    run(twin, 1500, alpha_2=LANDING_ANGLE - 0.3)
    state = twin.true_state()
    assert state.held
    assert state.contact_force > 10
    assert -state.foot[2] == pytest.approx(state.contact_force / stiffness, rel=1e-3)


@pytest.mark.parametrize("start_speed", [0.0, 0.4])
def test_landing_on_rigid_ground_is_the_plastic_impact(start_speed: float):
    """M (q̇⁺ − q̇⁻) = Jᵀ P, J q̇⁺ = 0 (Eqs. 6, 7)."""

    def held() -> Servo:
        return Servo(make(tick=2e-5, start_height=0.36, start_speed=start_speed, hold=0.01), damping=0.0)

    servo = held()
    ticks = next(count for count in range(20000) if servo.tick().contact_force > 0)
    servo = held()
    for _ in range(ticks - 1):
        servo.tick()
    before = servo.twin.true_state()
    for _ in range(6):
        servo.tick()
    after = servo.twin.true_state()
    q, qd = generalised(before)
    _, found = generalised(after)
    mass, jacobian = mass_matrix(q), foot_jacobian(q)
    saddle = np.block([[mass, -jacobian.T], [jacobian, np.zeros((2, 2))]])
    expected = np.linalg.solve(saddle, np.concatenate([mass @ qd, [0, 0]]))[:4]
    assert np.linalg.norm(jacobian @ qd) > 0.5
    assert np.linalg.norm(jacobian @ found) < 0.01 * np.linalg.norm(jacobian @ qd)
    np.testing.assert_allclose(found, expected, atol=0.015 * np.max(np.abs(expected - qd)))


def test_rigid_ground_keeps_the_foot_where_it_landed():
    twin = make(tick=1e-4, start_height=0.4, start_speed=0.2, hold=0.01)
    servo = Servo(twin)
    feet, forces = [], []
    while twin.true_state().time < 0.28:
        servo.tick()
        state = twin.true_state()
        if forces or state.contact_force > 0:
            feet.append(state.foot)
            forces.append(state.contact_force)
    assert len(forces) > 200
    assert min(forces) > 0
    assert np.ptp(np.array(feet)[:, 0]) < 2e-5
    assert np.max(np.abs(np.array(feet)[5:, 2])) < 1e-4


@pytest.mark.parametrize(("friction", "least", "most"), [(0.3, 2e-3, 0.1), (1e3, 0.0, 1e-4)])
def test_foot_scrubs_sideways_on_the_arc_where_friction_lets_it(friction: float, least: float, most: float):
    twin = make(replace(NONE, boom_arc=True, ground_friction=friction), start_height=0.36, hold=0.01)
    servo = Servo(twin)
    radii = []
    for _ in range(250):
        servo.tick()
        state = twin.true_state()
        if state.contact_force > 0:
            radii.append(np.hypot(*state.foot[:2]))
    assert len(radii) > 50
    assert least <= np.ptp(radii[1:]) <= most  # the first sample is of the impact itself


def test_ground_profile_has_the_declared_roughness_and_slope():
    yaw = np.linspace(0, 2 * pi, 400, endpoint=False)
    rough = GroundProfile(replace(NONE, ground_roughness=1e-3), 1.854, np.random.default_rng(3))
    assert np.std([rough.height(angle) for angle in yaw]) == pytest.approx(1e-3)
    sloped = GroundProfile(replace(NONE, ground_slope=0.01), 1.854, np.random.default_rng(3))
    assert sloped.height(pi / 2) == pytest.approx(1.854 * np.tan(0.01))
    assert not len(GroundProfile(NONE, 1.854, np.random.default_rng(3)).waves)


def test_foot_lands_on_the_ground_where_it_is():
    gap = replace(NONE, boom_arc=True, ground_friction=0.5, ground_slope=0.02)
    twin = make(gap, start_height=0.36, start_speed=0.4, hold=0.01)
    run(twin, 200)
    state = twin.true_state()
    assert state.contact_force > 0
    assert abs(state.ground_height) > 1e-4
    assert state.foot[2] == pytest.approx(state.ground_height, abs=1e-3)


# Sensors and motors


def test_exact_counts_are_the_true_angles():
    twin = make(start_speed=0.3)
    run(twin, 400)
    reading, state, sensors = twin.read(), twin.true_state(), twin.sensor_model
    np.testing.assert_allclose(np.array(reading[:2]) * 2 * pi / sensors.motor_counts, state.leg)
    travelled = reading.boom_horizontal * 2 * pi / sensors.boom_counts_horizontal * sensors.boom_length
    pitch = reading.boom_vertical * 2 * pi / sensors.boom_counts_vertical
    height = sensors.pivot_height + sensors.boom_length * sin(pitch)
    np.testing.assert_allclose([travelled, height], state.hip)


def test_counts_are_the_nearest_integers():
    gap = replace(NONE, motor_counts=500, boom_counts_horizontal=300, boom_counts_vertical=400)
    twin, exact = make(gap, start_speed=0.3), make(start_speed=0.3)
    for _ in range(400):
        for rig in (twin, exact):
            rig.write((0.1, -0.1))
        coarse, fine = twin.read(), np.array(exact.read()[:4])
        scale = np.array([500, 500, 300, 400]) / 16384
        assert all(float(count).is_integer() for count in coarse[:4])
        assert np.max(np.abs(np.array(coarse[:4]) - fine * scale)) <= 0.5 + 1e-9


@pytest.mark.parametrize("arc", [False, True])
def test_boom_encoders_do_not_see_the_deflection(arc: bool):
    gap = replace(NONE, boom_arc=arc, ground_friction=0.3, boom_stiffness=2e3)
    twin = make(gap, start_height=0.42, hold=0.01)
    run(twin, 150)
    state, sensors = twin.true_state(), twin.sensor_model
    seen = sensors.pivot_height + sensors.boom_length * sin(
        twin.read().boom_vertical * 2 * pi / sensors.boom_counts_vertical
    )
    assert abs(state.deflection[1]) > 1e-3
    assert state.hip[1] - seen == pytest.approx(state.deflection[1], rel=0.01)


@pytest.mark.parametrize("hold", [0.0, 10.0])
@pytest.mark.parametrize("delay", [0.0, 2.5e-4, 1e-3, 1.3e-3, 2e-3])
@pytest.mark.parametrize("lag", [0.0, 1.5e-3])
def test_a_step_has_the_mean_torque_after_delay_and_lag(hold: float, delay: float, lag: float):
    """Of the last step of each tick: a step of 1 ms in flight, of 0.25 ms where the held foot is near the ground."""
    gap = replace(NONE, delay=delay, torque_lag=lag, torque_scale=0.9)
    height = LENGTH + ROBOT.foot_length + (2e-3 if hold else 0.2)
    twin, commands = make(gap, start_height=height, hold=hold), np.sin(np.arange(12.0))
    fine, per_tick = 1e-6, 1000
    command = np.concatenate([np.zeros(round(delay / fine)), np.repeat(commands, per_tick)])[: 12 * per_tick]
    torque, now, kept = np.empty_like(command), 0.0, np.exp(-fine / lag) if lag else 0.0
    for i, aim in enumerate(command):
        now = aim + kept * (now - aim)
        torque[i] = now
    steps = 4 if hold else 1
    expected = torque.reshape(12, steps, -1).mean(axis=2)[:, -1]
    for value, mean in zip(commands.tolist(), expected, strict=True):
        twin.write((value, -value))
        np.testing.assert_allclose(twin._data.actuator_force, [0.9 * mean, -0.9 * mean], atol=1e-3)


def test_connecting_discards_delayed_torques():
    twin = make(replace(NONE, delay=3e-3, torque_lag=1e-2))
    for _ in range(10):
        twin.write((5.0, 5.0))
    twin.connect()
    for _ in range(5):
        twin.write((0.0, 0.0))
        assert not twin._data.actuator_force.any()


def test_applied_torque_is_the_limited_one():
    twin = make(replace(NONE, torque_limit=12.0))
    assert twin.write((100.0, -100.0)) == (12.0, -12.0)
    assert twin.write((1.5, -2.5)) == (1.5, -2.5)
    assert make().write((1e6, 0.0)) == (ROBOT.torque_limit, 0.0)


@pytest.mark.parametrize("memory", [0.0, 2e-3])
def test_torque_noise_has_the_declared_standard_deviation_and_correlation_time(memory: float):
    twin = make(replace(NONE, torque_noise=0.2, torque_noise_time=memory), hold=10.0)
    noise = []
    for _ in range(4000):
        twin.write((0.0, 0.0))
        noise.append(twin._data.qfrc_applied[twin._motors[0]])
    assert np.std(noise) == pytest.approx(0.2, rel=0.06)
    expected = np.exp(-1e-3 / memory) if memory else 0.0
    assert np.corrcoef(noise[:-1], noise[1:])[0, 1] == pytest.approx(expected, abs=0.05)


def test_motors_deliver_what_imbalance_and_saturation_leave():
    twin = make(replace(NONE, torque_imbalance=0.1, torque_saturation=30.0))
    assert twin.write((20.0, -40.0)) == (20.0, -40.0), "the drive does not report it"
    np.testing.assert_allclose(
        twin._data.actuator_force, [1.1 * 30 * np.tanh(20 / 30), -0.9 * 30 * np.tanh(40 / 30)], rtol=1e-12
    )


def test_a_motor_encoder_may_have_an_offset():
    gap = replace(NONE, motor_offset_1=0.01, motor_offset_2=-0.02)
    shift = np.array(make(gap).read()[:2]) - make().read()[:2]
    np.testing.assert_allclose(shift * 2 * pi / make().sensor_model.motor_counts, [0.01, -0.02], rtol=1e-9)


@pytest.mark.parametrize("arc", [False, True])
def test_the_boom_bearing_takes_the_declared_momentum(arc: bool):
    """Momentum decreases by friction × time + drag × distance; there is no other difference between the two twins."""
    free = replace(NONE, boom_arc=arc, ground_friction=1.0)
    braked = replace(free, boom_friction=0.3, boom_drag=0.8)
    states = []
    for gap in (free, braked):
        twin = make(gap, tick=1e-4, start_height=0.6, start_speed=0.4, hold=0.02)
        servo = Servo(twin, stiffness=2000.0, damping=2.0)
        for _ in range(1700):
            servo.tick()
        states.append(twin.true_state())
    mass = mass_matrix(generalised(states[0])[0])[0, 0]
    lost = mass * (states[0].hip_rate[0] - states[1].hip_rate[0])
    assert lost == pytest.approx(0.3 * 0.15 + 0.8 * states[1].hip[0], rel=0.01)


def test_a_tilted_boom_axis_accelerates_around_the_circle():
    gap = replace(NONE, boom_arc=True, ground_friction=1.0, boom_tilt=0.02)
    twin = make(gap, tick=1e-4, start_height=0.6, hold=0.02)
    uphill, downhill = (twin.fork(np.random.default_rng(0), turn) for turn in (-pi / 2, pi / 2))
    speeds = []
    for each in (uphill, twin, downhill):
        servo = Servo(each, stiffness=2000.0, damping=2.0)
        for _ in range(1200):
            servo.tick()
        speeds.append(each.true_state().hip_rate[0])
    mass = ROBOT.body_mass + 2 * (ROBOT.top_mass + ROBOT.bottom_mass)
    pull = ROBOT.gravity * sin(0.02) * mass / (mass + ROBOT.boom_inertia_horizontal / ROBOT.boom_length**2)
    np.testing.assert_allclose(speeds, [-pull * 0.1, 0, pull * 0.1], atol=0.02 * pull * 0.1)


# Forks


def forked(twin: Twin) -> Twin:
    return twin.fork(np.random.default_rng(9))


def become_itself(twin: Twin) -> Twin:
    fork = forked(twin)
    fork.become(twin._gap)
    return fork


@pytest.mark.parametrize("copied", [forked, become_itself])
def test_a_copy_of_a_twin_continues_bit_for_bit(copied):
    gap = replace(RealityGap(), torque_noise=0.0, delay=3e-3)
    twin = make(gap, start_height=0.4, start_speed=0.3, hold=0.02)
    servo = Servo(twin)
    for ticks in (15, 60, 120):  # held, in flight, in stance
        for _ in range(ticks):
            servo.tick()
        other = Servo(copied(twin))
        other.last = servo.last
        assert [servo.tick() for _ in range(60)] == [other.tick() for _ in range(60)]
        assert other.twin.true_state().qpos.tolist() == twin.true_state().qpos.tolist()


def test_forks_with_equal_noise_are_equal_and_do_not_change_their_origin():
    twins = [make(RealityGap(), start_height=0.4, start_speed=0.3, hold=0.02) for _ in range(2)]
    for twin in twins:
        run(twin, 60)
    first, same, other = (run(twins[0].fork(np.random.default_rng(seed)), 200) for seed in (1, 1, 2))
    assert first == same != other
    assert run(twins[0], 100) == run(twins[1], 100)


def test_a_fork_on_a_turned_floor_lands_on_the_turned_floor():
    gap = replace(NONE, boom_arc=True, ground_friction=0.5, ground_slope=0.02)
    twin = make(gap, start_height=0.5)
    ahead = twin.true_state().foot[0]  # the foot protrudes
    fork = twin.fork(np.random.default_rng(0), floor_yaw=pi / 2)
    before, after = twin.true_state(), fork.true_state()
    assert before.ground_height == pytest.approx(ahead * np.tan(0.02), rel=0.05)
    assert after.ground_height == pytest.approx(ROBOT.boom_length * np.tan(0.02), rel=1e-3)
    assert after.qpos.tolist() == before.qpos.tolist()
    assert make(gap, start_height=0.5, floor_yaw=pi / 2).true_state().ground_height == after.ground_height


# A change in the midst of the motion


def test_a_twin_that_becomes_heavier_keeps_its_motion_and_then_moves_as_the_heavier_one():
    gap, heavy = RealityGap(torque_noise=0.0), RealityGap(torque_noise=0.0, body_mass_scale=1.3)
    twin, light, heavier = (make(each, start_height=0.4, start_speed=0.3, hold=0.02) for each in (gap, gap, heavy))
    for each in (twin, light):
        run(each, 60)
    twin.become(heavy)
    assert twin.true_state().qpos.tolist() == light.true_state().qpos.tolist()
    assert twin.read() == light.read()
    assert run(twin, 200) != run(light, 200)
    for each in (twin, heavier):
        each.connect()
        run(each, 200)
    assert twin.true_state().qpos.tolist() == heavier.true_state().qpos.tolist()


@pytest.mark.parametrize("change", [{"delay": 3e-3}, {"motor_counts": 1000.0}, {"boom_stiffness": inf}])
def test_a_moving_twin_keeps_its_devices(change):
    with pytest.raises(ValueError, match="keeps its sensors, delays and joints"):
        make(RealityGap()).become(replace(RealityGap(), **change))


# Rig


def test_the_sensor_model_converts_the_counts():
    sensors = make(RealityGap(), tick=5e-4).sensor_model
    assert (sensors.tick, sensors.boom_length, sensors.pivot_height) == (5e-4, 1.854, RealityGap().boom_pivot_height)
    assert (sensors.motor_counts, sensors.boom_counts_horizontal, sensors.boom_counts_vertical) == (16384, 5000, 16384)
    assert (sensors.touchdown_force, sensors.takeoff_length) == (5.0, RealityGap().takeoff_length)
    assert make().sensor_model.motor_counts < inf
    other = twin_sensor_model(RobotParameters(boom_length=1.7), RealityGap(motor_counts=4096, boom_counts_vertical=inf))
    assert (other.boom_length, other.motor_counts, other.boom_counts_vertical) == (1.7, 4096, 16384)


def test_hip_is_held_and_then_released_with_the_start_speed():
    twin = make(RealityGap(), start_height=0.57, start_speed=0.35, hold=0.1)
    run(twin, 99)
    held = twin.true_state()
    assert held.held
    np.testing.assert_allclose(held.hip, [0, 0.57], atol=1e-4)
    run(twin, 1)
    state = twin.true_state()
    assert not state.held
    assert state.hip_rate[0] == pytest.approx(0.35, abs=0.01)


def test_same_seed_gives_the_same_counts():
    gap = replace(RealityGap(), torque_noise=0.3, ground_roughness=2e-3)
    first, second, other = (run(make(gap, seed, start_height=0.4, hold=0.02), 400) for seed in (1, 1, 2))
    assert repr(first) == repr(second)
    assert first != other


def test_connecting_again_restarts_the_motion():
    twin = make(start_height=0.4, hold=0.02)
    first = run(twin, 300)
    twin.connect()
    assert run(twin, 300) == first


def test_true_state_does_not_change_the_motion():
    gap = replace(RealityGap(), ground_slope=0.02)
    watched, unwatched = (make(gap, start_height=0.4, start_speed=0.3, hold=0.02) for _ in range(2))
    servo = Servo(watched)
    readings = []
    for _ in range(300):
        readings.append(servo.tick())
        watched.true_state()
    assert readings == run(unwatched, 300)


CHANGED = {
    "boom_arc": False,
    "boom_drag": 0.5,
    "ground_slope": 0.001,
    "torque_imbalance": 0.02,
    "torque_limit": 0.5,
    "motor_counts": 1000,
    "boom_counts_horizontal": 500,
    "boom_counts_vertical": 500,
}


@pytest.mark.parametrize("name", [field.name for field in fields(RealityGap)])
def test_every_difference_has_an_effect(name: str):
    gap = RealityGap()
    other = replace(gap, **{name: CHANGED.get(name, 1.5 * getattr(gap, name))})
    twin, changed = (make(each, start_height=0.4, start_speed=0.3, hold=0.02) for each in (gap, other))
    same = run(twin, 300) == run(changed, 300) and (twin.true_state().qpos == changed.true_state().qpos).all()
    assert same == (name in SILENT)
    if same:
        assert twin.sensor_model != changed.sensor_model


def test_offset_mass_does_not_matter_in_the_plane():
    twin, offset = (make(replace(NONE, body_com_offset=value), start_height=0.4, hold=0.02) for value in (0, 0.03))
    run(twin, 300)
    run(offset, 300)
    np.testing.assert_allclose(offset.true_state().qpos, twin.true_state().qpos, atol=1e-9)


@pytest.mark.parametrize("torques", [(nan, 0.0), (0.0, inf), (-inf, inf)])
def test_a_torque_that_is_not_a_number_stops_the_rig(torques: tuple[float, float]):
    twin = make(RealityGap())
    twin.write((5.0, -5.0))
    with pytest.raises(RigFault, match="finite"):
        twin.write(torques)
    assert not twin._data.ctrl.any()
    with pytest.raises(RigFault):
        twin.write((0.0, 0.0))
    twin.connect()
    twin.write((0.0, 0.0))


def test_a_motor_that_is_too_fast_stops_the_rig():
    twin = make()
    while max(abs(twin.true_state().leg_rate)) < 400:
        twin.write((40.0, 40.0))
    with pytest.raises(RigFault, match="faster"):
        twin.read()
    assert not twin._data.ctrl.any()


def test_a_rig_that_is_not_connected_neither_reads_nor_moves():
    twin = Twin(ROBOT, NONE, np.random.default_rng(0))
    with pytest.raises(RigFault):
        twin.read()
    with twin:
        twin.read()
    twin.close()
    with pytest.raises(RigFault):
        twin.write((0.0, 0.0))


def test_differences_may_be_numbers_of_numpy():
    gap = RealityGap()
    numbers: dict[str, Any] = {name: np.asarray(value)[()] for name, value in vars(gap).items()}
    with make(gap) as plain, make(RealityGap(**numbers)) as numpy:
        for _ in range(100):
            assert plain.read() == numpy.read()
            plain.write((0.5, 0.5))
            numpy.write((0.5, 0.5))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 1e300), st.booleans())
def test_no_finite_torque_gives_a_reading_that_is_not(seed: int, size: float, perfect: bool):
    rng = np.random.default_rng(seed)
    twin = make(NONE if perfect else RealityGap(), start_height=0.35, hold=0.01)
    try:
        for _ in range(150):
            assert np.isfinite(twin.read()).all()
            twin.write(tuple((size * rng.uniform(-1, 1, 2)).tolist()))
    except RigFault:
        assert not twin._data.ctrl.any()


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"tick": 0.0}, "tick"),
        ({"tick": nan}, "tick"),
        ({"hold": -1.0}, "hold"),
        ({"start_speed": nan}, "start_speed"),
        ({"start_height": 0.2}, "start_height"),
        ({"start_height": inf}, "start_height"),
        ({"start_height": 5.0}, "start_height"),
    ],
)
def test_refuses_an_impossible_start(options: dict[str, Any], name: str):
    with pytest.raises(ValueError, match=name):
        Twin(ROBOT, RealityGap(), np.random.default_rng(0), **options)


def test_a_boom_without_inertia_cannot_be_elastic():
    with pytest.raises(ValueError, match="boom_stiffness"):
        Twin(replace(ROBOT, boom_inertia_vertical=0), RealityGap(), np.random.default_rng(0))


@pytest.mark.parametrize("gap", [NONE, RealityGap()])
def test_exported_model_is_the_twin(gap: RealityGap):
    twin = make(gap)
    model = mujoco.MjModel.from_xml_string(twin.model_xml())
    own = twin._model
    assert [model.joint(i).name for i in range(model.njnt)] == [own.joint(i).name for i in range(own.njnt)]
    np.testing.assert_allclose(model.dof_armature, own.dof_armature, rtol=1e-5)
    np.testing.assert_allclose(model.body_mass, own.body_mass, rtol=1e-5)
    np.testing.assert_allclose(model.pair_solref, own.pair_solref, rtol=1e-5)
    assert model.ngeom > own.ngeom
    assert model.opt.timestep == own.opt.timestep
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 10)
    assert np.isfinite(data.qpos).all()
