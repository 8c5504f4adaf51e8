"""A simulated coil in a channel is where its travel along the path in space leads to."""

from functools import cache

import numpy as np
import pytest

from glissando.geometry import se3
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.io.shipped_robots import robot_file
from glissando.model.tendons.channel import Channel
from glissando.simulation import Tendon, load_bench
from glissando.simulation.channel import poses_in, straight_length

BENCH = load_bench(robot_file("sliding700"))
FINE = np.linspace(0.0, BENCH.rod.length, 3001)
ANY = np.random.default_rng(8)
CHANNELS = [Channel(r, a, p) for r, a, p in zip(ANY.uniform(1e-3, 8e-3, 2), ANY.uniform(-3, 3, 2),
                                                (np.inf, -0.2), strict=True)]  # fmt: skip
TIGHT = Channel(6e-3, 1.0, 0.1)


@cache
def motion():
    return BENCH.move(BENCH.shape("C-to-S"), BENCH.flaws, 5)


def path_in_space(channel, time):
    """Positions along the channel, and the lengths up to each, by chords."""
    turn = channel.angle + 2.0 * np.pi * FINE / channel.pitch
    off = channel.radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    pose = motion().at(FINE, time).pose
    path = pose[:, :3, 3] + np.einsum("nij,nj->ni", pose[:, :3, :3], off)
    return path, np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))


def expected(channel, travel, time):
    """Position and axis of the coil; beyond an end it goes straight on."""
    path, lengths = path_in_space(channel, time)
    axis = np.gradient(path, lengths, axis=0)
    inside = np.clip(travel, 0.0, lengths[-1])
    at = [np.array([np.interp(inside, lengths, x) for x in rows.T]) for rows in (path, axis)]
    return at[0] + (travel - inside) * at[1], at[1]


@pytest.mark.slow
@pytest.mark.parametrize("channel", [*CHANNELS, TIGHT], ids=["straight", "winding", "tightly"])
def test_the_coil_is_where_its_travel_along_the_channel_leads(channel):
    rng, longest = np.random.default_rng(9), straight_length(Tendon.in_channel(channel, 0.7), 0.7)
    time = rng.uniform(0.0, 20.0, 5)
    travel = np.append(rng.uniform(0.0, longest, 4), longest + 3e-3)
    found = poses_in(Tendon.in_channel(channel, 0.7), motion(), travel, time)
    flaws, off = BENCH.flaws.without("all"), []
    for k in range(time.size):
        place, axis = expected(channel, travel[k], time[k])
        off.append(np.linalg.norm(found[k, :3, 3] - place))
        np.testing.assert_allclose(found[k, :3, 2], axis, atol=3e-3)
        coil = SceneCoil(travel[k], -1.0, np.eye(4), port=0, way=channel.to_table())
        scene = Scene.of(motion(), [time[k]], [coil], flaws=flaws)
        seen = scene.coil_poses(0.0, 0.0)[0]
        assert np.linalg.norm(seen[:3, 3] - place) < 4e-4  # a scene has a node every 5 mm
        turned = se3.so3_log(se3.inverse(found[k])[:3, :3] @ seen[:3, :3])
        assert np.linalg.norm(turned[:2]) < 0.02
    assert max(off) < 1.5e-5  # the tight one was 0.15 mm off on a coarse mesh


@pytest.mark.slow
def test_a_scene_keeps_the_channel(tmp_path):
    coil = SceneCoil(0.5, -1.0, np.eye(4), port=0, way=CHANNELS[1].to_table())
    made = Scene.of(motion(), [0.0], [coil], flaws=BENCH.flaws)
    made.save(tmp_path / "scene.npz")
    assert Scene.load(tmp_path / "scene.npz").coils[0].way == coil.way
