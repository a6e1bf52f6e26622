"""The drift of a robot that turns by itself is that of the circle on which it walks."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.shortfall import moved
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.report.drift import drift
from stepgap.step import ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus

SECONDS, SPEED, TURN = 0.5, 0.4, 0.05
STATE = tuple(Quantity(name, "", -1.0, 1.0) for name in ("vx", "vy", "wz"))
SPACE = StepSpace(
    STATE, STATE, tuple(ContextQuantity(name, "") for name in StepSpace.pose_names), planar_seconds=SECONDS
)


def circle(count: int) -> Steps:
    target, done = np.array([SPEED, 0, 0]), np.array([SPEED, 0, TURN])
    pose, steps = np.array([5.0, -3.0, 1.0]), []
    for number in range(1, count + 1):
        pose = moved(pose, done * SECONDS)
        context = dict(zip(SPACE.pose_names, pose.tolist(), strict=True))
        record = StepRecord(done, target, target, done, StepStatus.OK, context)
        steps.append(LoggedStep(0, number, target, target, np.zeros(3), record))
    return Steps(SPACE, steps)


def test_the_drift_is_that_of_the_circle() -> None:
    steps = circle(40)
    found = drift(steps, np.full(40, SECONDS), 10.0)
    radius, angle = SPEED / TURN, TURN * 10
    ahead, left = radius * np.sin(angle) - SPEED * 10, radius * (1 - np.cos(angle))
    assert found.distance == pytest.approx(np.hypot(ahead, left))
    assert found.turn == pytest.approx(angle)


def test_a_deployment_that_is_too_short_says_nothing() -> None:
    assert np.isnan(drift(circle(10), np.full(10, SECONDS), 10.0)).all()


def test_without_a_measured_pose_nothing_is_said() -> None:
    space = replace(SPACE, context=())
    steps = Steps(space, [replace(each, record=replace(each.record, context={})) for each in circle(40)])
    assert np.isnan(drift(steps, np.full(40, SECONDS), 10.0)).all()
