"""Bars and colours only where a person looks at a terminal."""

import io

import pytest

from stepgap.cli.screen import screen


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("JPY_PARENT_PID", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")


@pytest.mark.parametrize(
    ("stream", "variable", "value", "watched"),
    [
        (Terminal(), "TERM", "xterm", True),
        (Terminal(), "TERM", "dumb", False),
        (Terminal(), "JPY_PARENT_PID", "12", False),
        (io.StringIO(), "FORCE_COLOR", "1", False),
    ],
)
def test_bars_and_colours_are_for_people(
    stream: io.StringIO, variable: str, value: str, watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv(variable, value)
    console = screen(stream)
    console.print("[red]text")
    assert console.is_terminal == watched
    assert ("\x1b[" in stream.getvalue()) == watched
