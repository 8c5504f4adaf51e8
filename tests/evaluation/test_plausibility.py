"""The guard: what is right passes, and mistakes with random parameters are named."""

import re
from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, PoseReadings, load_robot, se3
from glissando.errors import GlissandoError, ImplausibleError, OutsideGridError
from glissando.evaluation.plausibility.examine import examine
from glissando.evaluation.plausibility.finding import CHECKS, Finding, refuse
from glissando.evaluation.plausibility.noise import check_noise
from glissando.evaluation.plausibility.reach import out_of_reach
from scenes import LENGTH, arc

RNG = np.random.default_rng(7)


def found(robot, sensors, truth=(), frames=None, **options):
    return {f.name: f for f in examine(robot, sensors, truth, frames=frames, **options)}


def raw(reading, frame, change):
    """Readings with their poses changed as the file has them."""
    return reading.changed(values=frame @ change(se3.inverse(frame) @ reading.values))


def scaled(pose, factor):
    out = pose.copy()
    out[..., :3, 3] *= factor
    return out


def cycled(pose):
    out = pose.copy()
    order = se3.quaternion(pose[..., :3, :3])[..., [1, 2, 3, 0]]
    out[..., :3, :3] = se3.rotation_from_quaternion(order)
    return out


def test_a_right_session_passes_with_and_without_truth(session):
    robot, sensors, truth, frames = session
    assert not found(robot, sensors, truth, frames, window=(0.0, 5.0))
    assert not found(robot, sensors)


def test_a_base_that_may_move_so_far_is_not_out_of_reach():
    """Of a robot that is inserted, as a file with a base known to 30 mm only says."""
    robot, time = load_robot("tdcr466-segments"), np.arange(0.0, 4.0, 0.05)
    place = np.tile(np.eye(4), (time.size, 1, 1))
    place[:, 2, 3] = 0.037 * (1.0 - np.cos(time * np.pi / 2))
    base = PoseReadings(time=time, arclength=0.0, values=place, cov=1e-6, name="base")
    assert out_of_reach(robot, base).any()
    prior = replace(robot.prior, base=replace(robot.prior.base, pose=np.full(6, 9e-4)))
    assert not out_of_reach(replace(robot, prior=prior), base).any()
    kinematic = load_robot("tdcr466")
    assert out_of_reach(kinematic, base).any()
    known = replace(kinematic.prior.base, pose=np.full(6, 9e-4 / kinematic.time_rate))
    prior = replace(kinematic.prior, base=known)
    assert not out_of_reach(replace(kinematic, prior=prior), base).any()


def test_noise_of_a_coil_is_seen_whatever_its_roll():
    """A tracker of five degrees of freedom may report any."""
    time, std = np.arange(0.0, 8.0, 0.025), np.repeat([7e-4, 6e-3], [3, 2])
    error, roll = np.zeros((2, time.size, 6))
    error[:, :5] = std * RNG.standard_normal((time.size, 5))
    roll[:, 5] = RNG.uniform(-np.pi, np.pi, time.size)
    place = np.full(time.size, LENGTH)
    values = arc(place, time) @ se3.exp(error) @ se3.exp(roll)
    coil = CoilReadings(time=time, arclength=place, values=values, cov=std**2, name="coil")
    assert not list(check_noise([coil], LENGTH))
    surer = replace(coil, cov=np.repeat([std[0], 4e-4], [3, 2]) ** 2)
    (finding,) = check_noise([surer], LENGTH)
    assert "rad in angles, less than such sensors err" in finding.sentence


def test_a_stream_far_from_the_base_is_refused_whatever_else_is_wrong(session):
    robot, sensors, truth, frames = session
    shifted = np.eye(4)
    shifted[0, 3] = 0.4
    sensors = [s.changed(values=shifted @ s.values) if s.kind == "coil" else s for s in sensors]
    truth = [truth[0].changed(values=scaled(truth[0].values, 1e3)), *truth[1:]]
    refused = [f for f in found(robot, sensors, truth, frames).values() if f.refusal]
    assert any(truth[0].label in f.streams for f in refused)


@pytest.mark.parametrize(
    ("place", "said"), [(0.0, "the base probably moves"), (0.4, "it probably slides")]
)
def test_what_moves_along_its_axis_at_one_arclength_slides_unless_it_is_the_base(place, said):
    time = np.arange(0.0, 10.0, 0.025)
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = place + 0.05 * np.sin(time)
    fields = {"time": time, "arclength": np.full(time.size, place), "name": "moved"}
    read = PoseReadings(**fields, values=pose, cov=np.full(6, 1e-6))
    assert said in found(load_robot("sliding700"), [read])["slide"].sentence


def test_a_stream_that_reads_many_places_of_a_robot_at_rest_does_not_move():
    robot = load_robot("sliding700")
    time = np.repeat(0.05 * np.arange(20), 3)
    at = {"time": time, "arclength": np.tile([0.2, 0.45, 0.7], 20)}
    read = PoseReadings(**at, values=arc(at["arclength"], 2.0), cov=np.full(6, 1e-6), name="many")
    assert "speed" not in found(robot, [read])


