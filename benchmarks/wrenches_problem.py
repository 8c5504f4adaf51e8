"""Loaded rods of another group's solver, simulated coil readings, and priors to compare."""

import csv
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from glissando import BaseVariance, CoilReadings, GlissandoError, SeparablePrior
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Wrench, solve_shape
from glissando.simulation.mesh import Mesh
from glissando.simulation.shape import Shape

BODY = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # the file's tangent is body x, ours z
NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])  # standard deviation per axis, m and rad
_LITTLE = 1.2e-4  # m, rad: std of a stiff rod's total strain; numerical precision sets the limit
ROUNDING = 1e-4 / np.sqrt(12)  # m: the files have four decimals


@dataclass(frozen=True)
class Shapes:
    """S shapes of a file.

    Attributes:
        station: Arclengths (M,) of the stations without the base, m.
        pose: Poses (S, M, 4, 4) at the stations.
        gravity: Gravity (S, 3) in the world frame, m/s².
        middle: Wrenches (S, 6) at half the length, world axes, about that point.
        tip: Wrenches (S, 6) at the tip, world axes, about the tip.
    """

    station: np.ndarray
    pose: np.ndarray
    gravity: np.ndarray
    middle: np.ndarray
    tip: np.ndarray

    def take(self, rows):
        """Shapes with some of the rows."""
        others = (getattr(self, name)[rows] for name in ("pose", "gravity", "middle", "tip"))
        return Shapes(self.station, *others)


def load_shapes(file, length):
    """Read all shapes of a file in SoroSim's form, for a rod of some length, m."""
    with file.open() as text:
        rows = list(csv.reader(text))
    if len(rows) < 14 or (len(rows) - 2) % 6 or len({len(row) for row in rows[2:]}) != 1:
        raise GlissandoError(
            f"{file}: {len(rows)} lines are no two of a head and six a shape, of one length, of "
            f"two shapes or more; give a file in SoroSim's form."
        )
    fractions = np.array([float(x) for x in rows[1][4:]])
    half = fractions.size // 2
    station = 0.5 * length * np.concatenate([fractions[:half], 1.0 + fractions[half:]])
    table = np.array([[float(x) for x in row[1:]] for row in rows[2:]])
    euler, place = np.moveaxis(table.reshape(-1, 2, 3, table.shape[1]), (1, 3), (0, 2))
    keep = 3 + np.flatnonzero(np.diff(station, prepend=0.0) > 0.0)
    pose = np.tile(np.eye(4), (*place[:, keep].shape[:2], 1, 1))
    turns = Rotation.from_euler("XYZ", euler[:, keep].reshape(-1, 3)).as_matrix()
    pose[..., :3, :3] = turns.reshape(*pose.shape[:2], 3, 3) @ BODY
    pose[..., :3, 3] = place[:, keep]
    wrench = np.concatenate([place[:, :3], euler[:, :3]], axis=-1)
    return Shapes(station[keep - 3], pose, wrench[:, 0, :3], wrench[:, 1], wrench[:, 2])


def mechanical_prior(material, shapes, error):
    """Mechanical prior of the material, with the mean square of the wrenches of the shapes."""
    fields = {}
    for name, wrench in (("var_points", shapes.middle), ("var_tip", shapes.tip)):
        force, moment = np.mean(wrench[:, :3] ** 2), np.mean(wrench[:, 3:] ** 2)
        fields[name] = np.repeat([force, moment], 3)
    half = 0.5 * material.length
    return MechanicalPrior(
        Mechanics(material.stiffness[None], np.array([material.mass_per_length])),
        psd_load=np.repeat([1e-8, 1e-12], 3),
        psd_strain_error=np.repeat([1e-4 * error, error], 3),
        var_tip=fields["var_tip"],
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        base_pose=material.base,
        points=np.array([half]),
        var_points=fields["var_points"][None],
    )


def with_gravity(prior, gravity):
    """Prior with the gravity (S, 3) of each shape."""
    return replace(prior, mechanics=replace(prior.mechanics, gravity=gravity))


def solver_error(material, shapes):
    """Density of the error of strain (angular, 1/m) that explains differences from the simulator.

    White noise of density q on curvature gives a straight rod's cross-section at s a lateral
    variance of q s³/3 in each of two directions. The variance of the files' rounding is subtracted.
    """
    found = []
    for i in range(len(shapes.pose)):
        rod = equilibrium(material, shapes, i)
        gap = rod.at(shapes.station).pose[:, :3, 3] - shapes.pose[i, :, :3, 3]
        found.append(np.sum(gap**2, axis=1) - 3.0 * ROUNDING**2)
    mean = np.maximum(np.mean(found, axis=0), ROUNDING**2)
    far = shapes.station > 0.25 * material.length
    return float(np.mean((1.5 * mean / shapes.station**3)[far]))


