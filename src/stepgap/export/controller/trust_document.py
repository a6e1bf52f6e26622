"""What the documented model says of trust: constants, and the hypotheses at the start and the end of a deployment."""

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from stepgap.base.json_data import boolean, integer, numbers
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning import disturbance, outliers, trust
from stepgap.learning.disturbance import FORGETTING, DisturbanceFilter
from stepgap.learning.trust import Hypothesis, MapSource, Trust
from stepgap.step import Array

SOURCES = get_args(MapSource)
"""What a hypothesis takes the next state from, in the order of the hypotheses."""


def trust_document(controller: PortableController, last: Trust | None) -> dict[str, Any]:
    """The keys `disturbance`, `outliers` and `trust` of the model; see `model_document`."""
    sizes = controller.map.residual.sizes
    initial = DisturbanceFilter.initial(sizes[0], sum(sizes))
    return {
        "disturbance": {
            "used": controller.drift,
            "forgetting": FORGETTING.tolist(),
            "prior_variance": np.diagonal(initial.prior[:, :3, :3], axis1=1, axis2=2).tolist(),
            "score_memory": disturbance.SCORE_MEMORY,
            "switching_penalty": disturbance.SWITCHING_PENALTY,
            "change_std": disturbance.CHANGE_STD,
            "slope_std": disturbance.SLOPE_STD,
        },
        "outliers": {
            "used": controller.reject_outliers,
            "improbable": outliers.IMPROBABLE,
            "least_std": outliers.LEAST_STD,
            "probability": outliers.OUTLIER_PROBABILITY,
            "width": outliers.OUTLIER_WIDTH,
        },
        "trust": {
            "judges": controller.judges,
            "nominal": controller.monitor,
            "warm_start": controller.warm_start,
            "hazards": dict(trust.HAZARDS),
            "switching_odds": trust.SWITCHING_ODDS,
            "candidates": trust.CANDIDATES,
            "most_strained": trust.MOST_STRAINED,
            "young": trust.YOUNG,
            "straining": trust.STRAINING,
            "least_error": trust.LEAST_ERROR,
            "largest_std": trust.LARGEST_DEVIATION,
            "start": _state(controller.trust),
            "end": None if last is None else _state(last),
        },
    }


def trust_from(saved: Mapping[str, Any], controller: PortableController) -> Trust | None:
    """The trust at the end of a deployment in a documented model; None if it was not executed.

    Raises:
        KeyError: A key is missing.
        ValueError: It is not one that the controller can have.
    """
    end, start = saved["trust"]["end"], controller.trust
    if end is None:
        return None
    hypotheses = tuple(_hypothesis(each, start) for each in end["hypotheses"])
    places = [SOURCES.index(each.source) for each in hypotheses]
    allowed = sorted(places) == places and places.count(0) == 1
    if not allowed or max(map(places.count, (1, 2, 3))) > trust.CANDIDATES:
        raise ValueError(f"trust.end.hypotheses must be one of {', '.join(SOURCES)} after the other")
    return Trust(
        start.state_scale,
        start.drift,
        start.monitor,
        start.reject_outliers,
        hypotheses,
        integer(end, "strained", 0),
    )


def sized(saved: Mapping[str, Any], key: str, *shape: int) -> Array:
    """The array of finite numbers under a key, of this shape.

    Raises:
        KeyError: There is no such key.
        ValueError: It has another shape, or numbers that are not finite.
    """
    array = np.asarray(saved[key], float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{key} must be finite numbers of shape {shape}, not {array.shape}")
    return array


def _state(state: Trust) -> dict[str, Any]:
    return {
        "hypotheses": [_described(each) for each in state.hypotheses],
        "strained": state.strained,
    }


def _described(hypothesis: Hypothesis) -> dict[str, Any]:
    """A hypothesis; of a change, the scores without a filter are not used."""
    found, head = hypothesis.filter, {"source": hypothesis.source, "log_weight": float(hypothesis.log_weight)}
    return {
        **head,
        "corrected": hypothesis.corrected,
        "age": hypothesis.age,
        "changed": found.changed,
        "coefficients": found.coefficients.tolist(),
        "covariance": found.covariance.tolist(),
        "scores": np.where(np.isinf(found.scores), 0.0, found.scores).tolist(),
        "weight": float(found.weight),
    }


def _hypothesis(saved: Mapping[str, Any], start: Trust) -> Hypothesis:
    source, log_weight = saved["source"], float(numbers(saved, "log_weight", 0))
    if source not in SOURCES:
        raise ValueError(f"trust.end.hypotheses.source must be one of {', '.join(SOURCES)}, not {source!r:.40}")
    initial = start.hypotheses[0].filter
    changed, (count, q, n) = boolean(saved, "changed"), initial.coefficients.shape
    like = initial.restarted() if changed else initial
    scores = sized(saved, "scores", 1 + count, n)
    found = DisturbanceFilter(
        sized(saved, "coefficients", count, q, n),
        sized(saved, "covariance", count, q, q),
        like.prior,
        np.where(np.isinf(like.scores), np.inf, scores),
        float(numbers(saved, "weight", 0)),
    )
    return Hypothesis(source, found, log_weight, boolean(saved, "corrected"), integer(saved, "age", 0))
