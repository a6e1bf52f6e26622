"""Student's t distribution against SciPy's."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from stepgap.gauss.student import log_student

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("size", [1, 2, 5])
@pytest.mark.parametrize("freedom", [0.5, 2.0, 8.0, 300.0])
def test_it_is_the_density_of_scipy(size: int, freedom: float) -> None:
    for scale in (1e-6, 1.0, 1e4):
        variance = scale * RNG.uniform(0.1, 2.0, size)
        for error in (np.zeros(size), np.sqrt(scale) * RNG.normal(size=size), 1e3 * np.sqrt(scale) * np.ones(size)):
            expected = multivariate_t.logpdf(error, None, np.diag(variance), freedom)  # pyright: ignore[reportArgumentType]
            assert log_student(error, variance, freedom) == pytest.approx(float(expected), rel=1e-9, abs=1e-9)
