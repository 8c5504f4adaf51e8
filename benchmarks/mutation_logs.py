"""Parsers of sessions and journals, with damaged samples."""

import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np

from mutation_kinds import (
    NAMES,
    mutated_bytes,
    mutated_tree,
    pick,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from mcap.writer import Writer

from glissando.calibration.rig.session_data import rig_data
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session
from glissando.model.sensors.sensors import PoseReadings
from glissando.model.slide_path import SlideLimits
from glissando.simulation import SlidePath
from mutation_samples import Parser, files_below


def session_content():
    """Content of a session log by topic, and its metadata, to be damaged and written again."""
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
    """Bytes of a log with these topics and setup."""
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
    """Log with a chunk whose stated size is wrong, or that decompresses to a much larger size."""
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
