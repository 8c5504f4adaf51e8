from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from PIL import Image
from scipy.stats import chi2

from glissando import GlissandoError, Grid, PositionReadings, estimate
from glissando.visualization.canvas import canvas
from glissando.visualization.film import film, frames_at, save_animation
from glissando.visualization.film.stage import INCHES, Stage
from scenes import LENGTH, arc, judged_scene

SMALL = {"seconds": 0.5, "rate": 6.0, "width": 200}  # three frames


@pytest.fixture(scope="module")
def scene():
    posterior, readings, (poses,) = judged_scene()
    time, tip = poses.time, np.full(poses.time.size, LENGTH)
    marker = PositionReadings(
        time=time, arclength=tip, values=arc(tip, time)[:, :3, 3], cov=1e-6, name="marker"
    )
    return posterior, readings, [poses, marker]


@pytest.mark.slow
def test_a_gif_has_its_frames_lasts_its_seconds_and_starts_again(scene, tmp_path):
    told = []
    path = save_animation(
        *scene, tmp_path / "new" / "film.gif", **SMALL, progress=lambda *at: told.append(at)
    )
    assert path == tmp_path / "new" / "film.gif"
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (3, (200, 116), 0)
        lasts = 0
        for k in range(3):
            image.seek(k)
            lasts += image.info["duration"]
            assert len(image.convert("RGB").getcolors(10_000)) > 20  # not an empty picture
    assert lasts == 500
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [p.name for p in path.parent.iterdir()] == ["film.gif"]


@pytest.mark.slow
def test_a_motion_is_shown_in_its_own_time_unless_it_is_long(scene, monkeypatch, tmp_path):
    shown = []

    def write(stage, building, *_):
        building.touch()
        shown.append(stage.frames.time)

    monkeypatch.setattr(film, "_write_gif", write)
    save_animation(*scene, tmp_path / "film.gif", width=100)
    monkeypatch.setattr(film, "_LONGEST", 0.5)
    save_animation(*scene, tmp_path / "film.gif", width=100)
    assert [time.size for time in shown] == [12, 6]
    assert all(time[[0, -1]] == pytest.approx([0.0, 1.0]) for time in shown)


def test_without_ffmpeg_an_mp4_becomes_a_gif_beside_it(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(film, "_has_ffmpeg", lambda: False)
    path = save_animation(*scene, tmp_path / "film.mp4", **SMALL)
    assert path == tmp_path / "film.gif"
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]
    with Image.open(path) as image:
        assert image.format == "GIF"


@pytest.mark.skipif(not film._has_ffmpeg(), reason="ffmpeg is not installed")
def test_with_ffmpeg_an_mp4_is_one(scene, tmp_path):
    path = save_animation(*scene, tmp_path / "film.mp4", **SMALL)
    assert path == tmp_path / "film.mp4"
    assert path.read_bytes()[4:8] == b"ftyp"


def test_an_ffmpeg_that_fails_is_one_sentence_and_leaves_nothing(scene, tmp_path):
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    with (
        matplotlib.rc_context({"animation.ffmpeg_path": str(broken)}),
        pytest.raises(GlissandoError, match=r"ffmpeg could not encode .* ends in \.gif"),
    ):
        save_animation(*scene, tmp_path / "film.mp4", **SMALL)
    assert [p.name for p in tmp_path.iterdir()] == ["ffmpeg"]


