"""Signed distances: what they are, their slopes and curvatures, for every kind of obstacle."""

import os

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.planning.scene.mesh import read_mesh
from glissando.planning.scene.obstacles import (
    HalfSpace,
    RoundedBox,
    capsule,
    distances,
    sphere,
)

KINDS = ["sphere", "capsule", "box", "rounded box", "half-space"]


@pytest.fixture
def rng():
    """A generator of its own for each test."""
    return np.random.default_rng(0)


def drawn(kind, rng):
    """An obstacle of a kind, of about 0.1 m."""
    pose = se3.exp(np.concatenate([0.05 * rng.standard_normal(3), rng.standard_normal(3)]))
    half, a, b = rng.uniform(0.02, 0.06, 3), *(0.05 * rng.standard_normal((2, 3)))
    normal = rng.standard_normal(3)
    return {
        "sphere": sphere(a, 0.03),
        "capsule": capsule(a, b, 0.02),
        "box": RoundedBox(pose, half),
        "rounded box": RoundedBox(pose, half, 0.01),
        "half-space": HalfSpace(a, normal / np.linalg.norm(normal)),
    }[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_slopes_and_curvatures_are_those_of_the_distance(kind, rng):
    obstacle, step = drawn(kind, rng), 1e-6
    points = 0.1 * rng.standard_normal((40, 3))
    near = (
        np.stack([points + step * e for e in np.eye(3)]),
        np.stack([points - step * e for e in np.eye(3)]),
    )
    ahead, behind = ([obstacle.distance(x) for x in side] for side in near)
    slope = np.stack([(a[0] - b[0]) / (2 * step) for a, b in zip(ahead, behind, strict=True)], -1)
    curved = np.stack([(a[1] - b[1]) / (2 * step) for a, b in zip(ahead, behind, strict=True)], -1)
    smooth = np.abs(curved).max(axis=(1, 2)) < 1e3  # not across an edge inside
    found, bent = obstacle.distance(points)[1], obstacle.curvature(points)
    np.testing.assert_allclose(found[smooth], slope[smooth], atol=1e-6)
    np.testing.assert_allclose(bent[smooth], curved[smooth], atol=1e-3)
    assert smooth.sum() > 30


@pytest.mark.parametrize("kind", KINDS[:4])
def test_outside_the_distance_is_that_to_the_nearest_point_of_the_surface(kind, rng):
    obstacle = drawn(kind, rng)
    vertices, faces = obstacle.surface()
    weights = rng.dirichlet(np.ones(3), (60, len(faces)))
    surface = np.einsum("wft,ftc->wfc", weights, vertices[faces]).reshape(-1, 3)
    assert np.abs(obstacle.distance(surface)[0]).max() < 2e-3  # facets of what is round
    points = 0.2 * rng.standard_normal((30, 3))
    signed = obstacle.distance(points)[0]
    nearest = np.linalg.norm(points[:, None] - surface, axis=-1).min(axis=1)
    outside = signed > 0.0
    np.testing.assert_allclose(signed[outside], nearest[outside], atol=6e-3)
    assert np.all(signed[outside] <= nearest[outside] + 2e-3)


def test_all_obstacles_at_once_are_each_by_itself(rng):
    every, points = [drawn(kind, rng) for kind in KINDS], rng.standard_normal((7, 3))
    signed = distances(every, points)[0]
    for obstacle, row in zip(every, signed, strict=True):
        np.testing.assert_array_equal(row, obstacle.distance(points)[0])


@pytest.mark.slow
def test_a_mesh_is_as_far_as_the_box_it_is_of(tmp_path, rng):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    size, pose = np.array([0.06, 0.04, 0.05]), se3.exp(np.array([0.01, 0, 0.02, 0.3, 0.2, 0.1]))
    file = tmp_path / "box.stl"
    trimesh.creation.box(1e3 * size).export(file)
    mesh, box = read_mesh(file, pose, 1e-3), RoundedBox(pose, 0.5 * size)
    points = 0.05 * rng.standard_normal((200, 3))
    points = points[np.abs(box.distance(points)[0]) < 0.015]
    (near, slope), (true, direct) = mesh.distance(points), box.distance(points)
    assert np.abs(near - true).max() < 1.5e-3
    outside = true > 3e-3
    assert np.sum(slope[outside] * direct[outside], axis=1).min() > 0.95
    open_file = tmp_path / "open.stl"
    whole = trimesh.creation.box(size)
    whole.update_faces(np.arange(len(whole.faces)) > 0)
    whole.export(open_file)
    with pytest.raises(GlissandoError, match="has holes"):
        read_mesh(open_file, pose)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(0.1, 0.1, 0.001), (0.2, 0.002, 0.002), (0.01, 0.01, 0.01)])
