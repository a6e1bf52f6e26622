"""The figure of the limit cycles at the targets of a run: the reachable set, and the Floquet multipliers."""

from typing import TYPE_CHECKING

import numpy as np

from stepgap.records.missing import Missing
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import BLACK, BLUE, GREY, VERMILLION, axis_label, new_figure
from stepgap.report.figures import RunFigure
from stepgap.report.plots import clear_frame
from stepgap.report.reference_gait import ReferenceGait

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure


def reference_gait_figure(gait: ReferenceGait) -> "Figure":
    """Draws the reachable set from the central target, and the Floquet multipliers at all targets, map by map.

    There must be two state coordinates and two commands.
    """
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(3.7)
    plane, sizes = figure.subplots(1, 2, width_ratios=[1.5, 1])
    sizes.axhline(1, color=GREY, linewidth=1)
    looks = ({"color": VERMILLION, "linestyle": "-.", "marker": "x"}, {"color": BLUE, "linestyle": "-", "marker": "o"})
    for cycles, look in zip(gait.maps, looks, strict=False):
        border = cycles.reachable.boundary
        line = {name: look[name] for name in ("color", "linestyle")}
        label = f"boundary of the reachable set, {cycles.name} map"
        plane.plot(*np.vstack([border, border[:1]]).T, **line, linewidth=1.3, label=label)
        points = [(row, point) for row, point in enumerate(cycles.points, 1) if point]
        multipliers = [(row, abs(value)) for row, point in points for value in point.floquet_multipliers]
        mark = {"color": look["color"], "marker": look["marker"], "markerfacecolor": "none", "linestyle": ""}
        sizes.plot(*np.array(multipliers).reshape(-1, 2).T, **mark, label=f"open loop, {cycles.name} map")
    plane.plot(*gait.targets.T, ".", color=BLACK, label="targets")
    plane.plot(*gait.centre, "s", markersize=7, markerfacecolor="none", color=BLACK, label="start of the step")
    first, second = gait.space.state
    plane.set(xlabel=f"Next {axis_label(first, capital=False)}", ylabel=f"Next {axis_label(second, capital=False)}")
    plane.set_title("(a) One-step reachable set", loc="left", fontsize="medium")
    sizes.set(xlabel="Target, in the order of the reference", ylabel="Magnitude |λ| of the multipliers")
    sizes.set_ylim(bottom=0)
    sizes.xaxis.set_major_locator(MaxNLocator(integer=True))
    sizes.set_title("(b) Floquet multipliers", loc="left", fontsize="medium")
    for panel in (plane, sizes):
        clear_frame(panel)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def _is_known(analysis: Analysis) -> bool:
    gait = analysis.gait
    return not isinstance(gait, Missing) and (len(gait.space.state), len(gait.space.command)) == (2, 2)


def _caption(analysis: Analysis) -> str:
    gait = analysis.run.needed(analysis.gait)
    return (
        f"(a) The one-step reachable set within the command bounds, from the state {gait.centre_named}, the target "
        "nearest to the median of all. (b) Magnitudes of the Floquet multipliers (eigenvalues of the derivative of the "
        "next state with respect to the state) of the limit cycle at each target; below 1, an error decays. Open loop: "
        "at a constant command; the step controller does not need this stability."
    )


GAIT = RunFigure(
    "gait",
    "gait",
    8,
    "the reachable set",
    _caption,
    lambda analysis: reference_gait_figure(analysis.run.needed(analysis.gait)),
    _is_known,
)
