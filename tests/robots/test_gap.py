"""`difference`: one declaration of a difference is its checks, its draws, its absence and its text."""

from dataclasses import dataclass, fields, replace
from math import inf, nan

import numpy as np
import pytest

from stepgap.experiment.settings_text import meanings
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.velocity.walking_robot import WalkingGap
from stepgap.robots.gap import NOT_NEGATIVE, POSITIVE, Drawn, Gap, difference, differences
from stepgap.robots.hopper.twin.reality_gap import SHARE, RealityGap


@dataclass(frozen=True)
class Windy(RealityGap):
    """A twin in the wind."""

    wind: float = difference(0.0, exact=0.0, drawn=SHARE, whole=2.0)
    """Speed of the wind against the robot [m/s]."""


@dataclass(frozen=True)
class Deflated(MjcfGap):
    """A robot with soft tyres."""

    tyre_stiffness: float = difference(3e5, POSITIVE, exact=inf, drawn=Drawn(2e5, 4e5))
    """Stiffness of a tyre
    [N/m]."""


def test_a_new_difference_is_declared_in_one_place() -> None:
    assert (Windy().wind, Windy.none().wind, Deflated.none().tyre_stiffness) == (0.0, 0.0, inf)
    assert meanings(Windy)["wind"] == "Speed of the wind against the robot [m/s]. No gap: 0.0."
    assert meanings(Windy)["boom_drag"] == meanings(RealityGap)["boom_drag"]
    assert meanings(Deflated)["tyre_stiffness"] == "Stiffness of a tyre [N/m]. No gap: inf."
    for value, rule in ((nan, "be a number"), (-inf, "be finite"), (0.0, "be positive")):
        with pytest.raises(ValueError, match=f"tyre_stiffness = {value}, but it must {rule}"):
            Deflated(tyre_stiffness=value)
    with pytest.raises(ValueError, match="wind = inf, but it must be finite"):
        Windy(wind=inf)
    twins = [Windy.random(np.random.default_rng(seed)) for seed in range(50)]
    assert len({twin.wind for twin in twins}) == 50
    assert all(0 <= twin.wind <= 1.5 * 2.0 for twin in twins)
    assert 2e5 < Deflated.random(np.random.default_rng(0)).tyre_stiffness < 4e5


def test_a_new_difference_is_drawn_after_the_others() -> None:
    twin, windy = (kind.random(np.random.default_rng(4)) for kind in (RealityGap, Windy))
    assert all(getattr(twin, name) == getattr(windy, name) for name in differences(RealityGap))


FIELDS = [(gap, name) for gap in (RealityGap(), MjcfGap(), WalkingGap()) for name in differences(gap)]


@pytest.mark.parametrize(("gap", "name"), FIELDS, ids=[f"{type(gap).__name__}.{name}" for gap, name in FIELDS])
def test_every_difference_has_a_meaning_and_refuses_what_makes_no_sense(gap: Gap, name: str) -> None:
    known = differences(gap)[name]
    assert meanings(type(gap))[name]
    assert known.exact is not None or not known.drawn or name == "individual"  # a number that only tells robots apart
    if name == "boom_arc":  # no number
        return
    wrong = [nan, -inf, *[-1.0] * bool({POSITIVE, NOT_NEGATIVE} & set(known.rules)), *[0.0] * (POSITIVE in known.rules)]
    for value in wrong if known.exact == inf else [*wrong, inf]:
        with pytest.raises(ValueError, match=f"{name} = {value}, but it must"):
            replace(gap, **{name: value})
    if known.exact == inf:  # rigid, exact or unlimited
        replace(gap, **{name: inf}, **{"boom_arc": False} if isinstance(gap, RealityGap) else {})


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("ground_slope", 1.0, "lie within ±"),
        ("boom_tilt", -1.0, "lie within ±"),
        ("torque_imbalance", 1.0, "lie within ±"),
        ("delay", 1.001, "be at most 1 s"),
        ("ground_friction", inf, "be finite with boom_arc = true"),
    ],
)
def test_limits_of_the_twin_are_named(name: str, value: float, rule: str) -> None:
    with pytest.raises(ValueError, match=f"{name} = {value}, but it must {rule}"):
        replace(RealityGap(), **{name: value})


def test_no_gap_differs_from_a_real_machine_in_every_field_that_matters() -> None:
    none, real = RealityGap.none(), RealityGap()
    assert set(differences(none)) == {field.name for field in fields(RealityGap)}
    same = {name for name in differences(none) if getattr(none, name) == getattr(real, name)}
    kept = {name for name, known in differences(none).items() if known.exact is None}
    of_other_twins = {
        name for name, known in differences(none).items() if name != "boom_arc" and known.whole != getattr(real, name)
    }
    assert same == kept | of_other_twins


def test_random_twins_are_those_of_earlier_versions() -> None:
    twin, robot = RealityGap.random(np.random.default_rng(0)), MjcfGap.random(np.random.default_rng(0))
    assert (twin.body_mass_scale, twin.motor_offset_2) == (0.9713367240705345, 0.002800234252649547)
    assert (robot.mass_scale, robot.delay) == (1.0592404218303635, 0.003651022309110887)
