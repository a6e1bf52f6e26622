"""The verbs of the command line as functions: `verbs.check("quadruped")` is the command `stepgap check quadruped`.

    from stepgap import verbs

    verbs.gait(state="speed=0.2,height=0.58", gap={"payload": 0.1})
    verbs.export("runs/first", to="python")

What follows the verb is an argument, an option a keyword with underscores, and a table of settings a mapping. A
function prints and writes what its command does; `dir(verbs)` has the names, and their docstrings are the help.
"""

from collections.abc import Callable, Iterator, Mapping
from os import PathLike, fspath
from typing import Any

from cyclopts import CycloptsError

from stepgap.base.errors import InputError, message_of
from stepgap.base.plugins import load_plugin
from stepgap.cli.app import run_words
from stepgap.cli.python_door import setting_entries
from stepgap.cli.verbs import VERBS, command_line, verb_names


def __getattr__(name: str) -> Callable[..., bool]:
    """The function of a verb."""
    if name.startswith("__") or name not in verb_names():
        raise AttributeError(f"stepgap.verbs has no {name!r}; its verbs are {', '.join(verb_names())}")
    return _function(name)


def __dir__() -> list[str]:
    """Names of the verbs."""
    return verb_names()


def _function(name: str) -> Callable[..., bool]:
    def verb(*arguments: str | PathLike[str], **options: Any) -> bool:
        tokens = [name, *(fspath(argument) for argument in arguments), *_tokens(options)]
        try:
            run_words(tokens, [], command_line)
        except SystemExit as end:
            return not end.code
        except CycloptsError as error:
            raise InputError(message_of(error)) from None
        return True

    verb.__name__ = verb.__qualname__ = name
    verb.__doc__ = f"{load_plugin(VERBS, 'verb', name, callable, 'a function').__doc__}\n{_RESULT}"
    return verb


_RESULT = """
    Returns:
        Whether nothing was found to be wrong: false where the command would end with exit code 1.

    Raises:
        InputError: An argument, an option or a file is wrong.
"""


def _tokens(options: Mapping[str, Any]) -> Iterator[str]:
    """Options as words of a command line: true is a flag, false and None are left out, a list repeats its option."""
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, Mapping):
            yield from (f"--{key}={text}" for key, text in setting_entries({name: value}))
        elif value is True:
            yield option
        elif isinstance(value, list | tuple):
            yield from (f"{option}={part}" for part in value)
        elif value is not None and value is not False:
            yield f"{option}={value}"
