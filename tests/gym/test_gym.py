"""The environment keeps Gymnasium's rules, and its steps are the plant's."""

import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleObservation

from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.gym import LARGEST_COST, STEP_ID, StepEnv, robot_env
from stepgap.plants.model_plant import ModelPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import Gains
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array

START = (0.2, 0.58)
REFERENCE = Reference(("speed", "height"), np.array([START] * 4))
PLANTS = [pytest.param({"plant": "model"}, id="model"), pytest.param({"reference": REFERENCE}, id="twin")]


def made(**options: Any) -> StepEnv:
    env = gymnasium.make(STEP_ID, **options).unwrapped
    assert isinstance(env, StepEnv)
    return env


def model_env(noise: Sequence[float] = (0.0, 0.0), **options: Any) -> StepEnv:
    return made(plant="model", noise=noise, **{"reference": REFERENCE, **options})


def holding(env: StepEnv) -> Array:
    """The action that holds the first target on the model."""
    return env.space.point_of(StepController(env.nominal)(START, START).command)


def episode(env: StepEnv, seed: int) -> list[Array]:
    """Observations, rewards and applied commands, with actions drawn from the same seed."""
    rng, over = np.random.default_rng(seed), False
    rows = [env.reset(seed=seed)[0]]
    while not over:
        observation, reward, failed, at_end, info = env.step(rng.uniform(-0.3, 0.3, 2))
        rows.append(np.concatenate([observation, [reward], info["applied"]]))
        over = failed or at_end
    return rows


@pytest.mark.parametrize("options", PLANTS)
def test_gymnasiums_checker_finds_no_fault(options: dict[str, Any]) -> None:
    check_env(made(**options))  # warnings are errors


@pytest.mark.parametrize("options", PLANTS)
def test_same_seed_same_episode(options: dict[str, Any]) -> None:
    env = made(**{**options, "reference": REFERENCE})
    first, second, other = episode(env, 5), episode(made(**{**options, "reference": REFERENCE}), 5), episode(env, 6)
    assert len(first) == len(second) == len(REFERENCE) + 1
    for one, again in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, again)
    assert not np.array_equal(first[-1], other[-1])


def test_the_steps_of_the_twin_have_a_yaw() -> None:
    env = made(reference=REFERENCE)
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros(2))[4]["yaw"])


def test_the_name_suffices_in_a_new_process() -> None:
    code = "import gymnasium; gymnasium.make('stepgap.gym:stepgap/Step-v0', plant='model').reset(seed=0)"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_without_gymnasium_the_message_names_the_package() -> None:
    code = "import sys; sys.modules['gymnasium'] = None\nimport stepgap.gym"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert outcome.stderr.endswith("stepgap.gym needs Gymnasium: pip install 'stepgap[gym]'\n")


def test_a_step_is_the_maps_and_the_reward_its_error() -> None:
    env = model_env(reference=Reference(("speed", "height"), np.array([START, (0.3, 0.6), (0.1, 0.55)])))
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation, [*START, *START])
    assert info == {}
    action = np.array([-0.2, 0.1])
    observation, reward, failed, at_end, info = env.step(action)
    expected = ApexMap()(START, [-0.2 * 30, 0.1 * 20])
    np.testing.assert_allclose(observation, [*expected, 0.3, 0.6], rtol=0, atol=1e-12)
    np.testing.assert_allclose(info["predicted"], expected, atol=1e-12)
    assert "yaw" not in info  # a map has none
    assert reward == pytest.approx(-(((expected[0] - 0.2) / 0.2) ** 2) - ((expected[1] - 0.58) / 0.06) ** 2)
    assert (failed, at_end, info["status"]) == (False, False, "ok")


def test_the_step_controller_tracks_in_the_environment() -> None:
    stairs = Reference(("speed", "height"), np.array([START] * 10 + [(0.3, 0.6)] * 10 + [START] * 10))
    env, total, over = model_env(reference=stairs), 0.0, False
    observation, _ = env.reset(seed=0)
    controller, steps = StepController(env.nominal), 0
    while not over:
        plan = controller(observation[:2], observation[2:])
        observation, reward, failed, over, _ = env.step(env.space.point_of(plan.command))
        assert not failed
        total, steps = total + float(reward), steps + 1
    assert steps == 30
    assert -2 < total < 0  # only at stairs that are lower than one step can reach


def test_actions_beyond_the_bounds_are_clipped() -> None:
    env = model_env()
    env.reset(seed=0)
    info = env.step(np.array([-5.0, 0.1]))[-1]
    np.testing.assert_allclose(info["applied"], [-30, 2], atol=1e-12)
    assert env.action_space.contains(np.array([-1, 1], np.float32))
    with pytest.raises(ValueError, match=r"shape \(3,\); it must be \(2,\)"):
        env.step(np.zeros(3))


@pytest.mark.parametrize("options", PLANTS)
def test_an_action_that_is_no_number_makes_a_failed_step(options: dict[str, Any]) -> None:
    env = made(**{**options, "reference": REFERENCE})
    before, _ = env.reset(seed=0)
    observation, reward, failed, at_end, info = env.step(np.array([np.nan, 0.0]))
    assert failed
    assert not at_end
    assert info["status"] != "ok"
    assert "predicted" not in info
    np.testing.assert_array_equal(observation, before)
    assert reward == -LARGEST_COST * len(REFERENCE)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(np.zeros(2))


