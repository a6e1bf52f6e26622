"""The page on a drive: what the robot does with each command, how much can be corrected, and what to drive next."""

from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.cure.drive import AXIS_NAMES
from stepgap.cure.habits import Habit, commands_to_drive, within_reach
from stepgap.cure.lesson import Lesson
from stepgap.records.text import listed
from stepgap.report.drawing import BLUE, GREY, LIGHT, draw_figure, new_figure
from stepgap.report.html import bullets, page, paragraph, picture, section, table
from stepgap.step import Array

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

UNITS: Final = ("m/s", "m/s", "rad/s")
_SURE: Final = 0.15  # Half a 95 % interval up to which the correctable part is called sure
_LITTLE: Final = 0.1  # Part of the error below which a correction is not worth it
HOLD_SECONDS: Final = 3.0  # Time for which each of the proposed commands is held [s]


def verdict(lesson: Lesson) -> str:
    """How much of the error can be corrected, and how sure that is, in a sentence or two."""
    share, half = lesson.held.correctable(lesson.space.state_scale, lesson.driven)
    reached, asked = within_reach(lesson)
    low, high = np.clip([share - half, share + half], 0.0, 1.0).tolist()
    if share - half <= 0 or share < _LITTLE:
        sentence = (
            f"This log does not show that a correction helps: of the error at held commands it would remove "
            f"{100 * max(share, 0):.0f} % (95 % interval {100 * low:.0f} to {100 * high:.0f} %)."
        )
    else:
        sure = "That is sure enough." if half <= _SURE else "More driving makes that surer: see what to drive next."
        sentence = (
            f"Of the error at held commands, {100 * share:.0f} % can be corrected (95 % interval {100 * low:.0f} to "
            f"{100 * high:.0f} %, on parts of the log that were not learned from). {sure}"
        )
    where = f"{reached} of {asked} velocities that were asked for are within reach of the commands in the log."
    undriven = [name for name, is_driven in zip(AXIS_NAMES, lesson.driven, strict=True) if not is_driven]
    missing = f" {listed(undriven)} was never commanded, so it is not corrected." if undriven else ""
    return f"{sentence} {where}{missing}"


def habit_rows(habits: list[Habit]) -> list[list[str]]:
    """Rows of the table of what was asked and done, as text."""
    return [
        [_numbers(habit.asked), _numbers(habit.does), _numbers(2 * habit.std), _numbers(habit.corrected)]
        for habit in habits
    ]


HABIT_HEADS: Final = ("asked", "did", "±", "corrected command")


def error_rows(lesson: Lesson) -> list[list[str]]:
    """Root mean square errors before, and as they will be, for each velocity."""
    rows = list[list[str]]()
    everything = lesson.held.rms(held=False)
    held = lesson.held.rms(held=True)
    for axis, name in enumerate(AXIS_NAMES):
        if lesson.driven[axis]:
            values = [everything[0][axis], everything[1][axis], held[0][axis], held[1][axis]]
            rows.append([f"{name} [{UNITS[axis]}]", *(f"{value:.3f}" for value in values)])
    return rows


ERROR_HEADS: Final = ("", "all steps", "what is left", "held commands", "what is left")


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.2f}" for value in values.tolist())


def cure_page(lesson: Lesson, habits: list[Habit], checks: list[str], passport: list[str]) -> str:
    """The page, as HTML.

    Args:
        lesson: What was learned.
        habits: What the robot does.
        checks: Sentences on the odometry.
        passport: Lines of the passport.
    """
    figure = draw_figure(lambda: _figure(lesson), "what was asked and done")
    commands = commands_to_drive(lesson)
    rows = [[str(number + 1), *(f"{value:.2f}" for value in row)] for number, row in enumerate(commands)]
    heads = ["", *(f"{name} [{unit}]" for name, unit in zip(AXIS_NAMES, UNITS, strict=True))]
    minutes = lesson.drive.seconds / 60
    return page(
        f"Cure from {lesson.drive.log.source}",
        [
            "<h1>What the robot does with its commands</h1>",
            section(
                "does",
                "What it does",
                bullets([habit.in_words() for habit in habits]),
                table("forward [m/s], to the left [m/s], turning [rad/s]", HABIT_HEADS, habit_rows(habits)),
                picture(figure, "a", "What was asked for, and what was done, of each step whose command was held."),
            ),
            section(
                "corrected",
                "What can be corrected",
                paragraph(verdict(lesson)),
                table("root mean square of done less asked", ERROR_HEADS, error_rows(lesson)),
                paragraph(
                    "What is left is what the map, learned from the other parts of the log, does not predict: noise, "
                    "sway, and what the robot needs to follow a new command, which no correction removes."
                ),
            ),
            section(
                "next",
                "What to drive next",
                paragraph(
                    "These ten commands say most that this log does not. Where there is room and the robot is safe, "
                    f"hold each for {HOLD_SECONDS:g} s, record again, and give both logs to stepgap cure."
                ),
                table("", heads, rows),
            ),
            section(
                "log",
                "The log",
                paragraph(f"{minutes:.1f} minutes, {len(lesson.steps)} steps. {lesson.response.in_words()}"),
                bullets([*lesson.drive.notes, *checks]),
                bullets(passport),
            ),
            section("use", "On the robot", bullets(ON_THE_ROBOT)),
        ],
    )


ON_THE_ROBOT: Final = (
    "ROS 2: ros2 launch ./correction.launch.py, with velocities that are asked for on cmd_vel_raw; without launch: "
    "python3 cmd_vel_correction.py --ros-args -r odom:=/your/odom",
    "Python: velocity_filter.py and controller.py need NumPy alone: VelocityFilter(StepFilter(MODEL), …).command(time, "
    "asked)",
    "C: controller.c and controller.h; one plan for each step. Without odometry give NULL as the state; the command is "
    "then the target.",
    "Go on learning on the robot: stepgap run experiment.toml --warm-start steps.csv -- YOUR PROGRAM",
)


def _figure(lesson: Lesson) -> "Figure":
    figure = new_figure(2.4)
    rows = ~lesson.held.first
    panels = figure.subplots(1, len(AXIS_NAMES))
    predicted = lesson.steps.next_state - lesson.held.predicted
    for axis, panel in enumerate(panels):
        asked = lesson.steps.command[rows, axis]
        done = lesson.steps.next_state[rows, axis]
        ends = np.array([min(asked.min(), done.min()), max(asked.max(), done.max())])
        panel.plot(ends, ends, color=GREY, linewidth=0.8)
        panel.plot(asked, done, ".", color=LIGHT, markersize=3, label="done")
        panel.plot(asked, predicted[rows, axis], ".", color=BLUE, markersize=1.5, label="learned")
        panel.set_xlabel(f"{AXIS_NAMES[axis]} asked [{UNITS[axis]}]")
    panels[0].set_ylabel("Done")
    panels[0].legend()
    return figure
