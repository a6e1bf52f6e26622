"""The verb `stepgap completion`."""

from collections.abc import Sequence
from inspect import signature
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cyclopts import App

_BASH = """
_stepgap_or_setting() {{
  _stepgap
  case "${{COMP_WORDS[1]}} ${{COMP_WORDS[COMP_CWORD]}}" in
    {patterns}) COMPREPLY+=( $(compgen -W "{settings}" -- "${{COMP_WORDS[COMP_CWORD]}}") ) ;;
  esac
}}
complete -F _stepgap_or_setting stepgap
"""

_ZSH = """
_stepgap_or_setting() {{
  case "$words[2] $PREFIX" in
    {patterns}) compadd -- {settings} ;;
  esac
  _cyclopts_stepgap
}}
compdef _stepgap_or_setting stepgap
"""

_WITH_SETTINGS = {"bash": _BASH, "zsh": _ZSH}  # What is added to the script of Cyclopts, by the shell


def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """Print a script with which a shell completes verbs, options and, except fish, settings; evaluate it at its start.

    Args:
        shell: Name of the shell. For bash, add `eval "$(stepgap completion bash)"` to ~/.bashrc.
    """
    from stepgap.cli.verbs import command_line

    app = command_line()
    script = app.generate_completion(prog_name="stepgap", shell=shell)
    patterns = "|".join(f'"{verb} --"*' for verb in _verbs_with_settings(app))
    addition = _WITH_SETTINGS.get(shell, "").format(patterns=patterns, settings=" ".join(_settings()))
    print(script + addition, end="")


def _verbs_with_settings(app: "App") -> Sequence[str]:
    """Names of the verbs that take settings of an experiment."""
    verbs = {name: app[name].default_command for name in app if not name.startswith("-")}
    return [name for name, verb in verbs.items() if verb and "overrides" in signature(verb).parameters]


def _settings() -> Sequence[str]:
    """Options of the settings of the default robot."""
    from stepgap.experiment.settings import read_experiment
    from stepgap.experiment.settings_text import described_settings

    names = [name for name, _, _ in described_settings(read_experiment(None))]
    return [f"--{name}" for name in names if "." in name]
