"""Options that have no effect beside others are refused, not ignored."""

from __future__ import annotations

import argparse

from glissando.errors import GlissandoError

_FLAGS = {"posterior": "from"}


def refuse_unused(options: argparse.Namespace, to: str, *silent: str) -> None:
    """Make sure that options which have no effect are left at their defaults.

    Args:
        options: The options of the command.
        to: What they say nothing to, such as another option.
        silent: Names of those options.

    Raises:
        GlissandoError: One is given.
    """
    for name in silent:
        if getattr(options, name) != options.default_of(name):
            flag = _FLAGS.get(name, name).replace("_", "-")
            raise GlissandoError(f"--{flag} says nothing to {to}; leave it out.")
