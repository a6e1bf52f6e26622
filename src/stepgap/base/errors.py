"""The error types of StepGap, which have one root, so that a program can catch all of them; and its warning.

An error that belongs to one module is defined there and derives from `StepGapError` or `InputError`.
"""


class StepGapError(Exception):
    """Root of all errors that StepGap raises deliberately; the message is one line with the remedy."""


class InputError(StepGapError, ValueError):
    """Invalid input of the user; the message is one line that states what is valid."""


class StepGapWarning(UserWarning):
    """What StepGap leaves out or doubts, for the user; the message is one line, and `stepgap` shows it as such."""


def message_of(error: Exception) -> str:
    """The message of an error; for an error of the operating system, the file and what is wrong with it."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)
