"""Every reader of what others wrote or send, with sound samples and a way to damage them."""

import io
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from mutation_kinds import (
    NAMES,
    mutated_bytes,
    mutated_file,
    mutated_json,
    mutated_tree,
    pick,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin

import foreign_files
from foreign_bags import bag, c3d
from glissando.calibration.rig.session_data import rig_data
from glissando.errors import GlissandoError
from glissando.evaluation.foreign_estimate import read_estimate
from glissando.evaluation.plausibility.examine import examine_recording
from glissando.evaluation.replay import replay
from glissando.evaluation.run import checked_window, chosen_streams, run_estimate, write_run
from glissando.experiments.study.plan import load_study
from glissando.geometry import se3
from glissando.hardware.capture import load_rig
from glissando.hardware.drivers import aurora_protocol, vicon
from glissando.hardware.drivers.gcode_stage import parse_status
from glissando.hardware.drivers.slide import Slide
from glissando.hardware.drivers.stage import Stage
from glissando.hardware.openigtlink import decode, encode
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.framer import Framer
from glissando.hardware.openigtlink.message import HEADER
from glissando.hardware.simulated_devices import aurora_wire
from glissando.hardware.simulated_devices.aurora_wire import PortReport
from glissando.hardware.simulated_devices.dynamixel import crc16
from glissando.io.foreign import export, read_tracks
from glissando.io.foreign.recording import Choices, write_recording
from glissando.io.journal import Journal
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.io.query_csv import read_query, write_query
from glissando.io.recording import load_recording, save_recording
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.io.tendon_commands import read_tendon_commands
from glissando.model.sensors.sensors import PoseReadings
from glissando.model.slide_path import SlideLimits, read_slide
from glissando.simulation import SlidePath, load_bench
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session
from glissando.visualization.page.comparison import comparison, written_runs
from glissando.visualization.page.page import save_view
from igtl_messages import random_messages
from servo_world import World, together

_LONGEST = 60  # time nodes of a damaged recording that is estimated
ROWS = 60  # of each stream that are kept: damage does not need many
Files = dict[str, bytes]


def damaged(rng, files: Files) -> Files:
    """The files, one of them damaged as its kind may be."""
    name = pick(rng, sorted(files))
    return {**files, name: mutated_file(rng, name, files[name])}


@dataclass(frozen=True)
class Parser:
    """A reader, and what it reads.

    Attributes:
        name: What it reads.
        samples: Sound files by name, or one entry of bytes that come over a line.
        read: Reads them from a folder as a command does, and may write into another.
        mutate: Damages them.
        share: Of the mutations that other parsers get; less where reading is dear.
    """

    name: str
    samples: list[Files]
    read: Callable[[Files, Path, Path], object]
    mutate: Callable[[np.random.Generator, Files], Files] = damaged
    share: float = 1.0


def files_below(folder: Path) -> Files:
    """Every file below a folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def shortened(source: Path) -> Files:
    """A recording with the first rows of each stream."""
    out = {}
    for name, data in files_below(source).items():
        if name.endswith(".csv"):
            data = b"\n".join(data.splitlines()[: ROWS + 2]) + b"\n"
        if name.endswith((".csv", ".toml")):
            out[name] = data
    return out


# ------------------------------------------------------------------ recordings, robots, posteriors


def read_recording(_, folder, out):
    """As `check` does before an estimate."""
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
    """As `estimate` and `replay` do, where that takes seconds."""
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
    """One of its variables or attributes replaced by what it must not be, or its bytes."""
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
    elif kind == 3:  # announced large, stored nowhere
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


# ------------------------------------------------------------------ sessions


def session_content():
    """A session log as topics with messages, and its metadata, to damage and write again."""
    rng = np.random.default_rng(0)
    path = SlidePath.oscillate(1, 0.05, SlideLimits(0.06, 0.05, 0.2))
    topics = {"/slide": [], "/tracker/coil": [], "/mocap/tip": []}
    for k in range(60):
        t = 0.1 * k
        slide = {"time": t, "tick": t, "travel": float(path.at(np.array([t]))[0]), "speed": 0.0}
        topics["/slide"].append(slide)
        for name in ("/tracker/coil", "/mocap/tip"):
            pose = {"position": rng.normal(size=3).tolist(), "quaternion": [1.0, 0.0, 0.0, 0.0]}
            topics[name].append({"time": t, "frame": k, **pose})
    mount = {"position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
    setup = {
        "name": "bench", "robot": "sliding700", "coil_arclength": 0.7, "direction": -1,
        "coil_arclength_std": 0.002, "bodies": {"tip": {"arclength": 0.7, **mount}},
        "frame": mount, "coils": {"coil": {"arclength": 0.7, "slides": True, "slide": ""}},
    }  # fmt: skip
    return {"topics": topics, "setup": setup, "plain": written_log(topics, setup)}


def written_log(topics, setup, start=0):
    """The bytes of a log."""
    image = io.BytesIO()
    log = Writer(image, chunk_size=4096)
    log.start(profile="", library="glissando")
    log.add_metadata("session", {"format": "glissando session 1", "setup": json.dumps(setup)})
    made = log.register_schema("Pose", "jsonschema", b"{}")
    for name, messages in topics.items():
        channel = log.register_channel(name, "json", made)
        for k, message in enumerate(messages):
            data = b"[" * 100_000 if message == "x" else json.dumps(message).encode()
            log.add_message(channel, start + k, data, start + k)
    log.finish()
    return image.getvalue()


def session_parser():
    content = session_content()

    def mutate(rng, files):
        kind = rng.integers(10)
        if kind <= 4:
            return {"session.mcap": mutated_bytes(rng, files["session.mcap"])}
        if kind == 5:
            return {"session.mcap": _announcing(rng, files["session.mcap"])}
        topics, setup = content["topics"], content["setup"]
        if kind == 6:
            setup = mutated_tree(rng, setup)
        elif kind == 7:
            name = pick(rng, sorted(topics))
            topics = dict(topics)
            topics[f"{pick(rng, ['/tracker/', '/mocap/', ''])}{pick(rng, NAMES)}"] = topics.pop(
                name
            )
        else:
            topics = mutated_tree(rng, topics)
        try:
            data = written_log(topics, setup, pick(rng, [0, 0, (1 << 63) - 20]))
        except Exception:  # what no writer can write
            data = mutated_bytes(rng, files["session.mcap"])
        return {"session.mcap": data}

    def read(_, folder, out):
        recording = load_recording(folder)
        save_recording(recording, out / "recording")
        rig_data(read_session(folder / "session.mcap"))

    return Parser("session log", [{"session.mcap": content["plain"]}], read, mutate, share=0.5)


def _announcing(rng, data):
    """A log whose chunks announce other sizes, or unpack to much more than they hold."""
    import lz4.frame
    import zstandard

    size = pick(rng, [1 << 20, 1 << 31, 1 << 40, (1 << 64) - 1])
    name = pick(rng, ["lz4", "zstd", "", "none"])
    payload = bytes(1 << 24) if rng.random() < 0.5 else b"x" * 100
    packed = {"lz4": lz4.frame.compress, "zstd": zstandard.compress}.get(name, bytes)(payload)
    body = (0).to_bytes(16, "little") + size.to_bytes(8, "little") + bytes(4)
    body += len(name).to_bytes(4, "little") + name.encode()
    body += len(packed).to_bytes(8, "little") + packed
    chunk = b"\x06" + len(body).to_bytes(8, "little") + body
    return data[:8] + chunk + data[8:]


def journal_parser(scratch):
    robot = load_robot("tdcr466")
    rest = np.tile(np.eye(4), (20, 1, 1))
    readings = PoseReadings(
        time=np.arange(20) / 10, arclength=np.full(20, robot.length), values=rest,
        cov=np.full(6, 1e-6), name="tip",
    )  # fmt: skip
    with Journal(scratch / "journal") as log:
        log.write(readings)

    def read(_, folder, out):
        shutil.copytree(folder, out / "log")
        with Journal(out / "log") as log:
            log.write(readings)
        load_recording(out / "log")

    return Parser("journal", [files_below(scratch / "journal")], read)


# ------------------------------------------------------------------ files of other programs


def import_parser(name, samples, mutate=damaged, **options):
    """As `import` reads them, each object at some arclength."""

    def read(files, folder, out):
        target = folder / next(iter(files)) if len(files) == 1 else folder
        tracks = read_tracks(target, **options)
        places = dict.fromkeys((t.name for t in tracks), 0.1)
        write_recording(tracks, out / "recording", Choices(places))

    return Parser(name, samples, read, mutate, share=0.5)


def renamed(rng, files):
    """A bag with names as long as its own that are paths or markup; or damaged as any file is."""
    if rng.random() < 0.7:
        return damaged(rng, files)
    name = pick(rng, sorted(files))
    old = pick(rng, [b"/vicon/tip", b"/vicon/mid", b"aurora", b"PoseStamped"])
    new = pick(rng, [b"/../../../../x", b"<script>al", b"/tmp/xyzabcd", b"\xff" * 12, b"\0" * 12])
    return {**files, name: files[name].replace(old, new[: len(old)].ljust(len(old), b"x"))}


def import_parsers(scratch):
    rng = np.random.default_rng(1)
    tracks = {name: se3.exp(0.3 * rng.normal(size=(12, 6))) for name in ("Tip", "my mid")}
    points = {name: pose[:, :3, 3] for name, pose in tracks.items()}
    made = scratch / "foreign"
    made.mkdir()
    f = foreign_files
    f.tracker_csv(made / "vicon.csv", tracks)
    f.ndi_csv(made / "ndi.csv", tracks, range(12))
    f.motive_csv(made / "motive.csv", tracks, points)
    f.qualisys_tsv(made / "qualisys.tsv", tracks)
    columns = ["t,x,y,z,qw,qx,qy,qz"]
    columns += [f"{k},0,0,{k}e-3,1,0,0,0" for k in range(12)]
    (made / "own.csv").write_text("\n".join(columns) + "\n")
    c3d(made / "points.c3d")
    mapping = "time=t,x=x,y=y,z=z,qw=qw,qx=qx,qy=qy,qz=qz"
    bags = []
    for version, storage in ((1, None), *((2, plugin) for plugin in StoragePlugin)):
        path = made / ("run.bag" if version == 1 else f"run-{storage.name}")
        bag(path, version, rng, storage)
        bags.append({"run.bag": path.read_bytes()} if version == 1 else files_below(path))

    def one(name):
        return [{name: (made / name).read_bytes()}]

    return [
        import_parser("Vicon export", one("vicon.csv"), rate=100.0),
        import_parser("NDI export", one("ndi.csv"), rate=40.0),
        import_parser("OptiTrack export", one("motive.csv")),
        import_parser("Qualisys export", one("qualisys.tsv")),
        import_parser("other columns", one("own.csv"), columns=mapping),
        import_parser("c3d", one("points.c3d")),
        import_parser("ROS bag", bags, renamed),
    ]


# ------------------------------------------------------------------ bytes over a line


def line_parser(name, samples, read, resealed=None):
    """Bytes that come over a line; half of the damaged ones with a checksum that fits again."""

    def mutate(rng, files):
        data = mutated_bytes(rng, files["line"])
        if resealed is not None and rng.random() < 0.5:
            data = resealed(data)
        return {"line": data}

    return Parser(name, [{"line": s} for s in samples], lambda f, *_: read(f["line"]), mutate)


def rigid(pose):
    """Raise unless a pose is finite and rigid: a wrong one must not be believed."""
    assert np.all(np.isfinite(pose)), "a pose is not finite"
    turn = pose[:3, :3]
    assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-2, "a pose is no rigid motion"


def read_aurora(raw):
    reports = []
    for parse in (aurora_protocol.parse_tx, aurora_protocol.parse_bx):
        try:
            reports.append(parse(raw))
        except GlissandoError as problem:
            reason = problem
    try:
        aurora_protocol.parse_handles(aurora_protocol.parse_ascii(raw))
        return
    except GlissandoError:
        pass
    if not reports:
        raise reason
    for port in (port for report in reports for port in report.ports):
        if port.pose is not None:
            rigid(port.pose)


def aurora_parser():
    rng = np.random.default_rng(2)
    q = rng.normal(size=(3, 4))
    values = [np.r_[a / np.linalg.norm(a), rng.uniform(-500, 500, 3), 0.3] for a in q]
    reports = [PortReport(k + 10, 0x31, v, "") for k, v in enumerate(values)]
    reports.append(PortReport(20, 0, None, "DISABLED"))
    samples = [
        aurora_wire.tx_reply(reports, 7, 0, bare=True),
        aurora_wire.tx_reply(reports, 7, 0, bare=False),
        aurora_wire.bx_reply(reports, 7, 0),
        aurora_wire.text_reply("020A0010B001"),
    ]

    def resealed(data):
        if data[:2] == b"\xc4\xa5" and len(data) > 10:
            head = data[:2] + (len(data) - 8).to_bytes(2, "little")
            head += aurora_wire.crc(head).to_bytes(2, "little")
            return head + data[6:-2] + aurora_wire.crc(data[6:-2]).to_bytes(2, "little")
        return data[:-5] + b"%04X\r" % aurora_wire.crc(data[:-5])

    return line_parser("Aurora replies", samples, read_aurora, resealed)


def vicon_parser():
    def item(name, *values):
        return vicon._ITEM.pack(0, 72) + vicon._OBJECT.pack(name, *values)

    packet = vicon._FRAME.pack(7, 2)
    packet += item(b"tip", 1, 2, 3, 0.1, 0.2, 0.3) + item(b"mid", 4, 5, 6, 0.1, 0.2, 0.3)

    def read(raw):
        frame = vicon.parse_packet(raw, 0.0)
        for pose in frame.poses.values() if frame else ():
            rigid(pose)

    return line_parser("Vicon datagrams", [packet], read)


class SpoiltWorld(World):
    """A servo some of whose answers are damaged on their way, as a seed says."""

    rng = None

    def writePort(self, packet):  # noqa: N802
        """Damage every third answer."""
        sent = super().writePort(packet)
        if self.rng is not None and self._due and self.rng.random() < 0.3:
            when, data = self._due.pop()
            data = mutated_bytes(self.rng, data)
            if self.rng.random() < 0.6 and len(data) > 4:
                data = data[:-2] + crc16(data[:-2]).to_bytes(2, "little")
            self._due.append((when, data))
        return sent


def read_servo(raw):
    """A short move with a servo whose answers are spoilt; it stands still at the end."""
    world = SpoiltWorld()
    world.rng = np.random.default_rng(int.from_bytes(raw[:8].ljust(8, b"\0"), "little"))
    stage = Stage(lead=0.0254, stroke=(0.0, 0.06), home=-0.002)
    try:
        with together(world), Slide("world", stage) as slide:
            slide.home_here(world.screw.travel)
            slide.move(0.032)
    finally:
        world.passes(1.0)
        rest = world.travel[-1][1]
        world.passes(1.0)
        assert abs(world.travel[-1][1] - rest) < 1e-6, "the stage still moves"
        places = [travel for _, travel in world.travel]
        assert 0.028 < min(places) <= max(places) < 0.034, "the stage left its way"


def igtl_parser():
    rng = np.random.default_rng(3)
    samples = [encode(message) for message in random_messages(rng)]

    def read(raw):
        for message in Framer().feed(raw):
            decode(message)

    def resealed(data):
        if len(data) < HEADER:
            return data
        head, body = bytearray(data[:HEADER]), data[HEADER:]
        head[42:50] = len(body).to_bytes(8, "big")
        head[50:58] = crc64(body).to_bytes(8, "big")
        return bytes(head) + body

    return line_parser("OpenIGTLink", samples, read, resealed)


# ------------------------------------------------------------------ small files


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
    """All parsers, with samples made in a folder.

    Args:
        scratch: Folder to make samples in.
        recording: A recording to damage beside those that are simulated.
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
        *import_parsers(scratch),
        aurora_parser(),
        vicon_parser(),
        Parser("Dynamixel answers", [{"line": bytes(8)}],
               lambda f, *_: read_servo(f["line"]), lambda rng, _: {"line": rng.bytes(8)}),
        line_parser("GRBL status", [b"<Idle|MPos:0.000,0.000,1.500|FS:0,0>"], parse_status),
        igtl_parser(),
    ]  # fmt: skip
