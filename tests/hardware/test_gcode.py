"""A stage on a GRBL controller follows its path, stays in its stroke, and stands when it must."""

import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.capture import Coil, FurtherStage, Rig, capture, load_rig, write_recording
from glissando.hardware.drivers import Aurora, GcodeSlide, GcodeStage
from glissando.hardware.drivers.gcode import parse_status
from glissando.hardware.openigtlink import Endpoint, Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.grbl import Grbl
from glissando.io.recording_folder import load_recording
from glissando.io.session_log import read_session
from glissando.model.slide_path import SlideLimits, SlidePath
from waiting import until

pytestmark = pytest.mark.alone

STAGE = GcodeStage(stroke=(0.0, 0.06), home=-0.001)


@pytest.mark.slow
def test_a_homed_stage_follows_a_path_and_reports_where_it_was():
    time_ = np.arange(0.0, 1.5, 0.01)
    travel = 0.005 + 0.005 * (1.0 - np.cos(2.0 * np.pi * time_ / 1.5))
    with started("grbl", "--locked") as address, GcodeSlide(address, STAGE) as slide:
        with pytest.raises(DeviceError, match="Home it first"):
            slide.move(0.01)
        slide.home_at_stop()
        assert slide.read().travel == pytest.approx(0.0, abs=1e-6)
        readings = list(slide.follow(time_, travel))
        assert slide.read().travel == pytest.approx(travel[-1], abs=1e-5)
    on_way = [r for r in readings if r.time - readings[0].time < 1.5]
    assert len(on_way) > 20
    off = [r.travel - np.interp(r.time - readings[0].time, time_, travel) for r in on_way]
    assert np.abs(off).max() < 1e-3


@pytest.mark.parametrize("wanted", [lambda t: -0.001, lambda t: 0.061, lambda t: np.nan])
def test_a_goal_outside_the_stroke_is_never_sent(wanted):
    with started("grbl") as address, GcodeSlide(address, STAGE) as slide:
        slide.home_here(0.0)
        with pytest.raises(DeviceError, match="outside the stroke"):
            list(slide.pursue(wanted, 1.0))
        assert slide.read().travel == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_leaving_the_loop_stops_the_stage_and_keeps_its_position():
    with started("grbl") as address, GcodeSlide(address, STAGE) as slide:
        slide.home_here(0.0)
        path = slide.pursue(lambda t: min(0.02 * t, 0.06), 3.0)
        for reading in path:
            if reading.travel > 0.004:
                path.close()
                break
        stood = slide.read().travel
        time.sleep(0.2)
        assert slide.read().travel == stood < 0.012
        assert slide.move(0.0)[-1].travel == pytest.approx(0.0, abs=1e-5)


def test_homing_believes_no_single_answer(monkeypatch):
    with started("grbl") as address, GcodeSlide(address, STAGE) as slide:
        answers = iter([8.0, 0.0, 0.0])
        line, asked = slide._line, slide._line.status
        monkeypatch.setattr(line, "status", lambda: (asked()[0], asked()[1] + next(answers, 0.0)))
        slide.home_here(0.03)
        assert slide.read().travel == pytest.approx(0.03, abs=1e-6)
        answers = iter(np.arange(1.0, 9.0))
        with pytest.raises(DeviceError, match="let it come to rest"):
            slide.home_here(0.03)


@pytest.mark.slow
def test_a_noisy_line_is_counted_and_survived_and_a_dead_one_is_a_sentence():
    with (
        started("grbl", "--faults", "lost=0.1,corrupt=0.2", "--seed", "4") as address,
        GcodeSlide(address, STAGE) as slide,
    ):
        slide.home_here(0.0)
        assert max(abs(slide.read().travel) for _ in range(60)) < 1.1e-3
        assert slide.counts["missing"] > 0
        assert slide.counts["corrupt"] > 0
    with (
        started("grbl", "--faults", "dead=20") as address,
        pytest.raises(DeviceError, match=r"did not (state its position|answer)"),
    ):
        _pursue(address)


def _pursue(address):
    with GcodeSlide(address, STAGE) as slide:
        slide.home_here(0.0)
        list(slide.pursue(lambda t: 0.01 * t, 3.0))


