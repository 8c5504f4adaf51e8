"""Rigs on the simulated bench: sessions of their devices, each with a clock of its own."""

import json
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.rig import Body, Noise, Rig, RigData
from glissando.geometry import se3
from glissando.io.robot_file import load_robot
from glissando.io.session_log import INTEGER, NUMBER, SessionWriter, numbers, schema
from glissando.io.shipped_robots import robot_file
from glissando.simulation import SlidePath, Tendon
from glissando.simulation.actuation import Actuation
from glissando.simulation.bench import load_bench
from glissando.simulation.channel import straight_length
from glissando.simulation.tracker import coil_rows, mocap_rows

DURATION, LONGER = 15.0, 45.0  # s; of a session as docs/calibration.md asks for
CLEAN = {"mocap": 1.5e-4, "mocap_angle": 1.5e-3, "registration": 0.0, "registration_angle": 0.0}
FAIR = {"bias": 3e-4, "bias_angle": 3e-3, "play": 1e-4}  # a good lab
BACKLASH = 1e-4  # m, standard deviation
READINGS, NODES = 60, 4  # of the coil and of the robot, for a calibration that is quick
DEVELOPMENT, REPORT = range(20), range(190, 230)  # seeds: by which motions, noise and method were
# chosen; and which were never looked at before what is reported of them


def bench(**flaws):
    """The shipped bench with four tendons, so that it bends every way."""
    made = load_bench(robot_file("sliding700"))
    ways = 5e-3 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    tendons = tuple(Tendon(way, 0.7, 0.0) for way in ways)
    given = replace(made.flaws, **{**CLEAN, "roll": "true", **flaws})
    return replace(made, tendons=tendons, flaws=given)


SHAPES = {
    "straight": np.zeros((1, 4)),
    "bent": np.array([[10.0, 4.0, 0.0, 0.0]]),
    "waving": np.array([[5, 0, 0, 0], [0, 5, 0, 0], [0, 0, 5, 0], [0, 0, 0, 5], [3, 3, 0, 0.0]]),
}


def poses(count):
    """Tensions (count, 4) that bend the robot every way, less and more."""
    k = np.arange(count)
    angle, pull = np.pi * (3.0 - np.sqrt(5.0)) * k, 2.0 + 8.0 * (0.618 * k % 1.0)
    x, y = pull * np.cos(angle), pull * np.sin(angle)
    return np.maximum(np.stack([x, y, -x, -y], axis=1), 0.0)


def posed():
    """Every five seconds another bend, held for three."""
    time = np.arange(0.0, LONGER + 1e-9, 5.0)
    held = np.sort(np.concatenate([time, time[:-1] + 3.0]))
    return Actuation(held, np.repeat(poses(time.size), 2, axis=0)[:-1], np.zeros(3))


@cache
def motion(shape="waving", seed=0):
    """The motion of a robot with a set of its own; slow to solve, so kept."""
    made = bench()
    flaws = replace(made.flaws, set_curvature=0.3)
    if shape == "posed":
        return made.move(posed(), flaws, seed)
    tensions = SHAPES[shape]
    time = np.linspace(0.0, DURATION, len(tensions)) if len(tensions) > 1 else np.zeros(1)
    return made.move(Actuation(time, tensions, np.zeros(3)), flaws, seed)


def truth(rng, T_wt, direction, lasts):
    return Rig(
        T_wt,
        direction,
        0.7 - 0.005 * rng.uniform() if direction < 0 else 0.63 + 0.005 * rng.uniform(),
        lasts / 2,
        np.r_[5e-4, 5e-4, 0.01, 0.01] * rng.standard_normal(4),
        1.0 + 5e-3 * rng.standard_normal(),
        abs(BACKLASH * rng.standard_normal()),
        np.r_[rng.uniform(-0.3, 0.3), 1e-4 * rng.standard_normal()],
        np.r_[rng.uniform(-0.3, 0.3), 1e-4 * rng.standard_normal()],
    )


def at_epoch(rig, epoch):
    """The same rig with its clocks' delays as of another epoch."""
    later = epoch - rig.epoch
    clocks = {
        name: np.array([clock[0] + clock[1] * later, clock[1]])
        for name in ("tracker_clock", "slide_clock")
        for clock in [getattr(rig, name)]
    }
    return replace(rig, epoch=epoch, **clocks)