def test_falling_is_never_better_than_continuing() -> None:
    env = model_env(reference=Reference(("speed", "height"), np.array([START] * 200)))
    returns = {True: [], False: []}
    for seed in range(6):
        env.reset(seed=seed)
        env.action_space.seed(seed)
        rewards, failed, over = [], False, False
        while not over:
            observation, reward, failed, at_end, _ = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation)
            rewards.append(float(reward))
            over = failed or at_end
        returns[failed].append(rewards)
    assert returns[True]
    assert returns[False]
    for rewards in returns[True]:  # the failed step costs as much as the worst case of continuing
        assert rewards[-1] == -LARGEST_COST * (200 - len(rewards) + 1)
    assert min(map(min, returns[False])) >= -LARGEST_COST


def test_a_reset_takes_another_reference_once() -> None:
    env = model_env()
    other = Reference(("speed", "height"), np.array([(0.25, 0.6)]))
    observation, _ = env.reset(seed=0, options={"reference": other})
    np.testing.assert_array_equal(observation, [*START, 0.25, 0.6])
    assert env.step(holding(env))[3]
    observation, _ = env.reset()
    np.testing.assert_array_equal(observation, [*START, *START])
    with pytest.raises(ValueError, match="unknown option targets of reset; the only option is 'reference'"):
        env.reset(options={"targets": other})
    with pytest.raises(ValueError, match="must be a stepgap Reference, not list"):
        env.reset(options={"reference": [START]})
    with pytest.raises(ValueError, match="the reference has targets of pace"):
        env.reset(options={"reference": Reference(("pace", "height"), other.targets)})


def test_a_target_that_is_missing_costs_nothing_and_is_observed_as_the_middle() -> None:
    env = model_env()
    height_only = Reference(("height",), np.array([[0.6]]))
    observation, _ = env.reset(seed=0, options={"reference": height_only})
    centre = env.get_wrapper_attr("space").state_centre
    np.testing.assert_array_equal(observation, [*START, centre[0], 0.6])
    (state, _), reward = np.split(env.step(holding(env))[0], 2), 0.0
    env.reset(seed=0, options={"reference": height_only})
    reward = env.step(holding(env))[1]
    error = (state[1] - 0.6) / env.get_wrapper_attr("space").state_scale[1]
    assert reward == pytest.approx(-(error**2))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"plant": "tiwn"},
            "plant = 'tiwn', but it must be 'twin' or 'emulated-ring' or 'model'; did you mean 'twin'?",
        ),
        ({"robot": "hoper"}, "robot 'hoper': unknown; did you mean hopper?"),
        (
            {"plant": "model", "noise": (0.1,)},
            "noise = (0.1,), but it must be numbers that are not negative, for speed",
        ),
        (
            {"plant": "model", "noise": (-0.1, 0.0)},
            "noise = (-0.1, 0.0), but it must be numbers that are not negative, for speed",
        ),
        ({"reference": Reference(("pace",), np.zeros((1, 1)))}, "the reference has targets of pace"),
    ],
)
def test_wrong_arguments_are_named(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011  (its message is compared below)
        robot_env(**wrong)
    assert message in str(error.value)


def test_gaps_make_a_difference() -> None:
    def first_state(**options: Any) -> Array:
        env = made(**options)
        try:
            return env.reset(seed=0)[0][:2]
        finally:
            env.close()
            env.close()

    none = first_state(robot=Hopper(gap=RealityGap.none()))
    default = first_state()
    np.testing.assert_array_equal(first_state(robot="hopper"), default)
    assert not np.array_equal(none, default)


def test_it_works_with_gymnasiums_wrappers_and_vectors() -> None:
    rescaled = RescaleObservation(gymnasium.make(STEP_ID, plant="model"), np.float64(-1), np.float64(1))
    assert np.abs(rescaled.reset(seed=0)[0]).max() <= 1
    envs = gymnasium.make_vec(STEP_ID, num_envs=3, plant="model", vectorization_mode="sync")
    envs.reset(seed=0)
    assert envs.step(envs.action_space.sample())[0].shape == (3, 4)
    envs.close()


def test_it_works_with_any_robot() -> None:
    real = ApexMap(gains=Gains(stiffness=2300))
    env = StepEnv(lambda rng: ModelPlant(real, np.array(START), np.zeros(2), rng), ApexMap(), REFERENCE)
    env.reset(seed=0)
    observation, _, _, _, info = env.step(np.zeros(2))
    np.testing.assert_allclose(observation[:2], real(START, [0, 0]))
    assert np.abs(info["predicted"] - observation[:2]).max() > 1e-3


def test_who_asks_for_pictures_reads_what_to_use_instead() -> None:
    with pytest.raises(ValueError, match=r"render_mode = 'rgb_array', but .* draws no pictures; leave it out, and see"):
        gymnasium.make(STEP_ID, plant="model", render_mode="rgb_array")
