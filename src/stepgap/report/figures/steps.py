"""The figures of a run in the style of the paper's Figs. 4 to 7: tracking, commands, errors and maps.

Line styles and markers make them readable without colour.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.control.reference import same_target
from stepgap.experiment.bands import interval_coverage, rmse_interval
from stepgap.experiment.outcome import cut_commands
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised, unit_suffix
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import BLACK, BLUE, GREY, LIGHT, SKY, VERMILLION, axis_label, plain, unit_label
from stepgap.report.figures import RunFigure
from stepgap.report.plots import (
    as_pixels,
    draw_tracking,
    drawn_values,
    ends_of_steps,
    finish,
    log_scale,
    show_steps,
    step_numbers,
    step_panels,
    write_note,
)

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_FLOOR: Final = 1e-2
"""Fraction of the smallest error below which the noise floor is not drawn, because it would squeeze the errors."""

MOST_CHANGES: Final = 60  # Number of changes of the target up to which each change is marked

VISIBLE: Final = 0.01
"""Relative change of a standard deviation above which a caption explains that it changes."""

FIRST_LOOK: Final[dict[str, Any]] = {"color": VERMILLION, "linestyle": "-.", "linewidth": 1.1}
LAST_LOOK: Final[dict[str, Any]] = {"color": BLUE, "linestyle": "-", "linewidth": 1.1, "marker": ".", "markersize": 3}


def tracking_figure(run: Run) -> "Figure":
    """State coordinates against the step number, in the first and last deployment, with the reference (Fig. 4).

    Below them is the ground above which some are measured.
    """
    first = run.shown_iterations[0]
    last = run.shown_iterations[-1]
    grounds = list(dict.fromkeys(quantity.above for quantity in run.space.state if quantity.above))
    figure, panels = step_panels(len(run.space.state) + len(grounds))
    longest = max((run.steps.of_iteration(number).tracking() for number in run.steps.iterations), key=len)
    show_steps(panels, run.steps)
    for index, (panel, quantity) in enumerate(zip(panels, run.space.state, strict=False)):
        reference = {"color": LIGHT, "linewidth": 3.5, "drawstyle": "steps-mid", "label": "reference"}
        panel.plot(step_numbers(longest), longest.target[:, index], **reference, **as_pixels(longest))
        steps = run.steps.of_iteration(first)
        draw_tracking(panel, steps, index, _name(run, first), {**FIRST_LOOK, **as_pixels(steps)})
        if last != first:
            steps = run.steps.of_iteration(last)
            draw_tracking(panel, steps, index, _name(run, last), {**LAST_LOOK, **as_pixels(steps)})
        panel.set_ylabel(axis_label(quantity))
    for panel, name in zip(panels[len(run.space.state) :], grounds, strict=True):
        _draw_ground(panel, run, name)
    finish(figure, panels, "Step")
    return figure


def command_figure(run: Run) -> "Figure":
    """Commands against the step number, in the first and last deployment, with their bounds if these are known."""
    first = run.shown_iterations[0]
    last = run.shown_iterations[-1]
    bounds = None if isinstance(run.nominal, Missing) else run.nominal.space
    figure, panels = step_panels(len(run.space.command))
    show_steps(panels, run.steps)
    for index, (panel, quantity) in enumerate(zip(panels, run.space.command, strict=True)):
        for number, look in {first: FIRST_LOOK, last: LAST_LOOK}.items():
            steps = run.steps.of_iteration(number)
            numbers = step_numbers(steps)
            requested = steps.requested[:, index]
            panel.plot(numbers, requested, label=_name(run, number), **{**look, **as_pixels(steps)})
            cut = cut_commands(steps)[:, index]
            if bounds is not None and cut.any():
                mark = {"color": look["color"], "marker": "v", "linestyle": "", "markersize": 5, "fillstyle": "none"}
                panel.plot(numbers[cut], requested[cut], label="cut by limits", **mark)
        if bounds is not None:
            for row, bound in enumerate((bounds.command[index].lower, bounds.command[index].upper)):
                panel.axhline(bound, color=GREY, linestyle=(0, (1, 2)), label="" if row else "bounds")
        panel.set_ylabel(axis_label(quantity))
    finish(figure, panels, "Step")
    return figure


def error_figure(run: Run) -> "Figure":
    """RMSE and MAE of the tracked coordinates by deployment, with published ones for the same reference (Fig. 5)."""
    rows = run.steps.tracking().tracked or list(range(len(run.space.state)))
    figure, panels = step_panels(len(rows))
    numbers = [deployment.iteration for deployment in run.deployments]
    theirs = run.compared_result
    panels[0].set_xlim(-0.25, max([*numbers, theirs.last if theirs else 1]) + 0.25)
    for panel, index in zip(panels, rows, strict=True):
        quantity = run.space.state[index]
        for measure, look in (("rmse", "s-"), ("mae", "o--")):
            values = [deployment.errors[measure][index] for deployment in run.deployments]
            if np.isfinite(values).any():
                panel.plot(numbers, values, look, color=BLUE, label=f"{measure.upper()}, this run")
        ends = [rmse_interval(run.steps.of_iteration(number))[:, index] for number in numbers]
        if np.isfinite(ends).any():
            panel.vlines(
                numbers, *np.transpose(ends), color=BLUE, linewidth=2.5, alpha=0.4, label="95 % interval of the RMSE"
            )
        floor = run.noise_floor[index]
        drawn = drawn_values(panel)
        if floor > LEAST_FLOOR * np.min(drawn, where=drawn > 0, initial=np.inf):
            panel.axhline(floor, color=GREY, linestyle=(0, (1, 2)), label="noise floor, this run")
            if np.isfinite(run.noise_floor_interval[:, index]).all():
                shade = {"color": "0.9", "zorder": 0, "label": "95 % interval of the noise floor"}
                panel.axhspan(*run.noise_floor_interval[:, index], **shade)
        if theirs:
            values = {number: theirs.error("mae", number, index) for number in range(theirs.last + 1)}
            shown = {number: value for number, value in values.items() if value is not None}
            label = f"MAE, {theirs.source}'s hardware"
            panel.plot([*shown], [*shown.values()], "^:", color=VERMILLION, label=label)
        panel.set_ylabel(f"Error of\n{axis_label(quantity, capital=False)}")
        log_scale(panel, drawn_values(panel))
        if not panel.lines:
            write_note(panel, "There is no error yet.")
    finish(figure, panels, _deployment_label(run))
    return figure


def map_figure(run: Run, index: int) -> "Figure":
    """Predicted and measured next state, and the standard deviation of the prediction (Figs. 6 and 7).

    Args:
        index: Index of the state coordinate.
    """
    figure, (upper, lower) = step_panels(2)
    quantity = run.space.state[index]
    last = run.steps.of_iteration(run.shown_iterations[-1])
    _draw_prediction(upper, last, index)
    upper.set_ylabel(axis_label(quantity))
    upper.set_title(f"(a) deployment {run.shown_iterations[-1]}", loc="left", fontsize="medium")
    learned = [number for number in run.shown_iterations if run.steps.of_iteration(number).std[:, index].any()]
    redeployed = list(dict.fromkeys(learned[:1] + learned[-1:]))
    drawn = [run.steps.of_iteration(number) for number in redeployed]
    show_steps([upper, lower], run.steps)
    for number, steps, style in zip(redeployed, drawn, (FIRST_LOOK, LAST_LOOK)[-len(drawn) :], strict=False):
        lower.plot(step_numbers(steps), steps.std[:, index], label=f"deployment {number}", **style, **as_pixels(steps))
    if learned:
        lower.set_ylim(0, 1.08 * max(float(np.max(steps.std[:, index])) for steps in drawn))
        _mark_changes(lower, last.tracking())
    else:
        write_note(lower, "These maps give no standard deviation.")
    lower.set_ylabel(f"Standard deviation{unit_label(quantity)}")
    lower.set_title("(b)", loc="left", fontsize="medium")
    finish(figure, [upper, lower], "Step", own_legends=True)
    return figure


def _name(run: Run, iteration: int) -> str:
    """Name of a deployment in legends."""
    kind = run.residual_name(iteration)
    labels = {"none": "nominal map", None: "unfinished"}
    return f"deployment {iteration}, {labels.get(kind) or 'corrected by ' + plain(str(kind))}"


def _deployment_label(run: Run) -> str:
    """Label of the axis of deployments, with the maps that they used."""
    nominal = [deployment.iteration for deployment in run.deployments if deployment.residual == "none"]
    if nominal == [0]:
        return f"Deployment (0: nominal map{'; later ones: corrected map' * (len(run.deployments) > 1)})"
    return "Deployment" if nominal or not run.deployments else "Deployment (all of this run: corrected map)"


def _draw_ground(panel: "Axes", run: Run, name: str) -> None:
    """Draws a measured ground of each step, in the first and the last deployment."""
    index = run.space.context_names.index(name)
    for number, look in {run.shown_iterations[0]: FIRST_LOOK, run.shown_iterations[-1]: LAST_LOOK}.items():
        steps = run.steps.of_iteration(number)
        style = {**look, "marker": "", "drawstyle": "steps-mid"}
        panel.plot(step_numbers(steps), steps.context[:, index], **style, **as_pixels(steps))
    panel.set_ylabel(axis_label(run.space.context[index]))


def _draw_prediction(panel: "Axes", steps: Steps, index: int) -> None:
    numbers = step_numbers(steps)
    std = steps.std[:, index]
    mean = steps.predicted[:, index]
    reached = ends_of_steps(steps, index)
    mean = np.where(np.isfinite(mean), mean, np.nan)
    if np.isnan(reached).all():
        write_note(panel, "No step has a next state.")
        return
    fast = as_pixels(steps)
    if std.any():
        band = {"color": SKY, "alpha": 0.5, "linewidth": 0, "label": "95 % band"}
        panel.fill_between(numbers, mean - INTERVAL_95 * std, mean + INTERVAL_95 * std, **band, **fast)
    panel.plot(numbers, mean, color=BLUE, linewidth=1.2, label="predicted mean", **fast)
    measured = {"color": BLACK, "linestyle": "", "marker": ".", "markersize": 3.5, "label": "measured"}
    panel.plot(numbers, reached, **measured, **fast)


def _mark_changes(panel: "Axes", steps: Steps) -> None:
    """Draws a light line at every step whose target differs from the previous one."""
    changes = np.flatnonzero(~same_target(steps.target[1:], steps.target[:-1])) + 1
    if len(changes) <= MOST_CHANGES:
        for order, step in enumerate(step_numbers(steps)[changes]):
            panel.axvline(step, color="#cccccc", lw=0.8, zorder=0, label="" if order else "change of the target")


def _first_and_last(run: Run) -> tuple[str, str]:
    """Phrases on the deployments that are drawn, and on how they learned."""
    first = run.shown_iterations[0]
    last = run.shown_iterations[-1]
    if first == last:
        return f"in deployment {first}", "of a single deployment"
    if run.residual_name(first) == "none" and run.residual_name(last) not in ("none", None):
        return "in the first and the last deployment", "without and with the learned correction"
    return "in the first and the last deployment", "in two deployments"


def _tracking_caption(analysis: Analysis) -> str:
    which, how = _first_and_last(analysis.run)
    below = " Below: the ground above which it was measured." * analysis.run.space.is_above_context
    return f"Tracking {how}: the state at the end of each step {which}, and the reference.{below}"


def _command_caption(analysis: Analysis) -> str:
    run = analysis.run
    which, _ = _first_and_last(run)
    drawn = {run.shown_iterations[0], run.shown_iterations[-1]}
    cut = any(cut_commands(run.steps.of_iteration(number)).any() for number in drawn)
    has_bounds = not isinstance(run.nominal, Missing)
    return (
        f"Requested commands {which}.{' Dotted: their bounds.' * has_bounds}"
        f"{' Triangles: limits of the robot removed a part.' * (has_bounds and cut)}"
    )


def _error_caption(analysis: Analysis) -> str:
    text = "Tracking error by deployment, on logarithmic axes."
    theirs = analysis.run.compared_result
    if theirs is None:
        return text
    return f"{text} {capitalised(theirs.source)}'s points are from its hardware: {theirs.origin}."


def map_caption(run: Run, row: int) -> str:
    """Caption of the map of a state coordinate."""
    quantity = run.space.state[row]
    last = run.shown_iterations[-1]
    unsure = [number for number in run.shown_iterations if run.steps.of_iteration(number).std[:, row].any()]
    held = [_held(run, iteration, row) for iteration in run.steps.iterations]
    band = " with 95 % band, noise included," if last in unsure else ""
    reasons = _reasons(run, row, unsure)
    text = f"Map of {quantity.name}. (a) Its mean{band} and the measured next state, in deployment {last}."
    if any(held):
        text += f" The band, predicted before the step, contains {', '.join(filter(None, held))}."
    if len(unsure) > 1:
        text += f" (b) Its standard deviation, noise included, in deployments {unsure[0]} and {unsure[-1]}.{reasons}"
    elif unsure:
        text += f" (b) Its standard deviation, noise included, in deployment {unsure[0]}.{reasons}"
    else:
        nothing = ", because nothing had been learned yet" * (run.residual_name(last) == "none")
        text += f" (b) The map gave no standard deviation{nothing}."
    theirs = run.compared_result
    if theirs and theirs.largest_std and unsure:
        before, after = (f"{std[row]:g}{unit_suffix(quantity)}" for std in theirs.largest_std)
        text += (
            f" On {theirs.source}'s hardware it was at most about {before} in its first and {after} in its last "
            "redeployment."
        )
    return text


def _reasons(run: Run, row: int, iterations: Sequence[int]) -> str:
    """Sentences on why the standard deviation of a coordinate changes in the first and last of these deployments."""
    drawn = [run.steps.of_iteration(number) for number in dict.fromkeys([*iterations[:1], *iterations[-1:]])]
    stds = [steps.std[:, row] for steps in drawn]
    if not any(np.ptp(std) > VISIBLE * std.max() for std in stds):
        return ""
    targets = [steps.tracking().target for steps in drawn]
    changes = any(not same_target(target[1:], target[:-1]).all() for target in targets)
    farther = " It is larger where state and command are farther from recorded ones"
    text = f"{farther}{', often after a change of the target' * changes}."
    if not isinstance(run.settings, Missing) and run.settings.learning.drift:
        text += " It jumps where what is believed of the robot changes."
    return text


def _held(run: Run, iteration: int, row: int) -> str:
    """Number of measurements of a deployment within the band, as text; empty where there was no band."""
    inside, count = (int(counts[row]) for counts in interval_coverage(run.steps.of_iteration(iteration)))
    return f"{inside} of {count} measurements ({100 * inside / count:.0f} %) in deployment {iteration}" if count else ""


TRACKING = RunFigure(
    "tracking", "figures", 1, "the tracking", _tracking_caption, lambda analysis: tracking_figure(analysis.run)
)
COMMANDS = RunFigure(
    "commands", "figures", 2, "the commands", _command_caption, lambda analysis: command_figure(analysis.run)
)
ERRORS = RunFigure("errors", "figures", 3, "the errors", _error_caption, lambda analysis: error_figure(analysis.run))
MAPS = RunFigure(
    "map",
    "figures",
    5,
    "the map",
    lambda analysis, row: map_caption(analysis.run, row),
    lambda analysis, row: map_figure(analysis.run, row),
    of_each_state=True,
)
