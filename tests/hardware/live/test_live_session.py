"""A live estimate is the replay's, loses nothing that it used, and ends with a sentence."""

import gc
import time
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from glissando.errors import DeviceError, GlissandoError, ImplausibleError
from glissando.estimation.state_estimate import StateEstimate
from glissando.evaluation.replay import replay
from glissando.hardware.live import (
    CsvSink,
    IgtlSource,
    LiveSession,
    Placement,
    RecordingSource,
)
from glissando.hardware.openigtlink import Endpoint
from glissando.io.query_csv import QUERY_COLUMNS
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.model.sensors.sensors import PoseReadings
from live_recordings import (
    ROBOT,
    ROD,
    SPAN,
    pose_messages,
    reading_messages,
    swaying,
    through_wire,
)

PLACES = (Placement("base", 0.0), Placement("tip", ROBOT.length))


def _assert_same(live, replayed):
    assert len(replayed.states) == len(live)
    for update, state in zip(live, replayed.states, strict=True):
        for name in ("pose", "strain", "velocity", "cov"):
            np.testing.assert_allclose(
                getattr(update.newest, name), getattr(state, name), rtol=1e-10, atol=1e-12
            )


@pytest.mark.slow
def test_poses_through_openigtlink_estimate_what_a_replay_of_the_journal_does(tmp_path):
    recording = swaying()
    live = through_wire(pose_messages(recording), tmp_path / "log", PLACES)
    window = live[0].time, live[-1].time
    assert window[0] == SPAN[0]
    _assert_same(live, replay(load_recording(tmp_path / "log"), ROBOT, window=window))
    before = replay(recording, ROBOT, window=window)  # differs by float32 and no more
    gap = max(
        np.abs(u.newest.pose - s.pose).max() for u, s in zip(live, before.states, strict=True)
    )
    assert 1e-12 < gap < 1e-5


@pytest.mark.slow
def test_readings_through_openigtlink_estimate_what_a_replay_of_the_recording_does(tmp_path):
    recording = swaying(1)
    readings, _ = recording.readings(["base", "tip"], ROBOT, SPAN)
    live = through_wire(reading_messages(readings), tmp_path / "log")
    window = live[0].time, live[-1].time
    _assert_same(live, replay(recording, ROBOT, window=window))
    logged = load_recording(tmp_path / "log").streams["tip"].rows
    used = logged.time.size
    np.testing.assert_array_equal(logged.time, recording.streams["tip"].rows.time[:used])
    np.testing.assert_array_equal(logged.arclength, recording.streams["tip"].rows.arclength[:used])


@pytest.mark.slow
def test_a_recording_at_its_pace_is_journaled_whole_and_written_as_csv(tmp_path):
    recording = swaying()
    source = RecordingSource(recording, ROBOT)
    sinks = [CsvSink(tmp_path / "newest.csv")]
    began = time.monotonic()
    with LiveSession(ROBOT, [source], sinks, points=5, journal=tmp_path / "log") as session:
        updates = list(session)
    assert time.monotonic() - began > SPAN[1] - SPAN[0]
    logged = load_recording(tmp_path / "log").streams
    for name, stream in recording.streams.items():
        np.testing.assert_array_equal(logged[name].rows.time, stream.rows.time)
    step = np.diff([u.time for u in updates]) * ROBOT.time_rate
    np.testing.assert_allclose(step, np.round(step), atol=1e-9)
    table = np.genfromtxt(tmp_path / "newest.csv", delimiter=",", names=True)
    assert list(table.dtype.names) == list(QUERY_COLUMNS)
    assert table.size == 5 * len(updates)
    np.testing.assert_allclose(table["x"][4::5], [u.tip[0] for u in updates], atol=1e-9)


def test_a_csv_of_updates_keeps_every_digit_of_a_unix_time(tmp_path):
    state = StateEstimate(np.eye(4)[None], *np.zeros((2, 1, 6)), np.zeros((1, 18, 18)))
    with CsvSink(tmp_path / "newest.csv") as sink:
        sink.send(SimpleNamespace(time=1.7e9 + 1.0 / 3.0, arclength=np.zeros(1), state=state))
    table = np.genfromtxt(tmp_path / "newest.csv", delimiter=",", names=True)
    assert table["time"] == 1.7e9 + 1.0 / 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments", "rod"])
def test_an_update_is_what_the_smoother_says_between_its_nodes(name):
    robot = ROD if name == "rod" else load_robot(name)
    with LiveSession(robot, [RecordingSource(swaying(), robot)], points=17) as session:
        for update in islice(session, 4):
            said = update.smoother.at(update.arclength, update.time)
            for field, value in vars(said).items():
                ours = getattr(update.state, field)
                np.testing.assert_allclose(ours, value, rtol=1e-9, atol=1e-9 * np.abs(value).max())


@pytest.mark.slow
def test_a_collection_of_garbage_holds_no_update_up():
    with LiveSession(ROBOT, [RecordingSource(swaying(), ROBOT)], duration=0.2) as session:
        list(session)
        began = time.thread_time()
        gc.collect()
        assert time.thread_time() - began < 0.01
    assert gc.get_freeze_count() == 0


