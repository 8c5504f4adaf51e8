"""Motion capture over UDP: what is parsed is what was sent, and nothing that comes can hurt."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, poses
from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.hardware.drivers import ViconStream
from glissando.hardware.drivers.vicon import parse_packet
from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices import vicon as sender
from glissando.hardware.simulated_devices.faults import parse_faults
from glissando.hardware.simulated_devices.scene import Scene
from glissando.simulation.imperfections import Imperfections

DRIFT, STRAIN = np.array([0.1, 0, 0, 0, 0, 0.5]), np.array([0, 0, 1.0, 2.0, 0, 0])


def turn(axis, angle):
    """An elementary rotation, written out."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out = np.eye(3)
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def item(name, values, kind=0, size=72):
    return struct.pack("<BH24s6d", kind, size, name.encode(), *values)


def packet(number, *items, count=None):
    return struct.pack("<IB", number, len(items) if count is None else count) + b"".join(items)


TIP = item("tip", [1, 2, 3, 0.1, 0.2, 0.3])


@law
@given(generators)
def test_angles_are_intrinsic_turns_about_x_then_y_then_z_and_lengths_millimetres(rng):
    mm, angles = rng.uniform(-2000, 2000, 3), rng.uniform(-np.pi, np.pi, 3)
    found = parse_packet(packet(7, item("tip", [*mm, *angles])), 1.5)
    pose = found.poses["tip"]
    expected = turn(0, angles[0]) @ turn(1, angles[1]) @ turn(2, angles[2])
    np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-14)
    np.testing.assert_allclose(pose[:3, 3], mm / 1000)
    assert (found.number, found.received, found.problems) == (7, 1.5, {})


@law
@given(generators)
def test_a_pose_that_the_sender_packs_is_parsed_back(rng):
    pose = poses(rng, largest_angle=np.pi)
    scene = Scene(np.zeros(1), np.zeros(1), pose[None, None], np.eye(4), (), Imperfections())
    (data,) = sender.Sender(scene, {"b": 0.0}).datagrams(1, 0.0)
    error = se3.log(se3.inverse(pose) @ parse_packet(data, 0.0).poses["b"])
    assert np.linalg.norm(error[:3]) < 5e-3 * sender.NOISE_MM
    assert np.linalg.norm(error[3:]) < 5 * sender.NOISE_RAD


def test_an_object_of_zeros_is_missing_and_padding_is_no_object():
    found = parse_packet(packet(1, TIP, item("base", [0.0] * 6)) + bytes(300), 0.0)
    assert list(found.poses) == ["tip"]
    assert found.missing == ("base",)
    assert not found.problems


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (packet(1, TIP, count=2), "truncated"),
        (packet(1, TIP, TIP[:-1]), "truncated"),
        (packet(1, TIP, b"\0"), "truncated"),
        (packet(1, TIP, item("x", [1] * 6, kind=3)), "unknown"),
        (packet(1, TIP, b"\0\4\0abcd"), "malformed"),
        (packet(1, TIP, item("x", [np.nan] * 6)), "malformed"),
        (packet(1, TIP, item("x", [1e9] * 6)), "malformed"),
        (packet(1, TIP, item("", [1.0] * 6)), "malformed"),
        (packet(1, TIP, TIP), "malformed"),
    ],
)
def test_what_is_wrong_with_an_item_is_counted_and_the_others_are_kept(data, problem):
    found = parse_packet(data, 0.0)
    assert found.problems == {problem: 1}
    assert found.poses["tip"][0, 3] == 1e-3


