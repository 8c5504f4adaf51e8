"""The posterior as a NetCDF-4 (HDF5) file, with names, units, and all that queries need.

xarray, MATLAB and any HDF5 reader open it. The information matrix is stored, from which the denser
covariances follow; standard deviations and node covariances are written too, for other programs.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.errors import GlissandoError, needing
from glissando.estimation.carried import carried, has_rolled
from glissando.estimation.loads import load_places
from glissando.estimation.posterior import Posterior
from glissando.estimation.solve_report import SolveReport
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.atomic_file import new_file
from glissando.io.plain_file import largest_deflated, require_plain
from glissando.io.provenance import require_readable, stated_format, versions
from glissando.io.robot_file import OLD_KINDS
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.priors.registry import UnknownPriorError, prior_class
from glissando.model.priors.separable import BaseVariance
from glissando.model.priors.white_noise import BaseDensity
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import State
from glissando.model.table import Table
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor

if TYPE_CHECKING:
    import xarray

_DAMAGED = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    RuntimeError,
    OverflowError,
)
_SKEW = 1e-6  # by which rotations may fail to be orthogonal
_SIX = ["x", "y", "z", "rx", "ry", "rz"]
_FIELDS = ("pose", "strain", "velocity", "strain_rate", "inertia")
_POINTS = [f"linearized_{field}" for field in _FIELDS]
_READ = ("time", "arclength", *_FIELDS, *_POINTS, "information", "information_below")
COMPONENTS = [f"{field}_{part}" for field in _FIELDS for part in _SIX]
"""Names of a node's components in the order of every covariance.

