"""Every file is the old one or the new one, whatever stops its writer and whenever."""

import ast
import errno
import os
import resource
from argparse import Namespace
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import glissando
from glissando import load_robot, save_posterior, save_view
from glissando.calibration.rig.result import Calibration
from glissando.calibration.rig.rig import Rig
from glissando.cli import estimate as estimate_command
from glissando.errors import GlissandoError, RecordingError
from glissando.evaluation.run import run_estimate
from glissando.io.atomic import new_file, new_folder, renewed_folder, write_table, write_text
from glissando.io.csv_stream import Rows, Stream
from glissando.io.foreign import export
from glissando.io.recording import Recording
from glissando.io.recording_folder import load_recording, save_recording
from glissando.visualization.canvas import save_figure
from glissando.visualization.film import save_animation
from outputs import contents, watched

SOURCE = Path(glissando.__file__).parent
HELPERS = {"new_file", "new_folder", "renewed_folder", "write_text", "write_table"}
PRIMITIVES = {
    *("write_text", "write_bytes", "savefig", "savetxt", "savez", "to_netcdf", "write_table"),
    *("tofile", "save", "saving", "copy", "copyfile", "dump"),
}
GROWING = {
    "io/journal.py": "rows are handed over as they come, and a cut-off one is left out",
    "io/session_log/writer.py": "messages are flushed twice a second, and a cut-off log is read",
    "hardware/live/sinks.py": "rows are appended while the robot moves, whole or not at all",
    "_kernels/jit.py": "a list of what is compiled: what is missing is compiled again",
}


def handed_a_place(function):
    """Whether a function is handed the place to write to by one that renames it later."""
    return "building" in {argument.arg for argument in function.args.args}


def safe(node, parents):
    """Whether a node stands in a `with` of a helper, or in a function handed a place."""
    while node in parents:
        node = parents[node]
        if isinstance(node, ast.With):
            calls = [item.context_expr for item in node.items]
            if any(getattr(getattr(c, "func", c), "id", "") in HELPERS for c in calls):
                return True
        if isinstance(node, ast.FunctionDef) and handed_a_place(node):
            return True
    return False


def writes(call):
    """Whether a call writes to a file: by its name, or an `open` whose mode says so."""
    if not isinstance(call.func, ast.Attribute):
        return isinstance(call.func, ast.Name) and call.func.id == "open"
    if call.func.attr == "open":
        modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
        return any(isinstance(mode, str) and set(mode) & set("wax+") for mode in modes)
    return call.func.attr in PRIMITIVES


@pytest.mark.slow
def test_no_file_is_written_but_through_the_helpers():
    """A new writer that forgets them is found here, and by the examples of the commands."""
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        if name not in (*GROWING, "io/atomic.py"):
            assert not direct_writes(path), name


def direct_writes(path):
    """Calls that write to a file which no helper renames into place."""
    tree = ast.parse(path.read_text())
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    known = ("copy.copy(", ".copy()", "result.save(", "scene.save(", "dataset.to_netcdf(e")
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and writes(n)]
    bad = [ast.unparse(n) for n in calls if not safe(n, parents)]
    return [text for text in bad if not any(part in text for part in known)]


def test_a_writer_that_forgets_them_is_found(tmp_path):
    (tmp_path / "a.py").write_text("def save(x, path):\n    path.write_text(x)\n")
    assert direct_writes(tmp_path / "a.py") == ["path.write_text(x)"]


@contextmanager
def full_disk(room):
    """No file may grow beyond so many bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def survives(write, folder):
    """The files in a folder are the old ones after every fault, and at every moment before."""
    write(folder)
    old = contents(folder)
    assert old
    places = []
    with watched(folder, lambda event, paths: places.append(event)):
        write(folder)
    new = contents(folder)
    assert new.keys() == old.keys()
    for room in (0, min(map(len, old.values())) // 2):
        with full_disk(room), pytest.raises((GlissandoError, OSError)) as told:
            write(folder)
        assert contents(folder) == new
        if isinstance(told.value, GlissandoError):
            assert "File too large" in str(told.value)
    for number in sorted({0, 1, len(places) // 2}):
        countdown = iter(range(len(places) + 1))

        def interrupt(event, paths, number=number, countdown=countdown):
            assert contents(folder) in (old, new)  # what a kill would leave
            if next(countdown) == number:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt), watched(folder, interrupt):
            write(folder)
        assert contents(folder) == new
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A tip that turns a little, estimated for a fifth of a second."""
    robot = load_robot("tdcr466")
    tip = np.tile(np.eye(4), (5, 1, 1))
    tip[:, 2, 3] = robot.length
    rows = Rows("pose", np.linspace(0, 0.2, 5), np.full(5, robot.length), tip, {})
    streams = {
        "tip": Stream("tip", rows, std=np.full(6, 1e-3), keep_repeats=True),
        "truth": Stream("truth", rows, True, np.full(6, 1e-3), keep_repeats=True),
    }
    recording = Recording("still", Path(), streams, robot, None)
    return run_estimate(recording, robot, window=None, use=None, truth=None)


