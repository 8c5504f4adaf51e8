"""Exports of trackers are read by their own layout: Motive, Qualisys, NDI."""

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from draws import generators, law, poses
from foreign_files import hole, motive_csv, qualisys_tsv, semicolons
from glissando.errors import RecordingError
from glissando.io.foreign import read_tracks


@law
@given(generators)
def test_a_motive_csv_is_read_back_with_quaternions_or_angles_and_gaps(tmp_path_factory, rng):
    tip, mid, point = poses(rng, 6, largest_angle=3.0), poses(rng, 6), rng.normal(size=(6, 3))
    point[2] = np.nan
    turn, unit = ("Quaternion", "XYZ", "ZYX")[rng.integers(3)], ("Meters", "Millimeters")
    file = tmp_path_factory.mktemp("f") / "take.csv"
    motive_csv(file, {"tip": hole(tip, 2, 5), "mid one": mid}, {"dot": point}, turn=turn,
               unit=unit[rng.integers(2)])  # fmt: skip
    if rng.integers(2):
        semicolons(file)
    found = {t.name: t for t in read_tracks(file)}
    assert list(found) == ["tip", "mid_one", "dot"]
    np.testing.assert_allclose(found["tip"].values, tip[[0, 1, 3, 4]], atol=1e-9)
    np.testing.assert_allclose(found["mid_one"].values, mid, atol=1e-9)
    np.testing.assert_allclose(found["dot"].values, point[[0, 1, 3, 4, 5]], atol=1e-9)
    np.testing.assert_allclose(found["tip"].time, np.array([0, 1, 3, 4]) / 120)
    assert (found["tip"].missing, found["dot"].missing, found["dot"].kind) == (2, 1, "position")
    assert read_tracks(file, rate=60.0)[0].time[-1] == pytest.approx(4 / 60)


@law
@given(generators)
def test_a_qualisys_tsv_is_read_back_as_bodies_or_markers(tmp_path_factory, rng):
    file, titles = tmp_path_factory.mktemp("f") / "take.tsv", bool(rng.integers(2))
    tip, mid = poses(rng, 5, largest_angle=3.0), poses(rng, 5)
    qualisys_tsv(file, {"tip": hole(tip, 1), "mid": mid}, titles=titles)
    first, second = read_tracks(file)
    np.testing.assert_allclose(first.values, tip[[0, 2, 3, 4]], atol=1e-7)
    np.testing.assert_allclose(first.time, np.array([0, 2, 3, 4]) / 100)
    assert (first.kind, first.missing, second.missing) == ("pose", 1, 0)
    points = rng.normal(size=(5, 3))
    gone = points.copy()
    gone[3] = np.nan
    qualisys_tsv(file, {"a": gone, "b": points}, titles=titles)
    first, second = read_tracks(file)
    np.testing.assert_allclose(first.values, points[[0, 1, 2, 4]], atol=1e-9)
    assert (first.kind, first.missing) == ("position", 1)


@pytest.mark.parametrize("poses_of", [poses, lambda rng, n: rng.normal(size=(n, 3))])
def test_frames_of_a_qualisys_tsv_are_its_clock(tmp_path, poses_of):
    tip = {"tip": poses_of(np.random.default_rng(0), 4)}
    file = qualisys_tsv(tmp_path / "take.tsv", tip, frames=[101, 102, 104, 105])
    assert read_tracks(file)[0].time.tolist() == [1.0, 1.01, 1.03, 1.04]
    assert read_tracks(file, rate=50.0)[0].time.tolist() == [2.0, 2.02, 2.06, 2.08]
    qualisys_tsv(file, tip, frames=[1, 2, 2, 3])
    (track,) = read_tracks(file)
    assert (track.time.tolist(), sum(track.dropped.values())) == ([0.0, 0.01, 0.02], 1)
    qualisys_tsv(file, tip, frames=[1, 2, 3, 1])
    with pytest.raises(RecordingError, match="frame or time 1 follows 3"):
        read_tracks(file)


@law
@given(generators)
def test_an_ndi_csv_may_hold_euler_angles(tmp_path_factory, rng):
    tip = poses(rng, 4)
    angles = Rotation.from_matrix(tip[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = [
        ",".join(["Port 1", str(k), "OK", *(repr(float(v)) for v in (*a, *(1e3 * t[:3, 3])))])
        for k, (a, t) in enumerate(zip(angles, tip, strict=True))
    ]
    file = tmp_path_factory.mktemp("f") / "a.csv"
    file.write_text("\n".join(["Port 1,Frame,State,Rz,Ry,Rx,Tx,Ty,Tz", *rows]) + "\n")
    (track,) = read_tracks(file, rate=40.0)
    np.testing.assert_allclose(track.values, tip, atol=1e-9)
