"""How often the verdicts of `stepgap fit` on random subsets of logs contradict each other, before and now.

The logs are parts of 40 steps of recorded runs. For random subsets of two to four of them, all residuals are validated
and two verdicts are compared between all pairs of subsets:

- *selection*, the rule of earlier versions: from simple to complex, the residual that is certainly better than the one
  chosen before. One verdict contradicts another if it calls the residual worse that the other one chose.
- *gain*, the present rule: the reduction of the error by the averaged prediction. Two verdicts contradict each other if
  their 95 % intervals have no number in common. Intervals are rarely apart, so the sentences that `fit` prints are
  compared, too: *another sentence* if one says less error (or more) and the other one does not, *opposite* if one says
  less and the other one more.

Subsets share logs, so they agree more often than independent ones would; this holds for both rules.

    ./go python benchmarks/fit_verdicts.py RUN… [--subsets 200]
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.learning.observations import Observations
from stepgap.logs.fits.fit import gains, read_fit_data
from stepgap.logs.fits.validation import Reduction, Validation, deployment_folds, validate

T = TypeVar("T")
KINDS = ("none", "constant", "linear", "quadratic", "gp", "gp_on_linear")
PART = 40
"""Number of steps of a log."""


class Verdicts(NamedTuple):
    """Both verdicts on one subset, all coordinates together.

    Attributes:
        chosen: Name of the residual by selection.
        worse: Residuals that it calls worse.
        gain: Reduction of the error without a correction by the averaged prediction.
        more: Reduction of the error with a constant.
    """

    chosen: str
    worse: frozenset[str]
    gain: Reduction
    more: Reduction


def selection(validation: Validation, coordinates: Sequence[int]) -> tuple[str, frozenset[str]]:
    """The rule of earlier versions."""
    chosen, *others = KINDS
    for kind in others:
        if validation.reduction(kind, chosen, coordinates).certain:
            chosen = kind
    by = {kind: validation.reduction(chosen, kind, coordinates) for kind in KINDS if kind != chosen}
    return chosen, frozenset(kind for kind, each in by.items() if each.certain)


def verdicts(steps: Observations) -> Verdicts:
    """Both verdicts on some steps."""
    validation = validate(KINDS, steps, deployment_folds(steps.labels[:, 0]))
    together = range(len(steps.space.state))
    by = gains(validation, together)
    return Verdicts(*selection(validation, together), by["none"], by["constant"])


def subset(steps: Observations, rng: np.random.Generator) -> Observations:
    """Two to four random logs."""
    logs = np.unique(steps.labels[:, 0])
    return steps.selected(np.isin(steps.labels[:, 0], rng.choice(logs, rng.integers(2, 5), replace=False)))


def apart(one: Reduction, other: Reduction) -> bool:
    """Whether two intervals have no number in common."""
    return abs(one.value - other.value) > one.half_width + other.half_width


def sentence(by: Reduction) -> int:
    """What `fit` prints: 1 for less error, −1 for more, 0 for no difference shown."""
    return 0 if abs(by.value) <= by.half_width or not np.isfinite(by.half_width) else int(np.sign(by.value))


def share(found: Sequence[T], contradict: Callable[[T, T], bool]) -> float:
    """Part of the pairs of verdicts that contradict each other."""
    return float(np.mean([contradict(*pair) for pair in combinations(found, 2)]))


def summary(found: Sequence[Verdicts]) -> str:
    """How often the verdicts differ and contradict each other."""
    chosen = Counter(one.chosen for one in found).most_common()
    other_name = share(found, lambda one, other: one.chosen != other.chosen)
    worse = share(found, lambda one, other: one.chosen in other.worse or other.chosen in one.worse)
    return (
        f"selection: {', '.join(f'{kind} {times}' for kind, times in chosen)}; "
        f"two choose another residual {other_name:.1%}, contradict each other {worse:.1%}; "
        f"gain over none: {_agreement([one.gain for one in found])}; over a constant: "
        f"{_agreement([one.more for one in found])}"
    )


def _agreement(found: Sequence[Reduction]) -> str:
    """How often two gains differ."""
    far = share(found, apart)
    other = share(found, lambda one, other: sentence(one) != sentence(other))
    opposite = share(found, lambda one, other: sentence(one) * sentence(other) < 0)
    return f"intervals apart {far:.1%}, another sentence {other:.1%}, opposite {opposite:.1%}"


def main() -> None:
    """Prints the shares of contradictions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="+", type=Path)
    parser.add_argument("--subsets", type=int, default=200)
    options, rng = parser.parse_args(), np.random.default_rng(0)
    found = []
    with threadpool_limits(limits=1, user_api="blas"):
        steps = read_fit_data(options.run, None, None, None, []).observed
        deployment = steps.labels[:, 0]
        rows = np.arange(len(steps)) - np.searchsorted(deployment, deployment)  # within each deployment
        steps = replace(steps, deployment=1000 * deployment + rows // PART)
        logs, count = np.unique(steps.labels[:, 0], return_counts=True)
        steps = steps.selected(np.isin(steps.labels[:, 0], logs[count == PART]))
        for done in range(1, options.subsets + 1):
            found.append(verdicts(subset(steps, rng)))
            if done % 20 == 0 or done == options.subsets:
                print(f"{done} subsets: {summary(found)}", flush=True)


if __name__ == "__main__":
    main()
