"""Learning robot files: what is moved, what is judged, what is found."""

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from glissando import GlissandoError, cli, estimate, load_robot, predictive, se3, uniform_grid
from glissando import learn as learning
from glissando.learn import learn
from glissando.parameters import Parameter, expanded, learnable, moved
from glissando.predictive import constants_of, predict
from glissando.robot import parse_robot, robot_file, shipped_robots
from glissando.sensors import ROWS, PoseReadings
from glissando.state import State
from glissando.tables import Table, read_document
from scenes import LENGTH, arc

EXAMPLE = Path(__file__).parents[1] / "examples" / "closed_form_motion.py"
NOISE = np.r_[2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2]


def shipped(name):
    return read_document(robot_file(name))


def parsed(document):
    return parse_robot(Table(document, "mine", GlissandoError))


def readings(kind, name, place, time, *, std=NOISE, cov=None, seed=0):
    """Poses of the moving arc, noisy by `std`."""
    place = np.broadcast_to(place, time.shape)
    noise = std * np.random.default_rng(seed).standard_normal((time.size, 6))
    values = arc(place, time) @ se3.exp(noise)
    cov = np.asarray(std) ** 2 if cov is None else cov
    return kind(time=time, arclength=place, values=values, cov=cov, name=name)


@dataclass(frozen=True)
class Arc:
    """A second of the moving arc, seen by trackers of the robot file's noise; truth if asked."""

    judged: bool = False
    most: float = np.inf  # noise above which the readings cannot be had

    def grid(self, robot):
        return uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0)

    def readings(self, robot):
        std = robot.sensor_std["pose"]
        if std[0] > self.most:
            raise GlissandoError("So much noise cannot be.")
        time = np.linspace(0.0, 1.0, 21)
        places = enumerate((0.0, LENGTH / 2, LENGTH))
        return [readings(PoseReadings, f"p{i}", s, time, cov=std**2, seed=i) for i, s in places]

    def truth(self, robot):
        time = np.linspace(0.0, 1.0, 6)
        exact = readings(PoseReadings, "truth", LENGTH, time, std=np.full(6, 1e-4), seed=9)
        return [exact] if self.judged else []


def start(noise=1.0):
    """A robot as slow as the arc, its trackers said to be so many times as noisy as they are."""
    document = expanded(shipped("tdcr466"))
    document["sensors"]["pose"]["std"] = (noise * NOISE).tolist()
    for key in ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength"):
        document["prior"][key] = [1e-3 * v for v in document["prior"][key]]
    return document


class InProcess:
    """Stands for the pool of processes, without any."""

    def __init__(self, workers, context, prepare, given):
        prepare(*given)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def map(self, tried, points):
        return [tried(point) for point in points]


@pytest.fixture
def in_process(monkeypatch):
    monkeypatch.setattr(learning, "ProcessPoolExecutor", InProcess)


# Parameters.


@pytest.mark.parametrize("name", shipped_robots())
def test_writing_pairs_out_leaves_a_robot_as_it_was(name):
    given, written = load_robot(name), parsed(expanded(shipped(name)))
    for part, value in vars(given.prior).items():
        other = getattr(written.prior, part)
        if part == "base":
            value, other = list(vars(value).values()), list(vars(other).values())
        np.testing.assert_array_equal(value, other)
    for kind, std in given.sensor_std.items():
        np.testing.assert_array_equal(std, written.sensor_std[kind])
    for one, other in zip(given.unknowns, written.unknowns, strict=True):
        assert {k: str(v) for k, v in vars(one).items()} == {
            k: str(v) for k, v in vars(other).items()
        }


@pytest.mark.parametrize("name", shipped_robots())
def test_every_learnable_number_of_a_shipped_robot_is_scaled_alone_and_parsed_again(name):
    document = expanded(shipped(name))
    numbers = learnable(document, list(ROWS))
    assert len({p.label for p in numbers}) == len(numbers) > 5
    assert moved(document, numbers, np.zeros(len(numbers))) == document
    before = np.array([p.of(document) for p in numbers])
    for i in range(len(numbers)):
        x = np.zeros(len(numbers))
        x[i] = 0.7
        there = moved(document, numbers, x)
        after = np.array([p.of(there) for p in numbers])
        expected = before * np.exp(x)
        if numbers[i].unit is not None:
            expected[i] = before[i] + 0.7 * numbers[i].unit
        np.testing.assert_allclose(after, expected, rtol=1e-12)
        assert there != document
        parsed(there)


