"""Shares of variance, compared with closed forms and with SciPy's analysis of variance."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from stepgap.records.missing import Missing
from stepgap.step import Array
from stepgap.sweep.report.cases import SweepCases
from stepgap.sweep.report.variance_shares import VarianceShare, VarianceShares, variance_shares
from tests.sweep.report.tables import cases_of, combinations_of


def found_in(cases: SweepCases) -> VarianceShares:
    found = variance_shares(cases)
    assert isinstance(found, VarianceShares)
    return found


def share_of(found: VarianceShares, name: str) -> VarianceShare:
    return next(share for share in found.axes if share.name == name)


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
    assert found.cases == 1200
    assert found.left_out == ()
    for name, value in {"a": 0.4, "b": 0.2, "twin": 0.1}.items():
        assert share_of(found, name).values[0] == pytest.approx(value, abs=0.02)
        assert share_of(found, name).chance[0] < 1e-9
    assert found.remainder[0] == pytest.approx(0.3, abs=0.02)
    assert [share.name for share in found.axes] == ["a", "b", "twin"]


def test_one_axis_agrees_with_the_analysis_of_variance(tmp_path: Path) -> None:
    """ε² = (F − 1)·ν / (F·ν + ν_error)."""
    rng = np.random.default_rng(0)
    codes = np.sort(rng.integers(0, 5, 90))
    logs = rng.normal(size=(90, 2)) + 0.4 * codes[:, np.newaxis]
    settings = {"a": list(map(str, codes)), "seed": list(map(str, range(90)))}
    (share,) = found_in(cases_of(tmp_path, settings, logs)).axes
    test = stats.f_oneway(*(logs[codes == level] for level in range(5)))
    np.testing.assert_allclose(share.values, (test.statistic - 1) * 4 / (test.statistic * 4 + 85))
    np.testing.assert_allclose(share.chance, test.pvalue)


def test_effects_are_those_of_least_squares(tmp_path: Path) -> None:
    """In an unbalanced table, in which a third of the cases is missing: the F test of nested models."""
    rng = np.random.default_rng(0)
    settings = combinations_of({"a": range(4), "b": range(3), "twin": range(6), "seed": range(3)})
    kept = rng.random(216) < 0.66
    settings = {
        name: [text for text, chosen in zip(texts, kept, strict=True) if chosen] for name, texts in settings.items()
    }
    codes = {name: np.array(texts, int) for name, texts in settings.items() if name != "seed"}
    logs = codes["a"] - codes["b"] + rng.normal(size=len(codes["a"]))
    found = found_in(cases_of(tmp_path, settings, logs))

    def rest(*names: str) -> float:
        columns = np.hstack([np.eye(codes[name].max() + 1)[codes[name]] for name in names])
        return float(np.sum((logs - columns @ np.linalg.lstsq(columns, logs)[0]) ** 2))

    left = len(logs) - 1 - 3 - 2 - 5
    for name, own in (("a", 3), ("b", 2), ("twin", 5)):
        f = (rest(*(codes.keys() - {name})) / rest(*codes) - 1) * left / own
        assert share_of(found, name).chance[0] == pytest.approx(stats.f.sf(f, own, left))


def test_an_axis_without_effect_has_a_share_of_zero(tmp_path: Path) -> None:
    settings = combinations_of({"noise": range(6), "b": range(3), "seed": range(5)})
    values, chances = [], []
    for seed in range(30):
        logs = np.tile(np.repeat([0.0, 1.0, 2.0], 5), 6) + np.random.default_rng(seed).normal(size=90)
        share = share_of(found_in(cases_of(tmp_path / str(seed), settings, logs)), "noise")
        values.append(share.values[0])
        chances.append(share.chance[0])
    assert np.count_nonzero(np.array(chances) < 0.05) <= 4
    assert stats.kstest(chances, "uniform").pvalue > 0.05
    assert np.abs(np.mean(values)) < 3 * np.std(values) / np.sqrt(30)


def test_cases_of_one_point_are_no_evidence_for_its_other_settings(tmp_path: Path) -> None:
    """Of a sequence of 32 points only `a` matters; by chance the other settings are correlated with it."""
    false, found_a = 0, []
    for seed in range(10):
        points = qmc.Sobol(4, rng=np.random.default_rng(seed)).random(32)
        settings = {name: np.repeat(points[:, row], 12).astype(str).tolist() for row, name in enumerate("abcd")}
        settings["seed"] = np.tile(np.arange(12), 32).astype(str).tolist()
        logs = np.repeat(3 * points[:, 0], 12) + np.random.default_rng(seed).normal(0, 0.1, 384)
        found = found_in(cases_of(tmp_path / str(seed), settings, logs))
        false += sum(share_of(found, name).chance[0] < 0.05 for name in "bcd")
        found_a.append(share_of(found, "a").chance[0] < 0.05)
    assert false <= 2
    assert all(found_a)


def test_a_sequence_finds_main_effects(tmp_path: Path) -> None:
    """x has a variance of 1/12, and the product of two such numbers with mean zero, which is no main effect, 1/144."""
    points = qmc.Sobol(3, rng=np.random.default_rng(0)).random(1024)
    x, y, _ = points.T - 0.5
    logs = x * np.sqrt(12) + 12 * x * y + np.random.default_rng(1).normal(size=1024)
    settings = {name: points[:, row].astype(str).tolist() for row, name in enumerate("xyz")}
    found = found_in(cases_of(tmp_path, {**settings, "seed": ["0"] * 1024}, logs))
    for name, value in {"x": 1 / 3, "y": 0, "z": 0}.items():
        assert share_of(found, name).values[0] == pytest.approx(value, abs=0.03)


def test_what_has_too_few_cases_is_left_out(tmp_path: Path) -> None:
    settings = {"twin": list(map(str, range(40))), "b": ["x", "y"] * 20, "seed": ["0"] * 40}
    found = found_in(cases_of(tmp_path, settings, np.random.default_rng(0).normal(size=40)))
    assert [share.name for share in found.axes] == ["b"]
    assert found.left_out == ("twin",)


@pytest.mark.parametrize(
    ("count", "spread", "reason"),
    [(15, 1.0, "fewer than 16"), (40, 0.0, "the same in all cases")],
)
def test_the_reason_is_given_where_there_are_no_shares(tmp_path: Path, count: int, spread: float, reason: str) -> None:
    settings = {"a": [str(row % 2) for row in range(count)], "seed": list(map(str, range(count)))}
    cases = cases_of(tmp_path, settings, spread * np.random.default_rng(0).normal(size=count))
    found = variance_shares(cases)
    assert isinstance(found, Missing)
    assert reason in found.reason
