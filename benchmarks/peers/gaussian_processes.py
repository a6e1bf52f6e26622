"""The libraries with which the Gaussian process is compared, with the same kernel: ARD Matérn-5/2, constant, noise."""

import warnings
from importlib.util import find_spec

import numpy as np

from benchmarks.speed.gaussian_process import GpPeers, Library

NOT_WRITTEN = {"GPy": "GPy", "GPyTorch": "gpytorch", "GPflow": "gpflow", "tinygp": "tinygp", "GPJax": "gpjax"}


def gp_peers(quick: bool) -> GpPeers:
    """Installed peers; with `quick`, only the fast ones."""
    return GpPeers(*libraries(quick))


def libraries(quick: bool) -> tuple[list[Library], dict[str, str]]:
    """Installed peers, and the reasons why the others are missing."""
    found, skipped = [], {}
    if find_spec("sklearn"):
        most = 200 if quick else 3000
        found.append(Library("scikit-learn", "maximum likelihood", _fit_sklearn, _predict_sklearn, most))
    else:
        skipped["scikit-learn"] = "not installed: ./go uv pip install scikit-learn"
    if not find_spec("openturns"):
        skipped["OpenTURNS"] = "not installed: ./go uv pip install openturns"
    elif quick:
        skipped["OpenTURNS"] = "left out by --quick"
    else:
        note = "maximum likelihood, TNC, noise known"
        found.append(Library("OpenTURNS", note, _fit_openturns, _predict_openturns, 200, starts=1))
    for name, module in NOT_WRITTEN.items():
        skipped[name] = "installed, but no fit is implemented for it" if find_spec(module) else "not installed"
    return found, skipped


def _fit_sklearn(points, values, starts):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    kernel = ConstantKernel(1.0, (1e-4, 1e4)) * Matern(np.ones(4), (1e-2, 1e3), nu=2.5) + WhiteKernel(0.04, (1e-8, 1e2))
    process = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=starts - 1, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # length scales at their bounds
        return process.fit(points, values)


def _predict_sklearn(process, queries):
    mean, std = process.predict(queries, return_std=True)
    noise = process.kernel_.k2.noise_level * process._y_train_std**2
    return mean, np.sqrt(np.maximum(std**2 - noise, 0))


def _fit_openturns(points, values, starts):
    import openturns as ot

    kernel = ot.MaternModel(np.ones(4), [float(np.std(values))], 2.5)
    kernel.setNuggetFactor((0.008 / float(np.std(values))) ** 2)
    fitter = ot.GaussianProcessFitter(points, values[:, None], kernel, ot.ConstantBasisFactory(4).build())
    fitter.run()
    regression = ot.GaussianProcessRegression(fitter.getResult())
    regression.run()
    kriging = regression.getResult()
    return kriging, ot.GaussianProcessConditionalCovariance(kriging)


def _predict_openturns(process, queries):
    kriging, covariance = process
    variance = np.ravel(covariance.getConditionalMarginalVariance(queries)) - 0.008**2
    return np.ravel(kriging.getMetaModel()(queries)), np.sqrt(np.maximum(variance, 0))
