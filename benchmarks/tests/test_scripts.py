"""Scripts that are given data nobody has seen: mistakes in a sentence, streams by what they are."""

import json
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import sbc
import tendons
from script import run

FOLDER = Path(__file__).parents[1]
ROD = ["--young", 2e11, "--poisson", 0.33, "--density", 7870, "--radius", 8e-4, "--length", 0.6]


def script(name, *arguments):
    command = [sys.executable, FOLDER / name, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("real_slide.py", ["/nowhere", "--json"], "holds no public recordings"),
        ("real_slide.py", ["--window", 1, 2], "name it with --recording"),
        ("real_slide.py", ["--periods", -1], "seconds above zero"),
        ("real.py", ["--data", "/nowhere", "--learn", "x"], "does not hold the public recordings"),
        ("real.py", ["--recording", "/nowhere", "--learned", "tdcr466"], "no recording folder"),
        ("real.py", ["--window", 1, 2], "name it with --recording"),
        ("tube.py", ["--recording", "/nowhere"], "no recording folder '/nowhere'"),
        ("tube.py", ["/nowhere", "--json"], "holds no public recordings"),
        ("claimed.py", ["/nowhere", "--json"], "is not a folder of recordings"),
        ("sbc.py", ["--sessions", 0], "--sessions is 1 or more"),
        ("contacts.py", ["--touched", 0], "ten shapes or more"),
        ("wrenches.py", ["--shapes", "/nowhere.csv", *ROD], "No such file"),
        ("wrenches.py", ["--shapes", __file__, *ROD], "no two of a head and six a shape"),
        ("wrenches.py", ["--shapes", "x", *ROD, "--young", 200], "--young is 200; give"),
    ],
)
def test_a_mistake_is_a_sentence_and_status_2(name, arguments, said, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:  # what else is raised would be a traceback
        run(import_module(Path(name).stem).main)
    out, err = capsys.readouterr()
    assert ended.value.code == 2
    assert said in err
    assert out == ""


@pytest.mark.slow
def test_bodies_of_any_name_and_order_are_taken_from_the_base_on(spacetime, tmp_path):
    """The base's is never truth, whatever it is called."""
    public, copy = spacetime / "fast_contact", tmp_path / "renamed"
    shutil.copytree(public, copy)
    for i in range(5):
        (copy / f"vicon{i}.csv").rename(copy / f"body{4 - i}.csv")
    options = ["--robot", "tdcr466-segments", "--window", 10, 12, "--periods", 2, "--json"]
    found = [script("real_slide.py", "--recording", f, *options) for f in (public, copy)]
    one, other = (json.loads(each.stdout)["rows"] for each in found)
    assert [row["samples"] for row in one] == [row["samples"] for row in other]
    rmse = [[row["position_rmse"] for row in rows] for rows in (one, other)]
    np.testing.assert_allclose(rmse[0], rmse[1], rtol=0.2)  # rolls are drawn anew


def test_of_one_pattern_blocks_are_stretches_of_time():
    assert tendons._blocks(np.array(["walk"] * 12)).tolist() == sorted([*range(6)] * 2)
    three = tendons._blocks(np.array(["a", "a_hold", "b", "c", "b"]))
    assert three.tolist() == [0, 0, 1, 2, 1]


@pytest.mark.slow
def test_a_recording_nobody_has_seen_is_judged_by_the_sensors_that_it_has(spacetime, tmp_path):
    copy = tmp_path / "a motion of another day"
    shutil.copytree(spacetime / "fast_contact", copy)
    (copy / "gyro_mid.csv").unlink()
    options = ["--learned", "tdcr466", "--recording", copy, "--window", 10, 12]
    (row,) = json.loads(script("real.py", *options, "--json").stdout)["rows"]
    assert row["window"] == [10.0, 12.0]
    assert row["converged"]
    assert 1.0 < row["position"] < 20.0
    printed = script("real.py", *options).stdout.splitlines()[-1]
    assert f"| 10–12 | {row['position']:.2f} | – |" in printed


@pytest.mark.parametrize(
    ("right", "more", "wrong", "passes"),
    [
        ([set(), set()], [], [{"pose"}, set()], True),
        ([set(), set()], [], [set(), set()], False),
        ([{"pose"}, set()], [{"strain"}, {"pose"}], [{"pose"}, {"pose"}], True),
        ([{"pose"}, set()], [{"pose", "strain"}, set()], [{"pose"}, {"pose"}], False),
    ],
)
def test_ranks_are_as_they_must_where_what_is_outside_twice_is_of_wrong_priors(
    right, more, wrong, passes
):
    checks = [
        {
            "prior_factor": factor,
            "estimator": estimator,
            "quantities": [{"name": n, "uniform": n not in out} for n in ("pose", "strain")],
        }
        for factor, each in ((1.0, right), (1.0, more), (1.3, wrong))
        for estimator, out in zip(("batch", "online"), each, strict=False)
    ]
    assert sbc.as_it_must(checks) == passes