@pytest.mark.slow
def test_no_bytes_that_come_can_hurt_the_parser():
    rng = np.random.default_rng(0)
    good = packet(9, TIP, item("base", [0.0] * 6), item("mid", [5, 6, 7, 3, -2, 1]))
    parsed = 0
    for trial in range(15_000):
        if trial % 3 == 0:
            data = rng.bytes(rng.integers(0, 400))
        else:
            data = bytearray(good)
            for at in rng.integers(0, len(good), rng.integers(1, 12)):
                data[at] = rng.integers(256)
            data = bytes(data[: rng.integers(len(good) // 2, len(good) + 1)])
        found = parse_packet(data, 0.0)
        for pose in found.poses.values() if found else ():
            parsed += 1
            assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
            assert np.all(np.abs(pose[:3, 3]) <= 1e3)
    assert parsed > 1000  # or the law has been shown of nothing


@law
@given(st.binary(max_size=400))
def test_a_datagram_is_a_frame_if_and_only_if_it_holds_a_header(data):
    assert (parse_packet(data, 0.0) is None) == (len(data) < 5)


@pytest.fixture
def stream():
    with ViconStream(0, host="127.0.0.1", timeout=0.3) as opened:
        yield opened


def sent(stream, *datagrams):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for data in datagrams:
            out.sendto(data, ("127.0.0.1", stream.port))


def test_frames_come_in_order_with_the_hosts_time_and_what_was_lost_is_counted(stream):
    before = time.monotonic()
    top = 2**32
    sent(stream, *(packet(n % top, TIP) for n in (top - 3, top - 2, top + 1, top - 1, top + 1)))
    sent(stream, b"junk", packet(3, TIP), packet(4, TIP, count=9))
    found = [stream.read() for _ in range(5)]
    assert [f.number for f in found] == [top - 3, top - 2, 1, 3, 4]
    assert all(before <= f.received <= time.monotonic() for f in found)
    assert stream.counts == {
        "lost": 3,
        "out of order": 1,
        "repeated": 1,
        "malformed": 1,
        "truncated": 1,
    }


def test_a_tracker_started_again_is_followed(stream):
    sent(stream, *(packet(n, TIP) for n in (5000, 5001, 1, 2, 900_000)))
    assert [stream.read().number for _ in range(5)] == [5000, 5001, 1, 2, 900_000]
    assert stream.counts == {"restarted": 2}


def test_a_frame_may_come_in_several_datagrams(stream):
    sent(stream, packet(1, TIP), packet(1, item("mid", [1] * 6)), packet(1, TIP), packet(2, TIP))
    found = [stream.read() for _ in range(3)]
    assert [(f.number, *f.poses) for f in found] == [(1, "tip"), (1, "mid"), (2, "tip")]
    assert stream.counts == {"repeated": 1}


@pytest.mark.slow
def test_silence_says_what_to_check_in_tracker(stream):
    with pytest.raises(
        DeviceError, match=rf"Nothing came on UDP port {stream.port} of 127.0.0.1 for 0.3 s; ch"
    ):
        stream.read()
    sent(stream, b"who is there", b"?")
    with pytest.raises(DeviceError, match="2 datagrams came, but no Vicon objects"):
        stream.read()


def test_a_port_in_use_is_named_and_a_closed_stream_says_so(stream):
    with (
        pytest.raises(DeviceError, match=rf"UDP port {stream.port} cannot be listened to \(Addr"),
        ViconStream(stream.port, host="127.0.0.1"),
    ):
        pass
    with pytest.raises(DeviceError, match="UDP port 70000 cannot"), ViconStream(70000):
        pass
    with pytest.raises(DeviceError, match="stream is closed"):
        ViconStream(0).read()


def moving_scene(duration=2.0):
    """A body that goes 0.1 m/s along x and turns, at two arclengths."""
    t, s = np.linspace(0, duration, 21), np.array([0.0, 0.4])
    T_wb = se3.exp(t[:, None, None] * DRIFT) @ se3.exp(s[None, :, None] * STRAIN)
    return Scene(t, s, T_wb, np.eye(4), (), Imperfections())


@pytest.mark.slow
def test_what_a_sender_in_its_own_process_sends_is_received(tmp_path):
    moving_scene(60.0).save(tmp_path / "scene.npz")
    epoch = time.monotonic()
    with ViconStream(0, host="127.0.0.1", timeout=20.0) as stream:
        to = ("--to", f"127.0.0.1:{stream.port}", "--bodies", "tip=0.4,mid=0.1")
        options = ("--scene", tmp_path / "scene.npz", "--epoch", f"{epoch}")
        with started("vicon", *to, *options) as line:
            assert line.startswith("ready")
            frames = [stream.read() for _ in range(60)]
    for frame in frames:
        at = (frame.number - 1) / 100
        assert frame.received >= epoch + at  # never before it is due
        for name, s in (("tip", 0.4), ("mid", 0.1)):
            true = se3.exp(at * DRIFT) @ se3.exp(s * STRAIN)
            error = se3.log(se3.inverse(true) @ frame.poses[name])
            assert np.abs(error[:3]).max() < 1e-3
            assert np.abs(error[3:]).max() < 1e-2


def test_faults_are_what_the_receiver_counts():
    text = "lost=0.1,late=0.1,repeated=0.1,truncated=0.1,occluded=0.3"
    faults = parse_faults(sender.MocapFaults, text)
    made = sender.Sender(moving_scene(), sender.parse_bodies("tip=0.4,mid=0"), faults, seed=1)
    with ViconStream(0, host="127.0.0.1", timeout=0.1) as stream:
        sent(stream, *(data for n in range(1, 150) for data in made.datagrams(n, n / 100)))
        frames = []
        with pytest.raises(DeviceError):
            frames.extend(iter(stream))
    counted = ("lost", "out of order", "repeated", "truncated")
    assert all(stream.counts[name] > 3 for name in counted)
    numbers = [f.number for f in frames]
    assert numbers == sorted(set(numbers))
    assert 0.15 < np.mean([len(f.missing) for f in frames]) / 2 < 0.45


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--bodies", "tip=far"], "give NAME=ARCLENGTH"),
        (["--bodies", "=0.1"], "give each a name of 1 to 24 bytes"),
        (["--bodies", "tip=0.9"], "0.9 lies outside the scene, 0 to 0.4"),
        (["--faults", "gremlins=1"], "'gremlins' is not a fault"),
        (["--scene", "nowhere.npz"], "Scene nowhere.npz cannot be read"),
    ],
)
def test_a_senders_mistake_is_one_sentence_and_status_2(tmp_path, capsys, options, sentence):
    moving_scene().save(tmp_path / "scene.npz")
    given = ["--scene", str(tmp_path / "scene.npz"), "--to", "127.0.0.1:9", "--bodies", "tip=0"]
    assert sender.main([*given, *options]) == 2
    assert sentence in capsys.readouterr().err
