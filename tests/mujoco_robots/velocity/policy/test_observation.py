"""Each term of an observation against MuJoCo's own sensors or a formula; histories against slices of single ones."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.mujoco_robots.velocity.policy.policy_robot import Observation
from stepgap.mujoco_robots.velocity.policy.policy_settings import TERMS, PolicySettings, Scales
from stepgap.step import Array
from tests.mujoco_robots.velocity.policy.networks import WHEELS, cart_xml

JOINTS = ("rear_left", "front_right", "front_left", "rear_right")
SETTINGS = PolicySettings("p", "m", 0.002, 0.02, JOINTS, (0.1, 0.2, 0.3, 0.4), (1.0,), TERMS, imu="imu_site")
ACTIONS, COMMAND = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, -0.1, 0.3])
SENSORS = """<sensor>
  <velocimeter name="v" site="imu_site"/><gyro name="w" site="imu_site"/>
  <framequat name="q" objtype="site" objname="imu_site"/>
</sensor>"""


def moved() -> tuple[Any, Any]:
    """The cart somewhere in the air, moving and turning, under gravity that is not vertical."""
    model = mujoco.MjModel.from_xml_string(cart_xml(SENSORS))
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    model.opt.gravity[:] = [-1.0, 2.0, -9.0]
    data.qpos[:], data.qvel[:] = rng.normal(size=model.nq), rng.normal(size=model.nv)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    mujoco.mj_forward(model, data)
    return model, data


def observed(settings: PolicySettings, times: int = 1) -> Array:
    model, data = moved()
    observation = Observation(settings, model)
    found = [
        observation.next(model, data, ACTIONS + number, COMMAND, 0.02 * number / settings.gait_period)
        for number in range(times)
    ]
    return found[-1]


def rotated_back(quaternion: Array, vector: Array) -> Array:
    """A vector in the frame of a quaternion, by v − 2w (u × v) + 2 u × (u × v)."""
    w, u = quaternion[0], quaternion[1:]
    return vector - 2 * w * np.cross(u, vector) + 2 * np.cross(u, np.cross(u, vector))


def expected(term: str, data: Any) -> Array:
    order = [WHEELS.index(joint) for joint in JOINTS]
    down = np.array([-1.0, 2.0, -9.0]) / np.sqrt(86.0)
    return {
        "base_lin_vel": lambda: data.sensor("v").data,
        "base_ang_vel": lambda: data.sensor("w").data,
        "projected_gravity": lambda: rotated_back(data.sensor("q").data, down),
        "joint_pos": lambda: data.qpos[7:][order] - [0.1, 0.2, 0.3, 0.4],
        "joint_vel": lambda: data.qvel[6:][order],
        "actions": lambda: ACTIONS,
        "command": lambda: COMMAND,
        "phase_sin": lambda: np.array([0.0]),
        "phase_cos": lambda: np.array([1.0]),
    }[term]()


@pytest.mark.parametrize("term", TERMS)
def test_a_term_is_what_sensors_measure_times_its_scale(term: str) -> None:
    scaled = replace(SETTINGS, observation=(term,), scale=Scales(**{term: (2.5,)}))
    _, data = moved()
    np.testing.assert_allclose(observed(scaled), 2.5 * expected(term, data), atol=1e-12)


def test_without_an_imu_it_is_the_frame_of_the_first_body() -> None:
    found = observed(replace(SETTINGS, observation=("base_lin_vel", "base_ang_vel", "projected_gravity"), imu=""))
    _, data = moved()
    pose, velocity = data.qpos[3:7], data.qvel[:6]
    parts = [rotated_back(pose, velocity[:3]), velocity[3:]]
    np.testing.assert_allclose(found[:6], np.concatenate(parts), atol=1e-12)
    np.testing.assert_allclose(found[6:], rotated_back(pose, np.array([-1.0, 2.0, -9.0])) / np.sqrt(86), atol=1e-12)


def test_terms_follow_each_other_and_each_number_may_have_its_scale() -> None:
    settings = replace(SETTINGS, observation=("command", "actions"), scale=Scales(command=(2.0, 2.0, 0.25)))
    assert observed(settings) == pytest.approx([1.0, -0.2, 0.075, 1.0, 2.0, 3.0, 4.0])


def test_phases_go_round_once_in_a_period() -> None:
    both = replace(SETTINGS, observation=("phase_cos", "phase_sin"), gait_period=0.08, gait_offsets=(0.0, 0.5))
    assert observed(both, times=2) == pytest.approx([0.0, 0.0, 1.0, -1.0])
    standing = replace(both, gait_stands_below=0.6, gait_standing=(0.5, 0.25))
    assert observed(standing, times=2) == pytest.approx([-1.0, 0.0, 0.0, 1.0]), "the command has a size of 0.59"
    assert observed(replace(standing, gait_standing=())).tolist() == [0.0] * 4
    assert observed(replace(standing, gait_stands_below=0.59), times=2) == pytest.approx([0.0, 0.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("by_term", "newest_first", "expected"),
    [
        (True, False, [1, 2, 3, 4, 2, 3, 4, 5, 0.5, -0.1, 0.3, 0.5, -0.1, 0.3]),
        (True, True, [2, 3, 4, 5, 1, 2, 3, 4, 0.5, -0.1, 0.3, 0.5, -0.1, 0.3]),
        (False, False, [1, 2, 3, 4, 0.5, -0.1, 0.3, 2, 3, 4, 5, 0.5, -0.1, 0.3]),
        (False, True, [2, 3, 4, 5, 0.5, -0.1, 0.3, 1, 2, 3, 4, 0.5, -0.1, 0.3]),
    ],
)
def test_a_history_has_the_order_of_the_training(by_term: bool, newest_first: bool, expected: list[float]) -> None:
    settings = replace(SETTINGS, observation=("actions", "command"), history=(2,), history_by_term=by_term)
    found = observed(replace(settings, newest_first=newest_first), times=2)
    assert found == pytest.approx(expected)


def test_a_history_begins_with_the_first_observation_and_terms_may_have_several_lengths() -> None:
    found = observed(replace(SETTINGS, observation=("command", "actions"), history=(1, 3)))
    assert found == pytest.approx([*COMMAND, *ACTIONS, *ACTIONS, *ACTIONS])
