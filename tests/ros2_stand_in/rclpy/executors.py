"""Errors of executors."""


class ExternalShutdownException(Exception):
    """The node is told to end."""
