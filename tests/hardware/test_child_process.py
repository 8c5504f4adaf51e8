"""Processes beside the one that drives see no Ctrl-C, the first of them neither."""

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import multiprocessing, os, signal, time
from glissando.hardware.capture.child_process import blocked_signals

def work(pipe):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)
    pipe.send(sorted(int(n) for n in signal.pthread_sigmask(signal.SIG_BLOCK, set())))

if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=work, args=(theirs,))
    with blocked_signals():
        process.start()
    print(ours.recv())
    process.join()
    print(process.exitcode)
"""


@pytest.mark.slow
def test_the_first_process_sees_no_interrupt_either(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    run = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=60)
    assert run.stderr == ""
    assert run.stdout.split("\n")[:2] == [str([int(signal.SIGHUP), int(signal.SIGINT)]), "0"]
