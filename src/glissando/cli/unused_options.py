"""Refusal of options that have no effect in combination with others."""

from __future__ import annotations

import argparse

from glissando.errors import GlissandoError

_FLAGS = {"posterior": "from"}


def refuse_unused(options: argparse.Namespace, to: str, *silent: str) -> None:
    """Require that options which have no effect have their default values.

    Args:
        options: Options of the command.
        to: Option or input on which they have no effect, for the message.
        silent: Names of the options without effect.

    Raises:
        GlissandoError: One of them is given.
    """
    for name in silent:
        if getattr(options, name) != options.default_of(name):
            flag = _FLAGS.get(name, name).replace("_", "-")
            raise GlissandoError(f"--{flag} has no effect on {to}; leave it out.")
