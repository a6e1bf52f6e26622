"""The contract of every `ResidualModel`: a self-contained file that can be copied to a package with its own model.

Subclass `ResidualContract` as `Test…` and give it a fixture `model`.
"""

import json
from typing import Any

import numpy as np
import pytest

from stepgap.learning.regression import Regression, ResidualModel, TrainingData

INPUTS, SIZE = 4, 30
CENTRE, SCALE, VALUE_SCALE = np.array([0.2, 0.58, 0.0, 0.0]), np.array([0.2, 0.045, 15.0, 1.0]), 0.2
OPTIONAL_KEYS = {"kernel"}  # files of earlier versions do not have them


def training_data(size: int = SIZE, seed: int = 0, *, timed: bool = False) -> TrainingData:
    """Noisy values of a slightly nonlinear function."""
    generator = np.random.default_rng(seed)
    x = generator.uniform(-1, 1, (size, INPUTS))
    if timed:
        x[:, -1] = np.arange(size) / 20
    shape = 0.2 - 0.3 * x[:, 0] + 0.2 * x[:, 1] * x[:, 2] + 0.1 * np.sin(2 * x[:, 2])
    values = VALUE_SCALE * (shape + 0.05 * generator.standard_normal(size))
    return TrainingData(CENTRE + SCALE * x, values, CENTRE, SCALE, VALUE_SCALE, timed)


QUERIES = training_data(7, seed=1).points


class ResidualContract:
    """Tests of the residual model that the fixture `model` gives."""

    @pytest.fixture(params=[False, True], ids=["untimed", "timed"])
    def data(self, request: pytest.FixtureRequest) -> TrainingData:
        return training_data(timed=request.param)

    @pytest.fixture
    def regression(self, model: ResidualModel, data: TrainingData) -> Regression:
        return model.fit(data)

    def test_it_has_a_name_and_a_description(self, model: ResidualModel, regression: Regression) -> None:
        assert model.name.isidentifier()
        assert model.description
        names = [parameter.name for parameter in regression.parameters()]
        assert len(names) == len(set(names))
        for parameter in regression.parameters():
            assert np.shape(parameter.value) in ((), (INPUTS,))
            assert np.isfinite(parameter.value).all()

    def test_shapes_follow_the_points(self, regression: Regression) -> None:
        assert regression.inputs == INPUTS
        assert regression.points.shape == (len(regression.values), INPUTS)
        for leading in ((), (3,), (2, 0), (2, 3)):
            point = np.broadcast_to(CENTRE, (*leading, INPUTS))
            assert np.shape(regression.mean(point)) == leading
            assert np.shape(regression.std(point)) == leading
            assert regression.mean_gradient(point).shape == (*leading, INPUTS)
            assert regression.std_gradient(point).shape == (*leading, INPUTS)

    def test_gradients_are_derivatives(self, regression: Regression) -> None:
        pairs: list[Any] = [(regression.mean, regression.mean_gradient), (regression.std, regression.std_gradient)]
        for function, gradient in pairs:
            for column, step in enumerate(np.diag(1e-5 * SCALE)):
                difference = (function(QUERIES + step) - function(QUERIES - step)) / 2e-5
                found = gradient(QUERIES)[..., column] * SCALE[column]
                np.testing.assert_allclose(found, difference, rtol=1e-5, atol=1e-8 * VALUE_SCALE)

    def test_a_point_that_is_not_finite_gives_nan(self, regression: Regression) -> None:
        points = np.tile(CENTRE, (INPUTS + 1, 1))
        points[np.arange(INPUTS), np.arange(INPUTS)] = np.nan
        for function in (regression.mean, regression.std, regression.mean_gradient, regression.std_gradient):
            found = function(points)
            assert np.isnan(found[:-1]).reshape(INPUTS, -1).any(axis=1).all()
            assert np.isfinite(found[-1]).all()

    def test_noise_adds_to_the_standard_deviation(self, regression: Regression) -> None:
        std, (mean, noisy) = regression.std(QUERIES), regression.predict(QUERIES)
        assert regression.noise_std > 0
        assert (std >= 0).all()
        np.testing.assert_array_equal(mean, regression.mean(QUERIES))
        np.testing.assert_allclose(noisy, np.hypot(std, regression.noise_std), rtol=1e-12)

    def test_it_is_restored_from_json_bit_for_bit(self, model: ResidualModel, regression: Regression) -> None:
        saved = json.loads(json.dumps(regression.to_dict(), allow_nan=False))
        loaded = model.from_dict(saved)
        assert loaded.to_dict() == saved
        for name in ("mean", "std", "mean_gradient", "std_gradient"):
            np.testing.assert_array_equal(getattr(loaded, name)(QUERIES), getattr(regression, name)(QUERIES))

    def test_appending_is_conditioning_on_all_data(self, model: ResidualModel, regression: Regression) -> None:
        """`from_dict` computes the model from the data that the grown one holds, at the same hyper-parameters."""
        grown, more, before = regression, training_data(5, seed=2), regression.mean(QUERIES)
        points = more.points.copy()
        points[:, -1] = 1.6 + 0.05 * np.arange(5)  # later than all others, should it be a time
        for point, value in zip(points, more.values, strict=True):
            grown = grown.append(point, float(value))
        again = model.from_dict(grown.to_dict())
        for name in ("mean", "std", "mean_gradient"):
            found, wanted = getattr(grown, name)(QUERIES), getattr(again, name)(QUERIES)
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * VALUE_SCALE)
        np.testing.assert_array_equal(regression.mean(QUERIES), before)
        if len(regression.values):
            assert len(grown.values) == len(regression.values) + 5
            assert not np.allclose(grown.mean(QUERIES), before, rtol=1e-6)

    def test_left_out_is_a_prediction_from_the_others(self, model: ResidualModel, regression: Regression) -> None:
        """The data are taken out of what `to_dict` gives, so that the hyper-parameters stay."""
        blocks = [slice(0, 12), slice(12, 13), slice(13, SIZE)]
        found, saved = regression.left_out(blocks), regression.to_dict()
        assert found.mean.shape == found.std.shape == (SIZE,)
        if not len(regression.values):
            return
        for block in blocks[:2]:  # without the last one the time would end earlier
            others = {key: np.delete(saved[key], block, axis=0).tolist() for key in ("points", "values")}
            mean, std = model.from_dict({**saved, **others}).predict(regression.points[block])
            np.testing.assert_allclose(found.mean[block], mean, rtol=1e-6, atol=1e-9 * VALUE_SCALE)
            np.testing.assert_allclose(found.std[block], std, rtol=1e-6)

    def test_a_single_value_is_enough(self, model: ResidualModel) -> None:
        regression = model.fit(training_data(1))
        mean, std = regression.predict(QUERIES)
        assert np.isfinite(mean).all()
        assert (std > 0).all()

    @pytest.mark.parametrize("wrong", ["missing", None, "3", {}])
    def test_a_wrong_entry_is_named(self, model: ResidualModel, regression: Regression, wrong: object) -> None:
        saved = regression.to_dict()
        for key in saved.keys() - (OPTIONAL_KEYS if wrong == "missing" else set()):
            others = {name: entry for name, entry in saved.items() if name != key}
            with pytest.raises(ValueError, match=f"^{key} "):
                model.from_dict(others if wrong == "missing" else {**others, key: wrong})
