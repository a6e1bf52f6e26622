"""Shares of variance, compared with closed forms, with SciPy's analysis of variance, and with dense least squares."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from stepgap.records.missing import Missing
from stepgap.step import Array
from stepgap.sweep.report.additive_model import additive_model, explained_by_two
from stepgap.sweep.report.cases import SweepCases
from stepgap.sweep.report.variance_shares import VarianceShare, VarianceShares, variance_shares
from tests.sweep.report.tables import cases_of, combinations_of


def found_in(cases: SweepCases) -> VarianceShares:
    found = variance_shares(cases, np.random.default_rng(0))
    assert isinstance(found, VarianceShares)
    return found


def share_of(found: VarianceShares, *names: str) -> VarianceShare:
    return next(share for share in (*found.axes, *found.pairs) if set(share.names) == set(names))


def indicators(codes: NDArray[np.int64]) -> Array:
    return np.eye(codes.max() + 1)[codes]


def centred(values: Array) -> Array:
    """Values with mean zero and variance one."""
    return (values - values.mean()) / values.std()


def test_known_effects_have_their_shares(tmp_path: Path) -> None:
    """Effects with variances 4, 2 and 1, an interaction with variance 2, and noise with variance 1."""
    axes = {"a": range(4), "b": [0.1, 0.2, 0.3], "twin": range(5), "seed": range(20)}
    rng = np.random.default_rng(1)
    a, b, twin = (centred(rng.normal(size=count)) for count in (4, 3, 5))
    both = np.outer(centred(np.arange(4.0)), centred(np.arange(3.0) ** 2))
    shape = (4, 3, 5, 20)
    effects = 2 * a[:, None, None] + np.sqrt(2) * b[:, None] + twin + np.sqrt(2) * both[:, :, None]
    logs = effects[..., None] + rng.normal(size=shape)
    found = found_in(cases_of(tmp_path, combinations_of(axes), logs.ravel()))
    wanted = {("a",): 0.4, ("b",): 0.2, ("twin",): 0.1, ("a", "b"): 0.2, ("a", "twin"): 0, ("b", "twin"): 0}
    assert found.cases == 1200
    assert found.left_out == ()
    for names, value in wanted.items():
        share = share_of(found, *names)
        assert share.values[0] == pytest.approx(value, abs=0.02)
        assert share.lower[0] <= value <= share.upper[0]
        assert share.upper[0] - share.lower[0] < 0.12
    assert found.remainder[0] == pytest.approx(0.1, abs=0.02)
    assert [share.names for share in found.axes] == [("a",), ("b",), ("twin",)]


def test_one_axis_agrees_with_the_analysis_of_variance(tmp_path: Path) -> None:
    """ε² = (F − 1)·ν / (F·ν + ν_error)."""
    rng = np.random.default_rng(0)
    codes = np.sort(rng.integers(0, 5, 90))
    logs = rng.normal(size=(90, 2)) + 0.4 * codes[:, np.newaxis]
    settings = {"a": list(map(str, codes)), "seed": list(map(str, range(90)))}
    (share,) = found_in(cases_of(tmp_path, settings, logs)).axes
    f = np.array([stats.f_oneway(*(row[codes == level] for level in range(5))).statistic for row in logs.T])
    np.testing.assert_allclose(share.values, (f - 1) * 4 / (f * 4 + 85))


def test_the_additive_model_is_that_of_least_squares(tmp_path: Path) -> None:
    """In an unbalanced table, in which a third of the cases is missing."""
    rng = np.random.default_rng(0)
    settings = combinations_of({"a": range(4), "b": range(3), "twin": range(6), "seed": range(3)})
    kept = rng.random(216) < 0.66
    settings = {
        name: [text for text, chosen in zip(texts, kept, strict=True) if chosen] for name, texts in settings.items()
    }
    cases = cases_of(tmp_path, settings, np.zeros(int(kept.sum())))
    values = rng.normal(size=(2, len(cases)))
    values -= values.mean(axis=1, keepdims=True)
    model = additive_model(values, cases.axes)
    columns = np.hstack([indicators(axis.codes) for axis in cases.axes])
    solution = np.linalg.lstsq(columns, values.T)[0]
    np.testing.assert_allclose(model.remainder, values - (columns @ solution).T, atol=1e-8)
    fitted = sum(effect[:, axis.codes] for axis, effect in zip(cases.axes, model.effects, strict=True))
    np.testing.assert_allclose(fitted + model.remainder, values, atol=1e-12)


@pytest.mark.parametrize("shape", [(6, 3), (2, 7)])
def test_two_effects_explain_as_much_as_by_least_squares(shape: tuple[int, int]) -> None:
    """In samples with empty combinations, and one with an empty level."""
    rng = np.random.default_rng(0)
    counts, sums, wanted, ranks = [], [], [], []
    for sample in range(4):
        cells = rng.integers(0, shape[0] * shape[1], 25)
        first, second = np.divmod(cells[cells % shape[1] > 0] if sample == 3 else cells, shape[1])
        values = rng.normal(size=len(first))
        columns = np.hstack([np.eye(shape[0])[first], np.eye(shape[1])[second]])
        fitted = columns @ np.linalg.lstsq(columns, values)[0]
        wanted.append(fitted @ fitted)
        ranks.append(np.linalg.matrix_rank(columns))
        cells = first * shape[1] + second
        counts.append(np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape))
        sums.append(np.bincount(cells, values, shape[0] * shape[1]).reshape(shape))
    explained, effects = explained_by_two(np.array(counts, float), np.array([sums]))
    np.testing.assert_allclose(explained[0], wanted)
    np.testing.assert_array_equal(effects, ranks)


def test_an_axis_without_effect_has_a_share_of_zero(tmp_path: Path) -> None:
    settings = combinations_of({"noise": range(6), "b": range(3), "seed": range(5)})
    values, inside = [], []
    for seed in range(30):
        logs = np.tile(np.repeat([0.0, 1.0, 2.0], 5), 6) + np.random.default_rng(seed).normal(size=90)
        found = found_in(cases_of(tmp_path / str(seed), settings, logs))
        both = [share_of(found, "noise"), share_of(found, "noise", "b")]
        values.append([share.values[0] for share in both])
        inside.append([share.lower[0] <= 0 <= share.upper[0] for share in both])
    assert (np.sum(inside, axis=0) >= 26).all()
    assert (np.abs(np.mean(values, axis=0)) < 3 * np.std(values, axis=0) / np.sqrt(30)).all()


def test_cases_of_one_point_are_no_evidence_for_its_other_settings(tmp_path: Path) -> None:
    """Of a sequence of 16 points only `a` matters; by chance the other settings are correlated with it."""
    false, found_a = 0, []
    for seed in range(10):
        points = qmc.Sobol(4, rng=np.random.default_rng(seed)).random(16)
        settings = {name: np.repeat(points[:, row], 24).astype(str).tolist() for row, name in enumerate("abcd")}
        settings["seed"] = np.tile(np.arange(24), 16).astype(str).tolist()
        logs = np.repeat(3 * points[:, 0], 24) + np.random.default_rng(seed).normal(0, 0.1, 384)
        found = found_in(cases_of(tmp_path / str(seed), settings, logs))
        false += sum(share_of(found, name).lower[0] > 0 for name in "bcd")
        found_a.append(share_of(found, "a").lower[0] > 0)
    assert false <= 2
    assert all(found_a)


def test_a_sequence_finds_main_effects_and_interactions(tmp_path: Path) -> None:
    """x has a variance of 1/12, and the product of two such numbers with mean zero 1/144."""
    points = qmc.Sobol(3, rng=np.random.default_rng(0)).random(1024)
    x, y, _ = points.T - 0.5
    logs = x * np.sqrt(12) + 12 * x * y + np.random.default_rng(1).normal(size=1024)
    settings = {name: points[:, row].astype(str).tolist() for row, name in enumerate("xyz")}
    found = found_in(cases_of(tmp_path, {**settings, "seed": ["0"] * 1024}, logs))
    for names, value in {"x": 1 / 3, "y": 0, "z": 0, "xy": 1 / 3}.items():
        share = share_of(found, *names)
        assert share.values[0] == pytest.approx(value, abs=0.03)
        assert share.lower[0] <= value <= share.upper[0]


def test_what_has_too_few_cases_is_left_out(tmp_path: Path) -> None:
    settings = combinations_of({"twin": range(20), "b": range(3), "seed": [0]})
    found = found_in(cases_of(tmp_path, settings, np.random.default_rng(0).normal(size=60)))
    assert {share.names for share in found.axes} == {("twin",), ("b",)}
    assert found.pairs == ()
    assert found.left_out == (("twin", "b"),)
    settings = {"twin": list(map(str, range(40))), "b": ["x", "y"] * 20, "seed": ["0"] * 40}
    found = found_in(cases_of(tmp_path, settings, np.random.default_rng(0).normal(size=40)))
    assert [share.names for share in found.axes] == [("b",)]
    assert found.left_out == (("twin",),)


@pytest.mark.parametrize(
    ("count", "spread", "reason"),
    [(15, 1.0, "fewer than 16"), (40, 0.0, "the same in all cases")],
)
def test_the_reason_is_given_where_there_are_no_shares(tmp_path: Path, count: int, spread: float, reason: str) -> None:
    settings = {"a": [str(row % 2) for row in range(count)], "seed": list(map(str, range(count)))}
    cases = cases_of(tmp_path, settings, spread * np.random.default_rng(0).normal(size=count))
    found = variance_shares(cases, np.random.default_rng(0))
    assert isinstance(found, Missing)
    assert reason in found.reason