@pytest.mark.parametrize(
    ("name", "changes", "sentence"),
    [
        ("film.avi", {}, r"film\.avi is not an animation: end it in \.gif or \.mp4\."),
        ("film", {}, "film is not an animation"),
        ("film.gif", {"seconds": 0.0}, "give seconds above 0"),
        ("film.gif", {"seconds": np.nan}, "give seconds above 0"),
        ("film.gif", {"rate": 0.0}, "a rate up to 50"),
        ("film.gif", {"rate": 60.0}, "a rate up to 50"),
        ("film.gif", {"width": 0}, "a width of 100 or more"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(scene, tmp_path, name, changes, sentence):
    with pytest.raises(GlissandoError, match=sentence) as caught:
        save_animation(*scene, tmp_path / name, **{**SMALL, **changes})
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_film_leaves_nothing_and_spoils_nothing(scene, tmp_path):
    def stop(done, frames):
        raise KeyboardInterrupt

    (tmp_path / "film.gif").write_text("an earlier film")
    with pytest.raises(KeyboardInterrupt):
        save_animation(*scene, tmp_path / "film.gif", **SMALL, progress=stop)
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]
    assert (tmp_path / "film.gif").read_text() == "an earlier film"


def test_a_robot_that_stands_still_is_one_frame(scene, tmp_path):
    posterior, readings, truth = scene
    grid = Grid(posterior.grid.arclength, [0.0])
    still = [r.inside(grid) for r in readings[:2]]
    path = save_animation(
        estimate(posterior.prior, grid, still), still, truth, tmp_path / "film.gif", width=200
    )
    with Image.open(path) as image:
        assert image.n_frames == 1


def test_a_sensor_is_where_its_nearest_reading_says(scene):
    posterior, readings, _ = scene
    coil = readings[1].select(slice(None, None, -1))  # in any order
    times = np.array([0.0, 0.06, 0.9, 0.5])  # at the last no reading is within 0.25 s
    frames = frames_at(posterior, [coil], [], times)
    assert frames.sensors == ["coil"]
    hidden = [np.isnan(a[:, 0]).tolist() for a in (frames.place, frames.dot[..., 0])]
    assert hidden == [[False, False, False, True]] * 2
    for k, time in enumerate(times[:3]):
        place = coil.arclength[np.argmin(np.abs(coil.time - time))]
        at = posterior.at(place, time)
        assert frames.place[k, 0] == pytest.approx(1e3 * place)
        assert frames.dot[k, 0] == pytest.approx(1e3 * at.position)
        assert frames.dot_std[k, 0] == pytest.approx(1e3 * at.std_position)


def test_truth_is_shown_where_it_has_a_sample_within_a_tenth_of_a_second(scene):
    posterior, _, truth = scene
    frames = frames_at(posterior, [], truth, np.array([0.1, 0.38, 0.42, 1.0]))
    assert np.isnan(frames.triad[:, 0, 0, 0]).tolist() == [False, False, True, True]
    assert np.isnan(frames.point[:, 0, 0]).tolist() == [False, False, True, True]
    origin, *tips = frames.triad[0, 0]
    true = arc(LENGTH / 2, 0.1)
    assert origin == pytest.approx(1e3 * true[:3, 3])
    assert (np.array(tips) - origin) / np.linalg.norm(tips[0] - origin) == pytest.approx(
        true[:3, :3].T
    )
    assert frames.point[0, 0] == pytest.approx(1e3 * arc(LENGTH, 0.1)[:3, 3])


def test_the_tube_holds_95_percent_across_the_body_at_every_arclength(scene):
    posterior = scene[0]
    frames = frames_at(posterior, [], [], np.array([0.25, 0.8]))
    count = frames.arclength.size
    extra = (frames.tube.shape[1] - count) // 2
    at = posterior.at(1e-3 * frames.arclength, frames.time[:, None])
    off = 1e-3 * frames.tube[:, extra:-extra] - at.position[:, :, None]
    body = off @ at.pose[..., :3, :3]
    assert body[..., 2] == pytest.approx(0.0, abs=1e-12)
    weight = np.linalg.inv(at.position_covariance()[..., :2, :2])
    squared = np.einsum("fnai,fnij,fnaj->fna", body[..., :2], weight, body[..., :2])
    assert squared == pytest.approx(chi2.ppf(0.95, 3))


def test_everything_is_found_in_one_query(scene):
    posterior, readings, truth = scene
    asked = []

    class Counting(type(posterior)):
        def at(self, arclength, time):
            asked.append(np.broadcast(arclength, time).size)
            return super().at(arclength, time)

    fields = {name: getattr(posterior, name) for name in posterior.__dataclass_fields__}
    frames = frames_at(Counting(**fields), readings, truth, np.linspace(0.0, 1.0, 5))
    assert asked == [5 * (frames.arclength.size + len(readings))]


def test_no_sensor_and_no_truth_is_still_a_film(scene, tmp_path):
    posterior, readings, _ = scene
    later = replace(readings[1], time=readings[1].time + 9.0)  # none of it on the grid
    path = save_animation(posterior, [later], [], tmp_path / "film.gif", **SMALL)
    assert path.stat().st_size > 1000


def test_every_axis_of_a_film_names_its_unit(scene):
    times = np.array([0.0, 0.5])
    with canvas(*INCHES) as figure:
        stage = Stage(figure, frames_at(*scene, times), 200, 1.0)
        three = (stage.space.xaxis, stage.space.yaxis, stage.space.zaxis)
        flat = [a for panel in figure.subfigs for a in panel.axes if a is not stage.space]
        axes = [*three, *(axis for a in flat for axis in (a.xaxis, a.yaxis))]
        assert len(axes) == 7
        assert all(a.get_label_text().endswith((" (mm)", " (s)")) for a in axes)


@pytest.mark.parametrize("times", [[0.25, 0.5], [0.5, 0.75, 1.0], [0.5]])
def test_the_map_over_time_shows_the_film_s_times_and_no_others(scene, times):
    with canvas(*INCHES) as figure:
        stage = Stage(figure, frames_at(*scene, np.array(times)), 200, 1.0)
        shown = times if len(times) > 1 else [times[0] - 0.5, times[0] + 0.5]
        assert stage.cursor.axes.get_xlim() == pytest.approx((shown[0], shown[-1]))
