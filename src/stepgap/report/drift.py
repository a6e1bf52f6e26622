"""How far a robot that walks gets from where its targets lead, in 10 s and in 10 m."""

from typing import NamedTuple

import numpy as np

from stepgap.control.shortfall import NOWHERE, moved, turned
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.step import Array

SECONDS = 10.0  # Time after which a robot is looked at
METRES = 10.0  # Way after which it is, too


class Drift(NamedTuple):
    """Medians over all begins of a time or a way; NaN if no deployment is as long."""

    distance: float
    turn: float

    @property
    def in_words(self) -> str:
        """Distance in metres and turn in degrees."""
        return f"by {self.distance:.2g} m and {np.degrees(self.turn):.2g}°"


def drift_sentences(run: Run) -> list[str]:
    """Sentence on the drift of the first deployment and the last one; empty where no pose is measured."""
    parts = list[str]()
    if not run.space.planar_seconds:
        return parts
    iterations = [deployment.iteration for deployment in run.deployments]
    for iteration in dict.fromkeys([*iterations[:1], *iterations[-1:]]):
        steps = run.steps.of_iteration(iteration)
        seconds = np.full(len(steps), steps.space.planar_seconds)
        after_time = drift(steps, seconds, SECONDS)
        after_way = drift(steps, seconds * np.hypot(*steps.target[:, :2].T), METRES)
        drifts = {f"{SECONDS:g} s": after_time, f"{METRES:g} m": after_way}
        words = [f"{away.in_words} after {reach}" for reach, away in drifts.items() if np.isfinite(away).all()]
        if words:
            parts.append(f"in deployment {iteration} {' and '.join(words)}")
    return [f"It was away from where its targets lead, in the median, {'; '.join(parts)}."] if parts else []


def drift(steps: Steps, lengths: Array, reach: float) -> Drift:
    """How far a robot is from where its targets lead, after a reach from the end of each step on.

    Args:
        lengths: Of each step, in the unit of the reach; shape (N,).
        reach: A time or a way.
    """
    space = steps.space
    unknown = Drift(np.nan, np.nan)
    if not set(space.pose_names) <= set(space.context_names):
        return unknown
    poses = steps.context[:, [space.context_names.index(name) for name in space.pose_names]]
    ways = steps.target[:, :3] * space.planar_seconds
    sums = np.cumsum(lengths)
    ends = np.searchsorted(sums, sums + reach - 1e-9)
    drifts = list[tuple[float, float]]()
    for begin, end in enumerate(ends):
        if end == len(steps):
            break
        wanted = NOWHERE
        for way in ways[begin + 1 : end + 1]:
            wanted = moved(wanted, way)
        change = poses[end] - poses[begin]
        place = turned(-poses[begin, 2], *change[:2])
        turn = (change[2] - wanted[2] + np.pi) % (2 * np.pi) - np.pi
        drifts.append((float(np.hypot(*(place - wanted[:2]))), abs(float(turn))))
    return Drift(*np.median(drifts, axis=0)) if drifts else unknown