def calibration(folder):
    rig = Rig(T_wt=np.eye(4), direction=-1, zero=0.7, epoch=0.0)
    Calibration(rig, np.zeros((17, 17)), "coil", 40.0).save(folder / "rig.toml")


def results(run, out, *, view):
    """All that `estimate --out` writes, with figures that are quickly drawn."""
    with pytest.MonkeyPatch.context() as patch:
        quick = lambda *_: [save_figure(FIGURE, _[-1] / "shape.png")]  # noqa: E731
        patch.setattr(estimate_command, "save_figures", quick)
        options = Namespace(out=out, animate=False, view=view, loads=False, figures=True)
        estimate_command._write(options, run, (np.zeros(1), np.zeros(1)), None, {})


FIGURE = Figure(figsize=(1, 1))
WRITERS = {
    "text": lambda run, out: write_text(out / "a.txt", "words " * 50),
    "table": lambda run, out: write_table(out / "a.csv", ["x"], np.arange(50.0)[:, None]),
    "posterior": lambda run, out: save_posterior(run.posterior, out / "posterior.nc"),
    "figure": lambda run, out: save_figure(FIGURE, out / "a.svg"),
    "view": lambda run, out: save_view(run.posterior, out / "view.html"),
    "film": lambda run, out: save_animation(
        run.posterior, [], [], out / "a.gif", seconds=0.05, width=100
    ),
    "trajectory": lambda run, out: export(run.posterior, out / "a.tum"),
    "csv": lambda run, out: export(run.posterior, out / "a.csv"),
    "mcap": lambda run, out: export(run.posterior, out / "a.mcap"),
    "calibration": lambda run, out: calibration(out),
    "estimate": lambda run, out: results(run, out, view=True),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n == "film" else ()) for n in WRITERS]
)
def test_a_full_disk_ctrl_c_or_a_kill_leaves_the_old_files(name, run, tmp_path):
    survives(lambda out: WRITERS[name](run, out), tmp_path)


def test_a_recording_is_whole_or_not_there(run, tmp_path):
    with full_disk(100), pytest.raises((GlissandoError, OSError)):
        save_recording(run.recording, tmp_path / "out")
    assert not list(tmp_path.iterdir())
    save_recording(run.recording, tmp_path / "out")
    assert load_recording(tmp_path / "out").streams.keys() == {"tip", "truth"}


def test_files_of_an_earlier_run_do_not_stay_beside_new_ones(run, tmp_path):
    results(run, tmp_path, view=True)
    (tmp_path / "notes.txt").write_text("mine")
    assert (tmp_path / "view.html").exists()
    results(run, tmp_path, view=False)
    assert not (tmp_path / "view.html").exists()
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_full_disk_is_said_in_a_sentence(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with (
        pytest.raises(
            GlissandoError, match=r"a\.txt cannot be written \(File too large\); what was"
        ),
        full_disk(2),
    ):
        write_text(tmp_path / "a.txt", "new words")
    assert (tmp_path / "a.txt").read_text() == "old"


def test_links_stay_links_pipes_stay_pipes_and_modes_are_the_users(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"
    plain = tmp_path / "plain.txt"
    plain.write_text("")
    assert (tmp_path / "real.txt").stat().st_mode == plain.stat().st_mode
    write_text("/dev/null", "nothing")
    assert not Path("/dev/null").is_file()


def test_a_mistake_in_the_writer_is_not_taken_for_a_full_disk(tmp_path):
    with pytest.raises(ZeroDivisionError), new_file(tmp_path / "a.txt") as building:
        building.write_text(str(1 / 0))
    with pytest.raises(RecordingError), renewed_folder(tmp_path / "out", ()):
        raise RecordingError("wrong")
    with pytest.raises(KeyError), new_folder(tmp_path / "new", RecordingError):
        raise KeyError
    assert not [p for p in tmp_path.rglob("*") if p.is_file()]


def test_an_unwritable_folder_is_said_in_a_sentence(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(GlissandoError, match=r"cannot be written \(Read-only file system\)"):
        write_text(tmp_path / "a.txt", "words")


@pytest.mark.parametrize("there", [False, True])
def test_a_file_of_results_that_cannot_be_written_is_named_where_it_was_to_be(tmp_path, there):
    if there:
        (tmp_path / "report.json").write_text("before")

    def fail():
        with renewed_folder(tmp_path, ["report.json"]) as folder, new_file(folder / "report.json"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(GlissandoError) as told:
        fail()
    kept = "; what was there is as it was" if there else ""
    named = f"{tmp_path / 'report.json'} cannot be written (No space left on device){kept}."
    assert str(told.value).startswith(named)
    assert [p.name for p in tmp_path.iterdir()] == ["report.json"] * there


def test_a_file_of_a_new_folder_that_cannot_be_written_is_named_where_it_was_to_be(tmp_path):
    def fail():
        with new_folder(tmp_path / "made", GlissandoError) as folder, new_file(folder / "coil.csv"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(GlissandoError) as told:
        fail()
    assert str(told.value).startswith(f"{tmp_path / 'made' / 'coil.csv'} cannot be written")
    assert not list(tmp_path.iterdir())
