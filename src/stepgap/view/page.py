"""The page: 3-D scene, buttons and charts of the tracking. It only displays a run and never acts on it."""

from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from viser import GuiApi, GuiUplotHandle, ViserServer, uplot

from stepgap.learning.steps import LoggedStep
from stepgap.records.text import in_scale, in_words, with_unit
from stepgap.report.drawing import BLUE, VERMILLION
from stepgap.robots.scene import Scene
from stepgap.step import Array, Quantity, StepStatus
from stepgap.view.player import Player
from stepgap.view.robot_scene import Ground, RobotScene, light
from stepgap.view.source import Source

INK = "#3c3e46"
TRANSPARENT = "rgba(0,0,0,0)"
HEIGHT = 160  # Height of a chart [pixels]

NO_DOTS = uplot.Series_Points(show=False)


def add_legend(gui: GuiApi, entries: Sequence[tuple[str, str, str]]) -> None:
    """Adds a legend of marks: mark, colour, meaning."""
    parts = (f'<span style="color:{colour}">{mark}</span>&nbsp;{meaning}' for mark, colour, meaning in entries)
    gui.add_html(f'<div style="font-size:0.8em;padding:0.2em 1em">{"&emsp;".join(parts)}</div>')


def _line(colour: str, width: float, dash: tuple[float, ...] = ()) -> uplot.Series:
    return uplot.Series(stroke=colour, width=width, dash=dash, points=NO_DOTS, auto=False)


def _axis(label: str, size: int) -> uplot.Axis:
    font = "12px sans-serif"
    return uplot.Axis(label=label, labelSize=16, size=size, labelFont=font, font=font, stroke=INK)


def _blank(columns: int) -> tuple[Array, ...]:
    return (np.array([0.0, 1.0]), np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in range(columns - 2)))


def _span(*columns: Array) -> Array:
    """Series of the length of a column that contains the smallest and the largest of all numbers."""
    numbers = np.concatenate([column[np.isfinite(column)] for column in columns])
    span = np.full(len(columns[0]), numbers.min())
    span[-1] = numbers.max()
    return span


class TrackingPlot:
    """Chart of targets and next states of one coordinate, step by step."""

    def __init__(self, gui: GuiApi, quantity: Quantity, index: int):
        self._index = index
        span = uplot.Series(stroke=TRANSPARENT, width=0, points=NO_DOTS)
        lines = _line(INK, 1.2, (5, 3)), _line(VERMILLION, 1.5, (2, 2)), _line(BLUE, 2)
        self._chart: GuiUplotHandle = gui.add_uplot(
            _blank(5),
            (uplot.Series(), span, *lines),
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
            axes=(_axis("step", 30), _axis(with_unit(quantity), 54)),
            legend=uplot.Legend(show=False),
            height=HEIGHT,
            padding=(8, 8, 0, 0),
        )

    def show(self, steps: Sequence[LoggedStep], overlaid: Sequence[LoggedStep], count: int) -> None:
        """Draws the targets of all steps, and the next states of the first `count` steps."""
        if not steps:
            self._chart.data = _blank(5)
            return
        number = np.array([float(logged.step) for logged in steps])
        target = np.array([logged.target[self._index] for logged in steps])
        measured = self._next_states(steps, len(steps))
        other = self._next_states(overlaid, len(steps))
        span = _span(target, measured, other)  # of all steps, so that the axis stays the same while they are played
        measured[count:] = np.nan
        other[count:] = np.nan
        self._chart.data = (number, span, target, other, measured)

    def _next_states(self, steps: Sequence[LoggedStep], count: int) -> Array:
        """Next states of the first steps, NaN where there are fewer; shape (count,)."""
        values = np.full(count, np.nan)
        existing = steps[:count]
        values[: len(existing)] = [logged.record.next_state[self._index] for logged in existing]
        return values


NO_OVERLAY = "nothing"
SPEEDS = {"¼": 0.25, "½": 0.5, "1": 1.0, "2": 2.0, "4": 4.0, "16": 16.0}
"""Selectable speeds, relative to real time."""

CAMERA = (1.1, -1.42, 1.05)
LOOK_AT = (0.07, 0.18, 0.57)
"""Position of the camera and its target, relative to the start of the track, in heights of the robot."""