def test_a_factor_acts_on_the_named_entries_only():
    document = {"prior": {"psd": [1.0, 2.0, 3.0, 4.0], "scale": 5.0}, "other": [1.0]}
    some = Parameter("some", ("prior", "psd"), (1, 3))
    number = Parameter("number", ("prior", "scale"), ())
    assert some.of(document) == pytest.approx(np.sqrt(8.0))
    assert number.of(document) == pytest.approx(5.0)
    there = moved(document, [some, number], np.log([10.0, 2.0]))
    assert there["prior"]["psd"] == pytest.approx([1.0, 20.0, 3.0, 40.0])
    assert there["prior"]["scale"] == pytest.approx(10.0)
    assert there["other"] == [1.0]
    assert document["prior"]["psd"] == [1.0, 2.0, 3.0, 4.0]


def test_a_number_that_is_zero_cannot_be_learned_and_is_left_out():
    document = expanded(shipped("tdcr466-segments"))
    before = len(learnable(document, []))
    document["prior"]["var_jumps"][0][5] = 0.0
    parsed(document)
    assert len(learnable(document, [])) == before - 1


# Learning.


def of_label(document, word):
    return [p for p in learnable(document, ["pose"]) if word in p.label]


def test_evidence_finds_the_noise_of_the_readings():
    document = start(noise=3.0)
    numbers = of_label(document, "pose noise")
    assert len(numbers) == 2
    found = learn(document, numbers, [Arc()], steps=8)
    std = np.array(found.document["sensors"]["pose"]["std"])
    assert np.all(np.abs(np.log(std / NOISE)) < np.log(1.3))
    assert found.after.value > found.before.value
    assert found.after.samples == 3 * 21 * 6
    assert np.all((found.std > 0.01) & (found.std < 0.3))
    np.testing.assert_allclose(std / (3.0 * NOISE), np.exp(np.repeat(found.moved, 3)))


def test_foretelling_truth_better_is_what_truth_is_for(in_process):
    document, told = start(noise=10.0), []
    numbers = of_label(document, "pose noise")
    found = learn(document, numbers, [Arc(judged=True)], steps=3, watch=lambda *a: told.append(a))
    assert found.after.value > found.before.value + 0.1
    assert found.before.samples == 3 * 6  # of six times 0.2 s apart, those half a second apart
    assert [step for step, _ in told] == list(range(1, len(told) + 1))
    values = [value for _, value in told]
    assert values == sorted(values)


@pytest.mark.parametrize("far", [1e6, 1e-6])
def test_a_start_that_is_far_off_in_noise_is_no_crash(in_process, far):
    document = start(noise=far)
    found = learn(document, of_label(document, "pose noise"), [Arc()], steps=1)
    assert np.isfinite(found.after.value)
    assert found.after.value >= found.before.value


def test_a_start_that_is_far_off_in_stiffness_is_no_crash(in_process):
    document = start()
    for key in ("psd_strain_arclength", "psd_strain_time"):
        document["prior"][key] = [1e-8 * v for v in document["prior"][key]]
    found = learn(document, of_label(document, "strain time, bending"), [Arc()], steps=1)
    assert np.isfinite(found.after.value)
    assert found.after.value >= found.before.value


def test_a_try_that_cannot_be_estimated_is_a_bad_one_and_not_the_end(in_process):
    document = start(noise=0.3)
    case = Arc(most=0.4 * NOISE[0])
    found = learn(document, of_label(document, "pose noise"), [case], steps=2)
    assert found.document["sensors"]["pose"]["std"][0] <= case.most
    assert found.after.value >= found.before.value
    assert learning._tried(start(noise=1.0)) == learning._BAD
    assert learning._tried(start(noise=0.3)) < learning._BAD


def test_a_start_that_cannot_be_estimated_is_said_to_be(in_process):
    document = start()
    with pytest.raises(GlissandoError, match="So much noise cannot be"):
        learn(document, of_label(document, "noise"), [Arc(most=1e-6)], steps=1)


# Foretelling.


