"""Uneven ground by place: what its settings promise, on grounds that nothing was tuned on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.robots.ground import FLAT_GROUND, LARGEST_SLOPE, UnevenGround

LENGTH = 11.65


def ends(treads):
    """Place and height at the end of each piece."""
    stop = np.append(treads.start[1:], LENGTH)
    return stop, treads.height + treads.slope * (stop - treads.start)


def jumps(treads):
    """Height of the riser after each piece; the last one leads to the first piece."""
    return np.roll(treads.height, -1) - ends(treads)[1]


GROUNDS = st.builds(
    UnevenGround,
    stair_height=st.sampled_from([0.0, 0.01, 0.1]),
    stair_length=st.floats(0.05, 20.0),
    slope=st.sampled_from([0.0, 0.1, LARGEST_SLOPE]),
    ramp_length=st.floats(0.1, 20.0),
    roughness=st.sampled_from([0.0, 0.003]),
    wave_length=st.floats(0.1, 20.0),
    patch_stiffness=st.sampled_from([1.0, 0.1]),
    patch_friction=st.sampled_from([1.0, 0.5]),
    patch_length=st.floats(0.05, 20.0),
)


@given(GROUNDS, st.integers(0, 2**32 - 1))
def test_a_ground_is_what_its_settings_say(ground, seed):
    treads = ground.treads(LENGTH, np.random.default_rng(seed))
    assert treads.start[0] == 0
    assert (np.diff(np.append(treads.start, LENGTH)) > 0).all()
    assert np.abs(jumps(treads)).max() <= ground.stair_height + 1e-12
    if not ground.roughness:
        assert np.abs(treads.slope).max() == pytest.approx(ground.slope)
    assert set(treads.stiffness) <= {1.0, ground.patch_stiffness}
    assert set(treads.friction) <= {1.0, ground.patch_friction}
    if ground.patch_stiffness != 1:
        long = np.diff(np.append(treads.start, LENGTH))
        assert long[treads.stiffness != 1].sum() == pytest.approx(LENGTH / 2)
    again = ground.treads(LENGTH, np.random.default_rng(seed))
    assert all(np.array_equal(one, other) for one, other in zip(treads, again, strict=True))


def test_stairs_have_risers_of_all_sizes():
    treads = UnevenGround(stair_height=0.05).treads(1000.0, np.random.default_rng(0))
    risers = np.diff(treads.height)
    assert np.std(risers) == pytest.approx(0.05 / np.sqrt(3), rel=0.1)
    assert np.diff(treads.start).mean() == pytest.approx(0.8, rel=0.01)


def test_a_field_has_the_declared_roughness_and_no_shorter_waves():
    treads = UnevenGround(roughness=0.01, wave_length=0.4).treads(100.0, np.random.default_rng(0))
    heights = np.interp(np.linspace(0, 100, 20_000, endpoint=False), treads.start, treads.height, period=100.0)
    assert np.std(heights) == pytest.approx(0.01, rel=0.02)
    power = np.abs(np.fft.rfft(heights)) ** 2
    assert power[: round(100 / 0.4) + 1].sum() > 0.999 * power.sum()


def test_flat_ground_draws_nothing():
    rng = np.random.default_rng(0)
    treads = FLAT_GROUND.treads(LENGTH, rng)
    assert len(treads.start) == 1
    assert not treads.height.any()
    assert rng.random() == np.random.default_rng(0).random()
    assert FLAT_GROUND.is_flat
    assert not FLAT_GROUND.is_measured
    assert UnevenGround(measured_heights=True).is_measured


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("stair_height", -0.1, "not be negative"),
        ("slope", 0.6, "lie between 0 and 0.5"),
        ("stair_length", 0.0, "be at least 0.02 m"),
        ("patch_stiffness", 0.0, "be positive"),
        ("roughness", float("nan"), "be finite"),
    ],
)
def test_a_wrong_number_is_named(name, value, rule):
    with pytest.raises(ValueError, match=f"{name} = .*, but it must {rule}"):
        UnevenGround(**{name: value})
