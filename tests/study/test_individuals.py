"""Robots of one type: who is named, in what, with what words, and how often without a reason."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from stepgap.base.errors import InputError
from stepgap.learning.polynomial import LINEAR
from stepgap.learning.regression import TrainingData
from stepgap.learning.residual import Residual, no_residual
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepSpace
from stepgap.study.individuals import (
    LARGEST_Z,
    ComparedRobots,
    Individual,
    Trait,
    compare_individuals,
    difference_sentences,
    differences_section,
)

SPACE = StepSpace(
    (Quantity("vx", "m/s", 0.0, 1.0), Quantity("wz", "rad/s", -0.6, 0.6)),
    (Quantity("cx", "m/s", 0.0, 1.2), Quantity("cw", "rad/s", -1.0, 1.0)),
)
NOMINAL = AffineMap(SPACE, np.zeros(2), np.zeros(2), np.zeros(2), np.hstack([np.zeros((2, 2)), np.eye(2)]))


def robot(number: int, *, slow: float = 0.0, turn: float = 0.0, noise: float = 0.01, steps: int = 80) -> Individual:
    """A robot whose error is linear in the command, like that of all others but for a small spread."""
    rng = np.random.default_rng(number)
    states, commands = rng.uniform(0, 1, (steps, 2)), SPACE.command_at(rng.uniform(-1, 1, (steps, 2)))
    gains = np.array([[-0.1, 0.0], [0.02, -0.2 + turn]]) + 0.01 * rng.normal(size=(2, 2))
    errors = commands @ gains.T + [0.05 - slow, 0.0] + 0.01 * rng.normal(size=2) + noise * rng.normal(size=(steps, 2))
    points, scale = np.hstack([states, commands]), np.concatenate([SPACE.state_scale, SPACE.command_scale])
    parts = [
        LINEAR.fit(TrainingData(points, error, np.zeros(4), scale, float(size)))
        for error, size in zip(errors.T, SPACE.state_scale, strict=True)
    ]
    return Individual(f"unit {number}", NOMINAL, Residual(LINEAR, tuple(parts), 2))


def named(comparison: ComparedRobots) -> list[tuple[str, Trait]]:
    """Who is unlike the others, and in what."""
    return [(comparison.names[row], comparison.traits[column]) for row, column in np.argwhere(comparison.unlike)]


def test_planted_robots_are_named_with_the_size_of_their_difference() -> None:
    robots = [robot(number) for number in range(10)]
    robots[3], robots[7] = robot(3, slow=0.15), robot(7, turn=-0.2)
    found = compare_individuals(robots)
    assert named(found) == [("unit 3", Trait("offset", 0)), ("unit 7", Trait("gain", 1, 1))]
    offset, gain = (found.traits.index(trait) for _, trait in named(found))
    assert abs(found.difference[3, offset] + 0.15) < 0.03
    assert abs(found.difference[7, gain] + 0.2) < 0.04


def test_nobody_is_named_where_nothing_is_planted() -> None:
    found = compare_individuals([robot(number) for number in range(20, 30)])
    assert not named(found)
    offsets = found.values[:, : len(SPACE.state)]
    assert (offsets.std(axis=0, ddof=1) < 0.03).all()


def test_a_robot_that_scatters_more_is_named() -> None:
    robots = [robot(number) for number in range(40, 50)]
    robots[5] = robot(45, noise=0.03)
    assert {trait.kind for name, trait in named(compare_individuals(robots)) if name == "unit 45"} == {"noise"}


def test_the_traits_are_those_of_least_squares() -> None:
    """The offset is that at the middle, whatever the commands of a robot are, and gains are those of the command."""
    one, other = robot(0, noise=0.0), robot(1, noise=0.0)
    found = compare_individuals([one, other])
    middle = np.concatenate([[0.5, 0.5], found.middle])

    def error(each: Individual, point: Array) -> Array:
        return each.residual.mean(point)

    expected = error(one, middle) - error(other, middle)
    np.testing.assert_allclose(found.values[0, :2] - found.values[1, :2], expected, atol=2e-3)
    gains = (one.residual.mean_gradient(middle) - other.residual.mean_gradient(middle))[:, 2:]
    np.testing.assert_allclose((found.values[0] - found.values[1])[2:6], gains.ravel(), atol=2e-3)


def compared(values: Array, kind: str = "offset") -> ComparedRobots:
    """Robots with these values (R, T) of traits of one kind."""
    traits = tuple(Trait(kind, 0) for _ in values[0])  # pyright: ignore[reportArgumentType]
    return ComparedRobots(tuple(f"unit {number}" for number in range(len(values))), SPACE, traits, np.zeros(2), values)


@pytest.mark.parametrize("size", [3, 6, 20])
def test_of_robots_that_are_alike_z_is_standard_normal(size: int) -> None:
    z = compared(np.random.default_rng(size).normal(2.0, 3.0, (size, 3000))).z
    assert stats.kstest(z[0], "norm").pvalue > 0.01
    assert np.mean(np.abs(z) > LARGEST_Z) < 0.001


def test_z_is_the_difference_from_the_mean_of_the_others() -> None:
    values = np.array([0.1, -0.2, 0.0, 0.3, -0.1, 0.2, -0.3, 0.0, 0.05, 4.0])
    found = compared(values[:, None])
    assert found.difference[9, 0] == pytest.approx(4.0 - values[:9].mean())
    t = found.difference[9, 0] / (values[:9].std(ddof=1) * np.sqrt(1 + 1 / 9))
    assert found.z[9, 0] == pytest.approx(stats.norm.isf(stats.t(8).sf(t)))
    assert np.argwhere(found.unlike).tolist() == [[9, 0]]
    assert np.isnan(compared(values[:2, None]).z).all(), "two robots"
    assert not compared(np.ones((8, 1))).unlike.any(), "without any spread"


def test_the_sentences_name_robot_size_place_and_z() -> None:
    robots = [robot(number) for number in range(10)]
    robots[3], robots[7] = robot(3, slow=0.15), robot(7, turn=-0.2)
    slow, turns = difference_sentences(compare_individuals(robots))
    assert slow.startswith("unit 3: its vx is 0.1")
    assert " m/s lower than that of the others at cx 0." in slow
    assert slow.endswith(")")
    assert " (z = −" in slow
    assert turns.startswith("unit 7: its wz grows by ")
    assert "less with cw" in turns


def test_without_an_odd_robot_or_with_two_robots_there_is_one_sentence() -> None:
    (alike,) = difference_sentences(compare_individuals([robot(number) for number in range(20, 30)]))
    assert alike.startswith("no robot is unlike the others: the largest |z| is ")
    few = difference_sentences(compare_individuals([robot(0), robot(1, slow=0.3)]))
    assert few == ["2 robots are too few to say which one is unlike the others; 3 are needed"]


def test_the_scatter_is_compared_by_its_ratio() -> None:
    found = compared(np.log([[1.0], [1.02], [0.98], [1.01], [0.99], [3.0]]), "noise")
    (sentence,) = difference_sentences(found)
    assert sentence.startswith("unit 5: its vx scatters 3.0 times as much as that of the others (z = ")


def test_the_section_has_a_row_for_each_trait_and_marks_the_odd_robot() -> None:
    robots = [robot(number) for number in range(8)]
    robots[3] = robot(3, slow=0.3)
    found = compare_individuals(robots)
    html = differences_section(found)
    assert html.count("<tr>") == 1 + len(found.traits)
    assert all(name in html for name in found.names)
    assert html.count(") *</td>") == np.count_nonzero(found.unlike) >= 1


def test_what_cannot_be_compared_is_refused() -> None:
    one, other = robot(0), robot(1)
    space = replace(SPACE, command=(Quantity("fx", "N", 0, 1), SPACE.command[1]))
    unlike = replace(one, nominal=AffineMap(space, np.zeros(2), np.zeros(2), np.zeros(2), NOMINAL.matrix))
    with pytest.raises(InputError, match="only robots of one type"):
        compare_individuals([other, unlike])
    with pytest.raises(InputError, match=r"unit 0: residual 'none' is no function .* that was learned"):
        compare_individuals([other, replace(one, residual=no_residual(2, 2))])
    with pytest.raises(InputError, match="unit 1: only 12 of its steps"):
        compare_individuals([one, robot(1, steps=12)])
