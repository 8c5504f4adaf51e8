"""A signal ends a command once, and no second one stops how it ends."""

import os
import signal
import time

import pytest

from glissando.cli import main as command_line
from glissando.cli.main import _stopped_by_signals, main


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_interrupts_and_the_next_ones_wait_until_all_is_put_away(name, capfd):
    number, put_away = getattr(signal, name), []
    before = signal.getsignal(number)

    def work():
        try:
            os.kill(os.getpid(), number)
            time.sleep(5.0)
        finally:
            for other in (number, signal.SIGINT, signal.SIGTERM):
                os.kill(os.getpid(), other)
            put_away.append(True)

    with _stopped_by_signals(), pytest.raises(KeyboardInterrupt):
        work()
    assert put_away
    assert capfd.readouterr().err.count("everything is being put away") == 3
    assert signal.getsignal(number) is before


def test_a_signal_that_comes_in_a_destructor_is_not_lost(capfd):
    class Doomed:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGTERM)
            sum(range(1000))

    def work():
        Doomed()
        time.sleep(5.0)

    begun = time.monotonic()
    with _stopped_by_signals(), pytest.raises(KeyboardInterrupt):
        work()
    assert time.monotonic() - begun < 4.0
    assert "Traceback" not in capfd.readouterr().err


def test_a_hang_up_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with _stopped_by_signals():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_too_little_memory_is_a_sentence(monkeypatch, capsys):
    def greedy(*_):
        raise MemoryError

    monkeypatch.setattr(command_line, "_old_names_shown", greedy)
    assert main(["doctor"]) == 2
    assert "more memory than there is" in capsys.readouterr().err
