"""Range checks of settings and arguments, with one form of message."""

from typing import Any

LARGEST_INTEGER = 10**300
"""Integers from here on are not accepted as a number."""


def require(condition: object, name: str, value: Any, rule: str) -> None:
    """Raises ValueError `name = value, but it must RULE` unless the condition holds.

    Args:
        condition: Whether the value is right.
        name: Name of the setting or argument.
        value: The value, as the message shows it.
        rule: What holds for a right value, such as "be positive".

    Raises:
        ValueError: The condition does not hold.
    """
    if not condition:
        raise ValueError(f"{name} = {format_value(value)}, but it must {rule}")


def format_value(value: Any) -> str:
    """A value as TOML writes it, for a message; at most 60 characters of it."""
    if isinstance(value, int) and abs(value) >= LARGEST_INTEGER:
        return "a very large integer"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"