18 for all priors, 24 with a strain rate, 30 with inertia.
"""


def _xarray() -> Any:
    with needing("Saving and loading posteriors needs xarray, h5netcdf and h5py", "netcdf"):
        import h5netcdf
        import h5py
        import xarray
    del h5netcdf, h5py
    return xarray


def to_xarray(posterior: Posterior) -> xarray.Dataset:
    """Mean, standard deviation and covariance at the nodes, with names and units.

    Raises:
        GlissandoError: xarray is not installed.
    """
    dof, six = posterior.state.dof, "component6"
    variables = _states(posterior)
    if isinstance(posterior.prior, MechanicalPrior):
        variables |= _loads(posterior, posterior.prior)
    coordinates: dict[str, Any] = {
        "time": ("time", posterior.grid.time, {"units": "s"}),
        "arclength": ("arclength", posterior.grid.arclength, {"units": "m"}),
        "axis": ["x", "y", "z"],
        "quaternion_part": ["w", "x", "y", "z"],
        six: _SIX,
        "component": COMPONENTS[:dof],
        "component_": COMPONENTS[:dof],
    }
    if "load" in variables:
        coordinates["place"] = ("place", variables.pop("place"), {"units": "m"})
    attributes = {
        "title": "Posterior of a continuum robot's motion",
        "format": stated_format("posterior"),
    }
    dataset: xarray.Dataset = _xarray().Dataset(variables, coordinates, attributes)
    return dataset


def _states(posterior: Posterior) -> dict[str, Any]:
    """Means, standard deviations and covariances at the nodes, as xarray takes variables."""
    k, n = posterior.grid.shape
    state, dof = posterior.state, posterior.state.dof
    of_nodes = posterior.marginals.cov[:, : n * dof, : n * dof]
    cov = np.einsum("kninj->knij", of_nodes.reshape(k, n, dof, n, dof))
    node, six = ("time", "arclength"), "component6"
    std = np.sqrt(np.einsum("knii->kni", cov))
    units = ["m", "rad", "1", "1/m", "m/s", "rad/s", "1/s", "1/m/s", "m/s²", "m/s³"]
    mixed = ", ".join(units[: dof // 3])
    variables: dict[str, Any] = {
        "position": ((*node, "axis"), state.pose[..., :3, 3], {"units": "m", "frame": "world"}),
        "quaternion": (
            (*node, "quaternion_part"),
            se3.quaternion(state.pose[..., :3, :3]),
            {"units": "1", "convention": "w, x, y, z; body to world"},
        ),
        "strain": ((*node, six), state.strain, {"units": "1, 1/m", "frame": "body"}),
        "velocity": ((*node, six), state.velocity, {"units": "m/s, rad/s", "frame": "body"}),
        "std": ((*node, "component"), std, {"units": mixed, "frame": "body"}),
        "cov": (
            (*node, "component", "component_"),
            cov,
            {"units": "product of the components' units", "frame": "body, pose on the right"},
        ),
    }
    if state.strain_rate is not None:
        of_rate = {"units": "1/s, 1/m/s", "frame": "body"}
        variables["strain_rate"] = ((*node, six), state.strain_rate, of_rate)
    if state.inertia is not None:
        of_inertia = {"units": "m/s², m/s³", "frame": "world"}
        variables["inertia"] = ((*node, six), state.inertia, of_inertia)
    return variables


def _loads(posterior: Posterior, prior: MechanicalPrior) -> dict[str, Any]:
    """Internal wrenches at the nodes and the loads where some are expected, with their places."""
    time, arclength = posterior.grid.time[:, None], posterior.grid.arclength
    place = load_places(prior, posterior.grid)
    inner, load = posterior.wrench(arclength, time), posterior.load(place, time)
    units = {"units": "N, N m", "frame": "body"}
    six = "component6"
    return {
        "wrench": (("time", "arclength", six), inner.wrench, units),
        "wrench_std": (("time", "arclength", six), inner.std, units),
        "load": (("time", "place", six), load.wrench, units),
        "load_std": (("time", "place", six), load.std, units),
        "place": place,
    }


def save_posterior(posterior: Posterior, path: str | Path) -> None:
    """Write everything that `load_posterior` needs to a NetCDF-4 (HDF5) file.

    Raises:
        GlissandoError: The file cannot be written, or xarray is not installed.
    """
    dataset = to_xarray(posterior)
    dataset["pose"] = (("time", "arclength", "row", "column"), posterior.state.pose)
    dataset["information"] = (("time", "slab", "slab_"), posterior.system.diagonal)
    dataset["information_below"] = (("time_step", "slab", "slab_"), posterior.system.lower)
    rolled = has_rolled(posterior.linearization_point, posterior.state)
    if rolled or isinstance(posterior.prior, MechanicalPrior):
        dataset.update(_linearization(posterior))
    dataset.attrs["prior"] = json.dumps(posterior.prior.to_table())
    dataset.attrs["sensor_parameters"] = json.dumps(
        [_plain({**vars(u), "values": values}) for u, values in posterior.sensor_parameters]
    )
    if posterior.grid.before is not None:
        dataset.attrs["time_before"] = posterior.grid.before
    dataset.attrs["versions"] = json.dumps(versions())
    dataset.attrs["solve"] = json.dumps(posterior.solve.to_table())
    packed = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding = dict.fromkeys(("information", "information_below", "cov"), packed)
    image = dataset.to_netcdf(engine="h5netcdf", encoding=encoding)  # HDF5 dies of a full disk
    with new_file(path) as building:
        building.write_bytes(image)


def _linearization(posterior: Posterior) -> dict[str, Any]:
    """The states (2, K, N) at which a posterior was linearised and weighted."""
    variables: dict[str, Any] = {}
    for name, key in zip(_FIELDS, _POINTS, strict=True):
        each = [getattr(state, name) for state in posterior.linearized or ()]
        if each and each[0] is not None:
            entries = ("row", "column") if name == "pose" else ("component6",)
            variables[key] = (("point", "time", "arclength", *entries), np.stack(each))
    return variables


def load_posterior(path: str | Path) -> Posterior:
    """Read a posterior; covariances are computed again from its information matrix.

    Raises:
        GlissandoError: The file cannot be read, is no posterior, or announces more than it holds.
    """
    path = Path(path)
    try:
        require_plain(path, 1 << 40)
        open_dataset, options = _xarray().open_dataset, {"decode_cf": False, "phony_dims": "sort"}
        with open_dataset(path, engine="h5netcdf", **options) as opened:
            announced = sum(int(v.nbytes) for v in opened.variables.values())
            if announced > largest_deflated(path.stat().st_size):
                raise ValueError(
                    f"it announces {announced:,} bytes of numbers, more than it or memory holds"
                )
            names = [name for name in _READ if name in opened.variables]
            dataset = opened[names].load()
    except (OSError, MemoryError, *_DAMAGED) as problem:
        raise GlissandoError(f"{path} cannot be read as NetCDF ({problem}).") from None
    require_readable(dataset.attrs.get("format", "unknown"), "posterior", path)
    try:
        return _posterior(dataset, path.name)
    except UnknownPriorError as problem:
        raise GlissandoError(f"{path}: {problem}") from None
    except (GlissandoError, np.linalg.LinAlgError, *_DAMAGED) as problem:
        raise GlissandoError(f"{path} is damaged ({problem}); estimate again.") from None


def _posterior(dataset: xarray.Dataset, name: str) -> Posterior:
    """The posterior that a dataset holds."""
    attributes = dataset.attrs
    parameters = attributes.get("sensor_parameters") or attributes.get("unknowns", "[]")
    prior = _as_prior(json.loads(attributes["prior"]), name)
    before = attributes.get("time_before")
    before = None if before is None else float(before)
    grid = Grid(_numbers(dataset, "arclength"), _numbers(dataset, "time"), before)
    state = State(*(_numbers(dataset, field) for field in _FIELDS if field in dataset))
    blocks = (_numbers(dataset, key) for key in ("information", "information_below"))
    estimated = [_as_sensor_parameter(table) for table in json.loads(parameters)]
    system = BlockTridiagonal(*blocks)
    _require_whole(grid, state, system, estimated)
    points = [_numbers(dataset, key) for key in _POINTS if key in dataset]
    if points and [p.shape for p in points] != [(2, *field.shape) for field in state.fields()]:
        raise ValueError("where it was linearised does not fit its nodes")
    solve = SolveReport.from_table(json.loads(attributes["solve"]))
    f"{solve.status}{solve.iterations:d}{solve.cost:g}{sum(solve.seconds.values()):g}"  # or raises
    where = (State(*(p[0] for p in points)), State(*(p[1] for p in points))) if points else None
    marginals = factor(system).marginals(consume=True)
    marginals = carried(where[0] if where else state, state, marginals)
    return Posterior(prior, grid, state, system, marginals, solve, estimated, where)


def _numbers(dataset: xarray.Dataset, name: str) -> Array:
    """A variable's numbers. Raises ValueError unless they are finite."""
    values = np.asarray(dataset[name].values, dtype=float)
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{name} is not finite")
    return values


