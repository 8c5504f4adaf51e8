"""The command line in this process."""

from glissando.cli.main import main


def run(*arguments):
    """Exit status of `glissando` with these words, numbers and paths."""
    return main([str(a) for a in arguments])