def path_of(kind):
    """Three cycles at one speed, two speeds, to and fro with rests, or none."""
    limits = bench().slide
    if kind == "calibrate":
        return SlidePath.calibrate(LONGER, limits.stroke, limits)
    if kind == "none":
        return SlidePath.hold(0.03, DURATION, limits)
    if kind == "even":
        return SlidePath.oscillate(3, 0.06, limits)
    time = [0.0, 2.75, 5.5, 9.25, 13.0, 15.0]
    return SlidePath.waypoints(time, [0.0, 0.06, 0.0, 0.03, 0.0, 0.035], limits)


def stamps(time, clock, epoch):
    """What a device's clock says at true times: late by delay + rate · (stamp − epoch)."""
    return epoch + (time - epoch + clock[0]) / (1.0 - clock[1])


def drawn(
    seed, shape="waving", *, sliding="two speeds", direction=None, motions=3, channel=None, **flaws
):
    """Data of a rig and the truth about it; the coil may slide in a channel off the axis."""
    rng = np.random.default_rng([seed, 7])
    made = bench(**{**FAIR, **flaws})
    direction = int(rng.choice([-1, 1])) if direction is None else direction
    T_wt = made.tracker @ se3.exp(0.3 * rng.standard_normal(6))
    lasts = LONGER if shape == "posed" else DURATION
    known = truth(rng, T_wt, direction, lasts)
    made = replace(made, flaws=replace(made.flaws, backlash=known.backlash))
    rods = motion(shape, seed % motions)
    path = path_of(sliding)
    # the simulated coil goes from the tip to the base; what the encoder says is up to the rig
    stated = RigData("", *[np.zeros(0)] * 4, {}, 0.0, 0.0, channel=channel)
    way = Tendon.in_channel(known.channel(stated), 0.7) if channel else None
    where = _Displaced(path, known, straight_length(way, 0.7) if way else 0.7)
    time = np.arange(0.0, lasts, 1.0 / 40.0) + rng.uniform(0.0, 0.02)
    time = time[time < lasts]
    coil = coil_rows(rods, where, time, 0.0, T_wt, made.flaws, rng, way)
    x, y, tilt_x, tilt_y = known.mount * ([0, 0, 1, 1] if channel else 1.0)
    roll = rng.uniform(-np.pi, np.pi)
    mount = se3.exp(np.r_[x, y, 0, tilt_x, tilt_y, 0]) @ se3.exp(np.r_[0, 0, 0, 0, 0, roll])
    places = {"base": 0.0, "middle": 0.34, "near": 0.58, "tip": 0.7}
    bodies = {}
    for name, s in places.items():
        when = np.arange(0.0, lasts + 1e-9, 1.0 / 20.0)
        rows = mocap_rows(rods, s, when, made.flaws, rng)
        marker = se3.exp(0.02 * rng.standard_normal(6))
        bodies[name] = Body(s, marker, rows.time, rows.values @ marker)
    slide = np.arange(0.0, lasts + 1e-9, 0.02)
    far = np.linalg.norm((T_wt @ coil.values)[:, :3, 3] - made.flaws.field_centre, axis=1)
    more = np.sqrt(np.mean((1.0 + (far / made.flaws.field_size) ** 2) ** 2))  # where the coil was
    noise = Noise(
        mocap=np.array([made.flaws.mocap, made.flaws.mocap_angle]) / np.sqrt(3.0),
        coil=more * np.array([made.flaws.jitter, made.flaws.jitter_angle]) / np.sqrt([3.0, 2.0]),
        bias=np.r_[more * np.array([made.flaws.bias, made.flaws.bias_angle]), 0.1]
        / np.sqrt([3.0, 2.0, 1.0]),
        play=np.array([max(made.flaws.play, 1e-6), 0.075]),
        backlash=BACKLASH,
    )
    data = RigData(
        coil_name="coil",
        coil_time=stamps(coil.time, known.tracker_clock, known.epoch),
        coil=coil.values @ mount,
        slide_time=stamps(slide, known.slide_clock, known.epoch),
        travel=path.at(slide),
        bodies=bodies,
        coil_arclength=0.7 if direction < 0 else 0.63,
        coil_arclength_std=0.005,
        direction=0,
        noise=noise,
        channel=channel,
    )
    return data, known


class _Displaced:
    """The simulated coil's displacement from the tip for what the rig's encoder says."""

    def __init__(self, path, known, length):
        self.path, self.known, self.length = path, known, length

    def at(self, time):
        place = self.known.zero + self.known.direction * self.known.lead * self.path.at(time)
        return self.length - place


