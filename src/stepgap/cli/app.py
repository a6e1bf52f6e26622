"""The command line; verbs in files of their own are read when they are called.

Exit codes: 0 done; 2 bad input, with one line that says what would be right; 130 Ctrl-C; 1 any other failure.
"""

import re
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from inspect import signature
from typing import Annotated, Any

import cyclopts
from cyclopts import App, Parameter

from stepgap.base.output_files import words_of
from stepgap.base.settings_file import InputError

Overrides = Annotated[list[tuple[str, str]] | None, Parameter(parse=False)]
"""Settings given as `--table.key value`."""

Program = Annotated[list[str] | None, Parameter(parse=False)]
"""A command line given after `--`."""

OVERRIDE = re.compile(r"--([a-z_][a-z0-9_-]*\.[a-z0-9_.-]+)(?:=(.*))?", re.DOTALL)

STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""

DEBUG_HELP = "--debug shows where an error arose."
"""All that the help of a verb without settings ends with."""

app = App(
    name="stepgap",
    help="Close the sim-to-real gap of a legged robot one step at a time.",
    help_epilogue="Any setting of an experiment can be given as --TABLE.KEY VALUE, such as --gains.stiffness 2400. "
    f"Tables: robot, gains, command, learning, gap; the experiment.toml of any run lists every key. {DEBUG_HELP}",
    help_format="plaintext",
    default_parameter=Parameter(negative=(), show_default=False),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command and exits with its code."""
    arguments, program = split_program(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    try:
        tokens, overrides = split_overrides([argument for argument in arguments if argument != "--debug"])
        command, bound, ignored = app.parse_args(tokens, exit_on_error=False, print_error=False)
        if "overrides" in ignored:
            bound.arguments["overrides"] = overrides
        elif overrides:
            raise InputError(f"--{overrides[0][0]}: this verb takes no settings")
        if "program" in ignored:
            bound.arguments["program"] = program
        elif program:
            raise InputError(f"-- {program[0]}: this verb runs no other command")
        command(*bound.args, **bound.kwargs)
    except KeyboardInterrupt as interrupt:
        say(f"stopped{interrupt}")
        sys.exit(STOPPED)
    except Exception as error:
        if debug:
            raise
        bad_input = _is_bad_input(error)
        foreseen = bad_input or _is_about_a_file(error) or type(error).__module__.startswith("stepgap.")
        say(f"{_words(error)}{_hint(error)}" if foreseen else f"{type(error).__name__}: {error}")
        sys.exit(2 if bad_input else 1)


def say(message: str) -> None:
    """Prints one line on stderr."""
    print(f"stepgap: {' '.join(message.split())}", file=sys.stderr)


def _is_bad_input(error: Exception) -> bool:
    if isinstance(error, cyclopts.CycloptsError) or _is_forbidden(error):
        return True
    from stepgap.records.steps_csv import RecordError

    return isinstance(error, InputError | RecordError)


def _is_forbidden(error: Exception) -> bool:
    """Whether the user named a file or folder that is another's to read or write."""
    return isinstance(error, PermissionError) and error.filename is not None


def _is_about_a_file(error: Exception) -> bool:
    """Whether the system says something of a file or folder, such as that its disk is full."""
    return isinstance(error, OSError) and error.filename is not None


def _words(error: Exception) -> str:
    """What a foreseen error says."""
    if isinstance(error, cyclopts.UnusedCliTokensError) and error.unused_tokens:
        return f"{' '.join(error.unused_tokens)}: more than this verb takes; --help shows what it does"
    return words_of(error)


def _hint(error: Exception) -> str:
    """What an option that is none may have been meant for: a setting, where the verb takes settings."""
    if not isinstance(error, cyclopts.UnknownOptionError) or "Did you mean" in str(error) or not error.target:
        return ""
    if "overrides" not in signature(error.target).parameters:
        return ""
    return " If it is a setting, name its table, too, as in --robot.body_mass 1.6."


def split_program(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Parts a command line given after `--` from the arguments before it."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    return list(arguments[:end]), list(arguments[end + 1 :])


def split_overrides(arguments: Sequence[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Parts `--table.key value` and `--table.key=value` from the other arguments.

    Raises:
        InputError: A setting has no value.
    """
    rest, overrides, left = [], [], list(arguments)
    while left:
        argument = left.pop(0)
        match = OVERRIDE.fullmatch(argument)
        if not match:
            rest.append(argument)
        elif match[2] is not None:
            overrides.append((match[1], match[2]))
        elif left and not left[0].startswith("--"):
            overrides.append((match[1], left.pop(0)))
        else:
            raise InputError(f"{argument}: give a value")
    return rest, overrides


def says_if_it_compiles(verb: Callable[..., None]) -> Callable[..., None]:
    """Has a verb that hops say on stderr, unless --quiet, why it takes longer the first time."""

    @wraps(verb)
    def saying(*arguments: Any, **options: Any) -> None:
        from stepgap.base.compiling import telling_of_compilation

        def tell() -> None:
            if not options.get("quiet"):
                say("compiling for this machine; takes about half a minute, once")

        with telling_of_compilation(tell):
            verb(*arguments, **options)

    return saying


HELP = {
    "cli.run:run": "Run the whole sim-to-real experiment: deploy, learn, redeploy, report. Without more, on the twin.",
    "cli.map:gait": "Find the limit cycle of the nominal map at a speed and height, and what one step can reach from "
    "it.",
    "cli.map:map_": "Evaluate the nominal map: the next apex and its derivatives, many rows of a file, or a table of "
    "commands.",
    "cli.fit:fit": "Fit every residual to recorded steps, score it on steps held out, and say what there is to learn.",
    "cli.bench:bench": "Measure how fast, how exact and how quick to learn StepGap is here.",
    "cli.rig:rig": "Bring up a robot, or try without one.",
}
"""Verbs that take settings; read when they are called, so that --help is quick, and since they import this module."""

HELP_WITHOUT_SETTINGS = {
    "cli.run:report": "Make the report of a run anew; of several runs, a page that compares them.",
    "cli.view:view": "Show a run in the browser, also one that goes on.",
    "cli.data:export": "Write a run for other programs: MATLAB, tables, players of tick logs, viewers of MuJoCo "
    "models.",
    "cli.data:recover": "Save what is whole of a steps.csv or a log of ticks that was cut off or damaged.",
    "cli.data:doctor": "Say what this machine has: versions, cores, graphics, rights for real time, the cache, extras.",
}
"""Those that take none."""

for place, words in HELP.items():
    app.command(f"stepgap.{place}", name=place.partition(":")[2].rstrip("_"), help=words)
for place, words in HELP_WITHOUT_SETTINGS.items():
    app.command(f"stepgap.{place}", name=place.partition(":")[2].rstrip("_"), help=words, help_epilogue=DEBUG_HELP)
