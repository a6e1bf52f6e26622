"""Bars and colours only where a person looks at a terminal, and no text of others that commands it."""

import io
import warnings

import pytest
from cyclopts import App

from stepgap.cli.app import main
from stepgap.cli.screen import screen
from stepgap.cli.terminal import printable, warn


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


def test_a_name_from_a_file_is_shown_and_does_not_command_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Such as a key of a stranger's sweep.toml that would clear the screen, or turn the direction of writing."""
    warn("sweep.toml: \x1b[2J\x1b]0;title\x07 Höhe \u202e\udcff: unknown key;\n did you mean seed?")
    line = r"stepgap: sweep.toml: \x1b[2J\x1b]0;title\x07 Höhe \u202e\udcff: unknown key; did you mean seed?"
    assert capsys.readouterr().err == f"{line}\n"
    assert printable("speed 0.3 m/s² – 5 %") == "speed 0.3 m/s² – 5 %"


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_warning_of_another_library_does_not_command_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    messages = list[str]()
    monkeypatch.setattr(warnings, "showwarning", lambda message, *place: messages.append(str(message)))
    app = App()

    @app.default
    def verb() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("log\x1b[2J.csv has no rows", UserWarning, stacklevel=1)

    main([], lambda word: app)
    assert messages == [r"log\x1b[2J.csv has no rows"]
