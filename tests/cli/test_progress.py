"""Long work says where it is: on a terminal in a bar, in a file as a line every few seconds."""

import ast
import io
import re
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

import glissando.cli
from glissando._kernels import jit
from glissando.cli import progress
from glissando.cli.commands import COMMANDS
from glissando.cli.progress import Descent, Work, working

CLI = Path(glissando.cli.__file__).parent
SHORT = {"completion", "doctor", "exporting", "importing", "report", "rerun", "live", "robot"}
"""Commands that compute next to nothing, or whose work shows itself: live, and what rerun runs."""


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(progress, "EVERY", 0.05)


def test_a_pipe_gets_a_line_again_and_again_with_share_and_time_left(quick, capsys):
    with working("estimating arm") as work:
        for done in range(1, 5):
            work.update(done, 10, f"iteration {done}")
            time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 4
    pattern = r"glissando: estimating arm: iteration (\d), \d0 % done, \d+ s(, about \d+ s left)?"
    numbers = [int(re.fullmatch(pattern, line)[1]) for line in lines]
    assert numbers == sorted(numbers)
    assert numbers[-1] == 4


def test_work_that_says_nothing_is_seen_to_go_on(quick, capsys):
    with working("thinking"):
        time.sleep(0.2)
    assert capsys.readouterr().err.splitlines()[0] == "glissando: thinking: 0 s"


def test_short_work_and_failed_work_leave_no_line_and_no_thread(capsys):
    with working("nothing"):
        pass
    with pytest.raises(KeyError), working("something"):
        raise KeyError
    assert capsys.readouterr().err == ""


def test_the_time_left_is_that_of_the_part_under_way():
    work = Work("first")
    work._began -= 90.0
    work.update(9, 10)
    assert work.line() == "first: 90 % done, 90 s, about 10 s left"
    work._began -= 4.0
    assert work.line() == "first: 90 % done, 94 s, about 6 s left"
    work._began -= 7.0  # it takes longer than the way so far made of it
    assert work.line() == "first: 90 % done, 101 s"
    work._began += 7.0
    work.begin("first")
    assert work.share == 0.9
    work.begin("second")
    assert work.line() == "second: 0 s"


@pytest.mark.slow
def test_a_terminal_gets_a_bar_that_is_removed(monkeypatch):
    screen = io.StringIO()
    terminal = Console(file=screen, force_terminal=True, width=100)
    monkeypatch.setattr(progress, "Console", lambda **_: terminal)
    with working("estimating [arm]") as work:
        work.update(1, 4, "iteration 3")
        time.sleep(0.4)
        work.begin("writing")
        time.sleep(0.3)
    text = screen.getvalue()
    assert "estimating [arm]: iteration 3" in text
    assert "25%" in text
    assert "writing" in text
    assert text.endswith("\x1b[2K")  # the line is erased


@pytest.mark.parametrize("module", sorted({m for m, _ in COMMANDS.values()} - SHORT))
def test_every_command_that_computes_shows_its_work(module):
    tree = ast.parse((CLI / f"{module}.py").read_text())
    called = {
        n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and hasattr(n.func, "id")
    }
    assert called & {"working", "estimate_watched", "posterior_shown"}


def test_compiling_says_how_far_it_is(tmp_path, monkeypatch, capsys):
    names = [SimpleNamespace(__name__=str(number)) for number in range(25)]
    kernels = [SimpleNamespace(file=f"steps.{f.__name__}", work=lambda: 3) for f in names]
    monkeypatch.setattr(jit, "_NOTICE", 0.02)
    monkeypatch.setattr(jit, "_AGAIN", 0.02)
    over = threading.Event()
    said = threading.Thread(target=jit._say, args=(kernels, tmp_path, over))
    said.start()
    for number in range(20):
        (tmp_path / f"steps.{number}-21.py311.nbc").touch()
        time.sleep(0.02)
    over.set()
    said.join()
    first, *lines = capsys.readouterr().err.splitlines()
    assert first.startswith(f"glissando: compiling its inner loops, once, into {tmp_path}")
    shares = [int(re.search(r"(\d+) % done, about \d+ s left", line)[1]) for line in lines]
    assert len(shares) >= 3
    assert shares == sorted(shares)
    assert 50 < shares[-1] < 100


def test_a_descent_is_never_done_before_what_follows_it_and_begins_again_elsewhere():
    work = Work("estimating arm")
    descent = Descent(work, 0.3)
    shares = []
    for iteration, length in ((1, 3e4), (2, 300.0), (3, 0.2), (1, 2e4), (2, 20.0)):
        descent(iteration, 5.0, length)
        shares.append(work.share)
    assert shares[0] == shares[3] == 0.0
    assert 0.3 < shares[1] < 0.7
    assert 0.5 < shares[4] < 0.8
    assert shares[2] is None
    descent(3, 5.0, 0.1)
    assert "judging readings" in work.line()
    assert "%" not in work.line()
