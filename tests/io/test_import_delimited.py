"""Any delimited text is read as what the user says its columns hold, or refused with a sentence."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from draws import generators, law, poses
from foreign_files import hole, motive_csv, ndi_csv, qualisys_tsv, semicolons, tracker_csv
from glissando.errors import RecordingError
from glissando.io.foreign import Choices, columns, read_tracks, write_recording
from glissando.io.foreign.columns import parse_mapping, read_path


def test_semicolons_and_decimal_commas_are_read_as_points_and_commas(tmp_path):
    rng = np.random.default_rng(0)
    tip = poses(rng, 5)
    for file in (
        tracker_csv(tmp_path / "a.csv", {"tip": hole(tip, 1)}),
        ndi_csv(tmp_path / "b.csv", {"tip": hole(tip, 1)}, [1, 2, 3, 4, 5]),
    ):
        before = read_tracks(file, rate=50.0)
        after = read_tracks(semicolons(file), rate=50.0)
        np.testing.assert_array_equal(before[0].values, after[0].values)
        np.testing.assert_array_equal(before[0].time, after[0].time)


@pytest.mark.parametrize("row", ["1,00{};0.25;0;0", "1.00{};0,25;0;0", "{};3,177;1.0;0"])
def test_commas_beside_points_are_refused_as_one_of_both_parts_thousands(tmp_path, row):
    lines = "\n".join(row.format(k) for k in range(9))
    (tmp_path / "t.csv").write_text(f"t;x;y;z\n{lines}\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"line 2 .* one of both parts thousands"):
        read_tracks(tmp_path / "t.csv", columns="time=t,x=x,y=y,z=z,length=mm")


def test_numbers_that_nobody_reads_may_have_another_mark(tmp_path):
    lines = "\n".join(f"{k},5;0,25;0;0;2.1;05.11" for k in range(9))
    head = "Tracker;Firmware;1.7\nt;x;y;z;version;date\n"
    (tmp_path / "t.csv").write_text(f"{head}{lines}\n", encoding="utf-8")
    (track,) = read_tracks(tmp_path / "t.csv", columns="time=t,x=x,y=y,z=z,length=mm")
    np.testing.assert_allclose(track.values[:, 0], 0.25e-3)


def test_columns_beyond_the_titles_have_numbers_up_to_those_of_the_rows(tmp_path):
    lines = "\n".join(f"{k},1,2,{k}" for k in range(9))
    (tmp_path / "t.csv").write_text(f"t,x\n{lines}\n", encoding="utf-8")
    (track,) = read_tracks(tmp_path / "t.csv", columns="time=t,x=x,y=3,z=4,length=mm")
    np.testing.assert_allclose(track.values[:, 2], 1e-3 * np.arange(9))
    with pytest.raises(RecordingError, match="has no column '5'; it has t, x"):
        read_tracks(tmp_path / "t.csv", columns="time=t,x=x,y=3,z=5,length=mm")


TURNS = {
    "qw,qx,qy,qz": lambda turn: np.roll(turn.as_quat(), 1, axis=1),
    "rx,ry,rz": lambda turn: turn.as_rotvec(degrees=True),
    "a1,a2,a3": lambda turn: turn.as_euler("zyx", degrees=True),
}


@law
@given(generators)
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_poses_are_read_from_any_columns(tmp_path_factory, delimiter, turn, rng):
    """Columns in any order, named or numbered, in millimetres, degrees and milliseconds."""
    track = poses(rng, 6)
    keys = ["time", "x", "y", "z", *turn.split(",")]
    table = np.column_stack(
        [
            25.0 * np.arange(6) + 7.0,
            1e3 * track[:, :3, 3],
            TURNS[turn](Rotation.from_matrix(track[:, :3, :3])),
        ]
    )
    order = rng.permutation(len(keys))
    names = [f"c_{key}" for key in keys]
    lines = ["# a program's remark", delimiter.join(names[k] for k in order)]
    lines += [delimiter.join(repr(float(row[k])) for k in order) for row in table]
    text = "\n".join(lines) + "\n"
    file = tmp_path_factory.mktemp("f") / "log.txt"
    file.write_text(text.replace(".", ",") if delimiter == ";" else text)
    if rng.integers(2):
        names = [str(1 + list(order).index(k)) for k in range(len(keys))]
    said = ",".join(f"{key}={name}" for key, name in zip(keys, names, strict=True))
    units = {"a1": ",angle=deg,euler=zyx", "rx": ",angle=deg"}  # a quaternion has none
    said += f",clock=ms,length=mm,frame=tracker{units.get(keys[4], '')}"
    (found,) = read_tracks(file, columns=said)
    np.testing.assert_allclose(found.values, track, atol=1e-9)
    np.testing.assert_allclose(found.time, 0.025 * np.arange(6) + 0.007)
    assert (found.name, found.kind, found.frame) == ("log", "pose", "tracker")


XYZ = "time=t,x=x,y=y,z=z"


@pytest.mark.parametrize(
    "text",
    [
        "# t x y z\n0.5 1.5 2 3\n",
        "% t x y z\n0,5 1,5 2 3\n",
        "#t,x,y,z\n0.5,1.5,2,3\n",
        'a "the y" t x y z\n0 0 0.5 1.5 2 3\n',
        "# by A, B, C\n# of D, E\nt\tx\ty\tz\n0,5\t1,5\t2,0\t3,0\n",
        "t x y z\n0,5 1,5 2,0 3,0\n",
        "#,t,x,y,z\n7,0.5,1.5,2,3\n",
        "t,x,y,z,\n0.5,1.5,2,3\n",
    ],
)
def test_titles_name_their_columns_however_they_are_written(tmp_path, text):
    (tmp_path / "log.txt").write_text(text)
    (track,) = read_tracks(tmp_path / "log.txt", columns=XYZ)
    np.testing.assert_array_equal(track.time, [0.5])
    np.testing.assert_array_equal(track.values, [[1.5, 2.0, 3.0]])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_titles_are_read_in_the_encodings_that_exports_have(tmp_path, encoding):
    (tmp_path / "log.csv").write_bytes("Zeit;X µm;Y;Höhe\r\n0,5;1,5;2;3\r\n".encode(encoding))
    (track,) = read_tracks(tmp_path / "log.csv", columns="time=Zeit,x=X µm,y=Y,z=Höhe")
    np.testing.assert_array_equal(track.values, [[1.5, 2.0, 3.0]])


def test_rows_that_share_a_time_are_counted_and_a_clock_too_coarse_is_refused(tmp_path):
    rows = ["t,x,y,z", "1,,,", "1,1,1,1", "1,1,1,1", "1,1,1,2", "2,1,1,2", "3,0,0,0", "3,1,1,3"]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    (track,) = read_tracks(tmp_path / "log.csv", columns=XYZ)
    np.testing.assert_array_equal(track.time, [1.0, 2.0, 3.0])
    assert (track.missing, sorted(track.dropped.values())) == (2, [1, 1])
    (line,) = write_recording([track], tmp_path / "out", Choices({"log": 0.1}))
    assert line.endswith(
        "m, 2 not seen, 1 that repeat another row, 1 with the time of another row but other values"
    )
    (tmp_path / "log.csv").write_text("\n".join([*rows, "3,2,2,2", "3,2,2,3"]))
    with pytest.raises(RecordingError, match="3 of 6 rows have the time of the row before but oth"):
        read_tracks(tmp_path / "log.csv", columns=XYZ)


def test_rows_of_servos_without_a_marker_are_counted(tmp_path):
    rows = ["timestamp,servo_1_mm,tip_x,tip_y,tip_z", "10,1,1,2,3", "11,1,,,", "12,2,1,2,3"]
    (tmp_path / "v4.csv").write_text("\n".join(rows))
    tracks = read_tracks(tmp_path / "v4.csv")
    assert [(t.name, t.missing, t.time.tolist()) for t in tracks] == [
        ("tendons", 1, [10.0, 12.0]),
        ("tip", 1, [10.0, 12.0]),
    ]


def test_a_toml_file_says_it_for_several_objects(tmp_path):
    (tmp_path / "log.csv").write_text(
        "stamp,gx,gy,gz,px,py,pz\n2026-11-22T10:00:00,1,2,3,10,20,30\n"
        "2026-11-22T10:00:00.025,0,0,0,,,\n2026-11-22T10:00:00.050,4,5,6,40,50,60\n"
    )
    (tmp_path / "columns.toml").write_text(
        'time = "stamp"\nlength = "mm"\nangle = "deg"\n'
        '[objects.gyro]\nwx = "gx"\nwy = "gy"\nwz = "gz"\n'
        '[objects."tip marker"]\nx = 5\ny = 6\nz = 7\n'
    )
    gyro, tip = read_tracks(tmp_path / "log.csv", columns=str(tmp_path / "columns.toml"))
    assert (gyro.name, gyro.kind, tip.name, tip.kind) == ("gyro", "gyro", "tip_marker", "position")
    np.testing.assert_allclose(gyro.values, np.deg2rad([[1, 2, 3], [0, 0, 0], [4, 5, 6]]))
    np.testing.assert_allclose(tip.values, [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])
    assert (gyro.missing, tip.missing) == (0, 1)
    np.testing.assert_allclose(np.diff(gyro.time), 0.025, atol=1e-6)
    assert gyro.absolute


def test_frames_that_are_counted_need_their_rate(tmp_path):
    (tmp_path / "a.csv").write_text("n,x,y,z\n10,1,2,3\n11,2,3,4\n")
    said = "count=n,x=x,y=y,z=z"
    with pytest.raises(RecordingError, match="give their rate with --rate"):
        read_tracks(tmp_path / "a.csv", columns=said)
    (track,) = read_tracks(tmp_path / "a.csv", columns=said, rate=100.0)
    np.testing.assert_allclose(track.time, [0.1, 0.11])
    with pytest.raises(RecordingError, match="--rate 100 has no effect"):
        read_tracks(tmp_path / "a.csv", columns="time=n,x=x,y=y,z=z", rate=100.0)
    with pytest.raises(RecordingError, match="clock has no effect on count"):
        read_tracks(tmp_path / "a.csv", columns=f"{said},clock=ms", rate=100.0)


def test_a_path_of_a_slide_is_read_from_its_travel(tmp_path):
    (tmp_path / "stage.csv").write_text("Zeit;Weg\n0,0;0,0\n1,5;20,5\n3,0;60,0\n")
    time, place = read_path(tmp_path / "stage.csv", "time=Zeit,travel=Weg,length=mm,zero=0.7")
    np.testing.assert_allclose(time, [0.0, 1.5, 3.0])
    np.testing.assert_allclose(place, [0.7, 0.6795, 0.64])
    _, place = read_path(tmp_path / "stage.csv", "time=1,travel=2,length=mm,zero=0.1,direction=1")
    np.testing.assert_allclose(place, [0.1, 0.1205, 0.16])
    _, place = read_path(tmp_path / "stage.csv", "time=1,arclength=2,length=mm")
    np.testing.assert_allclose(place, [0.0, 0.0205, 0.06])


@pytest.mark.parametrize(
    ("text", "said", "sentence"),
    [
        ("t,x,y\n1,2,3\n", "time=t,x=x,y=y,z=z", "has no line with the titles t, x, y, z; it begi"),
        ("t,x,y\n1,2,3\n", "time=t,x=x,y=y", "the columns x,y of 'log' make no sensor"),
        ("t,x,y,z\n1,2,3,4\n", "x=x,y=y,z=z", "time is missing"),
        ("t [s] x y z\n1 2 3 4\n", "time=t,x=x,y=y,z=z", "line 1 has 5 titles, and the rows"),
        ("t,x,y,z\n1,2,3,4\n", "time=t,x", "'x' is not KEY=COLUMN"),
        ("t,x,y,z\n1,2,3,4\n", "time=t,x=x,y=y,z=z,angel=deg", "angel is not a column; is angle"),
        ("0,1,2,3\n", "time=0,x=2,y=3,z=4", "has no column '0'; it has 4 columns, numbered from 1"),
        ("0,1,2,3\n", "time=1,x=1,y=3,z=4", "x is the column of the time, 1; give it its own"),
        ("t,x,y,z\n1,2,3,4\n", "time=t,x=x,y=y,z=z,length=inch", "length is 'inch'; give one of"),
        ("t,x,y,z\n1,2,a,4\n", "time=t,x=x,y=y,z=z", "line 2: '2,a,4' is not all numbers"),
        ("t,x,y,z\n2,2,3,4\n1,2,3,4\n", "time=t,x=x,y=y,z=z", "line 3: frame or time 1 follows"),
        ("t,x,y,z,a,b,c\n1,2,3,4,5,6,7\n", "time=t,x=x,y=y,z=z,a1=a,a2=b,a3=c", "say the axes of"),
        ("t,x,y,z,a,b,c,d\n1,2,3,4,5,6,7,8\n",
         "time=t,x=x,y=y,z=z,qw=a,qx=b,qy=c,qz=d", "a quaternion has norm 13.2"),
        ("0,1,2,3\n", "time=1,x=2,y=3,z=4,euler=ZYX", "euler has no effect on columns without"),
        ("0,1,2,3\n", "time=1,x=2,y=3,z=4,angle=deg", "angle has no effect on columns without"),
        ("0,1,2,3\n", "time=1,wx=2,wy=3,wz=4,euler=ZYX", "euler has no effect on columns with"),
        ("0,0.2,0.2,0.2,0.2\n1,1,0,0,0\n",
         "time=1,qw=2,qx=3,qy=4,qz=5", "a quaternion has norm 0.4"),
        ("t,x,y,z,x\n1,2,3,4,5\n", XYZ, "has 2 columns 'x'; give the number of the one"),
        ("2026-11-22,2,3,4\n", "time=1,x=2,y=3,z=4,clock=ms", "has dates for times; leave out"),
        ("1,2,3,4\n", "time=²,x=2,y=3,z=4", "has no line with the titles ²"),
        ("t,x,y,z\n1,2,3,4\n", "time=t,x=x,y=y,z=z,euler=XYX", "euler is 'XYX'"),
        ("0,0,0,0,0,3,1\n1,0,0,0,-38.2,84.9,13.9\n",
         "time=1,x=2,y=3,z=4,rx=5,ry=6,rz=7", "row 1 turns by 84.9 rad, more than a whole turn"),
        ("0,0,0,0,0,3,1\n1,0,0,0,-38.2,84.9,13.9\n",
         "time=1,x=2,y=3,z=4,a1=5,a2=6,a3=7,euler=ZYX", "if these are degrees, say angle=deg"),
        ("t,x,z\n1,2,3\n2,3,4\n", "time=t,x=x,y=x,z=z", "x and y are one column of log.csv"),
    ],
)  # fmt: skip
def test_a_mapping_that_does_not_fit_says_why(tmp_path, text, said, sentence):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(RecordingError, match=re.escape(sentence)):
        read_tracks(tmp_path / "log.csv", columns=said)


@pytest.mark.slow
def test_mutilated_exports_are_read_or_refused_with_a_sentence(tmp_path):
    rng = np.random.default_rng(0)
    tip = {"tip": poses(rng, 4), "mid": poses(rng, 4)}
    whole = [
        motive_csv(tmp_path / "a.csv", tip, {}).read_bytes(),
        qualisys_tsv(tmp_path / "b.tsv", tip).read_bytes(),
        b"t;x;y;z\n0,0;1,5;2;3\n0,1;1;2;3\n0,2;1;2;4\n",
    ]
    refused = read = 0
    for trial in range(600):
        data = bytearray(whole[trial % 3])
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.choice(list(b",\n,;.\tx0-9e\xff\x00 S"))
        (tmp_path / "c.csv").write_bytes(data[: rng.integers(len(data) // 3, len(data) + 1)])
        said = "time=1,x=2,y=3,z=4" if trial % 3 == 2 else ""
        try:
            for found in read_tracks(tmp_path / "c.csv", rate=100.0, columns=said):
                assert np.all(np.isfinite(found.time))
                assert np.all(np.isfinite(found.values))
                assert np.all(np.diff(found.time) > 0)
                assert len(found.time) == len(found.values)
            read += 1
        except RecordingError:
            refused += 1
    assert min(read, refused) > 50


@pytest.mark.parametrize("text", ["Objects 100", "Frame Port Q0", '"Format Version" 1', "NO_OF 1"])
def test_empty_lines_above_text_that_blanks_part_change_nothing(tmp_path, text):
    said = []
    for name, lines in (("a.csv", f"{text}\n1 2 3\n"), ("b.csv", f"\n\n{text}\n1 2 3\n")):
        (tmp_path / name).write_text(lines)
        with pytest.raises(RecordingError) as refusal:
            read_tracks(tmp_path / name, rate=100.0)
        said.append(re.sub(r"\S*[ab]\.csv( line \d)?", "it", str(refusal.value)))
    assert said[0] == said[1]


def test_a_quaternion_of_zeros_is_a_tool_that_was_not_seen(tmp_path):
    text = "t,x,y,z,qw,qx,qy,qz\n0,1,1,1,1,0,0,0\n1,0,0,0,0,0,0,0\n2,1,1,2,1,0,0,0\n"
    (tmp_path / "log.csv").write_text(text)
    said = "time=t,x=x,y=y,z=z,qw=qw,qx=qx,qy=qy,qz=qz"
    (track,) = read_tracks(tmp_path / "log.csv", columns=said)
    assert track.time.tolist() == [0.0, 2.0]
    assert track.missing == 1


def test_a_sensor_of_ones_own_may_have_columns_that_are_nearly_general_keys(monkeypatch):
    own = SimpleNamespace(settings=(), value_columns=lambda _: {"range": "m"})
    monkeypatch.setitem(columns.SENSORS, "ranger", own)
    given = parse_mapping("time=1,range=2", "log")
    assert columns._kind(Path("log.csv"), given, "log", given.objects["log"]) == (
        "ranger",
        ("range",),
    )
