"""Options for handlers of signals."""

from enum import Enum


class SignalHandlerOptions(Enum):
    """Which handlers there are."""

    NO = 0
    ALL = 3
