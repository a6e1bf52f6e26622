"""Figures of a run, in the style of the paper's Figs. 4 to 7.

They are made without `pyplot`, so that no figure stays open. Line styles and markers make them readable without colour.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from stepgap.base.normal import INTERVAL_95
from stepgap.experiment.outcome import cut_commands
from stepgap.learning.steps import Steps
from stepgap.records.run_folder import RunRecord
from stepgap.report.colours import BLACK, BLUE, GREY, LIGHT, SKY, VERMILLION
from stepgap.report.intervals import rmse_interval
from stepgap.step import Array, Quantity, StepSpace, StepStatus

WIDTH: Final = 7.16
"""Width of every figure [inches]: both columns of a journal's page, so that fonts are printed in their size."""

MOST_VECTORS: Final = 2000
"""Number of steps above which curves are drawn as pixels inside the vector graphic, so that its file stays small."""

LEAST_FLOOR: Final = 1e-2
"""Fraction of the smallest error below which the noise floor is not drawn, because it would squeeze the errors."""

MOST_CHANGES: Final = 60
"""Number of changes of the target up to which each change is marked."""

LONGEST_LABEL: Final = 26
"""Largest number of drawn characters of a name."""

RUN_COLOURS: Final = (BLUE, VERMILLION, BLACK, "#009E73", "#CC79A7")
RUN_MARKERS: Final = ("o", "s", "^", "D", "v", "x", "P")
RUN_LINES: Final = ("-", "--", "-.", ":")
FIRST_LOOK: Final[dict[str, Any]] = {"color": VERMILLION, "linestyle": "-.", "linewidth": 1.1}
LAST_LOOK: Final[dict[str, Any]] = {"color": BLUE, "linestyle": "-", "linewidth": 1.1, "marker": ".", "markersize": 3}


def tracking_figure(record: RunRecord) -> Figure:
    """State coordinates against the step number, in the first and last deployment, with the reference (Fig. 4)."""
    first, last = record.shown_iterations[0], record.shown_iterations[-1]
    figure, panels = _panels(len(record.space.state))
    longest = max((record.steps.of_iteration(number).tracking() for number in record.steps.iterations), key=len)
    _show_steps(panels, record.steps)
    for index, (panel, quantity) in enumerate(zip(panels, record.space.state, strict=True)):
        reference = {"color": LIGHT, "linewidth": 3.5, "drawstyle": "steps-mid", "label": "reference"}
        panel.plot(_numbers(longest), longest.target[:, index], **reference, **_pixels(longest))
        steps = record.steps.of_iteration(first)
        _draw_tracking(panel, steps, index, _name(record, first), {**FIRST_LOOK, **_pixels(steps)})
        if last != first:
            steps = record.steps.of_iteration(last)
            _draw_tracking(panel, steps, index, _name(record, last), {**LAST_LOOK, **_pixels(steps)})
        panel.set_ylabel(axis_label(quantity))
    _finish(figure, panels, "Step")
    return figure


def command_figure(record: RunRecord, bounds: StepSpace | None) -> Figure:
    """Commands against the step number, in the first and last deployment, with their bounds.

    Args:
        record: The run.
        bounds: Its state and command with their bounds; None if these are not known.
    """
    first, last = record.shown_iterations[0], record.shown_iterations[-1]
    figure, panels = _panels(len(record.space.command))
    _show_steps(panels, record.steps)
    for index, (panel, quantity) in enumerate(zip(panels, record.space.command, strict=True)):
        for number, look in {first: FIRST_LOOK, last: LAST_LOOK}.items():
            steps = record.steps.of_iteration(number)
            numbers, requested = _numbers(steps), steps.requested[:, index]
            panel.plot(numbers, requested, label=_name(record, number), **{**look, **_pixels(steps)})
            cut = cut_commands(steps)[:, index]
            if bounds is not None and cut.any():
                mark = {"color": look["color"], "marker": "v", "linestyle": "", "markersize": 5, "fillstyle": "none"}
                panel.plot(numbers[cut], requested[cut], label="cut by limits", **mark)
        if bounds is not None:
            for row, bound in enumerate((bounds.command[index].lower, bounds.command[index].upper)):
                panel.axhline(bound, color=GREY, linestyle=(0, (1, 2)), label="" if row else "bounds")
        panel.set_ylabel(axis_label(quantity))
    _finish(figure, panels, "Step")
    return figure


