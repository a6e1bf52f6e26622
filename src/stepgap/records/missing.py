"""A value that stands for something that a record does not contain."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Missing:
    """Marks something that a record does not contain, with the reason.

    Attributes:
        reason: A clause in lower case without a full stop, for use within a sentence.
    """

    reason: str
