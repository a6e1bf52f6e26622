"""Robots other than the hopper: the runner of examples/own_robot.py is correct and learns; so do maps of any sizes."""

import importlib
import re
import runpy
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array, Outcome, Quantity, StepMap, StepRecord, StepSpace, StepStatus, difference_jacobian

EXAMPLE = Path(__file__).parents[1] / "examples" / "own_robot.py"
HOPPER = (
    r"stepgap\.(robots|rigs|bench|experiment\.(settings|plants|replay|noise_floor)|plants\.(?!plant$|model_plant$))"
)
REAL = {"mass": 10.6, "stiffness": 2850.0, "damping": 6.0, "friction": 4.0}


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLE))


@pytest.fixture(scope="module")
def runner(names: dict[str, Any]) -> StepMap:
    return names["SpringRunner"]()


@pytest.fixture(scope="module")
def points(runner: StepMap) -> tuple[Array, Array]:
    """Random states and commands within their ranges."""
    rng, space = np.random.default_rng(0), runner.space
    lower = [quantity.lower for quantity in space.state]
    upper = [quantity.upper for quantity in space.state]
    return rng.uniform(lower, upper, (300, 2)), rng.uniform(space.command_lower, space.command_upper, (300, 2))


def integrated(robot: Any, state: Array, command: Array) -> Array:
    """The next apex by SciPy, in polar coordinates and with flight integrated, too."""
    angle, push = command
    drop = state[1] - robot.rest_length * np.cos(angle)
    speed, sink, turn = state[0], np.sqrt(2 * 9.81 * drop), -angle
    rate = speed * np.sin(turn) - sink * np.cos(turn)
    swing = (speed * np.cos(turn) + sink * np.sin(turn)) / robot.rest_length
    z = np.array([robot.rest_length, turn, rate, swing])
    for phase in (-1, 1):

        def force(t: float, z: Array) -> float:
            stiffness = robot.stiffness + (push if phase > 0 else 0)  # noqa: B023  (called before the next)
            return stiffness * (robot.rest_length - z[0]) - robot.damping * z[2] - robot.friction * phase  # noqa: B023

        def rates(t: float, z: Array) -> Array:
            length, turn, rate, swing = z
            outward = force(t, z) / robot.mass - 9.81 * np.cos(turn) + length * swing**2
            return np.array([rate, swing, outward, (9.81 * np.sin(turn) - 2 * rate * swing) / length])

        def ends(t: float, z: Array) -> float:
            return z[2] if phase < 0 else force(t, z)  # noqa: B023

        ends.terminal, ends.direction = True, -phase  # pyright: ignore[reportFunctionMemberAccess]
        z = solve_ivp(rates, (0, 2), z, "DOP853", events=ends, rtol=1e-11, atol=1e-12).y[:, -1]
    length, turn, rate, swing = z
    speed = rate * np.sin(turn) + length * swing * np.cos(turn)
    rise = rate * np.cos(turn) - length * swing * np.sin(turn)
    return np.array([speed, length * np.cos(turn) + rise**2 / (2 * 9.81)])


def test_the_model_conserves_energy(runner: StepMap, points: tuple[Array, Array]) -> None:
    state, command = points
    next_state, status = runner.evaluate(state, command * [1, 0])
    hops = status == StepStatus.OK
    assert hops.mean() > 0.9

    def energy(state: Array) -> Array:
        return state[hops, 0] ** 2 / 2 + 9.81 * state[hops, 1]

    np.testing.assert_allclose(energy(next_state), energy(state), rtol=1e-8)


@pytest.mark.parametrize("real", [{}, REAL], ids=["model", "real"])
def test_it_is_what_scipy_integrates(
    names: dict[str, Any], points: tuple[Array, Array], real: dict[str, float]
) -> None:
    robot, compared = names["SpringRunner"](**real), 0
    for state, command in zip(*points, strict=True):
        next_state, status = robot.evaluate(state, command)
        if status == StepStatus.OK and compared < 20:
            np.testing.assert_allclose(next_state, integrated(robot, state, command), rtol=0, atol=2e-7)
            compared += 1
    assert compared == 20


def test_losses_lose_energy(names: dict[str, Any], runner: StepMap) -> None:
    state, command = np.array([1.2, 0.6]), np.array([0.22, 0.0])
    for loss in ({"damping": 6.0}, {"friction": 4.0}):
        lossy = names["SpringRunner"](**loss)(state, command)
        assert lossy[0] ** 2 / 2 + 9.81 * lossy[1] < 1.2**2 / 2 + 9.81 * 0.6 - 0.05


def test_a_failed_step_has_a_status(runner: StepMap) -> None:
    for state, command, status in (
        ([1.0, 0.4], [0.2, 0.0], StepStatus.FELL),  # starts in the ground
        ([np.nan, 0.6], [0.2, 0.0], StepStatus.INVALID),
        ([1.0, 0.6], [np.nan, 0.0], StepStatus.INVALID),
    ):
        outcome = runner.evaluate(state, command)
        assert outcome.status == status
        assert np.isnan(outcome.next_state).all()


def test_the_map_broadcasts_and_is_smooth(runner: StepMap, points: tuple[Array, Array]) -> None:
    state, command = points[0][:3], points[1][:2]
    grid = runner.evaluate(state[:, None], command).next_state
    assert grid.shape == (3, 2, 2)
    np.testing.assert_array_equal(grid[2, 1], runner.evaluate(state[2], command[1]).next_state)
    coarse, fine = (
        runner.jacobian([1.2, 0.6], [0.22, 100.0]),
        difference_jacobian(runner, [1.2, 0.6], [0.22, 100.0], 1e-5),
    )
    np.testing.assert_allclose(coarse, fine, rtol=1e-5, atol=1e-8)


