"""`RealityGap`: the values of differences that it accepts."""

from dataclasses import FrozenInstanceError, fields, replace
from math import inf, nan

import pytest

from stepgap.robots.gap import NOT_NEGATIVE, POSITIVE, differences
from stepgap.robots.hopper.twin.reality_gap import RealityGap

KNOWN = {name: known for name, known in differences(RealityGap).items() if name != "boom_arc"}
NUMBERS = list(KNOWN)


def test_every_field_is_a_difference():
    assert set(differences(RealityGap)) == {field.name for field in fields(RealityGap)}


def test_no_gap_differs_from_a_real_machine_in_every_field_that_matters():
    none, real = RealityGap.none(), RealityGap()
    same = {name for name in differences(none) if getattr(none, name) == getattr(real, name)}
    kept = {name for name, known in differences(none).items() if known.exact is None}
    of_other_twins = {name for name, known in KNOWN.items() if known.whole != getattr(real, name)}
    assert same == kept | of_other_twins


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [nan, -inf])
def test_refuses_a_value_that_is_not_a_number_and_names_it(name: str, value: float):
    with pytest.raises(ValueError, match=rf"{name} = -?(nan|inf), but it must"):
        replace(RealityGap(), **{name: value})


@pytest.mark.parametrize("name", NUMBERS)
def test_accepts_infinity_only_where_it_means_rigid_exact_or_unlimited(name: str):
    plane = replace(RealityGap(), boom_arc=False)
    if KNOWN[name].exact == inf:
        replace(plane, **{name: inf})
    else:
        with pytest.raises(ValueError, match=name):
            replace(plane, **{name: inf})


def test_on_the_arc_the_foot_must_be_able_to_slip():
    for gap, change in ((RealityGap(), {"ground_friction": inf}), (RealityGap.none(), {"boom_arc": True})):
        with pytest.raises(ValueError, match="ground_friction = inf, but it must be finite with boom_arc = true"):
            replace(gap, **change)


@pytest.mark.parametrize("name", [name for name in NUMBERS if {POSITIVE, NOT_NEGATIVE} & set(KNOWN[name].rules)])
def test_refuses_negative_values(name: str):
    with pytest.raises(ValueError, match=rf"{name} = -1.0, but it must"):
        replace(RealityGap(), **{name: -1.0})


@pytest.mark.parametrize("name", ["body_mass_scale", "motor_counts", "ground_stiffness", "torque_limit"])
def test_refuses_zero_where_it_has_no_meaning(name: str):
    with pytest.raises(ValueError, match=f"{name} = 0, but it must be positive"):
        replace(RealityGap(), **{name: 0})


@pytest.mark.parametrize("name", ["ground_slope", "boom_tilt", "torque_imbalance"])
def test_refuses_a_wall_for_a_floor_and_a_motor_that_pulls_back(name: str):
    for value in (1.0, -1.0):
        with pytest.raises(ValueError, match=rf"{name} = {value}, but it must lie within ±"):
            replace(RealityGap(), **{name: value})


@pytest.mark.parametrize("delay", [1.001, 1e5, 1e6])
def test_refuses_a_delay_that_the_simulation_cannot_keep(delay: float):
    with pytest.raises(ValueError, match=r"delay = .*, but it must be at most 1 s"):
        replace(RealityGap(), delay=delay)


def test_is_frozen():
    with pytest.raises(FrozenInstanceError):
        RealityGap().delay = 1.0  # pyright: ignore[reportAttributeAccessIssue]
