"""Signals while processes start: children ignore Ctrl-C, and this process loses none."""

import os
import signal
import subprocess
import sys
import threading
from multiprocessing import get_context

import pytest

from glissando.experiments.runner import ignoring_interrupts

pytestmark = pytest.mark.skipif(
    not hasattr(signal, "pthread_sigmask"), reason="needs signals that can be blocked"
)
_INTERRUPTED = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('lives')"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_processes_start_comes_when_they_have_started(name):
    number, started = getattr(signal, name), []

    def stop(got, frame):
        raise KeyboardInterrupt

    def start():
        with ignoring_interrupts():
            os.kill(os.getpid(), number)
            started.append(True)

    before = signal.signal(number, stop)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    try:
        with pytest.raises(KeyboardInterrupt):
            start()
        assert started
        assert signal.getsignal(number) is stop
        assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == mask
    finally:
        signal.signal(number, before)


def _interrupt_itself():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("thread", [False, True])
def test_what_starts_meanwhile_ignores_an_interrupt(thread):
    said = []

    def start():
        words = [sys.executable, "-c", _INTERRUPTED]
        said.append(subprocess.run(words, capture_output=True, text=True, check=False).stdout)

    with ignoring_interrupts():
        if thread:
            starting = threading.Thread(target=start)
            starting.start()
            starting.join()
        else:
            start()
    assert said == ["lives\n"]


def test_the_first_process_of_a_program_ignores_an_interrupt():
    process = get_context("spawn").Process(target=_interrupt_itself)
    with ignoring_interrupts():
        process.start()
    process.join()
    assert process.exitcode == 0
