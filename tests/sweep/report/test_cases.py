import re
from pathlib import Path

import numpy as np
import pytest

from stepgap.sweep.report.cases import MOST_LEVELS, SweepAxis
from stepgap.sweep.results_table import RESULTS
from tests.sweep.report.tables import cases_in, cases_of, combinations_of, write_results_table


def test_levels_of_numbers_ascend_and_names_keep_the_order_of_the_cases(tmp_path: Path) -> None:
    settings = combinations_of(
        {
            "gap.delay": [1e1, "2", 0.5],
            "learning.residual": ["linear", "gp"],
            "twin": [7, 3],
            "plant": ["twin"],
            "seed": [0],
        }
    )
    cases = cases_of(tmp_path, settings, np.zeros(12))
    delay, residual, twin = cases.axes
    assert (delay.name, delay.levels) == ("gap.delay", ("0.5", "2", "10"))
    np.testing.assert_array_equal(delay.codes, np.repeat([2, 1, 0], 4))
    assert residual.levels == ("linear", "gp")
    assert twin.levels == ("7", "3")
    np.testing.assert_array_equal(twin.codes, np.tile([0, 1], 6))
    assert cases.constants == {"plant": "twin"}


def test_infinite_and_empty_values_are_levels(tmp_path: Path) -> None:
    settings = combinations_of({"learning.forgetting_time": ["inf", "100"], "warm_start": ["", "a b"], "seed": [0]})
    time, start = cases_of(tmp_path, settings, np.zeros(4)).axes
    assert time.levels == ("100", "inf")
    assert start.levels == ("(empty)", "a b")


def test_many_values_are_divided_into_ranges_with_equally_many_cases(tmp_path: Path) -> None:
    values = np.random.default_rng(0).permutation(np.arange(600) ** 2 / 1000)
    settings = {"gap.drag": [repr(value) for value in values.tolist()], "seed": ["0"] * 600}
    (axis,) = cases_of(tmp_path, settings, np.zeros(600)).axes
    np.testing.assert_array_equal(np.bincount(axis.codes), np.full(8, 75))
    order = np.argsort(values)
    assert (np.diff(axis.codes[order]) >= 0).all()
    assert axis.levels[:2] == ("0 to 5.48", "5.62 to 22.2")


def test_equal_values_stay_in_one_range(tmp_path: Path) -> None:
    values = np.repeat(np.arange(MOST_LEVELS + 1), 10)
    settings = {"gap.drag": list(map(str, values)), "seed": list(map(str, range(len(values))))}
    (axis,) = cases_of(tmp_path, settings, np.zeros(len(values))).axes
    assert all(len(set(axis.codes[values == value])) == 1 for value in values)


def test_quartiles_are_those_of_the_known_values_of_each_level() -> None:
    rng = np.random.default_rng(0)
    values, codes = rng.integers(20, 200, 60).astype(float), rng.integers(0, 3, 60)
    values[rng.random(60) < 0.4] = np.inf
    values[::7] = np.nan
    found = SweepAxis("a", tuple("wxyz"), codes).quartiles(values)
    for level in range(3):
        known = values[(codes == level) & ~np.isnan(values)]
        wanted = np.quantile(known, [0.25, 0.5, 0.75], method="inverted_cdf")
        np.testing.assert_array_equal(found[:, level], wanted)
    assert np.isnan(found[:, 3]).all()


def test_errors_that_cannot_be_compared_are_unknown(tmp_path: Path) -> None:
    settings = combinations_of({"a": [1, 2], "seed": [0, 1, 2]})
    errors = np.random.default_rng(0).uniform(1, 2, (6, 3, 2))
    errors[4, 2, 0] = np.nan
    errors[5, 2, 1] = 0
    write_results_table(tmp_path, settings, errors, aborted={0: 2, 1: 1, 2: 0}, hops={1: 40}, failed={3: "why"})
    cases = cases_in(tmp_path)
    np.testing.assert_array_equal(cases.numbers, [0, 1, 2, 4, 5])
    np.testing.assert_array_equal(cases.aborted, [True, True, True, False, False])
    np.testing.assert_array_equal(cases.aborted_last, [True, False, False, False, False])
    np.testing.assert_array_equal(cases.hops, [np.inf, 40, np.inf, np.inf, np.inf])
    np.testing.assert_array_equal(cases.comparable, [False, True, True, False, False])
    last = errors[[0, 1, 2, 4, 5], 2]
    last[0], last[4, 1] = np.nan, np.nan
    np.testing.assert_array_equal(cases.last_errors, last)
    first = errors[[0, 1, 2, 4, 5], 0]
    first[2] = np.nan
    np.testing.assert_array_equal(cases.first_errors, first)
    (failed,) = cases.failed
    assert (failed.number, failed.settings, failed.reason) == (3, ("2", "0"), "why")
    assert cases.rows == 16


def test_the_order_of_the_rows_does_not_matter(tmp_path: Path) -> None:
    settings = combinations_of({"a": [1, 2], "seed": [0, 1, 2]})
    errors = np.random.default_rng(0).uniform(1, 2, (6, 3, 2))
    path = write_results_table(tmp_path, settings, errors) / RESULTS
    whole = cases_in(tmp_path)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *np.random.default_rng(0).permutation(rows)]) + "\n")
    shuffled = cases_in(tmp_path)
    np.testing.assert_array_equal(shuffled.numbers, whole.numbers)
    np.testing.assert_array_equal(shuffled.last_errors, whole.last_errors)
    np.testing.assert_array_equal(shuffled.first_errors, whole.first_errors)


def test_all_cases_may_have_failed(tmp_path: Path) -> None:
    settings = combinations_of({"a": [1, 2], "seed": [0]})
    write_results_table(tmp_path, settings, np.ones((2, 1, 2)), failed={0: "x", 1: "y"})
    cases = cases_in(tmp_path)
    assert len(cases) == 0
    assert cases.axes == ()
    assert [case.reason for case in cases.failed] == ["x", "y"]


@pytest.mark.parametrize("number", ["", "-1", "0.5", "1e300", "inf"])
def test_the_number_of_a_case_is_checked(tmp_path: Path, number: str) -> None:
    path = write_results_table(tmp_path, {"seed": ["0"]}, np.ones((1, 1, 2))) / RESULTS
    path.write_text(re.sub(r"^0,", f"{number},", path.read_text(), flags=re.MULTILINE))
    with pytest.raises(ValueError, match=r"^column case must contain integers from 0 to 99999999$"):
        cases_in(tmp_path)
