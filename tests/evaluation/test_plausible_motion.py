"""The guard on motion: clocks that are late, and inertial sensors against tracked bodies."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from glissando import CoilReadings, GyroReadings, PoseReadings, load_robot, se3
from glissando.evaluation.plausibility.examine import examine
from glissando.model.sensors.accelerometer import AccelerometerReadings
from scenes import LENGTH, angular_velocity, arc


def found(robot, sensors, truth=()):
    return {f.name: f for f in examine(robot, sensors, truth)}


def moving(rng, duration=8.0):
    """A pose at the tip and one at mid length of a robot that moves unevenly, and its clock."""
    time = np.arange(0.0, duration, 0.025)
    warped = time + 0.8 * np.sin(1.7 * time + rng.uniform(0.0, 6.0))
    noise = se3.exp(1e-4 * rng.standard_normal((2, time.size, 6)))

    def pose(place, noise, name):
        values = arc(np.full(time.size, place), warped) @ noise
        s = np.full(time.size, place)
        return PoseReadings(time=time, arclength=s, values=values, cov=1e-6, name=name)

    return pose(LENGTH, noise[0], "tip"), pose(LENGTH / 2, noise[1], "middle"), warped


@pytest.mark.parametrize("seed", range(4))
def test_a_lag_is_measured(seed):
    rng = np.random.default_rng(seed)
    tip, middle, _ = moving(rng)
    robot = load_robot("tdcr466")
    assert "lag" not in found(robot, [tip], [middle])
    late = rng.uniform(0.3, 1.2) * rng.choice([-1.0, 1.0])
    finding = found(robot, [tip], [middle.changed(time=middle.time + late)])["lag"]
    assert finding.streams == ("middle",)
    told = float(finding.sentence.split("moves ")[1].split(" s ")[0])
    assert told == pytest.approx(abs(late), abs=0.06)
    assert ("later" if late > 0 else "earlier") in finding.sentence
    assert (" subtract " if late > 0 else " add ") in finding.sentence


@pytest.mark.parametrize(("shifts", "named"), [((-0.6, 0.6), False), ((0.6, 0.6), True)])
def test_truth_is_of_one_late_clock_only_where_its_streams_agree(shifts, named):
    """Segments that move out of phase once made "moves 0 s earlier; subtract 0 s"."""
    tip, middle, _ = moving(np.random.default_rng(0))
    truth = [
        middle.changed(time=middle.time + shift, name=name)
        for shift, name in zip(shifts, "ab", strict=True)
    ]
    said = found(load_robot("tdcr466"), [tip], truth)
    assert ("lag" in said) == named
    if named:
        assert "The truth" in said["lag"].sentence


def swaying(rng, robot, shares, std):
    """Poses at shares of the length of an arm of four segments that move by themselves for 6 s."""
    time, segment = np.arange(0.0, 6.0, 0.1), robot.length / 4.0
    knots = rng.normal(size=(6, 4, 3)) * np.array([1.0, 1.0, 0.2]) * np.pi / 8.0 / segment
    bends, out = CubicSpline(3.0 * np.arange(6), knots)(time), []
    for number, share in enumerate(shares):
        pose = np.eye(4)
        for k in range(4):
            strain = np.concatenate([np.tile([0.0, 0.0, 1.0], (time.size, 1)), bends[:, k]], axis=1)
            pose = pose @ se3.exp(np.clip(share * 4.0 - k, 0.0, 1.0) * segment * strain)
        values = pose @ se3.exp(std * rng.standard_normal((time.size, 6)))
        at, name = np.full(time.size, share * robot.length), f"{len(std)} {number} {std[0]}"
        out.append(PoseReadings(time=time, arclength=at, values=values, cov=std**2, name=name))
    return out


def test_segments_that_move_by_themselves_for_a_few_seconds_seldom_look_like_late_clocks():
    robot, said = load_robot("tdcr466"), 0
    for seed in range(200, 220):
        drawn = (np.random.default_rng(seed) for _ in range(2))  # the same motion
        sensors = swaying(next(drawn), robot, (1.0, 0.5), np.repeat([5e-4, 1e-2], 3))
        truth = swaying(next(drawn), robot, np.arange(1, 6) / 5.0, np.full(6, 1e-6))
        said += "lag" in found(robot, sensors, truth)
    assert said <= 5  # of so short a motion two are often alike by chance


@pytest.mark.parametrize("seed", range(6))
def test_poses_taken_at_an_even_pace_are_no_lag(seed):
    rng, time, pace = np.random.default_rng(seed), np.arange(0.0, 15.0, 0.025), 2.5
    size = rng.uniform(0.1, 1.0, (2, 8)) * rng.choice([-1.0, 1.0], (2, 8))
    part, pose = np.clip(time % pace / 0.8, 0.0, 1.0), (time // pace).astype(int)
    eased = part**2 * (3.0 - 2.0 * part)
    streams = []
    for (name, place), way in zip((("tip", LENGTH), ("middle", LENGTH / 2)), size, strict=True):
        still = np.cumsum(way)
        turn = np.zeros((time.size, 6))
        turn[:, 3] = 0.2 * (still[pose] + eased * way[pose + 1])
        s = np.full(time.size, place)
        values = se3.exp(turn + 1e-4 * rng.standard_normal(turn.shape))
        streams.append(PoseReadings(time=time, arclength=s, values=values, cov=1e-6, name=name))
    assert "lag" not in found(load_robot("tdcr466"), streams[:1], streams[1:])


@pytest.mark.parametrize("seed", range(4))
def test_units_signs_and_axes_of_a_gyroscope_are_found(seed):
    rng = np.random.default_rng(seed)
    tip, _, warped = moving(rng)
    rates = angular_velocity(tip.arclength, warped) * np.gradient(warped, tip.time)[:, None]
    rates += 5e-3 * rng.standard_normal(rates.shape)
    gyro = GyroReadings(time=tip.time, arclength=tip.arclength, values=rates, cov=1e-4, name="gyro")
    robot = load_robot("tdcr466")
    assert "gyro" not in found(robot, [tip, gyro])
    wrong = -rates if seed % 2 else rates[:, [1, 0, 2]]
    factor = rng.choice([1.0, 180.0 / np.pi])
    assert "gyro" in found(robot, [tip, gyro.changed(values=factor * wrong)])


@pytest.mark.parametrize("kind", ["pose", "coil"])
@pytest.mark.parametrize("seed", range(4))
def test_units_signs_and_axes_of_an_accelerometer_are_found(seed, kind):
    rng = np.random.default_rng(seed)
    tip, _, _ = moving(rng)
    turn = se3.exp(np.concatenate([np.zeros(3), rng.uniform(-1.0, 1.0, 3)]))
    seen, gravity = turn @ tip.values, np.array([0.0, 0.0, -9.81])
    force = -np.einsum("mji,j->mi", seen[:, :3, :3], gravity)
    force += rng.standard_normal(force.shape)
    at = {"time": tip.time, "arclength": tip.arclength}
    felt = AccelerometerReadings(**at, values=force, cov=1e-2, gravity=gravity, name="imu")
    beside = tip.changed(values=seen)
    if kind == "coil":
        beside = CoilReadings(**at, values=seen, cov=np.full(5, 1e-6), name="beside")
    robot = load_robot("tdcr466")

    def said(values, **changes):
        streams = [beside, felt.changed(values=values, **changes)]
        found = [f for f in examine(robot, streams) if f.name == "accelerometer"]
        return found[0].correction if found else ""

    assert said(force) == ""
    assert said(force / 9.80665).startswith("g,")
    assert said(1e3 * force) == "mm/s²"
    along = np.abs(np.mean(force[:, 2])) > 5.0  # a coil shows nothing of what pulls across it
    if along or kind == "pose":
        assert said(-force) == said(force, gravity=-gravity) == "with the wrong sign"
    if kind == "pose":
        assert "for x, y, z" in said(force[:, [1, 2, 0]])


@pytest.mark.parametrize("share", [1e-3, 1.0, 1e3])
def test_stated_noise_is_held_against_what_is_seen(share):
    tip, _, _ = moving(np.random.default_rng(1))
    still = tip.changed(values=arc(tip.arclength, np.zeros(len(tip))) @ se3.exp(
        1e-3 * np.random.default_rng(2).standard_normal((len(tip), 6))))  # fmt: skip
    findings = found(load_robot("tdcr466"), [still.changed(cov=share**2 * still.cov)])
    assert ("noise" in findings) == (share != 1.0)
