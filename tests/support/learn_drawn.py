"""Robot files as documents, and noisy poses of the moving arc to learn them from."""

import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from glissando.geometry import se3
from glissando.io.robot_file import read_robot_document
from glissando.io.shipped_robots import robot_file
from scenes import arc

EXAMPLE = Path(__file__).parents[2] / "examples" / "closed_form_motion.py"
NOISE = np.r_[2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2]


def shipped(name):
    return read_robot_document(robot_file(name))


def readings(kind, name, place, time, *, std=NOISE, cov=None, seed=0):
    """Poses of the moving arc, noisy by `std`."""
    place = np.broadcast_to(place, time.shape)
    noise = std * np.random.default_rng(seed).standard_normal((time.size, 6))
    values = arc(place, time) @ se3.exp(noise)
    cov = np.asarray(std) ** 2 if cov is None else cov
    return kind(time=time, arclength=place, values=values, cov=cov, name=name)


@contextmanager
def same_process(workers, context, prepare, arguments):
    """Stands for the pool of processes."""
    prepare(*arguments)
    yield SimpleNamespace(map=map, shutdown=lambda **_: None)


def write_arc(folder):
    """A recording whose streams leave their noise to the robot file, and a robot on few nodes."""
    subprocess.run([sys.executable, EXAMPLE, folder], check=True, capture_output=True)
    text = (folder / "recording.toml").read_text()
    kept = [line for line in text.splitlines() if not line.startswith("std = ")]
    (folder / "recording.toml").write_text("\n".join(kept))
    robot = robot_file("tdcr466").read_text()
    for old, new in (("arclength_nodes = 5", "arclength_nodes = 3"), ("= 30.0", "= 5.0")):
        assert old in robot
        robot = robot.replace(old, new)
    (folder / "few.toml").write_text(robot)
    return folder
