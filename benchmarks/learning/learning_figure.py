"""The figure of the learning benchmark: the error of each method relative to that which it is compared with."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.learning.learning_summary import (
    DEFAULT,
    UNCORRECTED,
    DeploymentRow,
    Key,
    summarise_learning,
    tracking_error_of,
)
from benchmarks.learning.paired_differences import log_ratio
from stepgap.report.drawing import BLUE, GREY


def learning_picture(rows: Sequence[DeploymentRow], form: str) -> bytes:
    """Draws the ratio of errors on each twin and seed, its geometric mean and the 95 % interval of that.

    Each method is compared with that of its paired difference. Where this was not measured, all methods are compared
    with the uncorrected deployment, without an interval.
    """
    errors: dict[str, dict[Key, float]] = {}
    for row in rows:
        errors.setdefault(row["method"], {})[row["twin"], row["seed"]] = tracking_error_of(row)
    found = [(row["method"], row["difference"]) for row in summarise_learning(rows)["methods"]]
    compared = [(method, difference) for method, difference in found if difference]
    compared = compared or [(method, {"to": UNCORRECTED}) for method, _ in found if method != UNCORRECTED]
    points = [_ratios(errors[method], errors[difference["to"]]) for method, difference in compared]
    order = np.argsort([-np.mean(np.log(ratios)) for ratios in points], kind="stable")
    figure = Figure(figsize=(8, 0.9 + 0.3 * len(order)), layout="constrained")
    axes = figure.subplots()
    axes.axvline(1, color=GREY, linewidth=1)
    for height, index in enumerate(order):
        _draw(axes, height, points[index], compared[index][1])
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(order)), [compared[index][0] for index in order])
    axes.set_ylim(-0.7, len(order) - 0.3)
    base = DEFAULT if DEFAULT in errors else UNCORRECTED
    axes.set_xlabel(
        f"tracking error relative to {base}, of METHOD-RULE and template_METHOD relative to METHOD\n"
        "points: twins and seeds; diamond: geometric mean, filled if significant"
    )
    stream = BytesIO()
    figure.savefig(stream, format=form, dpi=150)
    return stream.getvalue()


def _ratios(errors: dict[Key, float], others: dict[Key, float]) -> list[float]:
    """Ratio of the errors on each twin and seed, limited as in the paired difference."""
    return [float(np.exp(log_ratio(error, others[key]))) for key, error in errors.items()]


def _draw(axes: Any, height: int, ratios: Sequence[float], difference: dict[str, Any]) -> None:
    """Draws one method; the diamond of a significant difference is filled."""
    offsets = height + 0.25 * np.linspace(-1, 1, len(ratios))
    axes.plot(ratios, offsets, ".", color="0.7", markersize=3, zorder=1)
    if interval := difference.get("interval"):
        axes.plot(interval, [height, height], "-", color=BLUE, linewidth=2.5, zorder=2)
    filled = BLUE if difference.get("significant") else "white"
    mean = difference.get("ratio", np.exp(np.mean(np.log(ratios))))
    axes.plot(mean, height, "D", color=BLUE, markerfacecolor=filled, markersize=5, zorder=3)