@pytest.mark.slow
def test_a_journal_of_an_earlier_session_is_refused(tmp_path):
    for again in (False, True):
        source = RecordingSource(swaying(), ROBOT)
        session = LiveSession(ROBOT, [source], journal=tmp_path / "log", duration=0.1)
        if again:
            with pytest.raises(GlissandoError, match="give the journal a new folder"), session:
                pass
        else:
            with session:
                list(session)


class Stamped:
    """A source whose readings are stamped some seconds off; it counts how often it is polled."""

    name, first, clock, finished, problem = "tracker", None, None, False, ""

    def __init__(self, off):
        self.off, self.looks, self.counts = off, 0, {}

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        pass

    def poll(self):
        self.looks += 1

    def read(self, clock):
        now = np.array([clock.now() + self.off])
        tip = np.array([ROBOT.length])
        return [PoseReadings(time=now, arclength=tip, values=np.eye(4)[None], cov=1e-6)]


@pytest.mark.parametrize(("off", "side"), [(3600.0, "ahead of"), (-20.0, "behind")])
def test_a_senders_clock_that_is_off_ends_the_session_with_a_sentence(off, side):
    why = rf"tracker: .* s {side} this computer's clock; set both by NTP.*clock=arrival"
    with LiveSession(ROBOT, [Stamped(off)]) as session, pytest.raises(ImplausibleError, match=why):
        next(iter(session))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* are left out:glissando.errors.EstimateWarning")
def test_a_clock_that_is_set_on_the_way_is_named_once_patience_ends():
    source = Stamped(0.0)
    with LiveSession(ROBOT, [source], rate=20.0, patience=1.0) as session:
        updates = iter(session)
        next(updates)
        source.off = -30.0
        with pytest.raises(DeviceError, match=r"for 1 s \(tracker: .* 30 s behind this computer"):
            list(islice(updates, 100))


@pytest.mark.slow
def test_stamps_ahead_of_this_clock_are_named_though_they_are_used():
    with LiveSession(ROBOT, [Stamped(0.3)], rate=20.0) as session:
        said = list(islice(session, 10))[-1].problems
    assert "s ahead of this computer's clock, so the shape is of another moment" in said[0]


@pytest.mark.slow
def test_readings_from_before_the_window_are_none_unless_updates_wait_for_them():
    why, session = (
        "before the window of 0.2 s: .* give a delay",
        LiveSession(ROBOT, [Stamped(-0.3)], rate=20.0, patience=0.5),
    )
    with session, pytest.raises(DeviceError, match=why):
        list(islice(session, 100))
    with LiveSession(ROBOT, [Stamped(-0.3)], rate=20.0, delay=0.35) as session:
        assert list(islice(session, 10))[-1].problems == ()


@pytest.mark.slow
def test_what_came_during_a_pause_of_its_reader_counts_before_patience_ends():
    with LiveSession(ROBOT, [Stamped(0.0)], rate=20.0, patience=0.3) as session:
        for _ in islice(session, 3):
            time.sleep(0.5)


@pytest.mark.slow
def test_patience_begins_when_no_source_is_busy_any_more():
    class Homing(Stamped):
        busy = True

        def read(self, clock):
            self.busy = self.looks < 100
            self.looks += 1
            return []

    source = Homing(0.0)
    with LiveSession(ROBOT, [source], patience=0.1) as session:
        began = time.monotonic()
        with pytest.raises(DeviceError, match="No source has sent anything usable for 0 s"):
            next(iter(session))
    assert source.looks > 100
    assert time.monotonic() - began > 0.5


def test_sources_are_looked_at_between_updates():
    """A link holds little: what a fast device sends until the next update would be lost.

    A busy host has no time to look where updates are late, so it gets more of them.
    """
    source = Stamped(0.0)
    with LiveSession(ROBOT, [source], rate=2.0) as session:
        for _ in islice(session, 20):
            if source.looks > 10:
                break
    assert source.looks > 10


@pytest.mark.slow
def test_silence_ends_with_a_sentence_and_so_do_wrong_arguments(tmp_path):
    with Endpoint("igtl-server://:0") as peer:
        source = IgtlSource(f"igtl://127.0.0.1:{peer.address.port}", ROBOT, PLACES)
        with (
            LiveSession(ROBOT, [source], patience=0.2) as session,
            pytest.raises(GlissandoError, match="No source has sent anything usable"),
        ):
            next(iter(session))
    wrong = {
        "rate": 0.0, "lag": -1.0, "delay": 60.0, "points": 1, "duration": 0.0, "patience": 0.0,
    }  # fmt: skip
    for name, value in [*wrong.items(), ("duration", np.inf)]:
        with pytest.raises(GlissandoError, match=r"correct|give"):
            LiveSession(ROBOT, [source], **{name: value})
    with pytest.raises(GlissandoError, match="needs a source"):
        LiveSession(ROBOT, [])
    for text in ("tip", "tip=x", "=0.1", "tip=0.1:imu", "tip=0.1:coil:pose"):
        with pytest.raises(GlissandoError, match="NAME=METRES"):
            Placement.parse(text)
    with pytest.raises(GlissandoError, match="in metres"):
        IgtlSource("igtl://:1", ROBOT, [Placement("tip", 466.0)])
    with pytest.raises(GlissandoError, match="placed twice"):
        IgtlSource("igtl://:1", ROBOT, [PLACES[0], PLACES[0]])
