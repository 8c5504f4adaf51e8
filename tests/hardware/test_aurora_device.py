"""The simulated Aurora by itself: its states, its scene, its faults, its travel."""

import socket

import numpy as np
import pytest
from hypothesis import given

from aurora_bench import QUIET, SPEED, tell_tale
from draws import generators, law, sixes
from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.hardware.drivers.aurora_protocol import frame_command, parse_bx, parse_tx
from glissando.hardware.simulated_devices.aurora_device import Device, DeviceIdentity, Sensing
from glissando.hardware.simulated_devices.faults import AuroraFaults, FaultDraws, parse_faults
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.hardware.simulated_devices.travel import MESSAGE, Travel
from glissando.hardware.simulated_devices.vicon import Sender
from glissando.simulation.imperfections import Imperfections


def device(faults="", scene=None, seed=0, **nature):
    scene = tell_tale() if scene is None else scene
    dice, nature = (
        FaultDraws(parse_faults(AuroraFaults, faults), seed),
        DeviceIdentity(0.0, **nature),
    )
    return Device(scene, Sensing(scene, None, 0.0, 0.0, nature.rate), dice, nature)


def say(dev, text, now=1.0):
    """The bytes that answer a command framed with a CRC, or with a space as it stands."""
    data = bytearray(text.encode() + b"\r" if " " in text else frame_command(text))
    return b"".join(reply for _, reply in dev.receive(data, now))


def asked(dev, *texts, now=1.0):
    """The texts of the replies, without their CRCs."""
    return [say(dev, text, now)[:-5].decode() for text in texts]


@pytest.mark.parametrize("begins", [0.0, 5.0])
def test_tracker_and_motion_capture_see_the_same_moment_whenever_a_scene_begins(begins):
    poses = np.tile(np.eye(4), (2, 2, 1, 1))
    poses[:, 1, 2, 3], poses[1, :, 0, 3] = 0.1, 0.05
    coil = SceneCoil(0.1, -1.0, np.eye(4), 0)
    flaws = Imperfections().without("all")
    at = begins + np.array([0.0, 1.0]), np.array([0.0, 0.1])
    scene = Scene(*at, poses, np.eye(4), (coil,), flaws)
    seen = Sensing(scene, None, 100.0, 100.0, 40.0).values(20)[0, 4]
    assert seen == pytest.approx(25.0)
    assert 1e3 * Sender(scene, {"tip": 0.1})._poses(0.5)[0, 0, 3] == pytest.approx(25.0)


READY = ["INIT:", "PINIT:0A", "PINIT:0B", "PENA:0AD", "PENA:0BD"]


def tracking(*arguments, now=1.0, **nature):
    dev = device(*arguments, **nature)
    assert set(asked(dev, *READY, "TSTART:", now=now)) <= {"OKAY", "WARNING01"}
    return dev


@pytest.mark.parametrize(
    ("before", "command", "answer"),
    [
        ([], "VER:0", "ERROR10"),
        ([], "TX:0801", "ERROR10"),
        ([], "RESET:", "RESET"),
        (["INIT:"], "TX:0801", "ERROR0C"),
        (["INIT:"], "BX:0801", "ERROR0C"),
        (["INIT:"], "TSTOP:", "ERROR0C"),
        (["INIT:"], "PENA:0AD", "ERROR0E"),
        (["INIT:"], "PINIT:55", "ERROR08"),
        (["INIT:"], "GETINFO:Features.Firmware.Version", "ERROR01"),
        (["INIT:"], "VER 3", "ERROR23"),
        (["INIT:"], "PHSR:02", "020A0010B001"),
        (["INIT:"], "PHSR 02", "020A0010B001"),
        (["INIT:", "PINIT:0a"], "PHSR:03", "010A011"),
        (["INIT:"], "COMM:50000", "OKAY"),
        (["INIT:"], "COMM:90000", "ERROR06"),
        ([*READY, "TSTART:"], "PINIT:0A", "ERROR0C"),
        ([*READY, "TSTART:"], "VER:0", "ERROR0C"),
        ([*READY, "TSTART:"], "TX:0002", "ERROR23"),
        ([*READY, "TSTART:"], "TSTOP:", "OKAY"),
    ],
)
def test_the_state_decides_the_answer(before, command, answer):
    dev = device()
    asked(dev, *before)
    assert asked(dev, command) == [answer]


