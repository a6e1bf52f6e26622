"""Uneven ground by place: what its settings promise, on grounds that nothing was tuned on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.robots.ground import FELT, FLAT_GROUND, GAP_DEPTH, LARGEST_SLOPE, RUN_UP, UnevenGround

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
        ("stone_length", 0.0, "be at least 0.02 m"),
    ],
)
def test_a_wrong_number_is_named(name, value, rule):
    with pytest.raises(ValueError, match=f"{name} = .*, but it must {rule}"):
        UnevenGround(**{name: value})


def height_at(treads, place):
    """Height of a ground at a place."""
    piece = np.searchsorted(treads.start, place, "right") - 1
    return treads.height[piece] + treads.slope[piece] * (place - treads.start[piece])


PROFILES = st.lists(st.tuples(st.integers(0, 110), st.integers(-50, 50)), min_size=1, max_size=12).map(sorted)


@given(rows=PROFILES)
def test_a_profile_is_read_as_it_is_written(rows, tmp_path_factory):
    """The ground has the height of each row at its place where rows are farther apart than a foot feels; steep ones
    are refused.
    """
    path = tmp_path_factory.mktemp("profile") / "profile.csv"
    place, height = np.array(rows).T / [[10], [1000]]
    path.write_text("height,place\n" + "".join(f"{y!r},{x!r}\n" for x, y in np.column_stack([place, height]).tolist()))
    ground = UnevenGround(profile=str(path))
    gaps = np.asarray(np.diff(np.append(place, place[0] + LENGTH)), float)
    rises = np.asarray(np.diff(np.append(height, height[0])), float)
    if (np.abs(rises[gaps > 0]) > LARGEST_SLOPE * gaps[gaps > 0]).any():
        with pytest.raises(InputError, match=r"profile.csv, row \d+: the ground rises"):
            ground.treads(LENGTH, np.random.default_rng(0))
        return
    treads = ground.treads(LENGTH, np.random.default_rng(0))
    last = np.append(np.diff(place) > 0, True)  # after a riser, its upper end
    wanted = np.where((place == place[0]) & (place == 0), height[last][0], height)
    assert height_at(treads, place)[last] == pytest.approx(wanted[last], abs=1e-12)
    assert not ground.is_flat
    assert ground.largest_change == pytest.approx(np.ptp(height))


def felt_ground(tmp_path, place, height):
    """Treads of a scanned profile on a ground 6 m long, which is smoothed with a word."""
    path = tmp_path / "scan.csv"
    rows = np.column_stack([place, height]).tolist()
    path.write_text("place,height\n" + "".join(f"{x!r},{y!r}\n" for x, y in rows))
    with pytest.warns(StepGapWarning, match=r"scan.csv: rows are 0\.0\d+ m apart; a foot feels 0.06 m of ground"):
        return UnevenGround(profile=str(path)).treads(6.0, np.random.default_rng(0))


def test_bumps_that_are_as_long_as_a_foot_feels_are_level(tmp_path):
    """Rows of 0 and 3 mm in turn: a wave as long as the mean has none of it left."""
    place = np.arange(200) * FELT / 2
    treads = felt_ground(tmp_path, place, np.where(np.arange(200) % 2, 0.003, 0.0))
    assert treads.height == pytest.approx(np.full(len(treads.height), 0.0015), abs=1e-12)
    assert treads.slope == pytest.approx(np.zeros(len(treads.slope)), abs=1e-9)


@pytest.mark.parametrize("spacing", [0.01, 0.02])
@pytest.mark.parametrize("waves", [7, 20, 60])
def test_a_wave_is_felt_by_the_sinc_of_its_length(tmp_path, spacing, waves):
    """The mean over w of sin(k x) is sin(k x) sin(k w / 2) / (k w / 2); straight pieces between rows cost a sinc²."""
    place = np.arange(round(6 / spacing)) * spacing
    number = 2 * np.pi * waves / 6
    treads = felt_ground(tmp_path, place, 0.003 * np.sin(number * place))
    share = np.sinc(waves / 6 * FELT) * np.sinc(waves / 6 * spacing) ** 2
    inner = np.arange(0, 6, 0.01)
    assert height_at(treads, inner) == pytest.approx(0.003 * share * np.sin(number * inner), abs=2e-4)
    fitted = 2 * np.mean(height_at(treads, inner) * np.sin(number * inner))
    assert fitted == pytest.approx(0.003 * share, abs=1e-5)


def test_a_corner_is_rounded_over_a_foot_and_a_riser_stays(tmp_path):
    """A corner of a bend s is raised by s w / 8, and what is farther from it than w / 2 stays; so does a riser."""
    place = np.arange(600) / 100
    height = np.interp(place, [0, 2, 3, 4, 5], [0, 0, 0.1, 0.1, 0])
    riser = np.searchsorted(place, 3.5)
    place, height = np.insert(place, riser, place[riser]), np.insert(height, riser, height[riser])
    height[riser + 1 :] += 0.02
    height[np.searchsorted(place, 5) :] = 0.02
    straight = np.interp(np.arange(0, 5.9, 0.001), place, height)
    treads = felt_ground(tmp_path, np.append(place, 5.995), np.append(height, 0.0))
    felt = height_at(treads, np.arange(0, 5.9, 0.001))
    near = np.abs(np.subtract.outer(np.arange(0, 5.9, 0.001), [0, 2, 3, 4, 5, 6])).min(axis=1) < FELT / 2
    edge = np.abs(np.arange(0, 5.9, 0.001) - 3.5) < 1e-6
    assert felt[~near & ~edge] == pytest.approx(straight[~near & ~edge], abs=1e-9)
    assert felt[2000] == pytest.approx(0.1 * FELT / 8)
    assert felt[3000] == pytest.approx(0.1 - 0.1 * FELT / 8)
    assert felt[3499], felt[3501] == pytest.approx([0.1, 0.12])


def test_level_treads_and_far_rows_are_not_smoothed(tmp_path):
    """Short treads between risers have no slope to smooth, so there is no word of it."""
    path = tmp_path / "treads.csv"
    path.write_text("place,height\n0,0\n0.03,0\n0.03,0.003\n0.06,0.003\n0.06,0\n")
    treads = UnevenGround(profile=str(path)).treads(6.0, np.random.default_rng(0))
    assert treads.start == pytest.approx([0, 0.03, 0.06])
    assert treads.height == pytest.approx([0, 0.003, 0])


def test_short_ramps_and_waves_are_felt_too():
    """They are bumps like those of a profile: ramps of half the length of a foot make level ground."""
    ramps = UnevenGround(slope=0.1, ramp_length=FELT / 2).treads(6.0, np.random.default_rng(0))
    assert ramps.slope == pytest.approx(np.zeros(len(ramps.slope)), abs=1e-9)
    rough = UnevenGround(roughness=0.001, wave_length=0.1).treads(6.0, np.random.default_rng(0))
    shares = np.sinc(np.arange(1, 61) / 6 * FELT)
    assert np.std(rough.height) == pytest.approx(0.001 * np.sqrt(np.mean(shares**2)), rel=0.03)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: the header is ''; it must be 'place,height'"),
        ("place,height\n0.1,x\n", "line 2, column 'height': 'x'; it must be a finite number in m"),
        ("place,height\n0.1,inf\n", "line 2, column 'height'"),
        ("place,height\n0.3,0\n0.2,0\n", "row 2: place 0.2 m follows 0.3 m; places must not fall"),
        ("place,height\n0.3,2\n", r"row 1: height 2 m; it must be within ±1 m"),
        ("place,height\n12,0\n", r"place 12 m is not on the ground; it must be from 0 to below 11.65 m"),
        ("place,height\n-1,0\n2,0\n", r"place -1 m is not on the ground"),
        ("place,height\n0,0\n0.1,0.1\n", "row 1: the ground rises by 0.1 m within 0.1 m, a slope of 1; it may be 0.5"),
    ],
)
def test_a_wrong_profile_is_named(text, message, tmp_path):
    path = tmp_path / "profile.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=f"profile.csv.*{message}"):
        UnevenGround(profile=str(path)).treads(LENGTH, np.random.default_rng(0))


def test_a_profile_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none.csv: No such file.*; ground.profile must be a CSV file"):
        _ = UnevenGround(profile=str(tmp_path / "none.csv")).largest_change
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bytes.csv: this is not text"):
        _ = UnevenGround(profile=str(tmp_path / "bytes.csv")).largest_change


@given(st.floats(0.1, 0.5), st.floats(0.0, 0.9), st.floats(0.02, 0.3), st.integers(0, 99))
def test_stones_carry_and_gaps_do_not(spacing, share, length, seed):
    spread = share * (spacing - 0.02)
    ground = UnevenGround(stone_spacing=spacing, stone_spread=spread, stone_length=length, stone_seed=seed)
    treads, stones = ground.treads(LENGTH, np.random.default_rng(0)), ground.stones(LENGTH)
    gaps = np.diff(np.append(stones, LENGTH))
    assert stones[0] == 0
    assert gaps.max() / gaps.min() <= (spacing + spread) / (spacing - spread) + 1e-9
    for side in (-0.499, 0, 0.499):
        assert not height_at(treads, (stones + side * length) % LENGTH).any()
    places = np.linspace(0, LENGTH, 3000, endpoint=False)
    near = np.abs((places[:, None] - stones + LENGTH / 2) % LENGTH - LENGTH / 2).min(axis=1) <= length / 2
    solid = near | (places <= stones[1]) | (places >= LENGTH - RUN_UP)
    assert height_at(treads, places) == pytest.approx(np.where(solid, 0.0, -GAP_DEPTH))