def strain_priors(material, shapes):
    """Priors on strain, without loads, fitted to shapes: by quarter with a jump, and uniform."""
    length = material.length
    edges = length * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    places = np.sort(np.concatenate([edges, [0.5 * length - 1e-6]]))
    strain = np.array(
        [equilibrium(material, shapes, i).at(places).strain for i in range(len(shapes.pose))]
    )
    change = np.mean(np.diff(strain, axis=1)[..., 3:] ** 2, axis=0)
    change[:, :2] = change[:, :2].mean(axis=1, keepdims=True)
    first = np.mean(strain[:, 0, 3:] ** 2, axis=0)
    first[:2] = first[:2].mean()
    stiff = np.full(3, (_LITTLE / length) ** 2 / length)
    rows = [np.concatenate([stiff, row]) for row in change]
    quarters = [np.concatenate([stiff, rows[i][3:] / (0.25 * length)]) for i in (0, 1, 3, 4)]
    none = np.repeat(stiff, 2)
    base = BaseVariance(np.full(6, 1e-10), np.concatenate([stiff, first]))
    jumps = np.array([none, rows[2], none])
    even = np.concatenate([stiff, change.sum(axis=0) / length])
    return (
        SeparablePrior(
            np.maximum(quarters, stiff[0]), 1.0, base, base_pose=material.base, joints=edges[1:4],
            jumps=jumps,
        ),
        SeparablePrior(even, 1.0, base, base_pose=material.base),
    )  # fmt: skip


def exact(material, gravity, middle, tip, start=None):
    """The simulator's shape under these loads; with `start`, the equilibrium nearest to it.

    Under dead loads a soft rod may have equilibria that cannot be reached by increasing the load
    from zero; the files contain such shapes.
    """
    half, length = 0.5 * material.length, material.length
    ends = [Wrench(s, w[:3], w[3:]) for s, w in ((half, middle), (length, tip))]
    loads = Loads(gravity=gravity, wrenches=ends)
    return solve_shape(material, [], loads, start=start, stable=start is None)


def equilibrium(material, shapes, i):
    """The simulator's equilibrium nearest to shape i of the file, under its loads."""
    start = _carrying(material, shapes, i)
    return exact(material, shapes.gravity[i], shapes.middle[i], shapes.tip[i], start)


def _carrying(material, shapes, i):
    """Shape with the strain that balances the loads of shape i at the positions of the file."""
    length, station = material.length, np.append(0.0, shapes.station)
    pose = np.concatenate([material.base[None], shapes.pose[i]])
    place = CubicSpline(station, pose[:, :3, 3])
    mesh = Mesh.through([0.0, 0.5 * length, length], 0.5 * length)
    here, left = place(mesh.points), length - mesh.points
    weight = material.mass_per_length * shapes.gravity[i]
    whole = place.antiderivative()
    force = left[:, None] * weight
    moment = np.cross(whole(length) - whole(mesh.points) - left[:, None] * here, weight)
    for at, wrench in ((0.5 * length, shapes.middle[i]), (length, shapes.tip[i])):
        beyond = (mesh.points < at)[:, None]
        force += beyond * wrench[:3]
        moment += beyond * (wrench[3:] + np.cross(place(at) - here, wrench[:3]))
    turn = RotationSpline(station, Rotation.from_matrix(pose[:, :3, :3]))(mesh.points)
    carried = np.hstack([turn.apply(force, inverse=True), turn.apply(moment, inverse=True)])
    strain = material.rest(mesh.points) + carried / material.stiffness
    return Shape(material, mesh, strain, mesh.roll_out(strain, material.base)[1])


def read(shapes, first, how):
    """Coil readings of all shapes, seeded by number, and the mask (S, M) of stations read."""
    count = shapes.station.size
    used, time_, place, values = np.zeros((len(shapes.pose), count), dtype=bool), [], [], []
    for i, pose in enumerate(shapes.pose):
        rng = np.random.default_rng(first + i)
        stops = np.array([count - 1]) if how == "tip" else rng.choice(count, 5, replace=False)
        off, roll = np.zeros((2, stops.size, 6))
        off[:, :5] = NOISE * rng.standard_normal((stops.size, 5))
        roll[:, 5] = rng.uniform(-np.pi, np.pi, stops.size)
        values.append(pose[stops] @ se3.exp(off) @ se3.exp(roll))
        time_.append(np.full(stops.size, i))
        place.append(shapes.station[stops])
        used[i, stops] = True
    data = {"time": np.concatenate(time_), "arclength": np.concatenate(place)}
    coil = CoilReadings(**data, values=np.concatenate(values), cov=NOISE**2)
    return coil, used
