"""Sentences, figure and table on what distinguishes robots."""

import numpy as np

from stepgap.study.individuals import ComparedRobots, Trait, compare_individuals
from stepgap.study.individuals_page import difference_sentences, differences_section, differences_table
from tests.study.test_individuals import SPACE, robot


def test_the_sentences_name_robot_size_interval_and_place() -> None:
    robots = [robot(number) for number in range(10)]
    robots[3], robots[7] = robot(3, slow=0.15), robot(7, turn=-0.2)
    slow, turns = difference_sentences(compare_individuals(robots))
    assert slow.startswith("unit 3: its vx is 0.1")
    assert "m/s lower than that of the others (± 0.0" in slow
    assert " at cx 0." in slow
    assert turns.startswith("unit 7: its wz grows by 0.2 rad/s per rad/s less with cw") or "less with cw" in turns


def test_without_an_odd_robot_or_with_few_robots_there_is_one_sentence() -> None:
    alike = difference_sentences(compare_individuals([robot(number) for number in range(20, 30)]))
    assert alike == ["no robot is unlike the others: no difference is larger than the spread of 10 robots explains"]
    few = difference_sentences(compare_individuals([robot(0), robot(1, slow=0.3)]))
    assert few == ["2 robots are too few to say which one is unlike the others; 5 are needed"]


def test_the_scatter_is_compared_by_its_ratio() -> None:
    traits, values = (Trait("noise", 0),), np.log([[1.0], [1.02], [0.98], [1.01], [0.99], [3.0]])
    names, steps = tuple("abcdef"), np.full(6, 100)
    found = ComparedRobots(names, SPACE, traits, np.zeros(2), values, np.full((6, 1), 0.05), steps)
    (sentence,) = difference_sentences(found)
    assert sentence == "f: its vx scatters 3.0 times as much as that of the others (95 %: 2.7 to 3.3)"


def test_the_section_has_a_figure_and_a_row_for_each_trait() -> None:
    robots = [robot(number) for number in range(6)]
    robots[3] = robot(3, slow=0.3)
    found = compare_individuals(robots)
    heads, rows = differences_table(found)
    assert heads[1:-1] == [f"unit {number}" for number in range(6)]
    assert [row[0] for row in rows][:3] == ["vx [m/s]", "wz [rad/s]", "vx by cx"]
    assert [row[4].endswith(" *") for row in rows].count(True) >= 1
    html = differences_section(found)
    assert "<svg" in html
    assert html.count("<tr>") == 1 + len(found.traits)
