"""The twin on uneven ground: treads carry the foot, risers stop it, ramps tilt its contact, patches yield more."""

from contextlib import closing
from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.model.dynamics import masses_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.plants.single_ticks import SingleTicks
from tests.robots.hopper.twin.test_twin import LANDING_ANGLE, LENGTH, Servo

ROBOT, GAP = RobotParameters(), RealityGap()
RADIUS = ROBOT.boom_length
STAIRS = UnevenGround(stair_height=0.05, stair_length=0.3)


def profile_of(ground, gap=GAP, seed=0):
    return GroundProfile(gap, RADIUS, np.random.default_rng(seed), ground)


def twin_on(ground, yaw=0.3, gap=GAP, seed=0, **start):
    return Twin(ROBOT, gap, np.random.default_rng(seed), ground=profile_of(ground, gap, seed), floor_yaw=yaw, **start)


def yaw_of(twin, state, floor_yaw):
    """Yaw of the floor under the foot [rad]."""
    return np.arctan2(state.foot[0], -state.foot[1]) + floor_yaw


def hopping(twin, hops=6):
    """True states in every tick of some hops."""
    states = []
    control = HopperControl(ROBOT, Gains(), CommandBounds(), ground=STAIRS)
    with RigPlant(SingleTicks(twin), control, lambda rows, step: states.append(twin.true_state())) as plant:
        plant.start()
        for _ in range(hops):
            if plant.take_step(np.array([-4.0, 8.0])).status != StepStatus.OK:
                break
    return states


@pytest.mark.parametrize("seed", range(3))
def test_the_foot_is_never_in_the_ground(seed):
    """By the profile alone, which knows nothing of planes that move: neither deep in a tread nor far behind a riser."""
    floor_yaw, ground = 0.7 * seed, STAIRS
    twin, profile = twin_on(ground, floor_yaw, seed=seed), profile_of(ground, seed=seed)
    states, landed = hopping(twin), set()
    for state in states:
        yaw = yaw_of(twin, state, floor_yaw)
        depth = profile.height(yaw) - state.foot[2]
        if depth > 4e-3:  # deeper than soft ground yields: then it can only stand against a riser
            assert min(profile.height(yaw + side * 2e-3 / RADIUS) for side in (-1, 1)) - state.foot[2] < 4e-3
        if state.contact_force > 20:
            landed.add(profile.tread_at(yaw))
            near = [profile.height(yaw + side * 2e-3 / RADIUS) for side in (-1, 0, 1)]  # on an edge, either tread
            assert np.abs(np.array(near) - state.ground_height).min() < 2e-3 or depth > 0
    assert len(landed) > 2


def test_a_riser_stops_the_foot():
    """A leg that swings level against it, below its edge, comes no further; above its edge it does."""
    ground, gap = UnevenGround(stair_height=0.1, stair_length=1.0), replace(RealityGap.none(), ground_friction=0.5)
    profile = profile_of(ground, gap, seed=3)
    treads = profile.treads
    assert treads is not None
    rising = int(np.argmax(np.diff(treads.height)))
    edge, rise = float(treads.start[rising + 1]), float(np.diff(treads.height)[rising])
    assert rise > 0.05
    reached = {}
    for clearance in (-0.02, 0.02):
        yaw = (edge - 0.1) / RADIUS
        height = 0.274 + 0.045 + rise + clearance
        twin = twin_on(ground, yaw, gap, 3, start_height=height, start_speed=3.0, hold=0.01)
        twin.connect()
        servo, reached[clearance] = Servo(twin), 0.0
        for _ in range(70):
            servo.tick()
            foot = twin.true_state().foot
            reached[clearance] = max(reached[clearance], float(foot[0]))
    assert reached[-0.02] < 0.101
    assert reached[0.02] > 0.12