@given(generators)
@law
def test_a_bad_crc_is_refused_and_any_bytes_leave_the_device_alive(rng):
    dev = device()
    ((_, reply),) = dev.receive(bytearray(b"INIT:E3A6\r"), 0.0)
    assert reply[:-5] == b"ERROR04"
    held = bytearray()
    for _ in range(20):
        held.extend(
            rng.bytes(30) + rng.choice([b"\r", b"PVWR:0A\r", b"PHINF \r", b"PENA 0\r", b""])
        )
        dev.receive(held, 0.0)
    held.clear()
    assert asked(dev, "INIT:") == ["OKAY"]


def test_the_frame_clock_runs_whether_it_is_asked_or_not_and_shows_its_own_instant():
    dev = tracking()
    ports = [parse_bx(say(dev, "BX:0801", now)).ports[0] for now in (1.001, 1.020, 2.001)]
    first, again, later = ports
    assert again.number == first.number
    assert np.array_equal(again.pose, first.pose)
    assert later.number == first.number + 40
    assert all(np.isclose(p.pose[0, 3], SPEED * p.number / 40.0, atol=1e-7) for p in ports)


def test_without_the_option_a_coil_out_of_the_volume_is_missing():
    dev = tracking("out=1")
    assert parse_tx(say(dev, "TX:0001")).ports[0].missing
    assert parse_tx(say(dev, "TX:0801")).ports[0].out_of_volume


def test_the_second_coil_of_a_plug_shows_after_the_first_is_initialised():
    coils = [SceneCoil(0.1, 0.0, np.eye(4), 0), SceneCoil(0.05, 0.0, np.eye(4), 0, channel=1)]
    dev = device(scene=tell_tale(coils=coils))
    assert asked(dev, "INIT:", "PHSR:02", "PINIT:0A", "PHSR:02")[1::2] == ["010A001", "010B001"]


def test_a_counter_rolls_over():
    dev = tracking("counter=4294967290", now=0.0)
    numbers = [parse_bx(say(dev, "BX:0801", 0.025 * k + 0.01)).ports[0].number for k in range(10)]
    assert numbers == [(4294967290 + k) % 2**32 for k in range(10)]


def test_a_wired_device_takes_the_time_its_baud_rate_gives():
    dev = device(wired=True)
    (_, head), (slow, rest) = dev.receive(bytearray(frame_command("INIT:")), 0.0)
    assert np.isclose(slow, 10 * (10 + len(head + rest)) / 9600)
    dev.receive(bytearray(frame_command("COMM:50000")), 0.0)
    (_, head), (fast, rest) = dev.receive(bytearray(frame_command("PHSR:02")), 0.0)
    assert np.isclose(fast, 10 * (12 + len(head + rest)) / 115200)


def test_a_fault_with_no_name_or_number_is_a_sentence():
    for text in ("nonsense=1", "crc", "crc=often"):
        with pytest.raises(SimulationError, match=r"\.$"):
            parse_faults(AuroraFaults, text)


@given(generators)
@law
def test_a_scene_of_arcs_is_exact_between_its_nodes(rng):
    strain, velocity = sixes(rng, reach=0.3), sixes(rng, angle=0.4)
    time, places = np.sort(rng.uniform(0, 2, 4)), np.sort(rng.uniform(0, 1, 5))
    along = se3.exp(places[:, None] * strain)
    # One velocity at every place holds where strain does not change: T(s, t) = exp(t v) exp(s e).
    scene = tell_tale()
    poses = se3.exp(time[:, None] * velocity)[:, None] @ along
    scene = Scene(time, places, poses, np.eye(4), scene.coils, QUIET)
    for _ in range(5):
        s, t = rng.uniform(places[0], places[-1], 3), rng.uniform(time[0], time[-1])
        truth = se3.exp(t * velocity) @ se3.exp(s[:, None] * strain)
        assert np.allclose(scene.pose(s, t), truth, atol=1e-9)


