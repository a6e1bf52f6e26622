"""The verbs of the command line, found by their entry points: those of this package first, then those of others."""

from collections.abc import Sequence

from cyclopts import App, Group, Parameter

from stepgap.base.errors import InputError
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.cli.help_format import HelpFormat
from stepgap.cli.options import SETTINGS_HELP, add_verb
from stepgap.cli.terminal import warn

VERBS = "stepgap.verbs"
"""Entry points of this group are functions with annotated parameters, or a Cyclopts `App` with verbs of its own."""

GROUPS = {
    "Start": ("run", "new", "settings", "doctor"),
    "Run and look": ("report", "view", "compare", "explain", "sweep", "export", "recover"),
    "Robots": ("check", "gait", "prior"),
    "Logs": ("cure", "steps", "fit"),
    "Hardware": ("rig",),
}
"""Headings of the help with their verbs, in this order."""

_OTHERS = "Other packages"
_OPTIONS = "Options"
"""Headings below those of the verbs of this package."""

_HEADINGS = {name: Group(name, sort_key=number) for number, name in enumerate([*GROUPS, _OTHERS, _OPTIONS])}

HIDDEN = "completion"  # A verb for the start of a shell, which no list shows


_NO_MODEL = "no model is applied to a log now; type stepgap fit OLD_LOG --test LOG"

GONE = {
    "bench": "it measures the project itself; in a clone of StepGap type ./go python -m benchmarks.speed, or "
    "./go python -m benchmarks.learning for the learning benchmark",
    "export --fmi": "an FMU is of FMI 3.0; leave this option out, or compile what --to c writes",
    "export --real": "the numbers of C are double; leave this option out",
    "fit --load": _NO_MODEL,
    "fit --predictions": _NO_MODEL,
    "gait knobs": "docs/evidence.md has which step command is the least coupled; type stepgap gait for the gait of the "
    "command",
    "map": "type stepgap gait --command NAME=VALUE for one step, --csv FILE for many, --table FILE for many commands",
    "sweep --merge": "copy the folders of all parts into one, and continue that with --out FOLDER --resume",
}
"""Verbs, second words and options of earlier versions, with what replaces them."""


def check_not_gone(tokens: Sequence[str]) -> None:
    """Refuses what earlier versions had.

    Raises:
        InputError: A command line has a verb or an option that is gone; the message says what replaces it.
    """
    verb, *others = tokens or [""]
    words = [other.partition("=")[0] for place, other in enumerate(others) if not place or other.startswith("--")]
    for asked in (verb, *(f"{verb} {word}" for word in words)):
        if asked in GONE and asked not in plugin_names(VERBS):
            raise InputError(f"{asked}: gone: {GONE[asked]}")


def command_line(only: str = "") -> App:
    """The command line with its verbs; a verb of another package that cannot be loaded is left out with a warning.

    Args:
        only: Name of a verb; if there is such a verb, no other one is loaded, which is faster.

    Raises:
        InputError: The only verb cannot be loaded.
    """
    app = App(
        name="stepgap",
        help="Close the sim-to-real gap of a legged robot one step at a time.",
        help_epilogue=SETTINGS_HELP,
        help_format="plaintext",
        help_formatter=HelpFormat(),
        default_parameter=Parameter(negative=()),
    )
    names = verb_names()
    for name in [only] if only in names else names:
        try:
            add_verb(app, name, load_plugin(VERBS, "verb", name, callable, "a function or a Cyclopts App"))
        except Exception as error:  # whatever the module of another package raises
            line = str(error) if isinstance(error, InputError) else f"verb '{name}': {type(error).__name__}: {error}"
            if name == only:
                raise InputError(line) from error
            warn(line)
        else:
            _place(app[name], name, names.index(name))
    for flag in (*app.help_flags, *app.version_flags):
        app[flag].group = _HEADINGS[_OPTIONS]
    return app


def _place(verb: App, name: str, number: int) -> None:
    """Puts a verb under its heading of the help; `number` is its place among all verbs."""
    headings = [heading for heading, names in GROUPS.items() if name in names]
    verb.group = _HEADINGS[headings[0] if headings else _OTHERS]
    verb.sort_key = number
    verb.show = name != HIDDEN


def verb_names() -> list[str]:
    """Names of all verbs, in the order of the help."""
    installed = plugin_names(VERBS)
    ours = [name for names in GROUPS.values() for name in names]
    return [*(name for name in ours if name in installed), *(name for name in installed if name not in ours)]