def test_a_ramp_without_grip_pushes_along_its_normal():
    """What it gives the hip forward is the slope times what it gives upward, less what swings the leg."""
    speed, given = {}, 0.0
    for slope in (0.0, 0.1):
        ground, gap = UnevenGround(slope=slope), replace(RealityGap.none(), ground_friction=1e-6, ground_stiffness=2e4)
        twin, given = twin_on(ground, 0.2, gap, start_height=0.33, hold=0.01), 0.0
        twin.connect()
        servo = Servo(twin, stiffness=300.0, damping=2.0)
        for _ in range(160):
            servo.tick()
            given += 1e-3 * twin.true_state().contact_force
        speed[slope] = float(twin.true_state().hip_rate[0])
    assert given > 0.5
    assert speed[0.1] - speed[0.0] == pytest.approx(-0.1 * given / masses_of(ROBOT).x, rel=0.25)


@pytest.mark.parametrize("share", [0.1, 4.0])
def test_a_patch_yields_by_load_over_its_stiffness(share):
    ground = UnevenGround(patch_stiffness=share, patch_length=1.0)
    gap = replace(RealityGap.none(), ground_stiffness=5e4, ground_damping_ratio=0.2)
    treads = profile_of(ground, gap).treads
    assert treads is not None
    for patch in (0, 1):
        yaw = (float(treads.start[patch]) + 0.5) / RADIUS
        twin = twin_on(ground, yaw, gap, start_height=LENGTH + 0.051, hold=10.0)
        twin.connect()
        servo = Servo(twin, LANDING_ANGLE - 0.3)
        for _ in range(1500):
            servo.tick()
        state = twin.true_state()
        stiffness = 5e4 * treads.stiffness[patch]
        assert -state.foot[2] == pytest.approx(state.contact_force / stiffness, rel=1e-3)


def test_heights_repeat_after_a_turn():
    profile = profile_of(STAIRS)
    yaw = np.linspace(-1, 1, 50)
    assert [profile.tread_height(y) for y in yaw] == pytest.approx([profile.tread_height(y + 2 * pi) for y in yaw])
    assert profile.has_risers
    assert not profile_of(UnevenGround(slope=0.1, roughness=0.01)).has_risers


def test_another_robot_keeps_its_ground():
    """A load on a soft patch: the contact is that of the patch, of the changed robot."""
    ground = UnevenGround(patch_stiffness=0.2, patch_length=0.5, stair_height=0.02)
    twin = twin_on(ground, 0.3)
    states = hopping(twin, 2)
    before = twin.true_state()
    twin.become(replace(GAP, body_mass_scale=1.1 * GAP.body_mass_scale))
    after = twin.true_state()
    assert states
    assert after.ground_height == before.ground_height
    np.testing.assert_array_equal(after.foot, before.foot)


def test_treads_may_be_as_long_as_half_the_circle():
    for seed in range(3):
        ground = UnevenGround(stair_height=0.04, stair_length=5.0)
        profile = profile_of(ground, seed=seed)
        for yaw in (0.0, 2.1, 4.2):
            twin = twin_on(ground, yaw, seed=seed)
            for state in hopping(twin, 1)[::3]:
                assert state.ground_height == pytest.approx(profile.height(yaw_of(twin, state, yaw)), abs=2e-3)


@pytest.mark.parametrize(
    "ground", [UnevenGround(stair_height=0.08), UnevenGround(slope=0.1), UnevenGround(patch_friction=0.6)]
)
def test_the_checks_of_a_rig_do_not_stop_a_healthy_robot(ground):
    """With the limits of the emulated ring, whose sensors are judged."""
    twin = twin_on(ground, yaw=1.0)
    limits = replace(
        emulated_settings(twin.sensor_model, ROBOT, RingSettings(), ground=ground).limits, torque=ROBOT.torque_limit
    )
    control = HopperControl(ROBOT, Gains(), CommandBounds(), replace(limits, torque_step=inf), ground)
    nominal = Hopper(ground=ground).apex_map()
    plant = RigPlant(twin, control)
    reference = Reference(("speed", "height"), np.tile([0.25, 0.58], (40, 1))).of(nominal.space)
    learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(residual="none"), 0)
    with closing(deploy(learner, plant, reference, 0)) as steps:
        found = [each.record.status for each in steps]
    assert (found, plant.fault) == ([StepStatus.OK] * len(found), "")
