"""Kernels are compiled once on a machine, whatever its home is like, and never without need."""

import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

import glissando._kernels
from glissando._kernels import jit
from glissando._kernels.jit import cache_folder
from live_recordings import MECHANICAL


@pytest.mark.slow
def test_numba_is_imported_when_the_first_kernel_is_called_and_not_before():
    code = (
        "import sys, numpy as np, glissando\n"
        "assert 'numba' not in sys.modules\n"
        "glissando.se3.exp(np.zeros(6))\n"
        "assert 'numba' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_a_process_that_only_reads_devices_never_imports_numba():
    code = (
        "import sys\n"
        "import glissando.hardware.capture.capture, glissando.hardware.simulated_devices\n"
        "assert 'numba' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


ONCE = "import numpy as np, glissando; print(glissando.se3.exp(np.zeros(6))[0, 0])"
SMALL = (
    "import numpy as np; from glissando._kernels import matern;"
    "print(matern.transition(1.0, np.zeros(1))[0, 0, 0])"
)  # of the modules that are compiled soonest


@pytest.mark.slow
@pytest.mark.parametrize("home", ["read-only", "missing"])
def test_a_home_that_cannot_be_written_to_does_not_matter(tmp_path, home):
    folder = tmp_path / "home"
    if home == "read-only":
        folder.write_text("a file where a folder is asked for")
    environment = {**os.environ, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}
    run = subprocess.run(
        [sys.executable, "-c", SMALL], env=environment, check=True, capture_output=True, text=True
    )
    assert run.stdout == "1.0\n"


@pytest.mark.slow
def test_a_full_disk_does_not_matter(tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
    environment = {**os.environ, "GLISSANDO_CACHE": str(tmp_path)}
    for code, saved in ((limit + SMALL, False), (SMALL, True)):
        run = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        )
        assert run.stdout == "1.0\n"
        (folder,) = tmp_path.glob("kernels-*")
        assert ("matern.transition" in jit._on_disk(folder)) == saved
        assert ("matern.transition" in (folder / "compiled").read_text()) == saved


def test_processes_that_compile_know_the_kernels_of_every_module():
    """One that they do not know is compiled by whoever calls it, alone and one after another."""
    code = (
        "import glissando._kernels.compile\n"
        "from glissando._kernels.jit import _KERNELS\n"
        "print(*{k.module for k in _KERNELS if k.signatures})\n"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    sources = Path(glissando._kernels.__file__).parent.glob("*.py")
    called = {s.stem for s in sources if re.search(r"^@jit\(\s*f?\"", s.read_text(), re.MULTILINE)}
    assert {"se3", "matern", "rod_flow"} <= called
    assert set(told.stdout.split()) == called


def test_what_an_upgrade_leaves_behind_is_never_met(tmp_path, monkeypatch):
    monkeypatch.setenv("GLISSANDO_CACHE", str(tmp_path))
    kept = jit._KEPT + 1  # others, and the newest
    folders = [cache_folder(str(version)) for version in range(kept + 1)]
    assert len(set(folders)) == kept + 1
    assert [folder.is_dir() for folder in folders] == [False] + kept * [True]
    cache_folder("1")
    cache_folder("new")
    assert [folder.is_dir() for folder in folders] == [False, True, False] + (kept - 2) * [True]
    assert folders[0] != cache_folder("0.1")


def test_what_another_copy_compiled_is_never_met(tmp_path, monkeypatch):
    """Numba would find nothing there, and every process would compile for itself, and otherwise."""
    monkeypatch.setenv("GLISSANDO_CACHE", str(tmp_path / "cache"))
    sources = Path(jit.__file__).parent
    copy = shutil.copytree(sources, tmp_path / "copy")
    folders = [cache_folder("1")]
    monkeypatch.setattr(jit, "__file__", str(copy / "jit.py"))
    folders.append(cache_folder("1"))
    (copy / "lie.py").touch()
    folders.append(cache_folder("1"))
    assert len(set(folders)) == 3
    assert cache_folder("1") == folders[-1]


CODE = """
from glissando._kernels import jit, white_noise
folder = jit._dispatchers()
jit._compile_once([white_noise.write_rows], folder)
print(len(white_noise.write_rows.compiled.overloads))
"""


OPTIMIZED = """
from numba.core.codegen import JITCodeLibrary

optimized, optimize = [], JITCodeLibrary._optimize_final_module
JITCodeLibrary._optimize_final_module = lambda self: (optimized.append(self.name), optimize(self))
from glissando._kernels import compile, jit, se3

compile.translate_whole_kernels_only(jit.called_from_python())
jit._dispatchers()
se3.log.compile()
print(*optimized)
"""


@pytest.mark.slow
def test_what_only_kernels_call_is_no_work_of_its_own(tmp_path):
    environment = {**os.environ, "GLISSANDO_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", OPTIMIZED]
    run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["log"]  # of the dozen functions that it is made of


@pytest.mark.slow
def test_what_is_compiled_is_always_the_same(tmp_path):
    """Else results would differ in the last digit between machines, and between copies on one."""
    codes = []
    for seed in ("1", "2"):
        environment = {**os.environ, "GLISSANDO_CACHE": str(tmp_path / seed)}
        environment |= {"PYTHONHASHSEED": seed}
        command = [sys.executable, "-c", CODE]
        run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        assert run.stdout == "0\n"  # it is loaded when it is called, as by a process that finds it
        (file,) = (tmp_path / seed).rglob("*.nbc")
        codes.append(re.sub(rb" at 0x[0-9a-f]+", b"", file.read_bytes()))  # in comments on types
    assert len(codes[0]) > 10_000
    assert codes[0] == codes[1]


@pytest.mark.slow
def test_two_processes_may_compile_at_once_and_say_so_in_a_line(tmp_path):
    environment = {**os.environ, "GLISSANDO_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", ONCE]
    both = [
        subprocess.Popen(command, env=environment, stdout=PIPE, stderr=PIPE, text=True)
        for _ in range(2)
    ]
    for process in both:
        out, err = process.communicate(timeout=300)
        assert (process.returncode, out) == (0, "1.0\n")
        lines = err.splitlines()  # one at once, then one every few seconds
        assert lines
        assert all(
            line.startswith("glissando: compiling its inner loops, once, into ") for line in lines
        )
    again = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert (again.stdout, again.stderr) == ("1.0\n", "")


LOADS = """
import sys, numpy as np
from glissando import CoilReadings, FixedLagSmoother, Grid, estimate, load_robot
from glissando._kernels import jit
loaded, load = [], jit.load
jit.load = lambda *modules: (loaded.append(*modules), load(*modules))  # of kernels when called
robot = load_robot(sys.argv[1])
time = np.linspace(0.0, 0.2, 4)
place, pose = np.full(4, robot.length), np.tile(np.eye(4), (4, 1, 1))
pose[:, 2, 3] = robot.length
coil = CoilReadings(time=time, arclength=place, values=pose, cov=[1e-6] * 3 + [1e-4] * 2)
if sys.argv[2] == "batch":
    grid = Grid(robot.arclength_nodes, np.linspace(0.0, 0.25, 5))
    estimate(robot.prior, grid, [coil]).at(0.3 * robot.length, 0.11)
else:
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    smoother.add(coil)
    for now in np.arange(0.0, 0.25, 0.05):
        smoother.advance(now)
print(*loaded)
"""


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["tdcr466", "tdcr466-segments", "mechanical"])
@pytest.mark.parametrize("way", ["batch", "online"])
def test_an_estimate_begins_with_all_kernels_that_it_calls(robot, way, tmp_path):
    """One that is missing is compiled alone, while another core has nothing to do."""
    (tmp_path / "mechanical.toml").write_text(MECHANICAL)
    robot = tmp_path / "mechanical.toml" if robot == "mechanical" else robot
    command = [sys.executable, "-c", LOADS, robot, way]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    assert set(run.stdout.split()) <= {"se3"}


class _Part:
    """A kernel as the line on compiling sees it."""

    def __init__(self, name, work):
        self.file, self.work = name, lambda: work


def test_modules_that_are_compiled_one_after_another_are_announced_once(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(jit, "_NOTICE", 0.001)
    for _ in range(3):
        over = threading.Event()
        said = threading.Thread(target=jit._say, args=([_Part("kernel", 1)], tmp_path, over))
        said.start()
        over.wait(0.2)  # shorter than the time between messages
        over.set()
        said.join()
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("seed", range(5))
def test_the_line_counts_only_what_is_compiled_now(seed, tmp_path, monkeypatch, capsys):
    """What an earlier process left, most of it even, is no progress of this one."""
    rng = np.random.default_rng(seed)
    parts = [_Part(f"kernel{i}", int(work)) for i, work in enumerate(rng.integers(1, 100, 12))]
    before, done = {p.file for p in parts[:6]}, {p.file for p in parts[: rng.integers(6, 12)]}
    found = iter([before, before, done, done])
    over = threading.Event()

    def on_disk(_):
        files = next(found)
        if files is done:
            over.set()
        return files

    monkeypatch.setattr(jit, "_on_disk", on_disk)
    monkeypatch.setattr(jit, "_NOTICE", 0.001)
    monkeypatch.setattr(jit, "_AGAIN", 0.001)
    jit._say(parts, tmp_path, over)
    first, *others = capsys.readouterr().err.splitlines()
    assert "% done" not in first  # nothing of it is compiled yet
    share = sum(p.work() for p in parts[6 : len(done)]) / sum(p.work() for p in parts[6:])
    said = [float(n) for line in others for n in re.findall(r"; (\d+) % done", line)]
    assert said == ([round(100 * share)] if share else [])