def robot(nodes=8):
    """The shipped robot with densities learned from motion capture of one of these sessions."""
    made = load_robot("sliding700")
    scales = {
        "psd_strain_arclength": 1e-4,
        "psd_strain_time": 6e-3,
        "psd_velocity_time": 0.6,
        "psd_velocity_arclength": 0.01,
    }
    scaled = {name: scale * getattr(made.prior, name) for name, scale in scales.items()}
    prior = replace(made.prior, **scaled)
    nodes = np.linspace(0.0, made.length, nodes)
    return replace(made, prior=prior, time_rate=2.0, arclength_nodes=nodes)


POSE = {"time": NUMBER, "position": numbers(3), "quaternion": numbers(4), "frame": INTEGER}


def write(path, data, *, without=(), setup=None):
    """A raw session log of a rig's data; missing poses are null."""
    bodies = {
        name: {
            "arclength": b.arclength,
            "position": b.mount[:3, 3].tolist(),
            "quaternion": se3.quaternion(b.mount[:3, :3]).tolist(),
        }
        for name, b in data.bodies.items()
    }
    noise = data.noise
    told = {
        "robot": data.robot or "sliding700",
        "coil_arclength": data.coil_arclength,
        "coil_arclength_std": data.coil_arclength_std,
        "direction": data.direction,
        "bodies": bodies,
        "mocap_std": noise.mocap.tolist(),
        "coil_std": noise.coil.tolist(),
        "coil_bias": noise.bias.tolist(),
        "play": noise.play.tolist(),
        "backlash": noise.backlash,
    }
    streams = {f"/tracker/{data.coil_name}": (data.coil_time, data.coil)}
    streams |= {f"/mocap/{name}": (b.time, b.poses) for name, b in data.bodies.items()}
    with SessionWriter(path, {"setup": json.dumps(told | (setup or {}))}) as log:
        for topic, (time, poses) in streams.items():
            if topic.split("/")[1] in without:
                continue
            log.add_topic(topic, schema("Pose", **POSE))
            quaternion = se3.quaternion(poses[:, :3, :3])
            for k, (t, pose, q) in enumerate(zip(time, poses, quaternion, strict=True)):
                row = {"frame": k, "time": t, "position": pose[:3, 3], "quaternion": q}
                log.write(topic, row, k)
                lost = {"frame": k, "time": t, "position": None, "quaternion": None}
                log.write(topic, lost if k % 7 == 0 else row, k)  # nothing seen, or polled again
        if "slide" not in without:
            log.add_topic("/slide", schema("Slide", time=NUMBER, travel=NUMBER))
            for k, (t, x) in enumerate(zip(data.slide_time, data.travel, strict=True)):
                log.write("/slide", {"time": t, "tick": t, "travel": x, "speed": 0.0}, k)
    return path


@dataclass(frozen=True)
class Trial:
    """Errors of a calibration (17,), their stated std, their normalised square, the warnings."""

    off: np.ndarray
    std: np.ndarray
    nees: float
    warnings: tuple


def trial(seed, *, stated=1.0):
    """A session as docs/calibration.md asks for, calibrated; noise is stated so many times."""
    data, known = drawn(seed, "posed", sliding="calibrate", motions=10_000)
    made = calibrate(misstated(data, stated), robot())
    off = made.rig.minus(at_epoch(known, made.rig.epoch))
    return Trial(off, made.std, float(off @ np.linalg.solve(made.cov, off)), made.warnings)


def calibrated(seed=0, shape="waving", sliding="two speeds", stated=1.0, channel=None):
    """A short session, quickly calibrated with noise stated so many times: result, truth, data."""
    return _calibrated(seed, shape, sliding, stated, channel)


@cache
def _calibrated(seed, shape, sliding, stated, channel):
    data, known = drawn(seed, shape, sliding=sliding, channel=channel)
    made = calibrate(misstated(data, stated), robot(NODES), readings=READINGS)
    return made, at_epoch(known, made.rig.epoch), data


def misstated(data, times):
    """The same data with a stated noise that is so many times the true one."""
    noise = data.noise
    said = {name: times * getattr(noise, name) for name in ("mocap", "coil", "bias", "play")}
    for name, of_noise in (("bias", 2), ("play", 1)):  # the rest are lengths
        said[name][of_noise:] = getattr(noise, name)[of_noise:]
    return replace(data, noise=replace(noise, **said))