@pytest.mark.slow
def test_an_alarm_loses_the_position_until_the_stage_is_homed_again():
    with (
        started("grbl", "--faults", "alarm=30") as address,
        GcodeSlide(address, STAGE) as slide,
    ):
        slide.home_here(0.0)
        with pytest.raises(DeviceError, match=r"alarm|ALARM|Alarm"):
            list(slide.pursue(lambda t: 0.01 * t, 3.0))
        with pytest.raises(DeviceError, match="Home it first"):
            slide.read()
        slide.home_here(0.02)
        assert slide.read().travel == pytest.approx(0.02, abs=1e-5)


@pytest.mark.slow
def test_a_controller_that_restarts_on_the_way_must_be_homed_again():
    with (
        started("grbl", "--faults", "restart=60") as address,
        GcodeSlide(address, STAGE) as slide,
    ):
        slide.home_here(0.0)
        with pytest.raises(DeviceError, match="restarted and lost its position"):
            list(slide.pursue(lambda t: 0.01 * t, 3.0))
        with pytest.raises(DeviceError, match="Home it first"):
            slide.read()


@pytest.mark.slow
def test_what_no_controller_says_is_refused():
    for line in (b"", b"ok", b"<Idle|WPos:1,2,3>", b"<Idle|MPos:1,x>", b"<Idle>"):
        with pytest.raises(DeviceError, match="machine position"):
            parse_status(line)
    assert parse_status(b"<Alarm:11|MPos:1.0,2.0,3.0|FS:0,0>")[0] == "Alarm"  # of grblHAL
    with pytest.raises(DeviceError, match="No GRBL controller answers"), started("servo") as other:
        GcodeSlide(other, STAGE).__enter__()
    for wrong in ({"stroke": (0.06, 0.0)}, {"speed": 0.0}, {"axis": "Q"}, {"stroke": (0.0, 60.0)}):
        with pytest.raises(DeviceError):
            GcodeStage(**{"stroke": (0.0, 0.06), **wrong})


def test_the_simulated_axis_keeps_its_speed_and_acceleration():
    device, now = Grbl(acceleration=200.0), 0.0
    device.receive(b"$J=G53G90G21X30.0F1200\n", now)
    places = [device.advance(0.002 * k) for k in range(1500)]
    speed = np.diff(places) / 0.002
    assert places[-1] == 30.0
    assert np.abs(speed).max() <= 20.0 + 1e-6
    assert np.abs(np.diff(speed[:600])).max() / 0.002 <= 201.0
    assert device.receive(b"$J=G53G90G21X99.0F1200\n", 9.0) == [b"error:15\r\n"]
    assert device.receive(b"G1 X3\n", 9.0) == [b"error:16\r\n"]
    assert device.receive(b"$J=G90G21X30.0F1200\n", 9.0) == [b"ok\r\n"]  # work coordinates
    assert device.advance(12.0) == 30.0 + device.work
    device.receive(b"$J=G53G90G21X60.0F1200\n$J=G53G90G21X0.0F1200\n", 12.0)
    assert device.receive(b"!", 12.5) == []
    assert device.state == "Jog"  # it slows down
    held = device.advance(13.0)
    assert device.state == "Idle"
    assert held == device.advance(14.0) < 60.0


def test_a_setup_file_names_a_grbl_stage_and_an_openigtlink_tracker(tmp_path):
    (tmp_path / "bench.toml").write_text("""
name = "bench"
robot = "sliding700"
[tracker]
address = "igtl://127.0.0.1:18944"
[[tracker.coils]]
name = "CoilToTracker"
arclength = 0.7
[[tracker.coils]]
name = "OuterToTracker"
arclength = 0.5
slide = "outer"
[slide]
protocol = "grbl"
address = "/dev/ttyACM0"
stroke = [0.0, 0.06]
axis = "Y"
standing = 0.0
[[slides]]
name = "outer"
protocol = "grbl"
address = "/dev/ttyACM1"
stroke = [0.0, 0.1]
home = -0.001
""")
    rig = load_rig(tmp_path / "bench.toml")
    assert rig.stage == GcodeStage(stroke=(0.0, 0.06), axis="Y")
    assert rig.tracker == "igtl://127.0.0.1:18944"
    (outer,) = rig.further
    assert (outer.name, outer.stage.stroke, outer.standing) == ("outer", (0.0, 0.1), None)
    assert [coil.slide_topic for coil in rig.coils] == ["/slide", "/slide/outer"]


