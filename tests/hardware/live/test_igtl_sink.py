"""What a viewer gets is the estimate: frames, surfaces and sigma, in its units and axes."""

import json
import re
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube, tube_faces
from glissando.geometry import se3
from glissando.hardware.live import IgtlSink, LiveSession, RecordingSource
from glissando.hardware.live.igtl_sink import frame_name, readings_message
from glissando.hardware.openigtlink import Endpoint, Message, decode, encode
from glissando.hardware.openigtlink import contents as c
from glissando.model.sensors.sensors import CoilReadings, FbgReadings, PoseReadings
from glissando.model.tendons.channel import Channel
from live_recordings import ROBOT, ROD, swaying
from waiting import until


def _shown(options: str, robot=ROBOT):
    """An update, what acted then, and the contents that a viewer got of it, by device."""
    sink = IgtlSink(f"igtl-server://:0{options}")
    source = RecordingSource(swaying(), robot)
    with ExitStack() as stack:
        session = stack.enter_context(LiveSession(robot, [source], [sink], points=7))
        viewer = stack.enter_context(Endpoint(f"igtl://127.0.0.1:{sink.port}"))
        until(lambda: viewer.receive() or viewer.peers)
        read, updates = [], {}
        for update in session:
            updates[update.stamp] = update, update.loads()
            read += [m for _, m in viewer.receive()]
            stamps = [m.stamp for m in read if m.device == "Robot"]
            if len(stamps) > 12:
                break
    stamp = stamps[-2]  # all of it has come: another followed
    assert stamp in updates
    latest = {(m.device, m.content.type_id): m.content for m in read if m.stamp <= stamp}
    return *updates[stamp], latest


@pytest.mark.slow
def test_frames_line_tube_and_ellipsoids_are_the_estimates():
    update, _, read = _shown("")
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
    draws = np.random.default_rng(0).standard_normal((40_000, 3))
    for shell, cov in zip(shells, update.state.cov_position_world, strict=True):
        hull = ConvexHull(np.linalg.solve(np.linalg.cholesky(cov), shell.T).T)
        inside = np.all(draws @ hull.equations[:, :3].T + hull.equations[:, 3] < 0.0, axis=1)
        assert inside.mean() == pytest.approx(0.95, abs=0.006)
    assert read["Estimate", "STATUS"].code == 1
    assert json.loads(read["Estimate", "STRING"].text)["skipped"] >= 0


@pytest.mark.slow
def test_axes_and_units_are_switched_and_parts_left_out():
    update, _, read = _shown("?axes=lps&unit=m&send=frames")
    assert {device for device, _ in read} == {"Robot"}
    matrices = np.stack([tool.matrix for tool in read["Robot", "TDATA"].tools])
    np.testing.assert_allclose(
        matrices[:, :3, 3], update.state.position * [-1.0, -1.0, 1.0], atol=1e-7
    )
    assert np.all(np.linalg.det(matrices[:, :3, :3]) > 0.999)


@pytest.mark.slow
def test_points_are_sensors_where_they_were_measured_and_forces_where_they_act():
    update, loads, read = _shown("?send=frames,points,status", ROD)
    points = read["Points", "POINT"].points
    sensors = {p.name: p.position for p in points if p.group == "sensors"}
    assert set(sensors) == {"base", "tip"}
    np.testing.assert_allclose(sensors["tip"], 1e3 * update.tip, atol=20.0)
    forces = [p for p in points if p.group == "loads"]
    np.testing.assert_allclose([p.position for p in forces], 1e3 * loads.position, atol=1e-2)
    sizes = np.linalg.norm(loads.wrench.force, axis=1)
    for point, size, std in zip(forces, sizes, loads.std_force, strict=True):
        said = re.fullmatch(r"(\S+) ± (\S+) N", point.name).groups()
        np.testing.assert_allclose([float(x) for x in said], [size, std], rtol=0.05)
    figures = json.loads(read["Estimate", "STRING"].text)["loads"]
    assert [load["arclength"] for load in figures] == [0.3, ROD.length]
    assert len(figures[0]["wrench"]) == len(figures[0]["std"]) == 6


def test_the_bytes_that_the_page_reads_in_matlab_are_the_frames():
    """The page's own indices, which count from one, applied to a message as MATLAB does."""
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "live.md").read_text(encoding="utf-8")
    code = page.partition("t = tcpclient")[2].partition("```")[0]
    head = int(re.search(r"read\(t, (\d+), ", code)[1])
    first, last = map(int, re.search(r"head\((\d+):(\d+)\)", code).groups())
    tool, begin, end = map(int, re.search(r"body\((\d+) \* k \+ \((\d+):(\d+)\)", code).groups())
    poses = se3.exp(np.random.default_rng(3).normal(size=(5, 6)))
    tools = tuple(c.Tool(frame_name(0.1 * k), c.TOOL_6D, pose) for k, pose in enumerate(poses))
    wire = encode(Message(c.TrackingData(tools), "Robot", 1))
    size = int.from_bytes(wire[first - 1 : last], "big")
    body = wire[head : head + size]
    assert len(wire) == head + size
    for k, pose in enumerate(poses):
        numbers = np.frombuffer(body[tool * k + begin - 1 : tool * k + end], ">f4")
        np.testing.assert_allclose(numbers.reshape(3, 4, order="F"), pose[:3], rtol=1e-6)


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


def test_readings_that_an_array_does_not_state_whole_are_not_sent_and_named():
    given = {"time": [0.0], "arclength": [0.1], "cov": 1e-6}
    plain = PoseReadings(values=[np.eye(4)], name="plain", **given)
    turned = plain.changed(name="turned", mount=se3.exp(np.array([0, 0, 0, 0, 0, 1.0])))
    inside = CoilReadings(values=[np.eye(4)], name="inside", channel=Channel(0.004), **given)
    cores = FbgReadings(
        values=np.zeros((1, 3)),
        name="cores",
        core_radius=np.full(3, 1e-4),
        core_angle=np.arange(3.0),
        **given,
    )
    sink = IgtlSink("igtl://127.0.0.1:1?send=readings")
    update = SimpleNamespace(stamp=1, time=0.0, readings=[plain, turned, inside, cores])
    assert [decode(wire).device for wire in sink._readings(update)] == ["plain"]
    why = "not sent (mount, channel or settings)"
    assert sink.counts == {f"{name} {why}": 1 for name in ("turned", "inside", "cores")}


@pytest.mark.parametrize("name", ["caméra de droite très longue", "位置位置位置位置位置位置位置"])
def test_a_stream_may_have_any_name(name):
    """A device's name has 20 bytes; the whole stands in the metadata."""
    readings = PoseReadings(time=[0.0], arclength=[0.1], values=[np.eye(4)], cov=1e-6, name=name)
    message = readings_message(readings, 1)
    assert len(message.device.encode()) <= 20
    assert name.startswith(message.device)
    assert decode(encode(message)).metadata["name"] == name
