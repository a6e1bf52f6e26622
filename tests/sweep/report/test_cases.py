import re
from pathlib import Path

import numpy as np
import pytest

from stepgap.sweep.results_table import RESULTS
from tests.sweep.report.tables import cases_in, cases_of, combinations_of, write_results_table


def test_levels_of_numbers_ascend_and_names_keep_the_order_of_the_cases(tmp_path: Path) -> None:
    axes = {"gap.delay": [1e1, "2", "inf"], "warm_start": ["", "a b"], "twin": [7, 3], "plant": ["twin"], "seed": [0]}
    cases = cases_of(tmp_path, combinations_of(axes), np.zeros(12))
    delay, start, twin = cases.axes
    assert (delay.name, delay.levels) == ("gap.delay", ("2", "10", "inf"))
    np.testing.assert_array_equal(delay.codes, np.repeat([1, 0, 2], 4))
    assert start.levels == ("(empty)", "a b")
    assert twin.levels == ("7", "3")
    np.testing.assert_array_equal(twin.codes, np.tile([0, 1], 6))
    assert cases.constants == {"plant": "twin"}


def test_many_values_are_divided_into_ranges_with_equally_many_cases(tmp_path: Path) -> None:
    values = np.random.default_rng(0).permutation(np.arange(600) ** 2 / 1000)
    settings = {"gap.drag": [repr(value) for value in values.tolist()], "seed": ["0"] * 600}
    (axis,) = cases_of(tmp_path, settings, np.zeros(600)).axes
    np.testing.assert_array_equal(np.bincount(axis.codes), np.full(8, 75))
    order = np.argsort(values)
    assert (np.diff(axis.codes[order]) >= 0).all()
    assert axis.levels[:2] == ("0 to 5.48", "5.62 to 22.2")


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


@pytest.mark.parametrize("number", ["", "-1", "0.5", "1e300", "inf"])
def test_the_number_of_a_case_is_checked(tmp_path: Path, number: str) -> None:
    path = write_results_table(tmp_path, {"seed": ["0"]}, np.ones((1, 1, 2))) / RESULTS
    path.write_text(re.sub(r"^0,", f"{number},", path.read_text(), flags=re.MULTILINE))
    with pytest.raises(ValueError, match=r"^column case must contain integers from 0 to 99999999$"):
        cases_in(tmp_path)
