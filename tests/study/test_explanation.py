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
from stepgap.study.cause_sizes import (
    Cause,
    RunError,
    Shares,
    Surface,
    causes_of,
    fit_sizes,
    fit_surface,
)
from stepgap.study.explanation import Explanation, explain_error
from stepgap.study.explanation_page import explanation_sentences

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


def simulate(wanted: Sequence[Shares]) -> list[Surface | None]:
    return [fit_surface(steps_of(shares, 1000 + number))[0] for number, shares in enumerate(wanted)]


def explained(shares: Shares, seed: int, causes: Sequence[Cause] = CAUSES) -> Explanation:
    return explain_error(RunError.of(steps_of(shares, seed, NOISE, 150)), causes, simulate)


def test_sizes_and_evidence_are_those_of_a_dense_normal_distribution() -> None:
    rng = np.random.default_rng(0)
    run, none = RunError.of(steps_of({"mass": 0.8}, 1, NOISE)), fit_surface(steps_of({}, 2))[0]
    slopes, sizes, rest = 0.1 * rng.standard_normal((2, 2, 15)), np.array([0.3, -0.2]), 0.05
    found = fit_sizes(run, none, sizes, slopes, np.zeros(2), np.array([rest]))
    h = np.array([run.seen(slope).ravel() for slope in slopes]).T
    prior = np.sum(run.values**2) / np.sum(h**2, axis=0)
    size = run.values.size
    noise = np.zeros((size, size))
    for row, (root, spread) in enumerate(zip(run.roots, none.covariance, strict=True)):
        part = slice(row * len(root), (row + 1) * len(root))
        noise[part, part] = np.eye(len(root)) + root @ (spread + rest**2 * np.eye(15)) @ root.T
    total = noise + h @ np.diag(prior) @ h.T
    value = run.values.ravel() - run.seen(none.weights).ravel() + h @ sizes
    gain = np.diag(prior) @ h.T @ np.linalg.inv(total)
    assert found.sizes == pytest.approx(gain @ value, rel=1e-6)
    assert found.covariance == pytest.approx(np.diag(prior) - gain @ h @ np.diag(prior), rel=1e-5, abs=1e-9)
    total_density: Any = multivariate_normal(np.zeros(size), total)  # pyright: ignore[reportArgumentType]
    density = total_density.logpdf(value) + size / 2 * np.log(2 * np.pi)
    assert found.log_evidence == pytest.approx(density, rel=1e-6)


def test_inaccurate_signatures_do_not_make_sizes_smaller() -> None:
    """Without the correction they would be a third smaller with an inaccuracy of a fifth of their square."""
    none, sizes, expected = fit_surface(steps_of({}, 2, NOISE))[0], list[float](), 2.0
    slope = 0.12 * (fit_surface(steps_of({"mass": 1.0}, 2, NOISE))[0].weights - none.weights)
    rng = np.random.default_rng(0)
    for seed in range(200):
        run = RunError.of(steps_of({}, 100 + seed, NOISE))
        run = replace(run, values=run.seen(none.weights) + run.seen(expected * slope) + rng.standard_normal((2, 15)))
        length = sum(np.trace(root @ spread @ root.T) for root, spread in zip(run.roots, none.covariance, strict=True))
        inaccuracy = 0.2 * run.effect(slope) / length
        noise = [rng.multivariate_normal(np.zeros(15), inaccuracy * spread) for spread in none.covariance]
        found = fit_sizes(run, none, np.zeros(1), np.array([slope + noise]), np.array([inaccuracy]))
        sizes.append(float(found.sizes[0]))
    assert np.median(sizes) == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("planted", [{"mass": 1.2}, {"torque": -1.4}, {"delay": 1.5}, {"friction": 0.8}])
def test_a_planted_cause_is_found_with_its_size(planted: dict[str, float]) -> None:
    (name, share), inside = next(iter(planted.items())), 0
    for seed in range(5):
        found = explained(planted, seed)
        members = {each.cause.name: each for each in found.groups[0].members}
        low, high = members[name].interval
        inside += low <= members[name].cause.value(share) <= high
        assert found.groups[0].explained > 0.8
        assert len(found.groups) == 1
        assert not found.has_rest
    assert inside >= 4


