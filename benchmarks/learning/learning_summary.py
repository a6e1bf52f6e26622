"""The summary of the learning benchmark: measures of each method over all twins and seeds, and their table."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.learning.paired_differences import CONFIDENCE, LARGEST_RATIO, PairedDifference, holm, paired_difference
from stepgap.experiment.bands import WINDOW
from stepgap.robots.hopper.paper import paper_result

DeploymentRow = dict[str, Any]
"""Measures of one deployment as plain data for JSON; a deployment without a step has none."""

Key = tuple[int, int]
"""Twin and seed."""

UNCORRECTED = "none"
"""Name of deployment 0, from which the other methods learn."""

DEFAULT = "posterior"
"""Name of the method that the others are compared with: the default settings of a run."""

WITHOUT = "-"
"""METHOD-RULE is the name of a method without one of its rules, which is compared with the method itself."""

ON_TEMPLATE = "template_"
"""template_METHOD is METHOD with a crude template instead of the exact nominal map, which is compared with METHOD."""

ERRORS = ("rmse", "transient_rmse", "steady_rmse", "true_rmse")
"""Names of the root-mean-square errors of a deployment; the last one is that of the true states."""

BEYOND_NOISE = 2.0
"""Number of standard deviations of the difference between uncorrected deployments that counts as significant."""


def summarise_learning(rows: Sequence[DeploymentRow]) -> dict[str, Any]:
    """Measures of each method over all twins and seeds, as plain data for JSON.

    An aborted deployment, in which a step failed, has an infinite error.
    """
    table: dict[str, dict[Key, DeploymentRow]] = {}
    for row in rows:
        table.setdefault(row["method"], {})[row["twin"], row["seed"]] = row
    first = table[UNCORRECTED]
    noise, differences = _noise(first), _differences(table)
    return {
        "schema": 2,
        "task": rows[0]["task"],
        "pairs": len(first),
        "drawn_again": sum({twin: row["drawn_again"] for (twin, _), row in first.items()}.values()),
        "noise": noise,
        "methods": [
            {"method": method, **_measures(found, first, noise), "difference": differences.get(method)}
            for method, found in table.items()
        ],
    }


def compared_with(method: str, measured: Collection[str]) -> str | None:
    """Name of the method that a method is compared with; None if there is none among the measured ones."""
    wholes = (method.partition(WITHOUT)[0], method.removeprefix(ON_TEMPLATE))
    others = [other for other in (*wholes, DEFAULT) if other != method and other in measured]
    return others[0] if others and method != DEFAULT else None


def _differences(table: Mapping[str, Mapping[Key, DeploymentRow]]) -> dict[str, dict[str, Any]]:
    """Paired difference of each method that is compared with another one, as plain data for JSON."""
    errors = {method: {key: tracking_error_of(row) for key, row in found.items()} for method, found in table.items()}
    pairs = {method: other for method in table if (other := compared_with(method, table))}
    found = {method: paired_difference(errors[method], errors[other]) for method, other in pairs.items()}
    adjusted = holm([difference.p_value for difference in found.values()])
    return {
        method: {"to": pairs[method], **_plain(difference, p_value)}
        for (method, difference), p_value in zip(found.items(), adjusted, strict=True)
    }


def _plain(difference: PairedDifference, adjusted: float) -> dict[str, Any]:
    known = math.isfinite(adjusted)
    return {
        "ratio": difference.ratio,
        "interval": [difference.low, difference.high] if known else None,
        "p_value": difference.p_value if known else None,
        "adjusted_p_value": adjusted if known else None,
        "significant": adjusted < 1 - CONFIDENCE if known else None,
    }


def tracking_error_of(row: DeploymentRow) -> float:
    """Tracking error of both coordinates together in half ranges; infinite if a step failed."""
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
        **{name: _median(rows, name) for name in ERRORS},
        "ratio": _finite(float(np.median(ratio))),
        "hops_to_band": _finite(float(np.median([math.inf if hop is None else hop for hop in hops]))),
        "reached_band": sum(hop is not None for hop in hops),
        "falls": sum(row["falls"] for row in rows.values()),
        "worse": None if noise is None else int(np.sum(ratio > math.exp(BEYOND_NOISE * noise))),
        "coverage": (covered / counted).tolist() if counted else None,
    }


def _ratio(error: float, uncorrected: float) -> float:
    """Ratio of two errors; 1 where both deployments were aborted."""
    return 1.0 if error == uncorrected == math.inf else error / uncorrected


def _median(rows: dict[Key, DeploymentRow], name: str) -> list[float | None] | None:
    """Median of each coordinate, None where it is infinite; None if the error is unknown."""
    if any(row[name] is None for row in rows.values() if not row["falls"]):
        return None
    values = [row[name] if not row["falls"] else [math.inf, math.inf] for row in rows.values()]
    return [_finite(value) for value in np.median(values, axis=0).tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


HEADER = (
    "method",
    *("speed [mm/s]", "transient", "steady", "true"),
    *("height [mm]", "transient", "steady", "true"),
    *("ratio", "hops", "in band", "aborted", "worse", "relative", "interval", "significant", "speeds in", "heights in"),
)
"""Columns of the table."""


def describe_learning(summary: dict[str, Any]) -> str:
    """The summary as a Markdown table, which is also readable as plain text."""
    table = [HEADER, *map(_cells, summary["methods"])]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "| " + " | ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)) + " |" for row in table
    ]
    band = paper_result().band
    lines.insert(1, "|" + "|".join(f"{'-' * (width + 1)}:" for width in widths) + "|")
    lines += [
        "",
        f"Speed and height: RMSE, median over {summary['pairs']} twins and seeds; infinite if a step failed.",
        "true: RMSE of the robot's true state, without the errors of its sensors.",
        "ratio: error of both coordinates together, relative to that of deployment 0.",
        f"hops: number of hops until the RMSE of {WINDOW} steps stays within {1e3 * band[0]:.1f} mm/s and "
        f"{1e3 * band[1]:.1f} mm; in band: number of twins and seeds that reach this.",
        f"relative: error relative to that of {DEFAULT} on the same twin and seed, geometric mean; a failed step",
        f"counts as a ratio of {LARGEST_RATIO:g}. METHOD{WITHOUT}RULE and {ON_TEMPLATE}METHOD are relative to METHOD.",
        "interval: 95 % by Student's t over the means of the twins. significant: p < 0.05 after Holm's correction.",
        "in: fraction of steps within the predicted 95 % interval.",
    ]
    if summary["noise"] is not None:
        lines.append(
            f"worse: number with more than {math.exp(BEYOND_NOISE * summary['noise']):.2f} times the error of "
            "deployment 0, which chance alone causes in one case of 40."
        )
    return "\n".join(lines)


def _cells(row: dict[str, Any]) -> list[str]:
    """Cells of one line of the table."""
    errors = [(row[name], i) for i in (0, 1) for name in ERRORS]
    return [
        row["method"],
        *("-" if error is None else "∞" if error[i] is None else f"{1e3 * error[i]:.1f}" for error, i in errors),
        "∞" if row["ratio"] is None else f"{row['ratio']:.2f}",
        "never" if row["hops_to_band"] is None else f"{row['hops_to_band']:.0f}",
        *("-" if row[name] is None else str(row[name]) for name in ("reached_band", "falls", "worse")),
        *_difference_cells(row["difference"]),
        *(f"{share:.1%}" for share in row["coverage"] or ()),
        *("-" for _ in range(0 if row["coverage"] else 2)),
    ]


def _difference_cells(difference: dict[str, Any] | None) -> list[str]:
    """Ratio, interval and significance."""
    if difference is None:
        return ["-"] * 3
    ratio, interval, significant = (difference[name] for name in ("ratio", "interval", "significant"))
    if interval is None:
        return [f"{ratio:.2f}", "-", "-"]
    return [f"{ratio:.2f}", f"{interval[0]:.2f}–{interval[1]:.2f}", "yes" if significant else "no"]