def error_figure(record: RunRecord) -> Figure:
    """RMSE and MAE of the state coordinates by deployment, with published ones for the same reference (Fig. 5)."""
    figure, panels = _panels(len(record.space.state))
    numbers = [deployment.iteration for deployment in record.deployments]
    theirs = record.compared_result
    panels[0].set_xlim(-0.25, max([*numbers, theirs.last if theirs else 1]) + 0.25)
    for index, (panel, quantity) in enumerate(zip(panels, record.space.state, strict=True)):
        for measure, look in (("rmse", "s-"), ("mae", "o--")):
            values = [deployment.errors[measure][index] for deployment in record.deployments]
            if np.isfinite(values).any():
                panel.plot(numbers, values, look, color=BLUE, label=f"{measure.upper()}, this run")
        ends = [rmse_interval(record.steps.of_iteration(number))[:, index] for number in numbers]
        if np.isfinite(ends).any():
            panel.vlines(
                numbers, *np.transpose(ends), color=BLUE, linewidth=2.5, alpha=0.4, label="95 % interval of the RMSE"
            )
        floor = record.noise_floor[index]
        drawn = _drawn(panel)
        if floor > LEAST_FLOOR * np.min(drawn, where=drawn > 0, initial=np.inf):
            panel.axhline(floor, color=GREY, linestyle=(0, (1, 2)), label="noise floor, this run")
            if np.isfinite(record.noise_floor_interval[:, index]).all():
                shade = {"color": "0.9", "zorder": 0, "label": "95 % interval of the noise floor"}
                panel.axhspan(*record.noise_floor_interval[:, index], **shade)
        if theirs:
            values = {number: theirs.error("mae", number, index) for number in range(theirs.last + 1)}
            shown = {number: value for number, value in values.items() if value is not None}
            label = f"MAE, {theirs.source}'s hardware"
            panel.plot([*shown], [*shown.values()], "^:", color=VERMILLION, label=label)
        panel.set_ylabel(f"Error of\n{axis_label(quantity, capital=False)}")
        log_scale(panel, _drawn(panel))
        if not panel.lines:
            _note(panel, "There is no error yet.")
    _finish(figure, panels, _deployment_label(record))
    return figure


def comparison_figure(records: Sequence[RunRecord], names: Sequence[str]) -> Figure:
    """RMSE of the state coordinates by deployment, with a curve for each run."""
    state = records[0].space.state
    figure, panels = _panels(len(state))
    for row, (record, name) in enumerate(zip(records, names, strict=True)):
        numbers = [deployment.iteration for deployment in record.deployments]
        look: dict[str, Any] = {
            "color": RUN_COLOURS[row % len(RUN_COLOURS)],
            "marker": RUN_MARKERS[row % len(RUN_MARKERS)],
        }
        for index, panel in enumerate(panels):
            values = [deployment.errors["rmse"][index] for deployment in record.deployments]
            if np.isfinite(values).any():
                panel.plot(numbers, values, **look, linestyle=RUN_LINES[row % len(RUN_LINES)], label=plain(name))
    for panel, quantity in zip(panels, state, strict=True):
        panel.set_ylabel(f"RMSE of\n{axis_label(quantity, capital=False)}")
        log_scale(panel, _drawn(panel))
        if not panel.lines:
            _note(panel, "There is no error yet.")
    _finish(figure, panels, "Deployment")
    return figure