MISTAKES = {
    "length-unit": lambda c, f: raw(c, f, lambda p: scaled(p, 1e3)),
    "quaternion": lambda c, f: raw(c, f, cycled),
    "frame": lambda c, f: c.changed(values=se3.inverse(f) @ se3.inverse(f) @ c.values),
    "mount": lambda c, f: c.changed(values=c.values @ se3.exp(np.array([0, 0, 0, 0, 1.57, 0]))),
    "slide": lambda c, f: c.changed(arclength=c.arclength.min() + c.arclength.max() - c.arclength),
    "time-unit": lambda c, f: c.changed(time=1e3 * c.time),
    "sampling": lambda c, f: c.select(np.repeat(np.arange(len(c)), 2)),
    "noise": lambda c, f: c.changed(cov=1e6 * c.cov),
    "clock": lambda c, f: c.changed(time=c.time + 1.7e9),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_with_the_coil_is_named(session, name):
    robot, (coil,), truth, frames = session
    frame = frames["coil"]
    wrong, stated = MISTAKES[name](coil, frame), se3.inverse(frame) if name == "frame" else frame
    finding = found(robot, [wrong], truth[::3], {"coil": stated})[name]
    assert finding.streams == ("coil",) or name == "clock"
    assert finding.name in CHECKS
    assert "probably" in finding.sentence
    assert ";" in finding.sentence, "what to do"


@pytest.mark.parametrize(("late", "word"), [(0.4, "later"), (-0.4, "earlier")])
def test_a_slide_on_a_clock_of_its_own_is_said_to_come_late_or_early(late, word):
    time = np.arange(0.0, 20.0, 0.025)
    place = 0.4 + 0.05 * np.sin(0.5 * np.pi * np.array([time, time - late]))
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, :3, 3] += RNG.normal(0.0, 2e-4, (time.size, 3))
    pose[:, 2, 3] += place[0]
    fields = {"time": time, "arclength": place[1], "values": pose, "name": "coil"}
    coil = CoilReadings(**fields, cov=np.full(5, 1e-6))
    said = found(load_robot("sliding700"), [coil])["slide"].sentence
    assert f"changes {abs(late):g} s {word} than the sensor moves" in said


@pytest.mark.slow
@pytest.mark.parametrize("factor", np.exp(RNG.uniform(np.log(30.0), np.log(3e3), 2)))
def test_a_slide_shows_any_scale_of_positions_without_truth(session, factor):
    robot, (coil,), _, frames = session
    wrong = raw(coil, frames["coil"], lambda p: scaled(p, factor))
    findings = found(robot, [wrong], (), frames)
    assert {"length-unit", "slide"} & findings.keys()


@pytest.mark.parametrize("factor", [*RNG.uniform(1.4, 2.0, 2), 1.1])
def test_a_length_that_poses_contradict_is_named_with_its_factor(session, factor):
    robot, *streams, frames = session
    nodes = factor * robot.arclength_nodes
    robot = replace(robot, length=factor * robot.length, arclength_nodes=nodes)
    sensors, truth = ([r.changed(arclength=factor * r.arclength) for r in s] for s in streams)
    said = {f for f in examine(robot, sensors, truth, frames=frames) if f.name == "length-unit"}
    assert bool(said) == (factor > 1.3)
    for finding in said:
        stated = re.search(r"probably (\S+) times", finding.sentence)
        assert float(stated[1]) == pytest.approx(factor, rel=0.05)


def test_a_check_that_is_allowed_is_left_out_and_others_stay(session):
    robot, (coil,), _, frames = session
    wrong = coil.changed(cov=1e6 * coil.cov, time=1e3 * coil.time)
    assert found(robot, [wrong], (), frames, allow=["noise"]).keys() == {"time-unit"}
    with pytest.raises(GlissandoError, match="'nose' is not a check; known: accelerometer, axes"):
        found(robot, [coil], allow=["nose"])


def test_refusals_are_one_error_that_says_how_to_go_on():
    refuse([Finding("lag", "Late.", False)])
    with pytest.raises(ImplausibleError, match=r"Far\. If that is as it should be: --allow reach"):
        refuse([Finding("lag", "Late.", False), Finding("reach", "Far.", True)])


def test_a_grid_beyond_memory_or_reason_is_refused_with_its_size(session):
    robot, sensors, _, _ = session
    with pytest.raises(OutsideGridError, match="would be inf time nodes"):
        replace(robot, time_rate=1e308).grid(0.0, 1e3)
    dense = replace(robot, time_rate=3000.0)
    finding = found(dense, sensors, window=(0.0, 5.0))["grid"]
    assert "15,000 time nodes" in finding.sentence
    assert f"{dense.memory(15000) / 1e9:.2g} GB" in finding.sentence
    with pytest.raises(OutsideGridError, match=r"time nodes and about [\d,.e+]+ GB, more than 60%"):
        dense.grid(0.0, 1e6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_damaged_numbers_never_break_the_guard(session, seed):
    """Numbers beyond all reason in any field are judged, or pass, without an error."""
    rng = np.random.default_rng(seed)
    robot, (coil,), truth, frames = session
    rows = rng.integers(len(coil), size=3)
    time, place, pose = coil.time.copy(), coil.arclength.copy(), coil.values.copy()
    pose[rows if seed % 2 else slice(None), :3, 3] *= 10.0 ** rng.uniform(-300, 300)
    time[rows] += 10.0 ** rng.uniform(-3, 300)
    place[rows] = rng.uniform(0.0, 0.7, 3)
    wrong = coil.changed(time=time, arclength=place, values=pose)
    if seed > 3:
        wrong = wrong.select(slice(0, int(rng.integers(1, 4))))
    findings = examine(robot, [wrong], truth[: seed % 3], frames=frames, window=(0.0, 5.0))
    assert all(np.all([f.name in CHECKS, f.sentence.endswith(".")]) for f in findings)
