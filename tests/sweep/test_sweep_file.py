"""Sweeps are read from their files with the cases in the order of the axes, and wrong files are refused by one line."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.base.settings_file import parse_toml
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.robots.hopper.robot import as_hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.sweep.sweep import Sweep
from stepgap.sweep.sweep_file import MOST_CASES, read_sweep


def gap_of(experiment: Experiment) -> RealityGap:
    return as_hopper(experiment.robot, "").gap


def sweep_of(folder: Path, text: str) -> Sweep:
    (folder / "my.toml").write_text(text, encoding="utf-8")
    return read_sweep(folder / "my.toml")


SMALLEST = """
seeds = [1, 2, 3]
[axes]
"gap.body_mass_scale" = [0.95, 1.05]
"learning.residual" = ["gp_on_linear", "linear"]
"""


def test_cases_are_all_combinations_with_the_last_axis_fastest(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, SMALLEST)
    expected = list(product([0.95, 1.05], ["gp_on_linear", "linear"], [1, 2, 3]))
    assert len(sweep) == len(expected) == 12
    assert [tuple(sweep.settings(number).values()) for number in range(12)] == expected
    assert sweep.names == ("gap.body_mass_scale", "learning.residual", "seed")
    found = sweep.experiment(7)
    assert (gap_of(found).body_mass_scale, found.learning.residual, found.seed) == expected[7]
    assert found == read_experiment(
        None, [("gap.body_mass_scale", "1.05"), ("learning.residual", "gp_on_linear"), ("seed", "2")]
    )


def test_a_file_without_axes_is_one_case(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, "")
    assert (len(sweep), sweep.experiment(0)) == (1, Experiment())


def test_a_range_of_an_integer_setting_has_integers(tmp_path: Path) -> None:
    axis = sweep_of(tmp_path, "[axes]\nlearning.iterations = { from = 0, to = 3, points = 4 }").axes[0]
    assert [(type(point), point) for (point,) in axis.points] == [(int, 0), (int, 1), (int, 2), (int, 3)]


def test_grids_and_nested_keys(tmp_path: Path) -> None:
    sweep = sweep_of(
        tmp_path,
        """
        [axes]
        gap.torque_scale = { from = 0.6, to = 1, points = 5 }
        gap.ground_stiffness = { from = 1e3, to = 1e5, points = 3, scale = "log" }
        """,
    )
    assert [point for (point,) in sweep.axes[0].points] == [0.6, 0.7, 0.8, 0.9, 1.0]
    assert [point for (point,) in sweep.axes[1].points] == [1e3, 1e4, 1e5]


def test_a_sobol_sequence_covers_its_ranges_evenly(tmp_path: Path) -> None:
    text = """
    [sobol]
    points = 64
    ranges."gap.torque_scale" = [0.6, 1.0]
    ranges."gap.ground_stiffness" = { from = 1e3, to = 1e5, scale = "log" }
    """
    (axis, _) = sweep_of(tmp_path, text).axes
    torque, stiffness = np.array(axis.points).T
    unit = np.array([(torque - 0.6) / 0.4, np.log(stiffness / 1e3) / np.log(100)])
    for count in (8, 64):  # a digital net has one point in each of 2^m intervals, and in each cell of 8 by 8
        assert (np.bincount((unit[0] * count).astype(int)) == 64 // count).all()
    assert len(set(map(tuple, (unit * 8).astype(int).T.tolist()))) == 64
    assert sweep_of(tmp_path, text).axes[0] == axis
    assert sweep_of(tmp_path, text.replace("points", "seed = 1\npoints")).axes[0] != axis


def test_a_random_twin_has_the_gap_of_its_number_before_other_settings_change(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, 'twins = 3\n[axes]\n"gap.delay" = [0.0, 0.002]')
    gap = RealityGap.random(random_stream(1))
    assert gap_of(sweep.experiment(3)).delay == 0.002
    assert gap_of(sweep.experiment(3)).body_mass_scale == gap.body_mass_scale
    assert gap_of(sweep_of(tmp_path, "twins = [1]").experiment(0)) == gap


def test_a_preset_is_an_axis(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, '[axes]\n"gap.preset" = ["none", "paper"]\n"gap.body_mass_scale" = [1.2]')
    assert gap_of(sweep.experiment(0)).torque_scale == 1
    assert gap_of(sweep.experiment(1)).torque_scale != 1
    assert gap_of(sweep.experiment(0)).body_mass_scale == 1.2


def test_the_folder_of_a_sweep_has_all_files_to_read_it_again(tmp_path: Path) -> None:
    reference = "speed,height\n0,0.55\n0.1,0.56\n"
    for name in ("in", "out"):
        (tmp_path / name).mkdir()
    for name in ("base.csv", "axis.csv"):
        (tmp_path / "in" / name).write_text(reference)
    (tmp_path / "in" / "e.toml").write_text('reference = "base.csv"\n[learning]\niterations = 2\n')
    sweep = sweep_of(tmp_path / "in", 'base = "e.toml"\nseeds = [4]\n[axes]\nreference = ["axis.csv", "paper"]')
    for name, text in sweep.files.items():
        former = text.replace("[learning]\n", '[learning]\nfeature_map = "identity"\n')
        (tmp_path / "out" / name).write_text(former, encoding="utf-8")
    again = read_sweep(tmp_path / "out" / "sweep.toml")
    assert again.files == sweep.files
    assert again.axes == sweep.axes
    assert [again.case(number) for number in range(2)] == [sweep.case(number) for number in range(2)]


def test_points_of_other_versions_are_refused(tmp_path: Path) -> None:
    text = sweep_of(tmp_path, '[sobol]\npoints = 4\n[sobol.ranges]\n"gap.delay" = [0.0, 0.001]').files["sweep.toml"]
    (tmp_path / "experiment.toml").write_text("# the defaults\n")
    sweep_of(tmp_path, text)
    with pytest.raises(InputError, match="points_sha256: the axes do not have these points"):
        sweep_of(tmp_path, text.replace("0.001", "0.002"))


def test_a_changed_file_of_an_axis_is_another_sweep(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("speed,height\n0,0.55\n")
    before = sweep_of(tmp_path, '[axes]\nreference = ["r.csv"]').files
    assert sweep_of(tmp_path, '[axes]\nreference = ["r.csv"]').files == before
    (tmp_path / "r.csv").write_text("speed,height\n0,0.56\n")
    assert sweep_of(tmp_path, '[axes]\nreference = ["r.csv"]').files != before


def test_a_case_needs_no_file(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("speed,height\n0,0.55\n0.1,0.56\n")
    sweep = sweep_of(tmp_path, 'keep = "steps"\n[axes]\nreference = ["r.csv"]')
    case = sweep.case(0)
    assert case["keep"] == "steps"
    assert set(case["files"]) == {"experiment.toml", "reference.csv"}
    assert parse_toml(case["files"]["experiment.toml"])["reference"] == "reference.csv"


def test_settings_that_do_not_fit_together_are_an_error_of_the_case(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, '[axes]\n"gains.rest_length" = [0.285, 0.9]')
    sweep.case(0)
    with pytest.raises(InputError, match=r"case 1: gains\.rest_length = 0\.9"):
        sweep.case(1)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[axes]\n"gap.body_mas_scale" = [1]', ["my.toml", "[axes] gap.body_mas_scale", "did you mean"]),
        ('[axes]\n"gap.body_mass_scale" = []', ["gap.body_mass_scale = []", "not empty"]),
        ('[axes]\n"gap.body_mass_scale" = 1', ["gap.body_mass_scale = 1", "a list of values"]),
        ('[axes]\n"gap.body_mass_scale" = [1, 1]', ["its values must differ"]),
        ('[axes]\n"gap.body_mass_scale" = [-1]', ["gap.body_mass_scale = -1", "positive"]),
        ('[axes]\n"gap.body_mass_scale" = ["heavy"]', ["must be a number"]),
        ('[axes]\n"learning.iterations" = [1.5]', ["must be an integer"]),
        ('[axes]\n"gap.preset" = ["moon"]', ["gap.preset = 'moon'", "'paper' or 'none'"]),
        ("[axes]\ngap.delay = { from = 1, to = 0, points = 3 }", ["the smaller number first"]),
        ("[axes]\ngap.delay = { from = 0, to = 1, points = 1 }", ["points = 1", "an integer from 2 to 1000000"]),
        ("[axes]\nlearning.iterations = { from = 0, to = 3, points = 3 }", ["learning.iterations = 1.5", "an integer"]),
        ('[axes]\ngap.delay = { from = 0, to = 1, points = 3, scale = "log" }', ["scale = 'log'", "positive"]),
        ("[axes]\ngap.delay = { from = 0, to = 1, point = 3 }", ["points = None"]),
        ("[axes]\nseed = [1]", ["[axes] seed: give seeds = "]),
        ('[axes]\nplant = ["ethercat"]', ["plant = 'ethercat'", "twin, emulated-ring"]),
        ('[axes]\nrig = ["rig.toml"]', ["cannot use a rig"]),
        ("axes = 3", ["must be a table"]),
        ("axis = 3", ["axis: unknown key; did you mean axes?"]),
        ("seeds = []", ["seeds = []", "a list of different integers"]),
        ("seeds = [1, 1]", ["different"]),
        ("seeds = [-1]", ["integers from 0"]),
        ("seeds = 3", ["seeds = 3"]),
        ("twins = 0", ["twins = 0", "number of random twins"]),
        ('keep = "all"', ["keep = 'all'", "runs, steps, nothing"]),
        ('base = "none.toml"', ["my.toml: base = 'none.toml'", "an existing file of settings"]),
        ("base = 3", ["base = 3"]),
        ('reference = "r.csv"\n[axes]', ["reference: unknown key"]),
        ('[axes]\nreference = ["none.csv"]', ["none.csv: No such file"]),
        ('[axes]\n"learning" = [{ residual = "linear" }]', ["[axes] learning", "a list of values"]),
        ('[axes]\n"gap.delay" = [0, 0.0]', ["its values must differ"]),
        ("[sobol]\npoints = 60", ["points = 60", "power of 2"]),
        ("[sobol]\npoints = 1048576", ["points = 1048576", "a power of 2 up to 1000000"]),
        ("[sobol]\npoints = 64", ["ranges: missing"]),
        ('[sobol]\npoints = 64\n[sobol.ranges]\n"gap.delay" = [1]', ["[sobol.ranges] gap.delay = [1]"]),
        ('[sobol]\npoints = 4\n[sobol.ranges]\n"learning.iterations" = [1, 9]', ["must be an integer"]),
        (f"twins = {MOST_CASES}\nseeds = [1, 2]", [f"{2 * MOST_CASES} combinations"]),
        ("x = [", ["not TOML"]),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, text: str, parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        sweep_of(tmp_path, text)
    assert "\n" not in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["from", "to", "points", "x"]), inner),
    max_leaves=6,
).filter(lambda value: value is not None)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(
    st.dictionaries(
        st.sampled_from(["base", "seeds", "twins", "keep", "axes", "sobol", "points_sha256", "x"]),
        VALUES | st.dictionaries(st.sampled_from(["gap.delay", "seed", "points", "ranges", "names"]), VALUES),
        max_size=4,
    )
)
def test_any_file_is_a_sweep_or_refused_by_one_line(tmp_path: Path, table: dict[str, object]) -> None:
    try:
        text = tomli_w.dumps(table)
    except (TypeError, ValueError):
        return
    try:
        sweep = sweep_of(tmp_path, text)
        assert 1 <= len(sweep) <= MOST_CASES
        message = ""
    except InputError as error:
        message = str(error)
    assert "\n" not in message
