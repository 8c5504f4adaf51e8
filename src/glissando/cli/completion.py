"""`glissando --print-completion SHELL`: commands and options, as the parser knows them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from glissando.io.robot_file import shipped_robots

_BASH = """\
_glissando() {
  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} words= command= i
  for ((i = 1; i < COMP_CWORD; i++)); do
    case ${COMP_WORDS[i]} in -*) ;; *) command=${COMP_WORDS[i]}; break ;; esac
  done
  case $command:$before in
@VALUES@
  *) case $command in
@OPTIONS@
    esac ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}
complete -o default -F _glissando glissando
"""
_ZSH = """\
(( $+functions[compdef] )) || { autoload -U compinit && compinit; }
autoload -U +X bashcompinit && bashcompinit
"""


class PrintCompletion(argparse.Action):
    """An option that prints a completion script of its parser and ends the program."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Print it; `values` is the shell."""
        print(completion(parser, str(values)), end="")
        parser.exit()


def completion(parser: argparse.ArgumentParser, shell: str) -> str:
    """A script that completes commands, options and robots; anything else is a file's name.

    bash reads it as it is; zsh through its emulation of bash's completion.
    """
    (commands,) = (a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    values = [f'  *:--robot) words="{" ".join(shipped_robots())}" ;;']
    options = [f'    "") words="{" ".join([*commands, *_flags(parser)])}" ;;']
    for name, command in commands.items():
        options.append(f'    {name}) words="{" ".join(_flags(command))}" ;;')
        for action in command._actions:
            if action.choices and action.option_strings:
                flags = "|".join(f"{name}:{flag}" for flag in action.option_strings)
                values.append(f'  {flags}) words="{" ".join(map(str, action.choices))}" ;;')
    script = _BASH.replace("@VALUES@", "\n".join(values)).replace("@OPTIONS@", "\n".join(options))
    return _ZSH + script if shell == "zsh" else script


def _flags(parser: argparse.ArgumentParser) -> list[str]:
    return [flag for action in parser._actions for flag in action.option_strings]
