"""All parsers of external files and messages, with valid samples and methods to damage them."""

import io
import sys
from pathlib import Path

import h5py
import numpy as np

from mutation_kinds import (
    NAMES,
    mutated_bytes,
    mutated_json,
    pick,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))


from glissando.errors import GlissandoError
from glissando.evaluation.foreign_estimate import read_estimate
from glissando.evaluation.plausibility.examine import examine_recording
from glissando.evaluation.replay import replay
from glissando.evaluation.run import checked_window, chosen_streams, run_estimate, write_run
from glissando.experiments.study.plan import load_study
from glissando.hardware.capture import load_rig
from glissando.hardware.drivers.gcode import parse_status
from glissando.io.foreign import export
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.io.query_csv import read_query, write_query
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.io.tendon_commands import read_tendon_commands
from glissando.model.slide_path import SlideLimits, read_slide
from glissando.simulation import load_bench
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session
from glissando.visualization.page.comparison import comparison, written_runs
from glissando.visualization.page.page import save_view
from mutation_exports import import_parsers
from mutation_logs import journal_parser, session_parser
from mutation_samples import _LONGEST, Parser, files_below, shortened
from mutation_scenes import calibration_parser, mesh_parser, scene_parser
from mutation_wires import aurora_parser, igtl_parser, line_parser, read_servo, vicon_parser


def read_recording(_, folder, out):
    """Read and check a recording as the command `check` does, and write it again."""
    recording = load_recording(folder)
    robot = recording.robot
    if robot is None:
        return
    window = checked_window(recording, None)
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)
    findings = examine_recording(recording, robot, readings, truth, window)
    if any(f.refusal for f in findings):
        raise GlissandoError(findings[0].sentence)
    robot.grid(*window)
    save_recording(recording, out / "again")


def estimate_recording(_, folder, out):
    """Estimate and replay a recording, if it is short enough to take seconds."""
    recording = load_recording(folder)
    robot, window = recording.robot, checked_window(recording, None)
    if robot is not None and (window[1] - window[0]) * robot.time_rate < _LONGEST:
        run_estimate(recording, robot, window=None, use=None, truth=None, max_iterations=30)
        replay(recording, robot)


def read_robot(_, folder, out):
    load_robot(folder / "robot.toml").grid(0.0, 10.0)


def read_posterior(_, folder, out):
    posterior = load_posterior(folder / "posterior.nc")
    time, place = posterior.grid.time, posterior.grid.arclength
    posterior.at(place[-1], time[:2])
    export(posterior, out / "tip.tum")


def mutated_posterior(rng, files):
    """Posterior file with an invalid variable or attribute, or with damaged bytes."""
    data = files["posterior.nc"]
    if rng.random() < 0.3:
        return {"posterior.nc": mutated_bytes(rng, data)}
    image = io.BytesIO(data)
    with h5py.File(image, "r+") as file:
        if rng.random() < 0.35:
            name = pick(rng, sorted(file.attrs))
            text = file.attrs[name]
            try:
                file.attrs[name] = mutated_json(rng, text.encode()).decode("utf-8", "replace")
            except (ValueError, AttributeError, TypeError):
                file.attrs[name] = pick(rng, [1, "x", 2.5])
        else:
            _damage_variable(rng, file)
    return {"posterior.nc": image.getvalue()}


def _damage_variable(rng, file):
    name = pick(rng, sorted(file))
    values, kind = file[name][()], rng.integers(6)
    if kind == 0:
        del file[name]
    elif kind == 1 and values.dtype.kind == "f" and values.size:
        flat = values.ravel()
        flat[rng.integers(flat.size)] = pick(rng, [np.nan, np.inf, 1e308, -1.0, 0.0, 1e-300])
        file[name][...] = values
    elif kind == 2 and values.dtype.kind == "f":
        file[name][...] = values * pick(rng, [-1.0, 1e3, 1e-3, 0.0, 1e200])
    elif kind == 3:  # large shape without stored data
        shape = tuple(int(n) for n in pick(rng, [(1 << 33,), (1 << 12,) * 3, (0,)]))
        del file[name]
        file.create_dataset(name, shape, "f8", chunks=True if 0 not in shape else None)
    elif kind == 4:
        del file[name]
        file[name] = pick(rng, [np.zeros(3), np.zeros((2, 2)), np.arange(5), np.array(["a"], "S")])
    else:
        file[name].attrs[pick(rng, ["_FillValue", "scale_factor", "units", "calendar"])] = pick(
            rng, [1, 1e300, "days since 1970", np.zeros(3)]
        )


def read_report(_, folder, out):
    page = comparison(written_runs([folder]))
    for name in NAMES:
        if "<" in name:
            assert name not in page.partition("</script>")[2], "markup of a name is in the page"


def read_study(_, folder, out):
    study = load_study(folder / "study.toml")
    if len(study) <= 500:
        study.cells()


