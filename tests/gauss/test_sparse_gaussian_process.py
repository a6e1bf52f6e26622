"""The sparse process against the exact one, and against the dense formulae of the approximation."""

import json

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.gaussian_process.kernels import Matern

from stepgap.gauss import gaussian_process_fit
from stepgap.gauss.gaussian_process import (
    ExactGaussianProcess,
    SparseGaussianProcess,
    condition,
    condition_sparse,
    process_from_dict,
)
from stepgap.gauss.gaussian_process_fit import (
    fit_gaussian_process,
    fit_hyper_parameters,
    fit_like_fitrgp,
    spread_points,
)
from stepgap.step import Array
from tests.gauss.test_gaussian_process import CENTRE, FIXED, SCALE, SLOPED, central_difference, sample, singles, truth

METHODS = ("mean", "mean_gradient", "std", "std_gradient", "kriging_std", "kriging_std_gradient")
BOTH = pytest.mark.parametrize("hyper_parameters", [FIXED, SLOPED], ids=["constant", "linear"])


@BOTH
def test_with_all_points_inducing_it_is_the_exact_process(hyper_parameters) -> None:
    points, values = sample(40)
    sparse = condition_sparse(points, values, SCALE, hyper_parameters, points)
    exact = condition(points, values, SCALE, hyper_parameters)
    queries, _ = sample(20, seed=1)
    for method in METHODS:
        np.testing.assert_allclose(getattr(sparse, method)(queries), getattr(exact, method)(queries), rtol=1e-6)
    np.testing.assert_allclose(sparse.leave_out(singles(40)), exact.leave_out(singles(40)), rtol=1e-6)
    np.testing.assert_allclose(sparse.std(queries), exact.std(queries), rtol=1e-6)
    assert sparse.coefficient == pytest.approx(exact.coefficient, rel=1e-6)


@BOTH
def test_agrees_with_the_dense_formulae(hyper_parameters) -> None:
    points, values = sample(60)
    queries, _ = sample(20, seed=1)
    inducing, _ = sample(12, seed=2)
    sparse = condition_sparse(points, values, SCALE, hyper_parameters, inducing)

    def linear_covariance(one: Array, other: Array) -> Array:
        return hyper_parameters.slope_std**2 * ((one - inducing[0]) / SCALE) @ ((other - inducing[0]) / SCALE).T

    def f(one: Array, other: Array) -> Array:
        lengths = SCALE * hyper_parameters.length_scale
        return hyper_parameters.signal_std**2 * np.asarray(Matern(nu=2.5)(one / lengths, other / lengths), float)

    def covariance(one: Array, other: Array) -> Array:
        return f(one, inducing) @ np.linalg.solve(f(inducing, inducing), f(inducing, other)) + linear_covariance(
            one, other
        )

    matrix = covariance(points, points) + hyper_parameters.noise_std**2 * np.eye(60)
    across, K_one = covariance(queries, points), np.linalg.solve(matrix, np.ones(60))
    constant = K_one @ values / K_one.sum()
    mean = constant + across @ np.linalg.solve(matrix, values - constant)
    prior = hyper_parameters.signal_std**2 + np.diag(linear_covariance(queries, queries))
    plug_in = prior - np.einsum("qn,nq->q", across, np.linalg.solve(matrix, across.T))
    kriging = plug_in + (1 - across @ K_one) ** 2 / K_one.sum()
    np.testing.assert_allclose(sparse.mean(queries), mean, rtol=1e-8)
    np.testing.assert_allclose(sparse.std(queries) ** 2, plug_in, rtol=1e-8)
    np.testing.assert_allclose(sparse.kriging_std(queries) ** 2, kriging, rtol=1e-8)


@BOTH
def test_gradients_are_derivatives(hyper_parameters) -> None:
    sparse = condition_sparse(*sample(60), SCALE, hyper_parameters, sample(12, seed=2)[0])
    queries, _ = sample(5, seed=3)
    for query in [*queries, sparse.inducing[0]]:
        for function, gradient in (
            (sparse.mean, sparse.mean_gradient),
            (sparse.std, sparse.std_gradient),
            (sparse.kriging_std, sparse.kriging_std_gradient),
        ):
            expected = central_difference(function, query, 1e-5 * SCALE)
            np.testing.assert_allclose(gradient(query) * SCALE, expected * SCALE, rtol=1e-5, atol=1e-9)


