"""What a viewer gets is the estimate: frames, surfaces and sigma, in its units and axes."""

import json
from contextlib import ExitStack

import numpy as np
import pytest

from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube, tube_faces
from glissando.hardware.live import IgtlSink, LiveSession, RecordingSource
from glissando.hardware.live.igtl_sink import frame_name
from glissando.hardware.openigtlink import Endpoint
from live_recordings import ROBOT, swaying
from waiting import until


def _shown(options: str):
    """An update, and the contents that a viewer got of it, by device."""
    sink = IgtlSink(f"igtl-server://:0{options}")
    source = RecordingSource(swaying(), ROBOT)
    with ExitStack() as stack:
        session = stack.enter_context(LiveSession(ROBOT, [source], [sink], points=7))
        viewer = stack.enter_context(Endpoint(f"igtl://127.0.0.1:{sink.port}"))
        until(lambda: viewer.receive() or viewer.peers)
        read, updates = [], {}
        for update in session:
            updates[update.stamp] = update
            read += [m for _, m in viewer.receive()]
            stamps = [m.stamp for m in read if m.device == "Robot"]
            if len(stamps) > 12:
                break
    stamp = stamps[-2]  # all of it has come: another followed
    assert stamp in updates
    latest = {(m.device, m.content.type_id): m.content for m in read if m.stamp <= stamp}
    return updates[stamp], latest


@pytest.mark.slow
def test_frames_line_tube_and_ellipsoids_are_the_estimates():
    update, read = _shown("")
    frames = read["Robot", "TDATA"].tools
    assert [tool.name for tool in frames] == [frame_name(s) for s in update.arclength]
    matrices = np.stack([tool.matrix for tool in frames])
    np.testing.assert_allclose(matrices[:, :3, 3], 1e3 * update.state.position, atol=1e-4)
    np.testing.assert_allclose(matrices[:, :3, :3], update.state.pose[:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(read["Tip", "TRANSFORM"].matrix, matrices[-1], atol=1e-6)
    line, sigma = read["Centreline", "POLYDATA"], 1e3 * update.state.std_position
    np.testing.assert_allclose(line.points, matrices[:, :3, 3], atol=1e-4)
    assert line.lines[0].tolist() == list(range(7))
    np.testing.assert_allclose(line.attributes[0].values[:, 0], sigma, rtol=1e-6)
    tube, ellipsoids = read["Tube95", "POLYDATA"], read["Ellipsoids95", "POLYDATA"]
    assert len(tube.points) == (7 + 10) * 12
    shells = 1e-3 * ellipsoids.points.reshape(7, -1, 3) - update.state.position[:, None]
    inverse = np.linalg.inv(update.state.cov_position_world)
    size = np.sqrt(np.einsum("npi,nij,npj->np", shells, inverse, shells))
    np.testing.assert_allclose(size, SIGMAS_95, rtol=2e-2)
    assert read["Estimate", "STATUS"].code == 1
    assert json.loads(read["Estimate", "STRING"].text)["skipped"] >= 0


def test_axes_and_units_are_switched_and_parts_left_out():
    update, read = _shown("?axes=lps&unit=m&send=frames")
    assert {device for device, _ in read} == {"Robot"}
    matrices = np.stack([tool.matrix for tool in read["Robot", "TDATA"].tools])
    np.testing.assert_allclose(
        matrices[:, :3, 3], update.state.position * [-1.0, -1.0, 1.0], atol=1e-7
    )
    assert np.all(np.linalg.det(matrices[:, :3, :3]) > 0.999)


@pytest.mark.parametrize("around", [3, 12])
def test_a_tube_is_closed_around_and_faces_outwards(around):
    pose = np.tile(np.eye(4), (4, 1, 1))
    pose[:, 2, 3] = np.arange(4)
    rings, ring = confidence_tube(pose, np.tile(0.01 * np.eye(3), (4, 1, 1)), around=around)
    assert rings.shape == (14, around, 3)
    assert ring.tolist() == [0] * 6 + [1, 2] + [3] * 6
    radius = np.linalg.norm(rings[5:9, :, :2], axis=-1)
    np.testing.assert_allclose(radius, 0.1 * SIGMAS_95)
    faces = tube_faces(14, around)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    inner = {(a, b) for a, b in edges.tolist() if around <= min(a, b) and max(a, b) < 13 * around}
    assert all((b, a) in inner for a, b in inner if a // around == b // around)


def test_the_status_says_what_is_silent():
    sink = IgtlSink("igtl://127.0.0.1:1")
    with sink:
        assert sink.problem == "nobody answers at igtl://127.0.0.1:1"
