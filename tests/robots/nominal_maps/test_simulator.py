"""Simulators as step maps: a bouncing ball with a closed form, and whether differences of rough maps are of use."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.robots.nominal_maps.differenced_map import STEPS, suitable_step
from stepgap.robots.nominal_maps.simulator import Simulator, SimulatorMap
from stepgap.step import Array, Quantity, StepSpace, StepStatus
from tests.control.maps import LossyHopper, NeverWorks, RoughMap

GRAVITY, RESTITUTION = 9.81, 0.8
SPACE = StepSpace((Quantity("height", "m", 0.2, 1.0),), (Quantity("paddle", "m/s", -0.5, 1.0),))


@dataclass
class Ball:
    """A ball on a moving paddle, from top to top, in time steps that are exact between the impacts."""

    tick: float = 1e-3
    height: float = 0.0
    speed: float = 0.0
    paddle: float = 0.0
    bounced: bool = False

    def reset(self, state: Array, command: Array) -> None:
        self.height, self.speed, self.paddle, self.bounced = state[0], 0.0, command[0], False

    def advance(self) -> None:
        self.height += self.speed * self.tick - GRAVITY * self.tick**2 / 2
        self.speed -= GRAVITY * self.tick
        if self.height < 0 and self.speed < 0:
            self.speed, self.bounced = -RESTITUTION * self.speed + (1 + RESTITUTION) * self.paddle, True

    def section(self) -> Array | StepStatus | None:
        if self.bounced and self.speed <= 0:
            return np.array([self.height]) if self.height > 0 else StepStatus.NO_TAKE_OFF
        return None


def ball_map(tick: float = 1e-3) -> SimulatorMap:
    ball = Ball(tick)
    return SimulatorMap(SPACE, Simulator(ball.reset, ball.advance, ball.section, most_ticks=round(3 / tick)))


def next_top(height: ArrayLike, paddle: ArrayLike) -> Array:
    leaving = RESTITUTION * np.sqrt(2 * GRAVITY * np.asarray(height)) + (1 + RESTITUTION) * np.asarray(paddle)
    return leaving**2 / (2 * GRAVITY)


def test_it_simulates_every_step_of_a_batch() -> None:
    heights, paddles = np.linspace(0.3, 0.9, 5), np.linspace(-0.2, 0.8, 5)
    found = ball_map(1e-4).evaluate(heights[:, None, None], paddles[:, None])
    assert found.next_state.shape == (5, 5, 1)
    np.testing.assert_allclose(found.next_state[..., 0], next_top(heights[:, None], paddles), rtol=3e-3)


def test_failures_have_their_status() -> None:
    found = ball_map().evaluate([[0.3], [np.nan], [0.3]], [[-2.0], [0.0], [0.2]])
    assert found.status.tolist() == [StepStatus.NO_TAKE_OFF, StepStatus.INVALID, StepStatus.OK]
    assert np.isnan(found.next_state[:2]).all()
    assert np.isfinite(found.next_state[2])
    endless = SimulatorMap(SPACE, Simulator(lambda *_: None, lambda: None, lambda: None, most_ticks=10))
    assert endless.evaluate([0.3], [0.0]).status == StepStatus.NO_APEX
    lost = SimulatorMap(SPACE, lambda state, command: state * np.inf)
    assert lost.evaluate([0.3], [0.0]).status == StepStatus.NO_APEX


def test_a_state_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(2,\) instead of \(1,\)"):
        SimulatorMap(SPACE, lambda state, command: np.zeros(2)).evaluate([0.3], [0.0])


def test_the_suitable_step_is_the_smallest_of_a_smooth_map_and_grows_with_roughness() -> None:
    found = [suitable_step(one, np.random.default_rng(0)) for one in (LossyHopper(), RoughMap(), RoughMap(grain=3e-4))]
    assert found[0] == found[1] == STEPS[1]
    assert found[2] is not None
    assert found[2] > 3e-3


def test_with_ticks_of_contact_the_derivatives_need_a_large_step_or_do_not_exist() -> None:
    """An impact is noticed up to one tick late, so the top is uncertain by some millimetres."""
    fine, coarse = (suitable_step(ball_map(tick), np.random.default_rng(0)) for tick in (1e-4, 1e-2))
    assert fine is not None
    assert coarse is None or coarse >= 10 * fine
    jacobian = SimulatorMap(SPACE, ball_map(1e-4).step, fine).jacobian([0.6], [0.3])
    leaving = np.sqrt(2 * GRAVITY * next_top(0.6, 0.3))
    exact = [leaving * RESTITUTION / np.sqrt(2 * GRAVITY * 0.6), leaving * (1 + RESTITUTION) / GRAVITY]
    np.testing.assert_allclose(jacobian[0], exact, rtol=0.15)


def test_a_map_that_always_fails_has_no_suitable_step() -> None:
    assert suitable_step(NeverWorks(), np.random.default_rng(0)) is None