@pytest.mark.slow
def test_an_experiment_with_two_stages_and_such_a_tracker_becomes_a_recording(tmp_path):
    over = threading.Event()
    names = ("inner", "outer")
    with (
        started("grbl") as first, started("grbl") as second, Endpoint("igtl-server://:0") as plus,
    ):  # fmt: skip

        def track() -> None:
            while not over.is_set():
                now = time.time()
                pose = np.eye(4)
                pose[:3, 3] = 700.0, 10.0 * np.sin(now), 0.0
                tools = tuple(c.Tool(name, c.TOOL_5D, pose) for name in names)
                plus.receive()
                plus.send([encode(Message(c.TrackingData(tools), "plus", stamp_of(now)))])
                over.wait(0.025)

        coils = Coil("inner", 0.7), Coil("outer", 0.5, slide="outer")
        rig = Rig(
            "bench", "sliding700", f"igtl://127.0.0.1:{plus.address.port}", coils, first, STAGE,
            0.0, further=(FurtherStage("outer", second, STAGE, 0.0),),
        )  # fmt: skip
        limits = SlideLimits(0.06, 0.024, 0.1)
        paths = SlidePath.oscillate(1, 0.02, limits), SlidePath.oscillate(1, 0.01, limits)
        thread = threading.Thread(target=track)
        thread.start()
        try:
            capture(rig, paths[0], tmp_path / "session", further={"outer": paths[1]})
        finally:
            over.set()
            thread.join()
        with GcodeSlide(second, STAGE) as stands:  # the port is free again
            stands.home_here(0.0)
            assert stands.read().speed == 0.0
    session = read_session(tmp_path / "session" / "session.mcap")
    write_recording(session, rig, tmp_path / "session")
    streams = load_recording(tmp_path / "session").streams
    for name, lowest in (("inner", 0.68), ("outer", 0.49)):
        rows = streams[name].rows
        assert rows.time.size > 30
        assert rows.arclength.min() == pytest.approx(lowest, abs=1e-3)
        np.testing.assert_allclose(rows.values[:, 0, 3], 0.7, atol=1e-6)


@pytest.mark.slow
def test_a_peer_that_floods_is_given_up_soon():
    """Bytes without end are no answer: to an Aurora's start, and to a controller's."""
    over = threading.Event()

    def flood(server):
        while not over.is_set():
            with suppress(OSError):
                peer, _ = server.accept()
                with peer:
                    while not over.is_set():
                        peer.sendall(b"\r\nnoise" * 4096)

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(1.0)
        thread = threading.Thread(target=flood, args=(server,))
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        begun = time.monotonic()
        try:
            with pytest.raises(DeviceError):
                Aurora(address, patience=1.0).__enter__()
            with pytest.raises(DeviceError):
                GcodeSlide(address, GcodeStage(stroke=(0.0, 0.06))).__enter__()
        finally:
            over.set()
            thread.join()
    assert time.monotonic() - begun < 20.0


def _homing_until_reset(server, answer, heard):
    """A controller that heeds nothing but a reset while it homes."""
    peer, _ = server.accept()
    homing = False
    with peer, suppress(OSError):
        while data := peer.recv(64):
            for byte in data:
                if byte == 0x18:
                    heard.append("reset while homing" if homing else "reset")
                    homing = False
                    peer.sendall(b"\r\nGrbl 1.1h ['$' for help]\r\n")
                elif byte == ord("H"):
                    homing = True
                elif byte == ord("?"):
                    peer.sendall(answer if homing else b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n")
    heard.append("homes on" if homing else "stands")


@pytest.mark.slow
@pytest.mark.parametrize("answer", [b"", b"<Home|MPos:0.000,0.000,0.000|FS:0,0>\r\n"])
def test_leaving_while_it_homes_ends_the_homing(answer):
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=_homing_until_reset, args=(server, answer, heard))
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with suppress(KeyboardInterrupt), GcodeSlide(address, STAGE) as slide:
            slide.home_here(0.0)
            slide._line._link.write(b"$H\n")
            raise KeyboardInterrupt
        thread.join()
    assert heard == ["reset", "reset while homing", "stands"]


@pytest.mark.slow
def test_another_thread_aborts_a_homing_by_a_reset():
    heard, ended = [], []
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=_homing_until_reset, args=(server, b"", heard))
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with GcodeSlide(address, STAGE) as slide:

            def home():
                with pytest.raises(DeviceError, match="has restarted and lost its position"):
                    slide.home_at_stop()
                ended.append(True)

            homing = threading.Thread(target=home)
            homing.start()
            until(lambda: slide._homing)
            time.sleep(0.2)
            slide.abort()
            homing.join(5.0)
            with pytest.raises(DeviceError):
                slide.read()
        thread.join()
    assert ended == [True]
    assert heard == ["reset", "reset while homing", "stands"]