def test_control_knows_it(runner: StepMap) -> None:
    state, target = np.array([1.1, 0.59]), np.array([1.2, 0.6])
    plan = StepController(runner)(state, target)
    assert plan.reached
    cautious = CautiousController(runner, runner, np.empty((0, 4)))(state, target)
    np.testing.assert_allclose(cautious.command, plan.command, rtol=1e-4)
    gait = fixed_point(runner, target)
    assert abs(gait.command[1]) < 1e-3  # the model needs no push
    assert np.isclose(np.abs(gait.floquet_multipliers), 1, atol=1e-4).any()  # energy is constant


@dataclass(frozen=True)
class Pulled(StepMap):
    """next = state / 2 + gain · tanh(B command), of any sizes."""

    n: int
    m: int
    gain: float

    @property
    def space(self) -> StepSpace:
        return StepSpace(
            tuple(Quantity(f"state_{i}", "m", -1, 1) for i in range(self.n)),
            tuple(Quantity(f"command_{i}", "N", -2, 2) for i in range(self.m)),
        )

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        pull = np.tanh(np.asarray(command, float) @ (np.eye(self.m, self.n) + 0.1))
        next_state = np.asarray(state, float) / 2 + self.gain * pull
        return Outcome(next_state, np.where(np.isfinite(next_state).all(axis=-1), StepStatus.OK, StepStatus.INVALID))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return difference_jacobian(self, state, command)


@pytest.mark.parametrize(("sizes", "exploration"), [((1, 1), 0), ((3, 2), 3), ((2, 3), 0), ((2, 3), 3)])
def test_state_and_command_may_have_any_sizes(tmp_path: Path, sizes: tuple[int, int], exploration: int) -> None:
    n, m = sizes
    nominal, real = Pulled(n, m, 1.0), Pulled(n, m, 0.6)
    targets = np.zeros((16, n))
    targets[:, : min(n, m)] = np.repeat(np.random.default_rng(0).uniform(-0.4, 0.4, (4, min(n, m))), 4, axis=0)
    reference = Reference(nominal.space.state_names, targets)
    learning = LearningSettings(iterations=1, exploration=exploration)

    def make_plant(rng: np.random.Generator) -> ModelPlant:
        return ModelPlant(real, np.zeros(n), np.full(n, 0.003), rng)

    first, second = run_experiment(Setup(nominal, Plants(make_plant), reference, learning), tmp_path)
    assert (first.failed_steps, second.failed_steps) == (0, 0)
    assert np.linalg.norm(second.rmse) < 0.6 * np.linalg.norm(first.rmse)


def test_learning_reduces_the_error_without_the_hopper() -> None:
    code = (
        f"import runpy, sys; runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')\n"
        "print(*sorted(name for name in sys.modules if name.split('.')[0] in ('stepgap', 'mujoco', 'gymnasium')))"
    )
    outcome = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    *lines, modules = outcome.stdout.splitlines()
    errors = np.array([re.findall(r"\d+\.\d+", line) for line in lines], float)
    assert (errors[-1] < errors[0] / 3).all()
    assert "stepgap.experiment.loop" in modules.split()
    assert "mujoco" not in modules.split()
    assert not [name for name in modules.split() if re.match(HOPPER, name)]


class MeasuredBall(ModelPlant):
    """A ball whose time in the air follows from the height that is measured."""

    def __init__(self, robot: Any, seed: int):
        real = robot.TimedBallMap(0.72, 0.15)
        super().__init__(real, [0.5, robot.airtime(0.5)], [0.003, 0.0], np.random.default_rng(seed))
        self._airtime = robot.airtime

    def _step(self, command: Array, rng: np.random.Generator) -> StepRecord:
        record = super()._step(command, rng)
        height = record.next_state[0]
        return replace(record, next_state=np.array([height, self._airtime(height)]))


@pytest.mark.parametrize("seed", range(2))
def test_a_function_of_the_state_is_learned_as_well_as_the_state(package: Path, tmp_path: Path, seed: int) -> None:
    robot: Any = importlib.import_module("ball_robot")
    nominal, real = robot.TimedBallMap(0.8), robot.TimedBallMap(0.72, 0.15)
    times = [(1, [0.62]), (11, [0.75]), (21, [0.55]), (31, [0.7])]
    reference = Reference.from_segments(("airtime",), times, steps=40)
    learning = LearningSettings("gp_on_linear", iterations=1, early_stop=False)
    plants = Plants(lambda rng: MeasuredBall(robot, int(rng.integers(99))))
    deployments = run_experiment(Setup(nominal, plants, reference, learning, seed=seed), tmp_path)
    before, after = (each.rmse for each in deployments)
    assert after[1] < 0.4 * before[1]
    assert np.isnan([before[0], after[0]]).all(), "the height is not tracked"
    log = read_step_log(tmp_path / "steps.csv", nominal.space)
    learned = Learner.start(nominal, log, learning, 2).step_map()
    states, commands = log.state, log.command
    truth, found = real(states, commands), learned(states, commands)
    direct, composed = (
        float(np.sqrt(np.mean((each - truth[:, 1]) ** 2))) for each in (found[:, 1], robot.airtime(found[:, 0]))
    )
    assert direct < 1.2 * composed
    assert composed < 0.1 * np.abs(nominal(states, commands)[:, 1] - truth[:, 1]).mean()
