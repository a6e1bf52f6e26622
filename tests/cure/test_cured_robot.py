"""A second drive, of the corrected robot, shows that it is cured."""

from pathlib import Path

import numpy as np

from stepgap.cure.cure_folder import filter_numbers
from stepgap.cure.drive import read_drive
from stepgap.cure.habits import stands_at_zero
from stepgap.cure.lesson import Lesson, lesson_of
from stepgap.cure.response import response_of
from stepgap.cure.velocity_filter import FilterSettings, VelocityFilter
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.portable_controller import portable_form
from stepgap.export.controller.step_filter import StepFilter
from stepgap.step import Array
from tests.cure.drives import DRIFT, GAINS, LAG, TICK, written

SECONDS = 32.0
LATE = 3
"""Ticks until a command acts."""


def driven_again(correction: VelocityFilter) -> tuple[Array, Array]:
    """Rows of odometry and of what was asked of the robot of the first drive; every other command is to stand."""
    rng = np.random.default_rng(4)
    levels = rng.uniform([-0.1, -0.15, -0.3], [0.5, 0.15, 0.3], (40, 3)) * (np.arange(40) % 2)[:, None]
    velocity, told = np.zeros(3), [np.zeros(3)] * LATE
    odometry, commands = list[Array](), list[Array]()
    for time in np.arange(0, SECONDS, TICK):
        asked = levels[int(time / 2.0)]
        told.append(np.array(correction.command(time, asked)))
        velocity = velocity + TICK / LAG * (GAINS * told[-1 - LATE] + DRIFT - velocity)
        measured = velocity + rng.normal(0, 0.02, 3)
        correction.odometry(time, measured)
        odometry.append(np.concatenate([[time], measured, np.zeros(3)]))
        commands.append(np.append(time, asked))
    return np.array(odometry), np.array(commands)


def test_of_the_corrected_robot_a_second_log_says_that_it_stands_and_that_nothing_is_left(
    minute: Lesson, tmp_path: Path
) -> None:
    controller = portable_form(minute.learner, minute.control, np.random.default_rng(0), {}, "a log")
    correction = VelocityFilter(StepFilter(model_document(controller)), FilterSettings(**filter_numbers(minute)))
    found = read_drive(written(tmp_path, *driven_again(correction)))
    lesson = lesson_of([found], response_of(found))
    assert not stands_at_zero(minute)
    assert stands_at_zero(lesson)
    share, half = lesson.held.correctable(lesson.space.state_scale, lesson.driven)
    assert share < half, "that a correction helps is not shown"
