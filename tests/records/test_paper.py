"""The paper's numbers are of the hopper that the package simulates."""

from stepgap.records import paper
from stepgap.robots.hopper.parameters import CommandBounds


def test_state_and_units_are_those_of_the_hopper() -> None:
    space = CommandBounds().space()
    assert space.state_names == paper.STATE_NAMES
    assert {quantity.name: quantity.unit for quantity in (*space.state, *space.command)} == dict(paper.UNITS)