def test_a_scene_holds_at_its_ends():
    held = tell_tale()
    assert np.array_equal(held.pose([0.1], held.time[-1] + 5), held.pose([0.1], held.time[-1]))


def test_a_saved_scene_is_the_same_scene(tmp_path):
    scene = tell_tale(Imperfections(roll="minimal", jitter=2e-4), seed=5)
    scene.save(tmp_path / "scene.npz")
    again = Scene.load(tmp_path / "scene.npz")
    assert np.array_equal(again.coil_poses(1.0, 0.02), scene.coil_poses(1.0, 0.02))
    assert (again.seed, again.flaws.jitter, again.flaws.roll) == (5, 2e-4, "minimal")


def test_a_scene_that_is_none_is_a_sentence(tmp_path):
    (tmp_path / "text.npz").write_text("no scene")
    np.savez(tmp_path / "short.npz", time=[0.0])
    for name in ("text.npz", "short.npz", "absent.npz"):
        with pytest.raises(SimulationError, match=r"\.$"):
            Scene.load(tmp_path / name)
    with pytest.raises(SimulationError, match="rising"):
        Scene(np.zeros(2), np.arange(2.0), np.zeros((2, 2, 4, 4)), np.eye(4), (), QUIET)


@pytest.mark.parametrize("axis", [[0, 0, 1], [0, 0.6, -0.8], [0, 0, -1]])
def test_the_reported_rotation_has_no_roll_and_keeps_the_axis(axis):
    turn = np.eye(4)
    angle = np.arctan2(-axis[1], axis[2])  # all axes are in the y-z plane
    turn[:3, :3] = se3.so3_exp(angle * np.array([1.0, 0.0, 0.0]))
    dev = tracking("", tell_tale(coils=[SceneCoil(0.1, 0.0, turn, k) for k in range(2)]))
    port = parse_bx(say(dev, "BX:0801")).ports[0]
    assert np.allclose(port.pose[:3, 2], axis, atol=1e-6)
    assert abs(se3.quaternion(port.pose[:3, :3])[3]) < 1e-6


def test_noise_is_white_and_bias_belongs_to_the_place():
    flaws = Imperfections(roll="true", jitter=1e-4, bias=1e-3, bias_angle=0.0, jitter_angle=0.0)
    grid = np.zeros(1), np.array([0.0, 0.1]), np.tile(np.eye(4), (1, 2, 1, 1))
    still = Scene(*grid, np.eye(4), (SceneCoil(0.0, 0.0, np.eye(4), 0),), flaws)
    sensing = Sensing(still, None, 0.0, 0.0, 40.0)
    places = np.array([sensing.values(k)[0, 4:7] for k in range(400)])
    spread = np.sqrt(3.0) * places.std(axis=0).mean()
    assert 0.08 < spread < 0.12
    assert np.linalg.norm(places.mean(axis=0)) > 0.1  # a bias, not noise, is left by averaging


def test_travel_is_interpolated_at_the_instant_and_held():
    travel = Travel(0)
    port = travel.socket.getsockname()[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as servo:
        assert travel.at(0.0) == 0.0
        for k in range(10):
            servo.sendto(MESSAGE.pack(10.0 + 0.005 * k, 0.024 * 0.005 * k), ("127.0.0.1", port))
        servo.sendto(b"noise", ("127.0.0.1", port))
        servo.sendto(MESSAGE.pack(np.nan, 1.0), ("127.0.0.1", port))
        for moment, way in ((10.0125, 0.0125), (10.0475, 0.0475), (9.0, 0.0), (99.0, 0.045)):
            assert np.isclose(travel.at(moment), 0.024 * way, atol=1e-12)
    travel.socket.close()


def test_a_sliding_coil_is_where_the_travel_takes_it():
    scene = tell_tale()
    fixed, slid = scene.coil_poses(0.0, 0.02)
    assert np.isclose(fixed[2, 3], 0.1)
    assert np.isclose(slid[2, 3], 0.05 - 0.02)
    assert np.isclose(scene.coil_poses(0.0, 9.0)[1, 2, 3], 0.0)  # the robot ends there