def posterior_of_the_arc():
    time = np.linspace(0.0, 1.0, 21)
    seen = [
        readings(PoseReadings, f"p{i}", s, time, std=np.full(6, 2e-4), seed=i)
        for i, s in enumerate((0.0, LENGTH / 2, LENGTH))
    ]
    return estimate(load_robot("tdcr466").prior, uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0), seen)


TIMES = np.linspace(0.0, 1.0, 6)


def test_the_score_is_the_gaussian_log_likelihood(monkeypatch):
    monkeypatch.setattr(predictive, "_APART", 0.1)
    posterior = posterior_of_the_arc()
    std = np.r_[1e-3, 2e-3, 1e-3, 1e-2, 2e-2, 1e-2]
    truth = [
        readings(PoseReadings, f"t{i}", s, TIMES, std=std, seed=20 + i)
        for i, s in enumerate((0.3, LENGTH))
    ]
    total = 0.0
    for t in truth:
        at = posterior.at(t.arclength, t.time)
        state = State(at.pose, at.strain, at.velocity)
        for residual, by, cov in zip(t.residual(state), t.jacobian(state), at.cov, strict=True):
            total += multivariate_normal.logpdf(residual, cov=by @ cov @ by.T + np.diag(std**2))
    found = predict(posterior, truth, (), free=False)
    assert found.samples == 2 * 6 * 6
    assert found.score == pytest.approx(total / found.samples, rel=1e-9)
    none = [t.select(slice(0, 0)) for t in truth]
    assert predict(posterior, [*truth, *none], (), free=False).score == found.score


def test_the_frame_of_the_truth_and_the_mounts_of_its_bodies_are_found():
    posterior, small = posterior_of_the_arc(), np.full(6, 3e-4)
    true = [
        readings(PoseReadings, name, s, TIMES, std=small, seed=i)
        for i, (name, s) in enumerate((("a", LENGTH / 2), ("b", LENGTH)))
    ]
    frame = np.r_[0.01, -0.005, 0.008, 0.02, -0.04, 0.03]
    mounts = [np.r_[-0.004, 0.006, 0.003, 0.05, 0.03, -0.1], np.r_[0.003, 0, 0.005, 0, 0.08, 0.1]]
    off = [
        replace(t, values=se3.exp(-frame) @ t.values @ se3.exp(mount))
        for t, mount in zip(true, mounts, strict=True)
    ]
    names = constants_of(off)
    assert [c.name for c in names] == ["truth frame", "a mount", "b mount"]
    best = predict(posterior, true, (), free=False)
    raw = predict(posterior, off, names, free=False)
    found = predict(posterior, off, names, free=True)
    assert raw.score < best.score - 10.0
    assert found.score > best.score - 0.05
    # A frame and mounts are told apart by motion alone; what they do together is found exactly.
    turned, *mounted = (se3.exp(c.value) for c in found.constants)
    for t, was, mount in zip(off, true, mounted, strict=True):
        apart = se3.log(se3.inverse(was.values) @ turned @ t.values @ se3.inverse(mount))
        assert np.abs(apart[:, :3]).max() < 2e-3
        assert np.abs(apart[:, 3:]).max() < 1e-2
    for i, each in enumerate([frame, *mounts]):
        alone = [
            replace(t, values=se3.exp(-each) @ t.values if i == 0 else t.values @ se3.exp(each))
            for t in (true if i == 0 else true[i - 1 : i])
        ]
        (one,) = predict(posterior, alone, names[i : i + 1], free=True).constants
        np.testing.assert_allclose(one.value[:3], each[:3], atol=1e-3)
        np.testing.assert_allclose(one.value[3:], each[3:], atol=5e-3)
    assert predict(posterior, off, found.constants, free=False).score == found.score