def comparison_tracking_figure(records: Sequence[RunRecord], names: Sequence[str]) -> Figure:
    """State coordinates against the step number in the last deployment of each run, with the reference of the longest.

    The runs must have the same reference.
    """
    state = records[0].space.state
    figure, panels = _panels(len(state))
    last = [record.steps.of_iteration(record.shown_iterations[-1]).tracking() for record in records]
    longest = max(last, key=len)
    _show_steps(panels, longest)
    for index, (panel, quantity) in enumerate(zip(panels, state, strict=True)):
        reference = {"color": LIGHT, "linewidth": 3.5, "drawstyle": "steps-mid", "label": "reference"}
        panel.plot(_numbers(longest), longest.target[:, index], **reference, **_pixels(longest))
        for row, (steps, name) in enumerate(zip(last, names, strict=True)):
            look = {
                "color": RUN_COLOURS[row % len(RUN_COLOURS)],
                "linestyle": RUN_LINES[row % len(RUN_LINES)],
                "linewidth": 0.8,
            }
            _draw_tracking(panel, steps, index, plain(name), {**look, **_pixels(steps)})
        panel.set_ylabel(axis_label(quantity))
    _finish(figure, panels, "Step")
    return figure


def map_figure(record: RunRecord, index: int) -> Figure:
    """Predicted and measured next state, and the standard deviation of the prediction (Figs. 6 and 7).

    Args:
        record: The run.
        index: Index of the state coordinate.
    """
    figure, (upper, lower) = _panels(2)
    quantity = record.space.state[index]
    last = record.steps.of_iteration(record.shown_iterations[-1])
    _draw_prediction(upper, last, index)
    upper.set_ylabel(axis_label(quantity))
    upper.set_title(f"(a) deployment {record.shown_iterations[-1]}", loc="left", fontsize="medium")
    learned = [number for number in record.shown_iterations if record.steps.of_iteration(number).std[:, index].any()]
    redeployed = list(dict.fromkeys(learned[:1] + learned[-1:]))
    drawn = [record.steps.of_iteration(number) for number in redeployed]
    _show_steps([upper, lower], record.steps)
    for number, steps, style in zip(redeployed, drawn, (FIRST_LOOK, LAST_LOOK)[-len(drawn) :], strict=False):
        lower.plot(_numbers(steps), steps.std[:, index], label=f"deployment {number}", **style, **_pixels(steps))
    if learned:
        lower.set_ylim(0, 1.08 * max(float(np.max(steps.std[:, index])) for steps in drawn))
        _mark_changes(lower, last.tracking())
    else:
        _note(lower, "These maps give no standard deviation.")
    lower.set_ylabel(f"Standard deviation{unit_label(quantity)}")
    lower.set_title("(b)", loc="left", fontsize="medium")
    _finish(figure, [upper, lower], "Step", own_legends=True)
    return figure


def axis_label(quantity: Quantity, capital: bool = True) -> str:
    """Name of a coordinate with its unit, if the unit is known."""
    name = plain(quantity.name.replace("_", " "))
    return f"{name[:1].upper() + name[1:] if capital else name}{unit_label(quantity)}"


def plain(text: str) -> str:
    """Text that the figures' font contains: one short line of Latin, Greek or Cyrillic letters, without formulae."""
    known = "".join(letter if letter.isprintable() and ord(letter) < 0x500 else "?" for letter in text)
    return (known if len(known) <= LONGEST_LABEL else f"{known[: LONGEST_LABEL - 1]}…").replace("$", r"\$")


def unit_label(quantity: Quantity) -> str:
    """The unit in brackets after a space; empty where it is not known."""
    return f" [{plain(quantity.unit)}]" if quantity.unit else ""


def _name(record: RunRecord, iteration: int) -> str:
    """Name of a deployment in legends."""
    kind = record.residual_of(iteration)
    labels = {"none": "nominal map", None: "unfinished"}
    return f"deployment {iteration}, {labels.get(kind) or 'corrected by ' + plain(str(kind))}"


def _deployment_label(record: RunRecord) -> str:
    """Label of the axis of deployments, with the maps that they used."""
    nominal = [each.iteration for each in record.deployments if each.residual == "none"]
    if nominal == [0] or not record.deployments:
        return "Deployment (0: nominal map; later ones: corrected map)"
    return "Deployment" if nominal else "Deployment (all of this run: corrected map)"


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, 0.8 + 2.0 * count), layout="constrained")
    return figure, list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])


