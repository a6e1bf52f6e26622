"""The quadruped against published masses, statics, an independent integrator and momentum; and that it pronks."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from math import hypot

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stepgap.mujoco_robots.hopping import COMPRESSION, FLIGHT, THRUST
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.quadruped.model import LEGS, TOE_RADIUS, TOTAL_MASS, quadruped_xml
from stepgap.mujoco_robots.quadruped.pronk import PronkGains, foot_placement, pronk
from stepgap.mujoco_robots.quadruped.robot import SPACE, Quadruped
from stepgap.mujoco_robots.quadruped.spring_mass import GRAVITY, SpringMassMap, landing_velocity
from stepgap.robots.entry_points import load_robot
from stepgap.step import Array, StepStatus

ROBOT, GAINS = Quadruped(), PronkGains()
RNG = np.random.default_rng(42)
CENTRE, SCALE = (
    np.concatenate(both)
    for both in ((SPACE.state_centre, SPACE.command_centre), (SPACE.state_scale, SPACE.command_scale))
)
POINTS = CENTRE + SCALE * RNG.uniform(-1, 1, (8, 4))


def spring_mass() -> SpringMassMap:
    found = ROBOT.nominal_maps()["spring_mass"]()
    assert isinstance(found, SpringMassMap)
    return found


def placed(state: Array, z: float | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model at an apex, or in its posture with the trunk at another height."""
    model = ROBOT.mjcf_model()
    data = mujoco.MjData(model)
    ROBOT.place(model, data, state)
    if z is not None:
        data.qpos[1] = z
    mujoco.mj_forward(model, data)
    return model, data


def test_the_mass_is_that_of_the_machine() -> None:
    model = mujoco.MjModel.from_xml_string(quadruped_xml())
    assert model.body_mass.sum() == pytest.approx(TOTAL_MASS)
    assert pytest.approx(15.2, abs=0.05) == TOTAL_MASS  # 15 kg in the data sheet
    assert isinstance(load_robot("quadruped"), Quadruped)


def test_at_an_apex_all_feet_are_at_their_landing_position() -> None:
    _, data = placed(np.array([0.6, 0.42]))
    x, z = foot_placement(GAINS.law, 0.6)
    assert hypot(x, z) == pytest.approx(GAINS.rest_length)
    for leg in LEGS:
        np.testing.assert_allclose(data.geom(f"{leg.name}_foot").xpos[[0, 2]], [leg.x + x, 0.42 + z], atol=1e-12)
        assert data.joint(f"{leg.name}_thigh").qpos[0] > 0 > data.joint(f"{leg.name}_calf").qpos[0]


@pytest.mark.parametrize("pitch", [0.0, 0.1])
@pytest.mark.parametrize("phase", [COMPRESSION, THRUST])
def test_the_torques_push_the_trunk_with_the_wanted_force_and_moment(phase: int, pitch: float) -> None:
    """The forces on the feet that balance the torques of their legs, with MuJoCo's Jacobians."""
    model, data = placed(np.array([0.5, 0.4]))
    data.qpos[2] = pitch
    data.qpos[4::2] -= 0.3
    mujoco.mj_forward(model, data)
    torques, command = np.zeros(8), np.array([9.0, -20.0])
    assert pronk(GAINS.law, phase, True, data.qpos, np.zeros(11), command, torques) == phase
    force, moment, virtual = np.zeros(2), 0.0, np.zeros(2)
    for number, leg in enumerate(LEGS):
        rows = np.zeros((3, model.nv))
        mujoco.mj_jacGeom(model, data, rows, None, model.geom(f"{leg.name}_foot").id)
        own = slice(2 * number, 2 * number + 2)
        of_foot = np.linalg.solve(-rows[[0, 2], 3 + own.start : 3 + own.stop].T, torques[own])
        at = data.geom(f"{leg.name}_foot").xpos[[0, 2]] - data.qpos[:2]
        force, moment, virtual = force + of_foot, moment + at[1] * of_foot[0] - at[0] * of_foot[1], virtual + at / 4
    length = np.linalg.norm(virtual)
    wanted = -GAINS.stiffness * (GAINS.rest_length - length) * virtual / length
    if phase == THRUST:
        wanted += command + np.array([0.0, GAINS.thrust])
    np.testing.assert_allclose(force, wanted, rtol=1e-9)
    unheld = virtual[1] * wanted[0] - virtual[0] * wanted[1]
    held = unheld + (-GAINS.pitch_stiffness * pitch - unheld) * np.cos(pitch)
    assert moment == pytest.approx(held, abs=1e-9)


