"""Results of `stepgap bench learning`: measures of each method over all twins and seeds, table and figure."""

import math
from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from stepgap.experiment.bands import PAPER_BAND, WINDOW
from stepgap.report.colours import BLUE, GREY

DeploymentRow = dict[str, Any]
"""Measures of one deployment as plain data for JSON; a deployment without a step has none."""

Key = tuple[int, int]
"""Twin and seed."""

UNCORRECTED = "none"
"""Name of deployment 0, from which the other methods learn."""

BEYOND_NOISE = 2.0
"""Number of standard deviations of the difference between uncorrected deployments that counts as significant."""


def summarise_learning(rows: Sequence[DeploymentRow]) -> dict[str, Any]:
    """Measures of each method over all twins and seeds, as plain data for JSON.

    A deployment that ended with a fall has an infinite error.
    """
    table: dict[str, dict[Key, DeploymentRow]] = {}
    for row in rows:
        table.setdefault(row["method"], {})[row["twin"], row["seed"]] = row
    first = table[UNCORRECTED]
    noise = _noise(first)
    return {
        "schema": 1,
        "pairs": len(first),
        "drawn_again": sum({twin: row["drawn_again"] for (twin, _), row in first.items()}.values()),
        "noise": noise,
        "methods": [
            {"method": method, **_measures(found, first, noise), "better_than_gp": _better(found, table.get("gp", {}))}
            for method, found in table.items()
        ],
    }


def tracking_error_of(row: DeploymentRow) -> float:
    """Tracking error of both coordinates together in half ranges; infinite after a fall."""
    return math.inf if row["falls"] else row["error"]


def _noise(first: dict[Key, DeploymentRow]) -> float | None:
    """Standard deviation of log(error) − log(error) of two uncorrected deployments of one twin; None if unknown."""
    squares, degrees_of_freedom = 0.0, 0
    for twin in {twin for twin, _ in first}:
        errors = np.log(
            [tracking_error_of(row) for (owner, _), row in first.items() if owner == twin and not row["falls"]]
        )
        if len(errors) > 1:
            squares += float(np.sum((errors - errors.mean()) ** 2))
            degrees_of_freedom += len(errors) - 1
    return math.sqrt(2 * squares / degrees_of_freedom) if degrees_of_freedom else None


def _measures(rows: dict[Key, DeploymentRow], first: dict[Key, DeploymentRow], noise: float | None) -> dict[str, Any]:
    """Measures of one method over its deployments."""
    ratio = np.array([_ratio(tracking_error_of(row), tracking_error_of(first[key])) for key, row in rows.items()])
    counted = sum(row.get("counted", 0) for row in rows.values())
    covered = np.sum([row["covered"] for row in rows.values() if "covered" in row], axis=0)
    hops = [row.get("hops_to_band") for row in rows.values()]
    return {
        "count": len(rows),
        **{name: _median(rows, name) for name in ("rmse", "transient_rmse", "steady_rmse")},
        "ratio": _finite(float(np.median(ratio))),
        "hops_to_band": _finite(float(np.median([math.inf if hop is None else hop for hop in hops]))),
        "reached_band": sum(hop is not None for hop in hops),
        "falls": sum(row["falls"] for row in rows.values()),
        "worse": None if noise is None else int(np.sum(ratio > math.exp(BEYOND_NOISE * noise))),
        "coverage": (covered / counted).tolist() if counted else None,
    }


def _better(rows: dict[Key, DeploymentRow], others: dict[Key, DeploymentRow]) -> int | None:
    """Number of twins and seeds with a smaller error than another method; None if that was not measured."""
    if not others:
        return None
    return sum(tracking_error_of(row) < tracking_error_of(others[key]) for key, row in rows.items())


def _ratio(error: float, uncorrected: float) -> float:
    """Ratio of two errors; 1 where both deployments fell."""
    return 1.0 if error == uncorrected == math.inf else error / uncorrected


