"""Format of the help: descriptions are wrapped to the width of the terminal, not where their docstrings are."""

from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:  # slow imports are made where they are used
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions


NARROWEST = 40
"""Smallest width of the help, in characters; in two, as COLUMNS=0 demands, its tables would never end."""


@final
class HelpFormat:
    """Cyclopts' default format, in which each description of an option is one paragraph."""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Prints a panel; line breaks of docstrings become spaces.

        Args:
            console: Where to print it.
            options: Width and other properties of the console.
            panel: Names and descriptions.
        """
        from cyclopts.help import DefaultFormatter
        from rich.text import Text

        for entry in panel.entries:
            text = getattr(entry.description, "primary_renderable", None)
            if isinstance(text, Text):
                text.plain = " ".join(text.plain.split())
        DefaultFormatter()(console, options, panel)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: Any) -> None:
        """Prints the line of usage, which comes first, and from here on widens a console that is too narrow."""
        from cyclopts.help import DefaultFormatter

        console.width = max(console.width, NARROWEST)
        DefaultFormatter().render_usage(console, options.update(width=console.width), usage)

    def render_description(self, console: "Console", options: "ConsoleOptions", description: Any) -> None:
        """Prints the purpose of the command; arguments as above."""
        from cyclopts.help import DefaultFormatter

        DefaultFormatter().render_description(console, options, description)