def test_a_mesh_is_nowhere_much_further_than_the_thin_box_it_is_of(tmp_path, rng, size):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    trimesh.creation.box(size).export(tmp_path / "box.stl")
    pose, half = se3.exp(np.array([0.01, 0, 0.02, 0.3, 0.2, 0.1])), 0.5 * np.array(size)
    mesh, box = read_mesh(tmp_path / "box.stl", pose), RoundedBox(pose, half)
    for beyond in (0.0, 0.005, 0.02):
        local = rng.uniform(-1.0, 1.0, (3000, 3)) * (half + beyond)
        points = local @ pose[:3, :3].T + pose[:3, 3]
        found, true = mesh.distance(points)[0], box.distance(points)[0]
        assert np.all(found <= true + 2e-4 + 0.04 * np.maximum(true, 0.0))
        assert np.all(found[true < -1e-4] < 0.0)
        outside = true > 0.0
        assert np.all(found[outside] > true[outside] - 0.8 * mesh.step)


def test_a_mesh_of_others_is_refused_or_read_alone(tmp_path):
    """Not a kind that unpacks or fetches, no pipe; materials that it names are left alone."""
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    box = trimesh.creation.box((0.06, 0.04, 0.05)).export(file_type="obj")
    os.mkfifo(tmp_path / "materials.mtl")  # whoever opens it waits for ever
    (tmp_path / "box.obj").write_text("mtllib materials.mtl\nusemtl any\n" + box)
    assert len(read_mesh(tmp_path / "box.obj", np.eye(4)).triangles) == 12
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "box.3mf").write_bytes(b"PK\x03\x04")
    (tmp_path / "long.stl").write_bytes(bytes(80) + b"\xff\xff\xff\x7f" + bytes(50))
    (tmp_path / "long.ply").write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    for name in ("pipe.stl", "box.3mf", "long.stl", "long.ply", "none.stl"):
        with pytest.raises(GlissandoError, match=r"is not a mesh|has 0 triangles"):
            read_mesh(tmp_path / name, np.eye(4))


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["as it is", "inside out", "one of two turned", "two that overlap"]
)
def test_a_mesh_is_solid_however_its_triangles_turn(kind, tmp_path, rng):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    half, apart = 0.02, np.array([0.02, 0.0, 0.0])
    cube = trimesh.creation.box((2.0 * half,) * 3)
    boxes = [RoundedBox(np.eye(4), np.full(3, half))]
    if kind == "inside out":
        cube.invert()
    elif kind != "as it is":
        moved = cube.copy()
        if kind == "one of two turned":
            apart = 2.5 * apart
            moved.faces = moved.faces[:, ::-1]
        moved.apply_translation(apart)
        cube = trimesh.util.concatenate([cube, moved])
        pose = np.eye(4)
        pose[:3, 3] = apart
        boxes.append(RoundedBox(pose, np.full(3, half)))
    cube.export(tmp_path / "cube.stl")
    mesh = read_mesh(tmp_path / "cube.stl", np.eye(4))
    points = rng.uniform(-0.035, 0.055, (800, 3))
    true = np.min([box.distance(points)[0] for box in boxes], axis=0)
    clear = np.abs(true) > 2e-3
    found = mesh.distance(points)[0][clear]
    assert np.array_equal(found < 0.0, true[clear] < 0.0)
    assert np.all(found < true[clear] + 2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_a_cavity_is_free_and_what_stands_in_it_is_not(turned, tmp_path, rng):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    wall, cavity, island = (trimesh.creation.box((2.0 * h,) * 3) for h in (0.04, 0.025, 0.008))
    cavity.faces = cavity.faces[:, ::-1]
    whole = trimesh.util.concatenate([wall, cavity, island])
    if turned:
        whole.faces = whole.faces[:, ::-1]
    whole.export(tmp_path / "organ.stl")
    mesh = read_mesh(tmp_path / "organ.stl", np.eye(4))
    points = rng.uniform(-0.06, 0.06, (1500, 3))
    far = np.abs(points).max(axis=1)
    true = ((far < 0.04) & (far > 0.025)) | (far < 0.008)
    clear = np.min([np.abs(far - h) for h in (0.04, 0.025, 0.008)], axis=0) > 5e-3
    assert np.array_equal(mesh.distance(points[clear])[0] < 0.0, true[clear])


def test_a_mesh_whose_triangles_disagree_is_refused(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    cube = trimesh.creation.box((0.02, 0.02, 0.02))
    cube.faces[3] = cube.faces[3][::-1]
    cube.export(tmp_path / "cube.stl")
    with pytest.raises(GlissandoError, match="face inwards and others outwards"):
        read_mesh(tmp_path / "cube.stl", np.eye(4))