def _require_whole(
    grid: Grid,
    state: State,
    system: BlockTridiagonal,
    estimated: Sequence[tuple[SensorParameter, Array]],
) -> None:
    """Raise ValueError unless shapes fit each other and poses are rigid motions."""
    k, n = grid.shape
    size = sum(parameter.size for parameter, _ in estimated)
    each = n * state.dof + size
    wanted = [(k, n, 4, 4), *[(k, n, 6)] * (len(state.fields()) - 1), (k, each, each)]
    shapes = [field.shape for field in state.fields()] + [system.diagonal.shape]
    values = [v.shape == (k, parameter.size) for parameter, v in estimated]
    if shapes != wanted or system.lower.shape != (k - 1, each, each) or not all(values):
        raise ValueError(f"arrays of shapes {shapes} do not fit {k} times and {n} arclengths")
    turn = state.pose[..., :3, :3]
    skew = np.abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max()
    last = np.abs(state.pose[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max()
    if max(skew, last) > _SKEW or np.any(np.linalg.det(turn) < 0.0):
        raise ValueError("a pose is no rigid motion")


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """The table with arrays as lists, and None for infinity, which JSON lacks."""
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in table.items()}
    return {k: None if v == np.inf else v for k, v in plain.items()}


def _as_sensor_parameter(table: dict[str, Any]) -> tuple[SensorParameter, Array]:
    values, memory = np.array(table.pop("values")), table.pop("correlation_time")
    table["kind"] = OLD_KINDS.get(table["kind"], table["kind"])
    table["streams"] = tuple(table["streams"])
    return SensorParameter(**table, correlation_time=np.inf if memory is None else memory), values


def _as_prior(document: dict[str, Any], where: str) -> Prior:
    """The prior of a document in the form of a robot file."""
    if "prior" not in document:
        return _prior_of_fields(document)
    table = Table(document, where, GlissandoError)
    entries = table.subtable("prior")
    return prior_class(entries.text("kind")).from_table(entries, table)


def _prior_of_fields(fields: dict[str, Any]) -> Prior:
    """The prior of a posterior that stores its fields, as all did before priors wrote tables."""
    kind = fields.pop("kind")
    arrays = {k: np.array(v) if isinstance(v, list) else v for k, v in fields.items()}
    if fields.get("base"):
        base = BaseVariance if kind == "separable" else BaseDensity
        arrays["base"] = base(**{part: np.array(v) for part, v in fields["base"].items()})
    if "jumps" in arrays:
        arrays["jumps"] = arrays["jumps"].reshape(-1, 6)
    return prior_class(OLD_KINDS.get(kind, kind))(**arrays)
