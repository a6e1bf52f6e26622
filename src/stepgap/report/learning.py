"""What `stepgap bench learning` found: measures of each method over all twins and seeds, table and picture."""

import math
from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stepgap.report.figures import BLUE, GREY
from stepgap.report.paper import WITH_GP
from stepgap.step import Array

Row = dict[str, Any]
"""Measures of one deployment, plain data for JSON; those of a deployment without a step are missing."""

Key = tuple[int, int]
"""Twin and seed."""

UNCORRECTED = "none"
"""Name of deployment 0, which the others learn from."""

BAND = np.array([WITH_GP["rmse"]["speed"], WITH_GP["rmse"]["height"]])
"""Error of the paper's robot after four redeployments, speed [m/s] and height [m]."""

WINDOW = 20
"""Steps over which an error is compared with it."""

BEYOND_NOISE = 2.0
"""Standard deviations of the difference between two uncorrected deployments that count as more than chance."""


def hops_to_band(errors: Array) -> int | None:
    """After how many of N steps with tracking errors (N, 2) the error of the last 20 is in the band for good.

    None where it never is, or where there are too few steps to tell.
    """
    if len(errors) < WINDOW:
        return None
    squares = np.cumsum(np.vstack([np.zeros(errors.shape[1]), errors**2]), axis=0)
    inside = np.all(np.sqrt((squares[WINDOW:] - squares[:-WINDOW]) / WINDOW) <= BAND, axis=1)
    outside = np.flatnonzero(np.logical_not(inside))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return first + WINDOW if first < len(inside) else None


def summarise_learning(rows: Sequence[Row]) -> dict[str, Any]:
    """Measures of each method over all twins and seeds; plain data for JSON.

    A deployment that ended by a fall has an infinite error.
    """
    table: dict[str, dict[Key, Row]] = {}
    for row in rows:
        table.setdefault(row["method"], {})[row["twin"], row["seed"]] = row
    first = table[UNCORRECTED]
    noise = _noise(first)
    return {
        "schema": 1,
        "pairs": len(first),
        "drawn_again": sum({twin: row["drawn_again"] for (twin, _), row in first.items()}.values()),
        "noise": noise,
        "methods": [{"method": method, **_measures(found, first, noise)} for method, found in table.items()],
    }


def error_of(row: Row) -> float:
    """Tracking error of both coordinates together in half ranges; infinite after a fall."""
    return math.inf if row["falls"] else row["error"]


def _noise(first: dict[Key, Row]) -> float | None:
    """Standard deviation of log(error) − log(error) of two uncorrected deployments of one twin; None if unknown."""
    squares, freedom = 0.0, 0
    for twin in {twin for twin, _ in first}:
        errors = np.log([error_of(row) for (owner, _), row in first.items() if owner == twin and not row["falls"]])
        if len(errors) > 1:
            squares, freedom = squares + float(np.sum((errors - errors.mean()) ** 2)), freedom + len(errors) - 1
    return math.sqrt(2 * squares / freedom) if freedom else None


def _measures(rows: dict[Key, Row], first: dict[Key, Row], noise: float | None) -> dict[str, Any]:
    """Those of one method's deployment."""
    ratio = np.array([_ratio(error_of(row), error_of(first[key])) for key, row in rows.items()])
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


def _ratio(error: float, uncorrected: float) -> float:
    """1 where both fell."""
    return 1.0 if error == uncorrected == math.inf else error / uncorrected


def _median(rows: dict[Key, Row], name: str) -> list[float | None]:
    values = [row[name] if not row["falls"] else [math.inf, math.inf] for row in rows.values()]
    return [_finite(value) for value in np.median(values, axis=0).tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def describe_learning(summary: dict[str, Any]) -> str:
    """The summary as a table."""
    lines = [
        f"{'method':14}{'speed RMSE [mm/s]':>26}{'height RMSE [mm]':>26}{'error':>8}{'hops to':>9}{'in':>5}"
        f"{'':>7}{'worse':>8}{'95 % covers':>15}",
        f"{'':14}{'all':>8}{'transient':>10}{'steady':>8}{'all':>8}{'transient':>10}{'steady':>8}{'ratio':>8}"
        f"{'band':>9}{'band':>5}{'falls':>7}{'than none':>10}{'speed':>8}{'height':>7}",
    ]
    for row in summary["methods"]:
        parts = [row[name] for name in ("rmse", "transient_rmse", "steady_rmse")]
        speed, height = ("".join(_cell(part[i], 1e3, width) for part, width in zip(parts, (8, 10, 8))) for i in (0, 1))  # noqa: B905
        covered = "".join(f"{share:{width}.1%}" for share, width in zip(row["coverage"] or (), (8, 7), strict=False))
        hops, worse = row["hops_to_band"], row["worse"]
        lines.append(
            f"{row['method']:14}{speed}{height}{_cell(row['ratio'], 1, 8, 2)}"
            f"{'never' if hops is None else format(hops, '.0f'):>9}{row['reached_band']:5}{row['falls']:7}"
            f"{'-' if worse is None else worse:>8}{covered or format('-', '>15')}"
        )
    noise = summary["noise"]
    lines += [
        "",
        f"Medians over {summary['pairs']} twins and seeds; a fall counts as an infinite error. error ratio: both "
        "coordinates together, to deployment 0.",
        f"hops to band: from the first hop of deployment 0 until the RMSE of {WINDOW} steps stays within "
        f"{1e3 * BAND[0]:.1f} mm/s and {1e3 * BAND[1]:.1f} mm, which 'in band' of them reach.",
    ]
    if noise is not None:
        lines.append(
            f"worse than 0: how many have more than {math.exp(BEYOND_NOISE * noise):.2f} times the error of deployment "
            "0; beyond that two uncorrected deployments differ in one of 20."
        )
    return "\n".join(lines)


def _cell(value: float | None, factor: float, width: int, digits: int = 1) -> str:
    return f"{'∞' if value is None else format(factor * value, f'.{digits}f'):>{width}}"


def learning_picture(rows: Sequence[Row], form: str) -> bytes:
    """Error of each method relative to that of `gp` on the same twin and seed, or of none without it."""
    base = "gp" if any(row["method"] == "gp" for row in rows) else UNCORRECTED
    errors = {(row["twin"], row["seed"]): error_of(row) for row in rows if row["method"] == base}
    ratios: dict[str, list[float]] = {}
    for row in rows:
        error, compared = error_of(row), errors[row["twin"], row["seed"]]
        if row["method"] != base and math.isfinite(error + compared):
            ratios.setdefault(row["method"], []).append(error / compared)
    names = sorted(ratios, key=lambda name: float(np.median(ratios[name])), reverse=True)
    figure = Figure(figsize=(8, 0.6 + 0.38 * len(names)), layout="constrained")
    axes = figure.subplots()
    axes.axvline(1, color=GREY, linewidth=1)
    for place, name in enumerate(names):
        values = np.array(ratios[name])
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        offsets = place + 0.25 * np.linspace(-1, 1, len(values))
        axes.plot(values, offsets, ".", color="0.75", markersize=4, zorder=1)
        axes.plot([low, high], [place, place], "-", color=BLUE, linewidth=3, zorder=2)
        axes.plot(middle, place, "D", color=BLUE, markerfacecolor="white", markersize=6, zorder=3)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(f"tracking error relative to {base}: each twin and seed, quartiles and median")
    stream = BytesIO()
    figure.savefig(stream, format=form, dpi=150)
    return stream.getvalue()