def _median(rows: dict[Key, DeploymentRow], name: str) -> list[float | None]:
    values = [row[name] if not row["falls"] else [math.inf, math.inf] for row in rows.values()]
    return [_finite(value) for value in np.median(values, axis=0).tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


HEADER = (
    "method",
    *("speed [mm/s]", "transient", "steady"),
    *("height [mm]", "transient", "steady"),
    *("ratio", "hops", "in band", "falls", "worse", "beats gp", "speeds in", "heights in"),
)
"""Columns of the table."""


def describe_learning(summary: dict[str, Any]) -> str:
    """The summary as a Markdown table, which is also readable as plain text."""
    table = [HEADER, *map(_cells, summary["methods"])]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "| " + " | ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)) + " |" for row in table
    ]
    lines.insert(1, "|" + "|".join(f"{'-' * (width + 1)}:" for width in widths) + "|")
    lines += [
        "",
        f"Speed and height: RMSE, median over {summary['pairs']} twins and seeds; a fall counts as an infinite error.",
        "ratio: error of both coordinates together, relative to that of deployment 0.",
        f"hops: number of hops until the RMSE of {WINDOW} steps stays within {1e3 * PAPER_BAND[0]:.1f} mm/s and "
        f"{1e3 * PAPER_BAND[1]:.1f} mm; in band: number of twins and seeds that reach this.",
        "beats gp: number with a smaller error than gp. in: fraction of steps within the 95 % interval.",
    ]
    if summary["noise"] is not None:
        lines.append(
            f"worse: number with more than {math.exp(BEYOND_NOISE * summary['noise']):.2f} times the error of "
            "deployment 0, which chance alone causes in one case of 40."
        )
    return "\n".join(lines)


def _cells(row: dict[str, Any]) -> list[str]:
    """Cells of one line of the table."""
    errors = [row[name][i] for i in (0, 1) for name in ("rmse", "transient_rmse", "steady_rmse")]
    return [
        row["method"],
        *("∞" if error is None else f"{1e3 * error:.1f}" for error in errors),
        "∞" if row["ratio"] is None else f"{row['ratio']:.2f}",
        "never" if row["hops_to_band"] is None else f"{row['hops_to_band']:.0f}",
        *(
            "-" if row[name] is None else str(row[name])
            for name in ("reached_band", "falls", "worse", "better_than_gp")
        ),
        *(f"{share:.1%}" for share in row["coverage"] or ()),
        *("-" for _ in range(0 if row["coverage"] else 2)),
    ]


def learning_picture(rows: Sequence[DeploymentRow], form: str) -> bytes:
    """Draws the error of each method relative to that of `gp` (or of `none`) on the same twin and seed."""
    base = "gp" if any(row["method"] == "gp" for row in rows) else UNCORRECTED
    errors = {(row["twin"], row["seed"]): tracking_error_of(row) for row in rows if row["method"] == base}
    ratios: dict[str, list[float]] = {}
    for row in rows:
        error, compared = tracking_error_of(row), errors[row["twin"], row["seed"]]
        if row["method"] != base and math.isfinite(error + compared):
            ratios.setdefault(row["method"], []).append(error / compared)
    names = sorted(ratios, key=lambda name: float(np.median(ratios[name])), reverse=True)
    figure = Figure(figsize=(8, 0.6 + 0.38 * len(names)), layout="constrained")
    axes = figure.subplots()
    axes.axvline(1, color=GREY, linewidth=1)
    for row, name in enumerate(names):
        values = np.array(ratios[name])
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        offsets = row + 0.25 * np.linspace(-1, 1, len(values))
        axes.plot(values, offsets, ".", color="0.6", markersize=4, zorder=1)
        axes.plot([low, high], [row, row], "-", color=BLUE, linewidth=3, zorder=2)
        axes.plot(middle, row, "D", color=BLUE, markerfacecolor="white", markersize=6, zorder=3)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(f"tracking error relative to {base}: each twin and seed, quartiles and median")
    stream = BytesIO()
    figure.savefig(stream, format=form, dpi=150)
    return stream.getvalue()
