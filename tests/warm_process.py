"""Processes that start within milliseconds: copies of one that has imported the package and loaded compiled functions.

A new interpreter computes for most of a second until it has done so, and tests start some hundred processes.
"""

from multiprocessing import get_context
from typing import Any

from stepgap.base import start_method


def start_processes_from_a_warm_server() -> None:
    """The package starts its processes so from now on, except for real-time processes."""
    forked: Any = get_context("forkserver")
    forked.set_forkserver_preload(["tests.warm_server"])
    start_method.CONTEXT = forked