def _show_steps(panels: Sequence[Axes], steps: Steps) -> None:
    """Sets the axis of step numbers to these steps, and marks the exploratory ones."""
    first, last = int(steps.number.min()), int(steps.number.max())
    margin = 0.5 + 0.01 * (last - first)
    panels[0].set_xlim(first - margin, last + margin)
    for panel in panels if first < 1 else ():
        label = "exploratory steps" if panel is panels[-1] else ""
        panel.axvspan(first - margin, 0.5, color="0.93", linewidth=0, zorder=0, label=label)


def _numbers(steps: Steps) -> Array:
    return steps.number.astype(float)


def _pixels(steps: Steps) -> dict[str, Any]:
    return {"rasterized": len(steps) > MOST_VECTORS}


def _reached(steps: Steps, index: int) -> Array:
    """One coordinate of the next states, NaN where there was none; shape (N,)."""
    completed = steps.status == StepStatus.OK
    return np.where(completed, steps.next_state[:, index], np.nan)


def _draw_tracking(panel: Axes, steps: Steps, index: int, name: str, style: dict[str, Any]) -> None:
    numbers, reached = _numbers(steps), _reached(steps, index)
    panel.plot(numbers, reached, label=name, **style)
    failed = np.isnan(reached)
    if failed.any():
        mark = {"color": style["color"], "marker": "X", "linestyle": "", "markersize": 7, "clip_on": False}
        panel.plot(numbers[failed], steps.state[failed, index], label="no next state after this one", **mark)


def _draw_prediction(panel: Axes, steps: Steps, index: int) -> None:
    numbers, std = _numbers(steps), steps.std[:, index]
    mean, reached = steps.predicted[:, index], _reached(steps, index)
    mean = np.where(np.isfinite(mean), mean, np.nan)
    if np.isnan(reached).all():
        _note(panel, "No step has a next state.")
        return
    fast = _pixels(steps)
    if std.any():
        band = {"color": SKY, "alpha": 0.5, "linewidth": 0, "label": "95 % band"}
        panel.fill_between(numbers, mean - INTERVAL_95 * std, mean + INTERVAL_95 * std, **band, **fast)
    panel.plot(numbers, mean, color=BLUE, linewidth=1.2, label="predicted mean", **fast)
    measured = {"color": BLACK, "linestyle": "", "marker": ".", "markersize": 3.5, "label": "measured"}
    panel.plot(numbers, reached, **measured, **fast)


def _note(panel: Axes, text: str) -> None:
    """Writes a text into an empty panel."""
    panel.set_yticks([])
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", color=GREY)


def _mark_changes(panel: Axes, steps: Steps) -> None:
    """Draws a light line at every step whose target differs from the previous one."""
    changes = np.flatnonzero((np.diff(steps.target, axis=0) != 0).any(axis=1)) + 1
    if len(changes) <= MOST_CHANGES:
        for order, step in enumerate(_numbers(steps)[changes]):
            panel.axvline(step, color="#cccccc", lw=0.8, zorder=0, label="" if order else "change of the target")


def _drawn(panel: Axes) -> Array:
    """Values of all curves of a panel."""
    return np.concatenate([np.asarray(line.get_ydata(), float) for line in panel.lines] or [np.zeros(0)])


def log_scale(panel: Axes, values: Array) -> None:
    """Sets a logarithmic axis with plain numbers for these values, if there are positive ones."""
    if not (values > 0).any():
        return
    panel.set_yscale("log", nonpositive="mask")
    if values[values > 0].max() < 1e3 * values[values > 0].min():
        panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())


def _finish(figure: Figure, panels: list[Axes], step_label: str, own_legends: bool = False) -> None:
    """Adds labels, grid, and legends outside the data: one above all panels, or one above each."""
    for panel in panels:
        panel.grid(True, axis="y", color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        if own_legends and panel.get_legend_handles_labels()[1]:
            panel.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, borderaxespad=0.2)
    panels[-1].set_xlabel(step_label)
    figure.align_ylabels(panels)
    if not own_legends:
        found = {
            label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
        }
        figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=3, frameon=False)