def test_intervals_hold_and_few_causes_are_made_up_where_simulations_scatter() -> None:
    """Effects are hardly larger than what 170 steps and a simulation of 120 determine, and do not bend."""
    causes = [each._replace(least=-8.0) for each in CAUSES if each.name in ("mass", "delay", "friction")]

    def steps(shares: Shares, rng: np.random.Generator, noise: float, count: int) -> Observations:
        x = rng.uniform(-0.8, 0.8, (count, 4))
        error = noise * rng.standard_normal((count, 2))
        error += sum(0.3 * share * EFFECTS[name](x) for name, share in shares.items())
        state = SPACE.state_centre + x[:, :2] * SPACE.state_scale
        return Observations(SPACE, state, SPACE.command_at(x[:, 2:]), error * SPACE.state_scale)

    found = inside = made_up = 0
    rng = np.random.default_rng(0)
    for _ in range(40):
        for planted in ({"delay": 1.0}, dict[str, float]()):
            error = RunError.of(steps(planted, rng, 0.03, 170))
            explanation = explain_error(
                error, causes, lambda wanted: [fit_surface(steps(each, rng, 0.022, 120))[0] for each in wanted]
            )
            members = {each.cause.name: each for group in explanation.groups for each in group.members}
            made_up += bool(members) and not planted
            for name in planted.keys() & members.keys():
                low, high = members[name].interval
                found, inside = found + 1, inside + (low <= 1.1 <= high)
    assert found >= 26
    assert inside >= 0.85 * found
    assert made_up <= 8


def test_the_noise_of_few_steps_is_not_too_small() -> None:
    """Of 24 values, 15 weights leave the noise nine."""
    found = [fit_surface(steps_of({"mass": 1.0}, seed, NOISE, 24))[1] for seed in range(60)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(NOISE, rel=0.1)


def test_sizes_of_causes_that_act_nearly_alike_keep_a_positive_covariance() -> None:
    run, none = RunError.of(steps_of({"mass": 0.8}, 1, NOISE)), fit_surface(steps_of({}, 2, NOISE))[0]
    slopes = np.array([fit_surface(steps_of({name: 1.0}, 2, NOISE))[0].weights for name in ("mass", "torque")])
    slopes[1] *= -1  # weaker motors act as a heavier body does
    found = fit_sizes(run, none, np.zeros(2), slopes, np.array([50.0, 50.0]))
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
    assert np.abs(found.sizes).max() < 5


def test_a_size_beyond_the_valid_ones_does_not_lose_its_cause() -> None:
    """The effect is convex, so that the signature at the usual size asks for a size that the gap refuses."""
    cause = Cause("mass", 1.0, 1.1, least=-3.0, most=3.0)

    def steps(shares: Shares, seed: int, noise: float) -> Observations:
        assert all(cause.least <= share <= cause.most for share in shares.values())
        known = steps_of({}, seed, noise, 150)
        x = known.space.scaled_inputs(known.state, known.command)
        share = shares.get("mass", 0.0)
        error = (share + 0.3 * share**2) * EFFECTS["mass"](x) * SPACE.state_scale
        return replace(known, error=known.error + error)

    found = explain_error(
        RunError.of(steps({"mass": 2.8}, 0, NOISE)),
        [cause],
        lambda wanted: [fit_surface(steps(each, 100 + number, 0.0))[0] for number, each in enumerate(wanted)],
    )
    assert found.groups[0].members[0].share == pytest.approx(2.8, rel=0.05)


def test_without_a_cause_that_walks_an_error_says_so() -> None:
    with pytest.raises(InputError, match="mass, torque"):
        explain_error(
            RunError.of(steps_of({}, 0, NOISE)),
            CAUSES[:2],
            lambda wanted: [None if shares else fit_surface(steps_of({}, 1))[0] for shares in wanted],
        )


def test_two_planted_causes_are_found() -> None:
    for seed in range(5):
        found = explained({"mass": 1.0, "delay": 1.2}, seed)
        names = [{each.cause.name for each in group.members} for group in found.groups]
        assert sorted(len(each) for each in names) == [1, 2]
        assert {"mass", "torque"} in names
        assert {"delay"} in names


def test_causes_that_act_alike_are_a_group_and_those_without_effect_are_named() -> None:
    found = explained({"mass": 1.0}, 0)
    assert [[each.name for each in group] for group in found.alike] == [["mass", "torque"], ["delay"], ["friction"]]
    assert [each.name for each in found.unseen] == ["sensor"]


def test_a_cause_outside_the_list_is_reported_as_unexplained() -> None:
    for name in ("delay", "friction"):
        found = explained({name: 1.5, "mass": 0.7}, 0, [each for each in CAUSES if each.name != name])
        assert found.has_rest
        assert found.rest > 0.1


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


def test_a_robot_without_a_gap_has_no_cause() -> None:
    assert not any(explained({}, seed).groups for seed in range(5))


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
