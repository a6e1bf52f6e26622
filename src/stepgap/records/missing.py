"""What stands for a thing that is not there."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Missing:
    """Stands for a thing that a record does not give, and says why.

    Attributes:
        reason: A clause that begins in lower case, without a full stop; whoever shows it builds the sentence.
    """

    reason: str