def test_a_raised_robot_is_in_flight_and_stays_in_its_posture() -> None:
    _, data = placed(np.array([0.5, 0.4]))
    torques = np.ones(8)
    assert pronk(GAINS.law, FLIGHT, False, data.qpos, data.qvel * 0, np.zeros(2), torques) == FLIGHT
    data.qvel[0] = 0.5
    assert pronk(GAINS.law, FLIGHT, False, data.qpos, data.qvel, np.zeros(2), torques) == FLIGHT
    np.testing.assert_allclose(torques, 0, atol=1e-9)


@pytest.mark.parametrize("point", POINTS)
def test_the_template_equals_an_independent_integration(point: Array) -> None:
    speed, height, fx, fz = point
    template = spring_mass()
    ahead, below = foot_placement(GAINS.law, speed)
    fall = np.sqrt(2 * GRAVITY * (height - TOE_RADIUS + below))
    start = np.array([-ahead, -below, *(template.landing @ [speed, -fall])])

    def rates(_: float, y: Array, thrust: float) -> list[float]:
        length = np.hypot(y[0], y[1])
        push = GAINS.stiffness * (GAINS.rest_length - length) - GAINS.damping * (y[:2] @ y[2:]) / length
        along = push * y[:2] / length + thrust * np.array([fx, fz + GAINS.thrust])
        return [y[2], y[3], along[0] / TOTAL_MASS, along[1] / TOTAL_MASS - GRAVITY]

    def ends(_: float, y: Array, thrust: float) -> float:
        return float(np.hypot(y[0], y[1]) - GAINS.rest_length if thrust else y[:2] @ y[2:])

    vars(ends).update(terminal=True, direction=1.0)
    for thrust in (0.0, 1.0):
        phase = solve_ivp(rates, (0, 1), start, events=ends, args=(thrust,), rtol=1e-11, atol=1e-12)
        start = phase.y[:, -1]
    outcome = template.evaluate(point[:2], point[2:])
    assert outcome.status == StepStatus.OK
    apex = [start[2], start[1] + TOE_RADIUS + start[3] ** 2 / (2 * GRAVITY)]
    np.testing.assert_allclose(outcome.next_state, apex, rtol=1e-7)


def test_the_template_is_smooth_and_refuses_what_is_no_step() -> None:
    template = spring_mass()
    states, commands = POINTS[:, :2], POINTS[:, 2:]
    coarse = template.jacobian(states, commands)
    for column, size in enumerate(1e-3 * SCALE):
        more = POINTS + size * np.eye(4)[column]
        less = POINTS - size * np.eye(4)[column]
        ahead, behind = (template.evaluate(p[:, :2], p[:, 2:]).next_state for p in (more, less))
        np.testing.assert_allclose(
            (ahead - behind) / (2 * size) * SCALE[column], coarse[..., column] * SCALE[column], atol=2e-5
        )
    bad = template.evaluate([[np.nan, 0.4], [0.5, 0.2], [0.5, 0.42]], [[0, 0], [0, 0], [0, -5000.0]])
    assert bad.status[0] == StepStatus.INVALID
    assert (bad.status[1:] != StepStatus.OK).all()
    assert np.isnan(bad.next_state).all()


def test_the_landing_keeps_the_momentum_that_no_foot_can_take() -> None:
    """With one free mass and massless legs nothing is lost; with feet that carry all mass everything is."""
    model, data = placed(SPACE.state_centre)
    feet = [f"{leg.name}_foot" for leg in LEGS]
    assert landing_velocity(model, data, []) == pytest.approx(np.eye(2))
    kept = landing_velocity(model, data, feet)
    assert ((np.linalg.eigvalsh((kept + kept.T) / 2) > 0.6) & (np.linalg.eigvalsh((kept + kept.T) / 2) < 1)).all()
    light = mujoco.MjModel.from_xml_string(quadruped_xml())
    for body in range(2, light.nbody):
        light.body_mass[body] *= 1e-6
        light.body_inertia[body] *= 1e-6
    light.dof_armature[:] = 0
    light.body_ipos[1] = 0  # off its joints, a pitching trunk would take part
    mujoco.mj_setConst(light, mujoco.MjData(light))
    lit = mujoco.MjData(light)
    ROBOT.place(light, lit, SPACE.state_centre)
    np.testing.assert_allclose(landing_velocity(light, lit, feet), np.eye(2), atol=1e-3)


@pytest.mark.parametrize(
    "gap",
    [MjcfGap.none(), ROBOT.gap, replace(ROBOT.gap, payload=3.0, friction_scale=0.5)],
    ids=["model", "default", "loaded"],
)
def test_it_pronks_with_random_commands(gap: MjcfGap) -> None:
    rng = np.random.default_rng(11)
    plant = MjcfPlant(replace(ROBOT, gap=gap), rng)
    plant.start()
    records = [plant.take_step(rng.uniform(-0.7, 0.7, 2) * SPACE.command_scale) for _ in range(30)]
    assert {record.status for record in records} == {StepStatus.OK}
    assert 0.0 < records[-1].next_state[0] < 1.0
