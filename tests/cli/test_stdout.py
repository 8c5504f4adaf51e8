"""Standard output that cannot be written is one sentence, or the status of a closed pipe."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_COMMANDS = ["--version", "simulate --help", "doctor --json", "--print-completion bash"]
_BUFFERED = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}


def _told(command, stdout):
    """Exit status and stderr of a command line."""
    words = [sys.executable, "-m", "glissando", *command.split()]
    done = subprocess.run(
        words, stdout=stdout, stderr=subprocess.PIPE, text=True, env=_BUFFERED, check=False
    )
    return done.returncode, done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("command", _COMMANDS)
def test_a_full_standard_output_is_one_sentence(command):
    with open("/dev/full", "w", encoding="utf-8") as full:
        status, said = _told(command, full)
    assert status == 2
    assert said.startswith("glissando: Standard output cannot be written")
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", _COMMANDS)
def test_a_closed_standard_output_ends_in_silence(command):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        assert _told(command, writing) == (141, "")
    finally:
        os.close(writing)
