"""Parsers of other programs' files, with damaged samples."""

import sys
from pathlib import Path

import numpy as np

from mutation_kinds import (
    pick,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from rosbags.rosbag2 import StoragePlugin

import foreign_files
from foreign_bags import bag, c3d
from glissando.geometry import se3
from glissando.io.foreign import read_tracks
from glissando.io.foreign.recording import Choices, write_recording
from mutation_samples import Parser, damaged, files_below

_ARM = Path(__file__).parents[1] / "examples" / "scene" / "arm.toml"


def import_parser(name, samples, mutate=damaged, robot=None, **options):
    """Parser that imports files as the command `import` does, with every object at 0.1 m."""

    def read(files, folder, out):
        target = folder / next(iter(files)) if len(files) == 1 else folder
        tracks = read_tracks(target, **options)
        places = dict.fromkeys((t.name for t in tracks), 0.1)
        write_recording(tracks, out / "recording", Choices(places, robot=robot))

    return Parser(name, samples, read, mutate, share=0.5)


def renamed(rng, files):
    """Bag whose names are replaced by paths or markup of equal length, or a damaged bag."""
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
    servos = ["timestamp," + "".join(f"servo_{j}_mm," for j in range(9)) + "tip_x,tip_y,tip_z"]
    servos += [f"{17e8 + k},{','.join([str(0.1 * k)] * 9)},{k},0,{180 - k}" for k in range(12)]
    (made / "servos.csv").write_text("\n".join(servos) + "\n")
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
        import_parser("servo export", one("servos.csv"), robot=str(_ARM)),
        import_parser("c3d", one("points.c3d")),
        import_parser("ROS bag", bags, renamed),
    ]