class Page:
    """Shows the data of a run on a server's page.

    Actions of users are executed at the next `update`, in the thread that calls it.

    Args:
        iteration: Deployment that is shown first; None for the last.
        live: Whether the run is in progress, so that the newest step is shown.
    """

    def __init__(self, server: ViserServer, source: Source, iteration: int | None = None, live: bool = False):
        self._server = server
        self._source = source
        self._actions = SimpleQueue[Callable[[], None]]()
        self.player = Player(follow=live)
        self.iteration = 0
        self.overlaid = None
        self._drawn: tuple[object, ...] = ()
        self._build_scene()
        self._build_controls()
        self._build_plots()
        self._find_deployments()
        self.choose(max(source.iterations, default=0) if iteration is None else iteration)
        self.overlay(0 if self.iteration else None)
        self.player.follow = live
        self.update(0.0)

    def choose(self, iteration: int) -> None:
        """Shows a deployment from its start."""
        self.iteration = iteration
        self._source.want(iteration)
        self.player.show(0)
        self._deployment.value = self._label(iteration)

    def overlay(self, iteration: int | None) -> None:
        """Shows another deployment as a ghost next to the chosen one; None for no ghost."""
        self.overlaid = iteration
        if iteration is not None:
            self._source.want(iteration)
        self._overlay.value = NO_OVERLAY if iteration is None else self._label(iteration)

    def toggle(self) -> None:
        """Pauses or resumes the motion."""
        self.player.toggle()

    def one_step(self) -> None:
        """Plays one step to its end."""
        self.player.one_step(self._source.motion_count(self.iteration))

    def follow(self) -> None:
        """Shows the newest step of the newest deployment, and follows new steps."""
        newest = max(self._source.iterations, default=0)
        if newest != self.iteration:
            self.choose(newest)
        self.player.show(self._source.motion_count(newest) - 1)
        self.player.playing = self.player.follow = True

    def update(self, elapsed: float) -> None:
        """Executes the users' actions, reads new data, and advances the displayed time [s]."""
        while True:
            try:
                self._actions.get_nowait()()
            except Empty:
                break
        source = self._source
        player = self.player
        if source.poll():
            self._find_deployments()
        newest = max(source.iterations, default=0)
        if player.follow and newest > self.iteration and player.share >= 1:
            self.choose(newest)
            player.follow = True
        count = source.motion_count(self.iteration)
        player.advance(elapsed, count, self._duration)
        with self._server.atomic():
            self._show_motion()
            state = (self.iteration, self.overlaid, player.step, count, source.missing_motion, player.playing)
            if state != self._drawn:
                self._show_step()
                self._drawn = state

    def _duration(self, number: int) -> float | None:
        motion = self._source.motion(self.iteration, number)
        return motion.duration if motion else None

    def _build_scene(self) -> None:
        api = self._server.scene
        source = self._source
        api.set_up_direction("+z")
        self._world = api.add_frame("/world", show_axes=False)
        if source.kinematics is None:
            return
        scene = source.kinematics.scene
        light(api)
        self._ground = Ground(api, "/world/ground", scene)
        self._robot = RobotScene(api, "/world/robot", scene)
        self._ghost = RobotScene(api, "/world/ghost", scene, ghost=True)
        self._ghost.hide()
        height = source.kinematics.at_section(source.space.state_centre)[:, 2].max()
        start = np.array([0.0, -scene.circle, 0.0])
        self._server.initial_camera.position = tuple(start + height * np.array(CAMERA))
        self._server.initial_camera.look_at = tuple(start + height * np.array(LOOK_AT))

    def _build_controls(self) -> None:
        gui = self._server.gui
        gui.main_panel.dock_right()
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.set_panel_label(f"StepGap – {self._source.folder.resolve().name}")
        self._status = gui.add_markdown("")
        self._deployment = gui.add_dropdown("Deployment", [self._label(0)])
        self._overlay = gui.add_dropdown("Overlay", [NO_OVERLAY], hint="A deployment shown next to it, step by step")
        self._step = gui.add_slider("Step", 0, 1, 1, 0, hint="0: before the first step")
        self._buttons = gui.add_button_group("Play", ("Pause / play", "One step", "Newest"))
        self._speed = gui.add_dropdown("Speed", list(SPEEDS), initial_value="1", hint="Times real time")
        self._ride = gui.add_checkbox("Ride along", True, hint="The robot stays in view, and the floor turns under it")
        actions = {"Pause / play": self.toggle, "One step": self.one_step, "Newest": self.follow}
        self._buttons.on_click(lambda event: self._actions.put(actions.get(event.target.value, lambda: None)))
        self._when_changed(self._deployment, lambda label: self.choose(_number(label)))
        self._when_changed(self._overlay, lambda label: self.overlay(None if label == NO_OVERLAY else _number(label)))
        self._when_changed(self._step, self._show_from)
        self._when_changed(self._speed, self.set_speed)

    def _show_from(self, number: int) -> None:
        """Shows a step from its start; sets the slider again, because an automatic move may have come in between."""
        number = min(max(number, 0), int(self._step.max))
        self.player.show(number)
        self._step.value = number + 1 if number < self._step.max else number - 1
        self._drawn = ()

    def set_speed(self, label: str) -> None:
        """Sets the speed to one of `SPEEDS`."""
        self.player.speed = SPEEDS[label]

    def _when_changed(self, control: Any, act: Callable[[Any], None]) -> None:
        """Calls `act` when a user, not this program, changes a control to one of its options, if it has some."""

        def changed(event: Any) -> None:
            value = control.value
            if event.client is not None and value in getattr(control, "options", [value]):
                self._actions.put(lambda: act(value))

        control.on_update(changed)

    def _build_plots(self) -> None:
        gui = self._server.gui
        add_legend(gui, [("┅", INK, "target"), ("━", BLUE, "measured"), ("┉", VERMILLION, "overlaid")])
        self._tracking = [TrackingPlot(gui, quantity, index) for index, quantity in enumerate(self._source.space.state)]

    def _find_deployments(self) -> None:
        labels = [self._label(number) for number in self._source.iterations] or [self._label(0)]
        for control, options in ((self._deployment, labels), (self._overlay, [NO_OVERLAY, *labels])):
            if list(control.options) != options:
                control.options = options

    def _label(self, iteration: int) -> str:
        if iteration > 0:
            return f"{iteration}: corrected map"
        learns = self._source.settings.learning.learns_in(0)
        return "0: learning from the start" if learns else "0: nominal map"

    def _show_motion(self) -> None:
        source = self._source
        player = self.player
        motion = source.motion(self.iteration, player.step)
        if motion is None or source.kinematics is None:
            return
        scene = source.kinematics.scene
        frame = motion.frame(player.share)
        self._robot.show(motion.positions[frame])
        self._ground.show(float(motion.ground[frame]), source.ground(self.iteration))
        ridden = float(scene.progress(motion.positions[frame])) if self._ride.value else 0.0
        yaw, x = (ridden, 0.0) if scene.circle else (0.0, ridden)
        self._world.wxyz = (np.cos(yaw / 2), 0.0, 0.0, -np.sin(yaw / 2))
        self._world.position = (-x, 0.0, 0.0)
        self._show_ghost(scene, float(scene.progress(motion.positions[0])))

    def _show_ghost(self, scene: Scene, start: float) -> None:
        """Draws the overlaid deployment in the same step, starting at the same position."""
        number = self.player.step
        other = self.overlaid
        motion = None
        if other is not None and other != self.iteration and number < self._source.motion_count(other):
            motion = self._source.motion(other, number)
        if motion is None:
            self._ghost.hide()
            return
        by = start - float(scene.progress(motion.positions[0]))
        self._ghost.show(scene.displaced(motion.positions[motion.frame(self.player.share)], by))

    def _show_step(self) -> None:
        source = self._source
        number = self.player.step
        steps = source.steps(self.iteration)
        other = self.overlaid
        overlaid = [] if other is None or other == self.iteration else source.steps(other)
        self._step.max = max(1, len(steps))
        self._step.value = min(number, len(steps))
        self._status.content = self._describe(steps, number)
        for plot in self._tracking:
            plot.show(steps, overlaid, number)

    def _describe(self, steps: list[LoggedStep], number: int) -> str:
        """Description of the displayed step, with a table."""
        lines = [] if self.player.playing else ["**Paused.**"]
        if not number:
            lines.append("The robot is released." if self.player.share < 1 else "The robot has been released.")
        elif number > len(steps):
            lines.append("This step is being executed.")
        else:
            lines.append(_step_table(steps[number - 1], self._source))
        if missing := self._source.missing_motion:
            lines.append(f"There is no motion: {as_markdown(missing.reason)}")
        return "\n\n".join(lines)


def as_markdown(text: str) -> str:
    """Plain text for Markdown, which viser shows with the HTML in it: marks that may mean something are entities."""
    return "".join(letter if letter.isalnum() or letter in " .,:/()" else f"&#{ord(letter)};" for letter in text)


def _number(label: str) -> int:
    return int(label.partition(":")[0])


def _step_table(logged: LoggedStep, source: Source) -> str:
    """Markdown table of target, prediction and measured end of a step, with its command."""
    record = logged.record
    space = source.space
    head = f"**Step {logged.step}**"
    if record.status != StepStatus.OK:
        head += f": {record.status.label}"
    rows = ["| | target | predicted | measured |", "|---|---:|---:|---:|"]
    for index, quantity in enumerate(space.state):
        values = (logged.target[index], logged.predicted[index], record.next_state[index])
        rows.append(
            f"| {as_markdown(with_unit(quantity))} | {' | '.join(in_scale(value, quantity) for value in values)} |"
        )
    command = in_words(space.command, record.command)
    return "\n".join([head, "", *rows, "", f"Command: {command}"])
