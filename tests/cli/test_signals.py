"""A signal ends a command once, and no second one stops how it ends."""

import os
import signal
import time
from contextlib import nullcontext

import pytest

from glissando.cli import main as command_line
from glissando.cli.interrupts import until_interrupted
from glissando.cli.main import _stopped_by_signals, main
from glissando.errors import needing


@pytest.fixture(autouse=True)
def _not_ignored():
    """Signals as at a terminal, also where what started the tests ignores them (nohup, `&`)."""
    before = {each: signal.signal(each, signal.SIG_DFL) for each in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


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

    monkeypatch.setattr(command_line, "_own_warnings_shown", greedy)
    assert main(["doctor"]) == 2
    said = capsys.readouterr().err
    assert "more memory than there is" in said
    assert "--" not in said  # not every command has the same options


@pytest.mark.parametrize("optional", [True, False])
def test_an_interrupt_while_a_compiled_module_is_imported_is_an_interrupt(
    optional, monkeypatch, capsys
):
    def imports(*_):
        with needing("Figures need matplotlib", "plot") if optional else nullcontext():
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as cause:  # as pybind11 does
                raise ImportError("initialization failed") from cause

    monkeypatch.setattr(command_line, "_own_warnings_shown", imports)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "glissando: interrupted\n"


@pytest.mark.parametrize("interrupted", [True, False])
def test_no_signal_disturbs_the_end_of_a_program(interrupted, monkeypatch, capsys):
    def interrupt():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5.0)

    if interrupted:
        monkeypatch.setattr(command_line, "_own_warnings_shown", interrupt)
    monkeypatch.setattr("sys.argv", ["glissando", "doctor"])
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        assert main() == (130 if interrupted else 0)
        for number in before:
            os.kill(os.getpid(), number)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert capsys.readouterr().err == ("glissando: interrupted\n" if interrupted else "")


def test_a_signal_after_a_command_dealt_with_one_is_only_noted(capfd):
    with _stopped_by_signals():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5.0)
        except KeyboardInterrupt:
            pass
        os.kill(os.getpid(), signal.SIGINT)  # while a session is closed, say
        time.sleep(0.01)
    assert "everything is being put away" in capfd.readouterr().err


def test_an_interrupt_inside_a_kernel_ends_a_session_as_any_other():
    with until_interrupted():
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as cause:
            raise SystemError("returned a result with an exception set") from cause
    with pytest.raises(SystemError, match="another"), until_interrupted():
        raise SystemError("another")
