"""The measures of `python -m benchmarks.learning`, on synthetic deployments."""

import numpy as np
import pytest

from benchmarks.learning.learning_figure import learning_picture
from benchmarks.learning.learning_summary import (
    BEYOND_NOISE,
    DEFAULT,
    ERRORS,
    DeploymentRow,
    compared_with,
    describe_learning,
    summarise_learning,
)


def row(method: str, seed: int, error: float, falls: int = 0, **more: object) -> DeploymentRow:
    measures = {name: [error, error / 10] for name in ERRORS}
    return (
        {"task": "reference", "twin": 0, "seed": seed, "method": method, "steps": 9, "falls": falls, "error": error}
        | measures
        | more
    )


ROWS = [
    row("none", 0, 1.0, drawn_again=1),
    row("none", 1, 1.1, drawn_again=1),
    row("none", 2, 1.2, falls=1, drawn_again=1),
    row(DEFAULT, 0, 0.1, covered=[9, 5], counted=10, hops_to_band=250),
    row(DEFAULT, 1, 2.0, covered=[10, 5], counted=10, hops_to_band=None),
    row(DEFAULT, 2, 0.3, covered=[0, 0], counted=0, hops_to_band=240),
    row("linear", 0, 0.2),
    {"task": "reference", "twin": 0, "seed": 1, "method": "linear", "steps": 0, "falls": 1},
    row("linear", 2, 0.3, falls=1),
]


def test_measures_are_medians_and_counts_over_twins_and_seeds() -> None:
    summary = summarise_learning(ROWS)
    none, gp, linear = summary["methods"]
    assert (summary["pairs"], summary["drawn_again"]) == (3, 1)
    assert summary["noise"] == pytest.approx(np.log(1.1)), "for two numbers, the difference"
    assert none["rmse"] == pytest.approx([1.1, 0.11]), "a failed step counts as the largest error"
    assert gp["rmse"] == pytest.approx([0.3, 0.03])
    assert gp["hops_to_band"] == 250
    assert gp["reached_band"] == 2
    assert gp["coverage"] == [0.95, 0.5]
    assert (gp["worse"], gp["falls"]) == (1, 0), "2.0 is more than 1.1 and chance"
    assert (linear["worse"], linear["falls"]) == (1, 2), "if both were aborted, neither is worse"
    assert (none["difference"]["to"], gp["difference"], linear["difference"]["to"]) == (DEFAULT, None, DEFAULT)
    assert linear["rmse"] == [None, None]
    assert 1.1 * np.exp(BEYOND_NOISE * summary["noise"]) < 2


def test_the_table_and_the_picture_hold_every_method() -> None:
    table = describe_learning(summarise_learning(ROWS))
    assert [line.split()[1] for line in table.splitlines()[2:5]] == ["none", DEFAULT, "linear"]
    assert "∞" in table
    assert learning_picture(ROWS, "png").startswith(b"\x89PNG")


def test_a_method_without_a_rule_is_compared_with_the_method() -> None:
    measured = {DEFAULT, "online", "online-drift", "linear-drift"}
    assert compared_with("online-drift", measured) == "online"
    assert compared_with("linear-drift", measured) == DEFAULT, "the full method was not measured"
    assert compared_with("online", measured) == DEFAULT
    assert compared_with("template_online", measured) == "online"
    assert compared_with("template_linear", measured) == DEFAULT, "the method on the exact map was not measured"
    assert compared_with(DEFAULT, measured) is None
    assert compared_with("online", {"online", "none"}) is None


def test_a_difference_that_chance_explains_is_not_significant() -> None:
    rng = np.random.default_rng(0)
    methods = {DEFAULT: 1.0, "equal": 1.0, "worse": 1.5}
    rows = [
        row(method, seed, factor * np.exp(0.1 * rng.standard_normal()), drawn_again=0) | {"twin": twin}
        for method, factor in ({"none": 9.0} | methods).items()
        for twin in range(10)
        for seed in range(2)
    ]
    _, _, equal, worse = summarise_learning(rows)["methods"]
    assert (equal["difference"]["significant"], worse["difference"]["significant"]) == (False, True)
    low, high = worse["difference"]["interval"]
    assert low < 1.5 < high
    assert "yes" in describe_learning(summarise_learning(rows)).splitlines()[5]


def test_an_unknown_error_is_not_a_failed_step() -> None:
    rows = [row(method, 0, 0.1, drawn_again=0) | {"steady_rmse": None} for method in ("none", DEFAULT)]
    assert summarise_learning(rows)["methods"][0]["steady_rmse"] is None
    assert "∞" not in describe_learning(summarise_learning(rows))
