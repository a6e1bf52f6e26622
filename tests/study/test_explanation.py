"""Explanation of errors: sizes against a dense solution, and causes planted into an analytic robot."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from stepgap.base.errors import InputError
from stepgap.learning.observations import Observations
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array
from stepgap.study.explanation import (
    PRIOR_SIZE,
    Cause,
    CauseSize,
    Explanation,
    RunError,
    Shares,
    Surface,
    causes_of,
    explain_error,
    fit_sizes,
    fit_surface,
)
from stepgap.study.explanation_page import explanation_sentences, explanation_table

SPACE = Hopper().space
NOISE = 0.02

EFFECTS: dict[str, Callable[[Array], Array]] = {
    "mass": lambda x: np.stack([0.1 - 0.1 * x[:, 2], 0.2 + 0.1 * x[:, 3]], axis=1),
    "torque": lambda x: np.stack([-0.11 + 0.1 * x[:, 2], -0.2 - 0.11 * x[:, 3]], axis=1),
    "delay": lambda x: np.stack([0.1 * x[:, 0] + 0.1 * x[:, 2] * x[:, 3], 0.05 * x[:, 1]], axis=1),
    "friction": lambda x: np.stack([0.1 + 0.1 * x[:, 0] ** 2, 0.1 * x[:, 0] * x[:, 2]], axis=1),
    "sensor": lambda x: np.zeros((len(x), 2)),
}
"""Error per size [half ranges]: weaker motors act nearly as a heavier body does."""

CAUSES = tuple(Cause(name, 1.0, 1.1, least=-8.0 if name in ("mass", "torque") else 0.0) for name in EFFECTS)


def steps_of(shares: Shares, seed: int, noise: float = 0.0, count: int = 60) -> Observations:
    """Steps of the analytic robot, whose effects bend with their size and are a little cubic."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.8, 0.8, (count, 4))
    error = 0.05 * x[:, :2] ** 3
    for name, share in shares.items():
        error = error + 2 * np.tanh(share / 2) * EFFECTS[name](x) * (1 + 0.05 * share * x[:, :1])
    error = error + noise * rng.standard_normal(error.shape)
    state = SPACE.state_centre + x[:, :2] * SPACE.state_scale
    return Observations(SPACE, state, SPACE.command_at(x[:, 2:]), error * SPACE.state_scale)


def simulate(asked: Sequence[tuple[Shares, int]]) -> list[Surface | None]:
    return [fit_surface(steps_of(shares, 1000 + number)) for shares, number in asked]


def explained(shares: Shares, seed: int, causes: Sequence[Cause] = CAUSES) -> Explanation:
    return explain_error(RunError.of(steps_of(shares, seed, NOISE, 150)), causes, simulate)


def by_name(explanation: Explanation) -> dict[str, CauseSize]:
    return {size.cause.name: size for size in explanation.causes}


def test_sizes_and_evidence_are_those_of_a_dense_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    run = RunError.of(steps_of({"mass": 0.8}, 1, NOISE))
    none = fit_surface(steps_of({}, 2))
    signatures = 0.1 * rng.standard_normal((2, 2, 15))
    rest = 0.05
    found = fit_sizes(run, none, signatures, rest)
    h = run.seen(signatures).reshape(2, -1).T
    size = run.values.size
    noise = np.zeros((size, size))
    for row, (root, spread) in enumerate(zip(run.roots, none.covariance, strict=True)):
        part = slice(row * len(root), (row + 1) * len(root))
        noise[part, part] = np.eye(len(root)) + root @ (spread + rest**2 * np.eye(15)) @ root.T
    total = noise + PRIOR_SIZE**2 * h @ h.T
    value = (run.values - run.seen(none.weights)).ravel()
    gain = PRIOR_SIZE**2 * h.T @ np.linalg.inv(total)
    assert found.sizes == pytest.approx(gain @ value, rel=1e-6)
    assert found.covariance == pytest.approx(PRIOR_SIZE**2 * (np.eye(2) - gain @ h), rel=1e-5, abs=1e-9)
    density: Any = multivariate_normal(np.zeros(size), total)  # pyright: ignore[reportArgumentType]
    assert found.log_evidence == pytest.approx(density.logpdf(value), rel=1e-6)
    product = h.T @ np.linalg.solve(noise, h)
    assert found.cosines[0, 1] == pytest.approx(product[0, 1] / np.sqrt(product[0, 0] * product[1, 1]))


@pytest.mark.parametrize("planted", [{"mass": 1.2}, {"torque": -1.4}, {"delay": 1.5}, {"friction": 0.8}])
def test_a_planted_cause_explains_most_with_its_size(planted: dict[str, float]) -> None:
    (name, share), inside, first = next(iter(planted.items())), 0, 0
    for seed in range(5):
        found = explained(planted, seed)
        size = by_name(found)[name]
        first += found.causes[0].cause.name == name
        low, high = size.interval
        inside += low <= size.cause.value(share) <= high
        assert size.alone == pytest.approx(share, abs=0.1)
        assert size.explained > 0.95
        assert not found.has_rest
    assert first >= (3 if name in ("mass", "torque") else 5)
    assert inside >= 4


def test_two_planted_causes_have_their_sizes_where_they_can_be_told_apart() -> None:
    for seed in range(5):
        found = by_name(explained({"friction": 1.0, "delay": 1.2}, seed))
        assert found["friction"].share == pytest.approx(1.0, abs=0.2)
        assert found["delay"].share == pytest.approx(1.2, abs=0.2)
        assert found["friction"].acts
        assert found["delay"].acts
        assert not found["mass"].acts