def small_parsers(scratch, run):
    limits = SlideLimits(0.06, 0.05, 0.2)
    robot = load_robot("tdcr466")
    slide = b"time,displacement\n" + b"".join(b"%d,%.3f\n" % (k, 0.01 * (k % 4)) for k in range(9))
    time = np.linspace(0.5, 1.2, 5)
    write_query(run.posterior, (time, np.full(5, robot.length)), scratch / "query.csv")
    query = (scratch / "query.csv").read_bytes()
    commands = b"time,a,b\n" + b"".join(b"%d,0.001,%.4f\n" % (k, 1e-4 * k) for k in range(9))
    shape = b"tensions = [[10, 20], [5, 5]]\ntime = [0, 20]\ngravity = [0, 0, 9.81]\n"
    shape += b"[[loads]]\narclength = 0.5\nforce = [0.1, 0, 0]\nmoment = [0, 0, 0]\n"
    bench = load_bench(robot_file("sliding700"))
    known = {name: robot_file(name).read_bytes() for name in shipped_robots()}
    study = b'name = "sweep"\nseeds = 3\n[grid]\nshape = ["C", "S"]\nnoise = [0.5, 1, 2]\n'
    study += b'[fixed]\nslide = "hold"\nat = 0.05\nduration = 5\n'
    return [
        Parser("robot file", [{"robot.toml": d} for d in known.values()], read_robot),
        Parser("study file", [{"study.toml": study}], read_study),
        Parser("plan and slide", [{"slide.csv": slide}],
               lambda _, f, out: read_slide(f / "slide.csv", limits)),
        Parser("query", [{"query.csv": query}], lambda _, f, out: read_query(f / "query.csv")),
        Parser("foreign estimate", [{"query.csv": query}],
               lambda _, f, out: read_estimate(f / "query.csv")),
        Parser("tendon commands", [{"c.csv": commands}],
               lambda _, f, out: read_tendon_commands(f / "c.csv", ("a", "b"))),
        Parser("shape file", [{"shape.toml": shape}],
               lambda _, f, out: (bench.shape(f / "shape.toml"), bench.scenario(f / "shape.toml"))),
        Parser("rig setup", [{"bench.toml": SETUP}],
               lambda _, f, out: load_rig(f / "bench.toml").described()),
    ]  # fmt: skip


SETUP = b"""name = "bench"
robot = "sliding700"
[tracker]
address = "/dev/ttyUSB0"
position = [0.1, 0, 0]
quaternion = [1, 0, 0, 0]
[[tracker.coils]]
name = "coil"
arclength = 0.70
serial = "3D0A"
[slide]
address = "/dev/ttyUSB1"
lead = 0.0254
stroke = [0.0, 0.06]
standing = 0.0
[mocap]
port = 51001
[[mocap.bodies]]
name = "tip"
arclength = 0.7
position = [0, 0, 0.02]
"""


def report_parser(scratch, run):
    folder = scratch / "run"
    folder.mkdir()
    write_run(run, folder)
    save_view(run.posterior, folder / "view.html")
    kept = {name: (folder / name).read_bytes() for name in ("report.json", "view.html")}
    return Parser("report", [kept], read_report)


def parsers(scratch: Path, recording: Path | None = None) -> list[Parser]:
    """All parsers, with samples written into a folder.

    Args:
        scratch: Folder for the samples.
        recording: A recording to damage in addition to simulated ones, or None.
    """
    session = simulate("sliding700", shape="C", slide="hold", duration=4.0, seed=5)
    write_session(session, scratch / "simulated", "sliding700")
    sources = [scratch / "simulated", *([recording] if recording else [])]
    for number, source in enumerate(sources):
        folder = scratch / f"base{number}"
        for name, data in shortened(source).items():
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
    bases = [scratch / f"base{number}" for number in range(len(sources))]
    loaded = load_recording(bases[0])
    run = run_estimate(loaded, loaded.robot, window=(0.5, 1.2), use=None, truth=None)
    save_posterior(run.posterior, scratch / "posterior.nc")
    posterior = [{"posterior.nc": (scratch / "posterior.nc").read_bytes()}]
    return [
        Parser("recording", [files_below(base) for base in bases], read_recording, share=0.4),
        Parser("its estimate", [files_below(bases[0])], estimate_recording, share=0.05),
        Parser("posterior", posterior, read_posterior, mutated_posterior, share=0.15),
        report_parser(scratch, run),
        session_parser(),
        journal_parser(scratch),
        *small_parsers(scratch, run),
        scene_parser(),
        mesh_parser(),
        calibration_parser(scratch),
        *import_parsers(scratch),
        aurora_parser(),
        vicon_parser(),
        Parser("Dynamixel answers", [{"line": bytes(8)}],
               lambda f, *_: read_servo(f["line"]), lambda rng, _: {"line": rng.bytes(8)}),
        line_parser("GRBL status", [b"<Idle|MPos:0.000,0.000,1.500|FS:0,0>"], parse_status),
        igtl_parser(),
    ]  # fmt: skip