# The command.


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording whose streams leave their noise to the robot file, and a robot on few nodes."""
    folder = tmp_path_factory.mktemp("recordings") / "arc"
    subprocess.run([sys.executable, EXAMPLE, folder], check=True, capture_output=True)
    text = (folder / "recording.toml").read_text()
    kept = [line for line in text.splitlines() if not line.startswith("std = ")]
    (folder / "recording.toml").write_text("\n".join(kept))
    robot = shipped_text = robot_file("tdcr466").read_text()
    for old, new in (("arclength_nodes = 5", "arclength_nodes = 3"), ("= 30.0", "= 5.0")):
        assert old in robot
        robot = robot.replace(old, new)
    assert robot != shipped_text
    (folder / "few.toml").write_text(robot)
    return folder


def run(*arguments):
    return cli.main([str(a) for a in arguments])


WINDOW = ["--window", 0, 1]


def test_what_was_learned_is_a_robot_file_that_estimate_takes(recording, tmp_path, capsys):
    out = tmp_path / "learned.toml"
    more = ["--truth", "truth2,truth4", "--calibrate", "--hold-out", "truth3", "--json"]
    arguments = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1, *more]
    assert run("learn", recording, *arguments, "--only", "coil noise") == 0
    told = json.loads(capsys.readouterr().out)
    assert {p["name"] for p in told["parameters"]} == {
        "coil noise, linear", "coil noise, angular"
    }  # fmt: skip
    assert told["objective_after"] >= told["objective_before"] - 1e-4  # constants move on
    assert [h["file"] for h in told["held_out"]] == ["before", "after"]
    robot, before = load_robot(out), load_robot(recording / "few.toml")
    for p in told["parameters"]:
        where = slice(0, 3) if "linear" in p["name"] else slice(3, 5)
        np.testing.assert_allclose(robot.sensor_std["coil"][where], p["value"])
        old = before.sensor_std["coil"][where]
        np.testing.assert_allclose(robot.sensor_std["coil"][where] / old, p["factor"])
    np.testing.assert_array_equal(robot.sensor_std["gyro"], before.sensor_std["gyro"])
    assert [u.name for u in robot.unknowns] == ["truth frame", "truth2 mount", "truth4 mount"]
    assert all(u.known for u in robot.unknowns)
    assert run("estimate", recording, "--robot", out, *WINDOW, "--json") == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "tdcr466"


def test_without_json_a_table_is_printed_that_names_the_numbers(
    recording, tmp_path, capsys, in_process
):
    out = tmp_path / "learned.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW, "--steps", 1]
    assert run("learn", recording, *options, "--only", "gyro noise") == 0
    printed = capsys.readouterr().out
    for word in ("What was learned", "gyro noise", "log-likelihood", "Wrote"):
        assert word in printed
    assert load_robot(out).sensor_std["gyro"].shape == (3,)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (["--calibrate"], "name it with --truth"),
        (["--only", "nonsense"], "There is nothing to learn with --only nonsense"),
        (["--steps", 0], "There is nothing to learn with --only"),
        (["--truth", "sonar"], "'sonar'"),
        (["--truth", "truth2", "--hold-out", "truth2"], "cannot be learned from and held out"),
        (["--use", "coil", "--truth", "coil"], "coil"),
        (["--robot", "nobody"], "no robot named 'nobody'"),
        (["--window", 2, 1], "is empty; give T0 < T1"),
        (["--window", 50, 60], "holds no readings"),
    ],
)
def test_a_mistake_is_one_sentence_and_status_2(recording, tmp_path, capsys, changes, sentence):
    out = tmp_path / "learned.toml"
    options = ["--robot", recording / "few.toml", "--out", out, *WINDOW]
    assert run("learn", recording, *options, *changes) == 2
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.startswith("glissando: ")
    assert captured.out == ""
    assert not out.exists()


def test_the_file_to_start_from_is_not_overwritten(recording, tmp_path, capsys):
    own = tmp_path / "own.toml"
    own.write_text((recording / "few.toml").read_text())
    assert run("learn", recording, "--robot", own, "--out", own, *WINDOW) == 2
    assert "is the file to start from; give another name" in capsys.readouterr().err
    assert own.read_text() == (recording / "few.toml").read_text()
    nowhere = tmp_path / "no" / "folder.toml"
    assert run("learn", recording, "--robot", own, "--out", nowhere, *WINDOW) == 2
    assert "is no file in a folder that exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("length = 1.0\n", "[prior] is missing"),
        ("[prior]\nkind = 3\n", "own.toml"),
        ("[prior]\n[sensors.pose]\n", "own.toml"),
        ("[prior]\npsd_strain_arclength = 3\n", "own.toml"),
    ],
)
def test_a_robot_file_that_is_none_is_one_sentence(recording, tmp_path, capsys, text, sentence):
    own = tmp_path / "own.toml"
    own.write_text(text)
    assert run("learn", recording, "--robot", own, "--out", tmp_path / "o.toml", *WINDOW) == 2
    assert sentence in capsys.readouterr().err
