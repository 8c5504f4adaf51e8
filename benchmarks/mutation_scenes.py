"""Parsers of scenes with meshes, and of calibrations, with damaged samples."""

from pathlib import Path

import numpy as np
import trimesh

from glissando.calibration.rig.result import Calibration, load_calibration
from glissando.calibration.rig.rig import PARAMETERS, Rig
from glissando.io.robot_file import load_robot
from glissando.planning.scene.mesh import read_mesh
from glissando.planning.scene.scene_file import read_scene
from mutation_kinds import mutated_bytes, mutated_table, mutated_toml
from mutation_samples import Parser

_EXAMPLE = Path(__file__).parents[1] / "examples" / "scene"
_MORE = b"""
[[obstacles]]
kind = "mesh"
file = "stone.stl"
position = [0, 0.1, 0.1]

[[slides]]
reach = [0.0, 0.18]
speed = 0.02
acceleration = 0.1

[[zones]]
center = [0.03, 0, 0.17]
radius = 0.02
"""


def scene_parser():
    """Parser of a scene of the examples with a mesh; the scene is damaged."""
    robot = load_robot(_EXAMPLE / "arm.toml")
    text = (_EXAMPLE / "scene.toml").read_bytes()
    stone = trimesh.creation.box((0.02, 0.03, 0.01)).export(file_type="stl")
    samples = [{"scene.toml": text}, {"scene.toml": text + _MORE, "stone.stl": stone}]

    def mutate(rng, files):
        damaged = mutated_toml(rng, files["scene.toml"].decode())
        return files | {"scene.toml": damaged.encode(errors="surrogateescape")}

    def read(_, folder, out):
        scene = read_scene(folder / "scene.toml", robot)
        for obstacle in scene.obstacles:
            obstacle.distance(np.zeros((1, 3)))

    return Parser("scene file", samples, read, mutate)


def mesh_parser():
    """Parser of meshes of every supported format; numbers in text formats are damaged too."""
    box = trimesh.creation.box((0.02, 0.03, 0.01))
    kinds = {"a.stl": "stl", "b.stl": "stl_ascii", "c.ply": "ply", "d.obj": "obj"}
    samples = [{name: box.export(file_type=kind)} for name, kind in kinds.items()]
    for one in samples:
        one |= {n: d.encode() for n, d in one.items() if isinstance(d, str)}
    samples[-1] = {n: b"mtllib ../../etc/passwd\nusemtl x\n" + d for n, d in samples[-1].items()}

    def mutate(rng, files):
        ((name, data),) = files.items()
        if name[0] in "bd" and rng.random() < 0.6:
            table = mutated_table(rng, data.decode(), " ")
            return {name: table.encode(errors="surrogateescape")}
        return {name: mutated_bytes(rng, data)}

    def read(files, folder, out):
        read_mesh(folder / next(iter(files)), np.eye(4)).distance(np.zeros((1, 3)))

    return Parser("mesh", samples, read, mutate, share=0.5)


def calibration_parser(scratch):
    """Parser of a rig's calibration."""
    rig = Rig(np.eye(4), 1, 0.1, 10.0, np.zeros(4), 0.0254, 1e-4, np.zeros(2), np.zeros(2))
    cov = 1e-8 * np.eye(len(PARAMETERS))
    Calibration(rig, cov, "coil", 3.0, (), ("of the zero little is seen",)).save(scratch / "c.toml")
    sample = {"calibration.toml": (scratch / "c.toml").read_bytes()}
    return Parser("calibration", [sample], lambda _, f, o: load_calibration(f / "calibration.toml"))
