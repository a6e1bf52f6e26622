"""The ensemble of neural networks: the contract of residuals, and its networks against scikit-learn's predictions."""

import numpy as np
import pytest

from benchmarks.learning.methods import ensemble as module
from benchmarks.learning.methods.ensemble import DECAY, ENSEMBLE, HIDDEN_UNITS, MOST_ITERATIONS, Ensemble
from stepgap.base.blas import one_blas_thread
from stepgap.learning.regression import ResidualModel
from tests.learning.residual_contract import QUERIES, ResidualContract, training_data

sklearn = pytest.importorskip("sklearn.neural_network")


class TestContract(ResidualContract):
    @pytest.fixture(autouse=True)
    def quickly_trained(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "MOST_ITERATIONS", 5)

    @pytest.fixture
    def model(self) -> ResidualModel:
        return ENSEMBLE


@pytest.mark.filterwarnings("ignore:lbfgs failed to converge")
def test_a_network_is_that_of_scikit_learn() -> None:
    data = training_data()
    found = Ensemble(data)._networks[1]
    sample = np.random.default_rng(1).integers(0, len(data.values), len(data.values))
    values = (data.values - data.values.mean()) / data.values.std()
    options = {"activation": "tanh", "solver": "lbfgs", "alpha": DECAY, "max_iter": MOST_ITERATIONS}
    peer = sklearn.MLPRegressor(hidden_layer_sizes=HIDDEN_UNITS, random_state=1, **options)
    with one_blas_thread():
        peer.fit(data.scaled(data.points)[sample], values[sample])
    inputs = data.scaled(QUERIES)
    np.testing.assert_allclose(found.value_and_gradient(inputs)[0], peer.predict(inputs), rtol=1e-9)
    assert 0 < found.unseen.sum() < len(values)


def test_it_learns_the_function_and_is_less_certain_away_from_the_data() -> None:
    data = training_data(size=100)
    ensemble, x = Ensemble(data), (QUERIES - data.centre) / data.scale
    shape = 0.2 - 0.3 * x[:, 0] + 0.2 * x[:, 1] * x[:, 2] + 0.1 * np.sin(2 * x[:, 2])
    error = ensemble.mean(QUERIES) - data.value_scale * shape
    assert np.sqrt(np.mean(error**2)) < 0.4 * data.value_scale * np.std(shape)
    assert 0.5 < ensemble.noise_std / (0.05 * data.value_scale) < 2.5
    outside = data.centre + 5 * (QUERIES - data.centre)
    assert ensemble.std(outside).mean() > 3 * ensemble.std(QUERIES).mean()
