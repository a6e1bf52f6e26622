"""The picture of a trial: the robot in side view along its steps, and its states and commands step by step."""

from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.experiment.inputs import TRIAL_STEPS
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.report.drawing import BLACK, BLUE, GREY, LIGHT, VERMILLION, axis_label, new_figure
from stepgap.robots.scene import Kinematics, Motion, Scene

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POSTURES: Final = 6  # Number of postures that are drawn in each step, at most
MOST_POSTURES: Final = 60  # Number of postures in the picture, at most


def trial_figure(run: Run, kinematics: Kinematics | Missing) -> "Figure":
    """Draws the first steps of a run's only deployment, and the robot if its motion is known.

    Args:
        kinematics: How the robot is drawn from its ticks.
    """
    from matplotlib.ticker import MaxNLocator

    steps = run.steps.selected(slice(TRIAL_STEPS))
    space = run.space
    drawn = not isinstance(kinematics, Missing) and 0 in run.ticks
    count = len(space.state) + len(space.command)
    figure = new_figure(0.8 + 1.6 * drawn + 1.3 * count)
    grid = figure.add_gridspec(drawn + count, 1, height_ratios=[*[1.2] * drawn, *[1.0] * count])
    if drawn and not isinstance(kinematics, Missing):
        _draw_motion(figure.add_subplot(grid[0]), kinematics.scene, kinematics.motion(run.ticks[0]))
    number = steps.number.astype(float)
    panels = [figure.add_subplot(grid[drawn + row]) for row in range(count)]
    for panel, quantity, row in zip(panels, space.state, range(count), strict=False):
        panel.axhspan(quantity.lower, quantity.upper, color="0.94", zorder=0, label="range of use")
        panel.plot(number, steps.target[:, row], color=LIGHT, lw=3.5, drawstyle="steps-mid", label="target")
        panel.plot(number, steps.predicted[:, row], ".:", color=VERMILLION, lw=0.8, ms=4, label="predicted")
        panel.plot(number, steps.next_state[:, row], ".-", color=BLUE, lw=1.1, ms=4, label="measured")
        panel.set_ylabel(axis_label(quantity))
    for panel, quantity, values in zip(panels[len(space.state) :], space.command, steps.requested.T, strict=True):
        for bound in (quantity.lower, quantity.upper):
            panel.axhline(bound, color=GREY, linestyle=(0, (1, 2)))
        panel.plot(number, values, ".-", color=BLACK, lw=1.1, ms=4, drawstyle="steps-mid")
        panel.set_ylabel(axis_label(quantity))
    for panel in panels:
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.spines[["top", "right"]].set_visible(False)
        panel.set_xlim(0.5, max(TRIAL_STEPS, len(steps)) + 0.5)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, frameon=False, fontsize=8)
    panels[-1].set_xlabel("Step")
    figure.align_ylabels(panels)
    return figure


def _draw_motion(panel: "Axes", scene: Scene, motion: Motion) -> None:
    """Draws postures one after another along the track, and the path of the body."""
    frames = np.flatnonzero(motion.step <= TRIAL_STEPS)
    count = min(MOST_POSTURES, POSTURES * TRIAL_STEPS, len(frames))
    chosen = frames[np.linspace(0, len(frames) - 1, count).round().astype(int)]
    along = np.unwrap(scene.progress(motion.positions))
    positions = np.array([scene.displaced(motion.positions[frame], -along[frame]) for frame in frames])
    travelled = along[frames] * (scene.circle or 1.0)
    side = positions[..., 0] + travelled[:, None], positions[..., 2]
    for frame in np.searchsorted(frames, chosen):
        for link in scene.links:
            ends = [scene.index(link.start), scene.index(link.end)]
            shade = {"body": BLACK, "near": BLUE, "far": GREY}[link.shade]
            panel.plot(side[0][frame, ends], side[1][frame, ends], color=shade, lw=0.8, alpha=0.6)
    body = scene.index(scene.body)
    panel.plot(side[0][:, body], side[1][:, body], color=VERMILLION, lw=1)
    panel.axhline(0, color="0.6", lw=0.8)
    panel.set(aspect="equal", xlabel="Along the track [m]", ylabel="Height [m]")
    panel.spines[["top", "right"]].set_visible(False)