@BOTH
def test_leave_out_is_the_prediction_without_the_block(hyper_parameters) -> None:
    points, values = sample(30)
    inducing, _ = sample(8, seed=2)
    blocks = [slice(0, 1), slice(1, 12), slice(12, 30)]
    found = condition_sparse(points, values, SCALE, hyper_parameters, inducing).leave_out(blocks)
    for block in blocks:
        others = np.delete(points, block, axis=0), np.delete(values, block)
        without = condition_sparse(*others, SCALE, hyper_parameters, inducing)
        stds = (std(points[block], include_noise=True) for std in (without.std, without.kriging_std))
        np.testing.assert_allclose([part[block] for part in found], [without.mean(points[block]), *stds], rtol=1e-7)


@BOTH
def test_append_is_the_same_as_conditioning_on_all(hyper_parameters) -> None:
    points, values = sample(60)
    inducing, _ = sample(12, seed=2)
    former = condition_sparse(points[:40], values[:40], SCALE, hyper_parameters, inducing)
    process, before = former, former.mean(CENTRE)
    for point, value in zip(points[40:], values[40:], strict=True):
        process = process.append(point, value)
    whole = condition_sparse(points, values, SCALE, hyper_parameters, inducing)
    assert isinstance(process, SparseGaussianProcess)
    assert process.to_dict() == whole.to_dict()
    queries, _ = sample(10, seed=1)
    for method in METHODS:
        np.testing.assert_allclose(getattr(process, method)(queries), getattr(whole, method)(queries), rtol=1e-8)
    assert former.mean(CENTRE) == before


def test_queries_keep_their_axes_and_nan_stays_nan() -> None:
    sparse = condition_sparse(*sample(60), SCALE, SLOPED, sample(12, seed=2)[0])
    queries, _ = sample(8000, seed=3)
    queries[5, 2] = np.inf
    for method in METHODS:
        result = getattr(sparse, method)(queries.reshape(2, 4000, 4))
        assert result.shape[:2] == (2, 4000)
        assert np.all(np.isnan(result[0, 5]))
        assert np.all(np.isfinite(result[1]))
        np.testing.assert_allclose(result[1, -1], getattr(sparse, method)(queries[-1]), rtol=1e-9)
        assert len(getattr(sparse, method)(queries[:0])) == 0


def test_is_restored_bit_for_bit() -> None:
    sparse = condition_sparse(*sample(60), SCALE, SLOPED, sample(12, seed=2)[0])
    loaded = process_from_dict(json.loads(json.dumps(sparse.to_dict(), allow_nan=False)))
    assert isinstance(loaded, SparseGaussianProcess)
    queries, _ = sample(10, seed=1)
    for method in METHODS:
        np.testing.assert_array_equal(getattr(loaded, method)(queries), getattr(sparse, method)(queries))
    assert isinstance(process_from_dict(condition(*sample(5), SCALE, FIXED).to_dict()), ExactGaussianProcess)


@pytest.mark.parametrize(
    ("key", "wrong"),
    [("inducing", [[1.0]]), ("inducing", []), ("noise_std", 0.0), ("slope_std", None), ("values", "x")],
)
def test_a_wrong_entry_is_named(key: str, wrong: object) -> None:
    saved = condition_sparse(*sample(6), SCALE, FIXED, sample(3)[0]).to_dict()
    with pytest.raises(ValueError, match=rf"^{key}\b.* must "):
        process_from_dict({**saved, key: wrong})