def test_causes_that_act_alike_are_said_to_be_so_and_their_sizes_together_are_uncertain() -> None:
    found = explained({"mass": 1.0}, 0)
    assert [[cause.name for cause in group] for group in found.alike] == [["mass", "torque"]]
    assert [cause.name for cause in found.unseen] == ["sensor"]
    mass = by_name(found)["mass"]
    assert mass.std > 0.1
    text = "\n".join(explanation_sentences(found, SPACE))
    assert "this run cannot tell mass and torque apart: measure one" in text
    assert "where all causes may act, no single one is certain to act" in text
    assert "this run says nothing of sensor, whose effect it could not see" in text


def test_without_a_cause_nothing_acts() -> None:
    for seed in range(5):
        found = explained({}, seed)
        assert not found.has_rest
        assert sum(size.acts for size in found.causes) <= 1
        assert all(abs(size.alone) < 0.2 for size in found.causes)


def test_a_cause_outside_the_list_is_reported_as_unexplained() -> None:
    for name in ("delay", "friction"):
        found = explained({name: 1.5, "mass": 0.7}, 0, [cause for cause in CAUSES if cause.name != name])
        assert found.has_rest
        assert found.rest > 0.1


def test_the_noise_of_few_steps_is_not_too_small() -> None:
    """Of 24 values, 15 weights leave the noise nine."""
    found = [fit_surface(steps_of({"mass": 1.0}, seed, NOISE, 24)).noise_std for seed in range(60)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(NOISE, rel=0.1)


def test_a_size_beyond_the_valid_ones_is_not_simulated() -> None:
    """The effect is convex, so that the signature at the usual size asks for a size that the gap refuses."""
    cause = Cause("mass", 1.0, 1.1, least=-3.0, most=3.0)

    def steps(shares: Shares, seed: int, noise: float) -> Observations:
        assert all(cause.least <= share <= cause.most for share in shares.values())
        plain = steps_of({}, seed, noise, 150)
        x = plain.space.scaled_inputs(plain.state, plain.command)
        share = shares.get("mass", 0.0)
        error = (share + 0.3 * share**2) * EFFECTS["mass"](x) * SPACE.state_scale
        return replace(plain, error=plain.error + error)

    found = explain_error(
        RunError.of(steps({"mass": 2.8}, 0, NOISE)),
        [cause],
        lambda asked: [fit_surface(steps(shares, 100 + number, 0.0)) for shares, number in asked],
    )
    assert found.causes[0].share == pytest.approx(2.8, rel=0.05)


def test_without_a_cause_that_walks_an_error_says_so() -> None:
    with pytest.raises(InputError, match="mass, torque"):
        explain_error(
            RunError.of(steps_of({}, 0, NOISE)),
            CAUSES[:2],
            lambda asked: [None if shares else fit_surface(steps_of({}, 1)) for shares, _ in asked],
        )


def test_a_cause_with_which_the_robot_falls_is_left_out() -> None:
    found = explain_error(
        RunError.of(steps_of({"mass": 1.0}, 0, NOISE)),
        CAUSES[:3],
        lambda asked: [
            None if "delay" in shares else fit_surface(steps_of(shares, number)) for shares, number in asked
        ],
    )
    assert [cause.name for cause in found.failed] == ["delay"]
    assert set(by_name(found)) == {"mass", "torque"}


@pytest.mark.parametrize(
    ("rest", "log_odds", "said"),
    [
        (0.2, 9.0, "none of these causes"),
        (0.02, 9.0, "small, but more than noise"),
        (0.02, 1.0, "no larger than noise"),
    ],
)
def test_what_is_said_of_the_rest_follows_from_its_size_and_odds(rest: float, log_odds: float, said: str) -> None:
    found = replace(explained({"mass": 1.0}, 0), rest=rest, rest_log_odds=log_odds)
    assert sum(said in sentence for sentence in explanation_sentences(found, SPACE)) == 1


def test_the_table_has_a_row_for_each_cause_that_the_run_sees() -> None:
    found = explained({"delay": 1.0}, 0)
    heads, rows = explanation_table(found, {"delay": "Delay of the torque [s]. More."})
    assert {len(row) for row in rows} == {len(heads)}
    assert [row[0] for row in rows] == [size.cause.name for size in found.causes]
    assert rows[0][-1] == "Delay of the torque [s]"


def test_what_may_be_a_cause_follows_from_the_gap() -> None:
    hopper = {each.name: each for each in causes_of(RealityGap())}
    assert {"body_mass_scale", "torque_scale", "delay", "boom_stiffness"} <= hopper.keys()
    assert not {"boom_arc", "boom_pivot_height", "ground_damping_ratio"} & hopper.keys()
    assert hopper["body_mass_scale"].signed
    assert not hopper["delay"].signed
    torque = hopper["torque_scale"]
    assert 0 < torque.value(torque.most) < 0.01
    assert torque.value(torque.least) > 4
    stiffness = hopper["boom_stiffness"]
    assert (stiffness.value(0), stiffness.value(2), stiffness.signed) == (inf, 1e4, False)
    assert {"payload", "motor_lag", "ground_softness", "slope"} <= {each.name for each in causes_of(MjcfGap())}
