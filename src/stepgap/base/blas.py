"""One thread for linear algebra: matrices here are small, so that more threads only wait for each other."""

from contextlib import AbstractContextManager
from functools import cache

import scipy.linalg  # noqa: F401 (loads the BLAS of scipy, which the controller must know)
from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """Limits the linear algebra of numpy and scipy to one thread within the block.

    Results are then the same bytes on machines with any number of cores.
    """
    return _controller().limit(limits=1, user_api="blas")


@cache
def _controller() -> ThreadpoolController:
    """Controller of all loaded BLAS; it is kept, since creating it takes 15 ms, longer than a small fit."""
    return ThreadpoolController()
