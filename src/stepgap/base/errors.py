"""The errors that StepGap raises on purpose: one root, so that a program can catch all of them.

An error that belongs to one module is defined there and derives from `StepGapError` or `InputError`.
"""


class StepGapError(Exception):
    """Root of all errors that StepGap foresees; the message is one line that says what to do."""


class InputError(StepGapError, ValueError):
    """The user gave something wrong; the message is one line that says what would be right."""


def message_of(error: Exception) -> str:
    """The message of an error; for an error of the operating system, the file and what is wrong with it."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)