class TestSpreadPoints:
    def test_they_are_distinct_points_that_leave_little_variance(self) -> None:
        points, values = sample(300)
        few, many = (spread_points(points, SCALE, FIXED, count) for count in (10, 60))
        np.testing.assert_array_equal(many[:10], few)
        assert len(np.unique(many, axis=0)) == 60
        chosen, random = (
            condition_sparse(points, values, SCALE, FIXED, inducing).kriging_std(points).mean()
            for inducing in (many, points[:60])
        )
        assert chosen < random

    def test_duplicates_are_taken_once(self) -> None:
        points = np.repeat(sample(7)[0], 5, axis=0)
        assert len(spread_points(points, SCALE, FIXED, 20)) == 7


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("EXACT_SIZE", 300), ("INDUCING_SIZES", (15, 30, 60, 120))):
        monkeypatch.setattr(gaussian_process_fit, name, value)


@pytest.mark.usefixtures("small")
class TestFit:
    @pytest.mark.parametrize("basis", ["constant", "linear"])
    def test_recovers_a_smooth_function(self, basis) -> None:
        sparse = fit_gaussian_process(*sample(1500), SCALE, 0.2, basis=basis)
        queries, observed = sample(1000, seed=5)
        error = sparse.mean(queries) - observed
        assert np.sqrt(np.mean((sparse.mean(queries) - truth(queries)) ** 2)) < 0.003
        covered = np.abs(error) < norm.ppf(0.975) * sparse.kriging_std(queries, include_noise=True)
        assert 0.92 < covered.mean() < 0.98

    def test_a_rougher_function_gets_more_inducing_points(self) -> None:
        points, noise = sample(1000)
        rough = 0.1 * np.prod(np.sin(3 * (points - CENTRE)[:, :2] / SCALE[:2]), axis=1)
        smooth, rougher = (
            len(fit_gaussian_process(points, values, SCALE, 0.2).covariance.centres)
            for values in (noise, 0.05 * noise + rough)
        )
        assert rougher > smooth

    def test_the_size_decides_which_process_is_fitted(self) -> None:
        for size, kind in ((300, ExactGaussianProcess), (301, SparseGaussianProcess)):
            assert isinstance(fit_gaussian_process(*sample(size), SCALE, 0.2, basis="linear"), kind)

    def test_the_search_uses_no_more_points_than_an_exact_process_may_have(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """So that the cost of a search does not grow with a log, and falls nowhere."""
        monkeypatch.setattr(gaussian_process_fit, "EXACT_SIZE", 120)
        points, values = sample(1500)
        some = np.linspace(0, 1499, 120).astype(int)
        for basis in ("constant", "linear"):
            part = fit_hyper_parameters(points[some], values[some], SCALE, 0.2, basis=basis)
            found = fit_gaussian_process(points, values, SCALE, 0.2, basis=basis).hyper_parameters
            np.testing.assert_equal(vars(found), vars(part))

    def test_that_of_fitrgp_is_sparse_beyond_this_number_and_predicts_as_well(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        points, values = sample(400)
        monkeypatch.setattr(gaussian_process_fit, "EXACT_SIZE", 400)
        exact = fit_like_fitrgp(points, values)
        monkeypatch.setattr(gaussian_process_fit, "EXACT_SIZE", 399)
        sparse, (queries, _) = fit_like_fitrgp(points, values), sample(100, seed=5)
        assert isinstance(sparse, SparseGaussianProcess)
        np.testing.assert_allclose(sparse.mean(queries), exact.mean(queries), atol=0.002)
        np.testing.assert_allclose(sparse.std(queries), exact.std(queries), atol=0.001)

    @pytest.mark.parametrize("size", [5, 9, 400])
    def test_awkward_data_do_not_fail(self, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(gaussian_process_fit, "EXACT_SIZE", 4)
        points, values = sample(size)
        points[:, 1] = CENTRE[1]
        points[size // 2 :] = points[-1]
        for data in (values, np.full(size, 0.03), 1e6 * values, 1e-9 * values):
            sparse = fit_gaussian_process(points, data, SCALE, 0.2, basis="linear")
            assert np.all(np.isfinite(sparse.mean_gradient(points)))
            assert np.all(sparse.kriging_std(points, include_noise=True) > 0)
            assert np.all(np.isfinite(sparse.leave_out(singles(size))[0]))
