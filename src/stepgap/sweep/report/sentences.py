"""The results of a sweep in sentences."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from stepgap.records.missing import Missing
from stepgap.records.text import decimal, unit_suffix
from stepgap.report.verdict import ABOUT
from stepgap.step import Array, Quantity
from stepgap.sweep.report.cases import SweepCases
from stepgap.sweep.report.levels import overall_mean
from stepgap.sweep.report.variance_shares import VarianceShares

CHANCE: Final = 0.05
"""Largest probability of a share by chance that counts as an effect."""


def sweep_headline(cases: SweepCases, state: Sequence[Quantity]) -> str:
    """Sentence on the errors before and after learning."""
    if not len(cases):
        return f"None of the {len(cases.failed)} cases in the table has a result: all failed."
    before, after = compared_errors(cases)
    many = f"{len(cases)} case{'' if len(cases) == 1 else 's'}"
    if len(before) and (after < before).any():
        values = [_means(errors, state) for errors in (before, after)]
        return f"{many}: from deployment 0 to the last one, the mean RMSE changed from {values[0]} to {values[1]}."
    if not (known := _means(cases.last_errors, state)):
        return f"{many}, but no error of a last deployment is known."
    return f"{many}: the mean RMSE of the last deployment is {known}."


def sweep_sentences(
    cases: SweepCases, state: Sequence[Quantity], planned: int | Missing, found: VarianceShares | Missing
) -> list[str]:
    """Sentences on finished, failed and aborted cases, on the errors, and on the settings that matter most.

    Args:
        cases: The cases.
        state: State coordinates.
        planned: Number of cases of the whole sweep.
        found: Sensitivity of the errors.
    """
    return [
        _finished(cases, planned),
        *_failed(cases),
        *_aborted(cases),
        *_worse(cases, state),
        *([] if isinstance(found, Missing) else _largest(found, state)),
    ]


def percent(value: float) -> str:
    """A percentage with one decimal."""
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def compared_errors(cases: SweepCases) -> tuple[Array, Array]:
    """Errors of deployment 0 and of the last one in the cases in which both can be compared; shapes (k, n)."""
    both = cases.comparable & np.isfinite(cases.first_errors).all(axis=1) & cases.redeployed
    return cases.first_errors[both], cases.last_errors[both]


def share_notes(cases: SweepCases, found: VarianceShares) -> list[str]:
    """Sentences on how shares of variance were computed, and what is left out."""
    notes = [
        f"{_cases(found.cases)} are compared. A share is corrected for what a setting would explain by chance (epsilon "
        "squared), so a share of zero may be slightly negative. Where a setting without effect would have such a share "
        "in more than one of 20 sweeps (F test), its bar is light.",
        "Everything else is due to the random seed, to settings together beyond the sum of their effects, and to the "
        "values within ranges. If not all combinations of settings are in the table, shares overlap.",
    ]
    without = len(cases) - found.cases
    if without:
        notes.append(
            f"{_cases(without)} whose last deployment was aborted, or without a known error, cannot be compared and "
            f"{'is' if without == 1 else 'are'} left out."
        )
    if found.left_out:
        notes.append(f"Too few cases per level for: {', '.join(found.left_out)}.")
    return notes


def _finished(cases: SweepCases, planned: int | Missing) -> str:
    count = len(cases) + len(cases.failed)
    if isinstance(planned, Missing):
        return f"The table has {cases.rows} rows of {_cases(count)}; {planned.reason}."
    if count < planned:
        return (
            f"The sweep is not finished: the table has {cases.rows} rows of {count} of its {planned} cases "
            f"({100 * count / planned:.3g} %). Not all combinations of settings are there yet, so effects may change."
        )
    return f"All {planned} cases of the sweep are finished, in {cases.rows} rows of the table."


def _failed(cases: SweepCases) -> list[str]:
    if not cases.failed or not len(cases):
        return []
    failed = len(cases.failed)
    return [f"{_cases(failed)} failed and {'has' if failed == 1 else 'have'} no result; the reasons are listed below."]


def _aborted(cases: SweepCases) -> list[str]:
    if not len(cases):
        return []
    aborted, last = int(cases.aborted.sum()), int(cases.aborted_last.sum())
    if not aborted:
        return ["No deployment was aborted by a failed step."]
    of_them = "all" if last == aborted else last or "none"
    return [
        f"In {_cases(aborted)} ({percent(100 * aborted / len(cases))} %) a deployment was aborted by a failed step, in "
        f"{of_them} of them the last one. The error of an aborted deployment is not compared with others."
    ]


def _means(errors: Array, state: Sequence[Quantity]) -> str:
    """Geometric means of the errors of the state coordinates, as far as they are known."""
    means = zip(state, map(overall_mean, errors.T), strict=True)
    return " and ".join(
        f"{decimal(mean)}{unit_suffix(each)} in {each.name}" for each, mean in means if np.isfinite(mean)
    )


def _worse(cases: SweepCases, state: Sequence[Quantity]) -> list[str]:
    before, after = compared_errors(cases)
    if not len(before):
        return []
    lines = []
    for index, quantity in enumerate(state):
        ratio = overall_mean(before[:, index]) / overall_mean(after[:, index])
        change = f"{decimal(ratio, 2)} times smaller" if ratio >= 1 else f"{decimal(1 / ratio, 2)} times larger"
        than = "about as large as" if 1 / ABOUT <= ratio <= ABOUT else f"{change} than"
        worse = int(np.count_nonzero(after[:, index] > before[:, index]))
        title = quantity.name.replace("_", " ")
        lines.append(
            f"{title[:1].upper()}{title[1:]}: the RMSE of the last deployment is {than} that of deployment 0 "
            f"(geometric mean of {_cases(len(before))}); it is larger in {worse or 'none'} of them."
        )
    return lines


def _largest(found: VarianceShares, state: Sequence[Quantity]) -> list[str]:
    """Sentences on the settings that explain most."""
    lines = []
    for index, quantity in enumerate(state):
        ranked = sorted(found.axes, key=lambda share: -share.values[index])
        named = [
            f"{share.name} ({percent(100 * share.values[index])} %)"
            for share in ranked[:3]
            if share.chance[index] < CHANCE
        ]
        if named:
            lines.append(
                f"Settings with the largest share of the variance of the {quantity.name} error: {', '.join(named)}."
            )
        else:
            lines.append(
                f"No setting's share of the variance of the {quantity.name} error is larger than by chance; the ratios "
                "below, from pairs of cases, may still show an effect."
            )
    return lines


def _cases(number: int) -> str:
    return f"{number} case{'' if number == 1 else 's'}"
