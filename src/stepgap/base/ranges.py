"""Range checks of settings and arguments, with one form of message."""

from typing import Any

LARGEST_INTEGER = 10**300  # Integers of this size or larger are not accepted as a number


def require(condition: object, name: str, value: Any, rule: str) -> None:
    """Raises ValueError `name = value, but it must RULE` unless the condition holds; a rule is like "be positive"."""
    if not condition:
        raise ValueError(f"{name} = {format_value(value)}, but it must {rule}")


def format_value(value: Any) -> str:
    """Formats a value as in TOML, for a message: one line, at most 60 characters of it."""
    if isinstance(value, int) and abs(value) >= LARGEST_INTEGER:
        return "a very large integer"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    if "\n" in text:  # of an array
        text = " ".join(text.split())
    return text if len(text) <= 60 else f"{text[:60]}…"
