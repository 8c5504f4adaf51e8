"""Posteriors in NetCDF-4 (HDF5) files, with names, units, and everything that queries need.

xarray, MATLAB and any HDF5 reader open them. The block-tridiagonal information matrix is stored,
and covariances are computed from it on loading; standard deviations and covariances of the nodes
are written too, for other programs.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import GlissandoError, needing
from glissando.estimation.given import require_kind
from glissando.estimation.posterior import Posterior
from glissando.estimation.solve_report import SolveReport
from glissando.estimation.transported import has_rolled, transported
from glissando.geometry.se3 import Array
from glissando.io.atomic import new_file
from glissando.io.labelled_posterior import FIELDS, Variables, labelled
from glissando.io.plain_file import largest_deflated, require_plain
from glissando.io.provenance import require_readable, versions
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

_DAMAGED = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    RuntimeError,
    OverflowError,
)
_PACKED, _CHUNK = 1 << 16, 1 << 20  # bytes above which a variable is compressed, and of a chunk
_SKEW = 1e-6  # tolerance of the orthogonality of rotations
_POINTS = [f"linearized_{field}" for field in FIELDS]
_READ = ("time", "arclength", *FIELDS, *_POINTS, "information", "information_below")


def _packages() -> Any:
    """The packages h5netcdf and h5py."""
    with needing("Saving and loading posteriors needs h5netcdf and h5py", "netcdf"):
        import h5netcdf
        import h5py
    return h5netcdf, h5py


def save_posterior(posterior: Posterior, path: str | Path) -> None:
    """Write a posterior to a NetCDF-4 (HDF5) file, which `load_posterior` reads.

    Raises:
        GlissandoError: The file cannot be written, or h5netcdf is not installed.
    """
    require_kind(posterior, Posterior, "posterior", "give what estimate returned, then the file")
    variables, coordinates, attributes = labelled(posterior)
    slab = ("slab", "slab_")
    of_pose = {"units": "m in its last column", "frame": "T_wb, body to world"}
    of_states = {"convention": "arclength × component, then sensor parameters; for queries"}
    of_steps = of_states | {"frame": "rows of a time node, columns of the one before"}
    variables["pose"] = (("time", "arclength", "row", "column"), posterior.state.pose, of_pose)
    variables["information"] = (("time", *slab), posterior.system.diagonal, of_states)
    variables["information_below"] = (("time_step", *slab), posterior.system.lower, of_steps)
    rolled = has_rolled(posterior.linearization_point, posterior.state)
    if rolled or isinstance(posterior.prior, MechanicalPrior):
        variables |= _linearization(posterior)
    attributes["prior"] = json.dumps(posterior.prior.to_table())
    attributes["sensor_parameters"] = json.dumps(
        [_json_table({**vars(u), "values": values}) for u, values in posterior.sensor_parameters]
    )
    if posterior.grid.before is not None:
        attributes["time_before"] = posterior.grid.before
    elif posterior.grid.time.size == 1:
        attributes["time_span"] = float(posterior.grid.time_spans[0])
    attributes["versions"] = json.dumps(versions())
    attributes["solve"] = json.dumps(posterior.solve.to_table())
    image = _image({**coordinates, **variables}, attributes)  # HDF5 aborts on a full disk
    with new_file(path) as building:
        building.write_bytes(image)


def _image(variables: Variables, attributes: dict[str, Any]) -> bytes:
    """Bytes of a NetCDF-4 file with these variables and attributes."""
    image, (h5netcdf, h5py) = io.BytesIO(), _packages()
    with h5netcdf.File(image, "w") as file:
        for name, (dimensions, values, about) in variables.items():
            sizes = zip(dimensions, values.shape, strict=True)
            file.dimensions.update({d: size for d, size in sizes if d not in file.dimensions})
            compression: dict[str, Any] = {}
            if values.nbytes > _PACKED:
                rows_per_chunk = max(1, _CHUNK * values.shape[0] // values.nbytes)
                compression = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
                compression["chunks"] = (min(rows_per_chunk, len(values)), *values.shape[1:])
            text = {"dtype": h5py.string_dtype()} if values.dtype == object else {}
            variable = file.create_variable(name, dimensions, data=values, **text, **compression)
            variable.attrs.update(about)
        file.attrs.update(attributes)
    return image.getvalue()


def _linearization(posterior: Posterior) -> Variables:
    """States (2, K, N): the linearisation point, and the state at which noise was evaluated."""
    variables: Variables = {}
    for name, key in zip(FIELDS, _POINTS, strict=True):
        each = [getattr(state, name) for state in posterior.linearized or ()]
        if each and each[0] is not None:
            entries = ("row", "column") if name == "pose" else ("component6",)
            about = {"convention": f"{name} where information was linearised; for queries"}
            variables[key] = (("point", "time", "arclength", *entries), np.stack(each), about)
    return variables


def load_posterior(path: str | Path) -> Posterior:
    """Read a posterior; covariances are computed again from its information matrix.

    Raises:
        GlissandoError: The file cannot be read, is not a posterior, or declares more data than a
            file of its size can hold.
    """
    require_kind(path, (str, PathLike), "posterior to load", "give the path of its file")
    path = Path(path)
    try:
        require_plain(path, 1 << 40)
        with _packages()[0].File(path, "r", phony_dims="sort") as file:
            announced = sum(prod(v.shape) * v.dtype.itemsize for v in file.variables.values())
            if announced > largest_deflated(path.stat().st_size):
                raise ValueError(
                    f"it announces {announced:,} bytes of numbers, more than it or memory holds"
                )
            arrays = {name: file.variables[name][...] for name in _READ if name in file.variables}
            attributes = dict(file.attrs)
    except (OSError, MemoryError, *_DAMAGED) as problem:
        raise GlissandoError(f"{path} cannot be read as NetCDF ({problem}).") from None
    require_readable(attributes.get("format", "unknown"), "posterior", path)
    try:
        return _posterior(arrays, attributes, path.name)
    except UnknownPriorError as problem:
        raise GlissandoError(f"{path}: {problem}") from None
    except (GlissandoError, np.linalg.LinAlgError, *_DAMAGED) as problem:
        raise GlissandoError(f"{path} is damaged ({problem}); estimate again.") from None


def _posterior(arrays: dict[str, Array], attributes: dict[str, Any], name: str) -> Posterior:
    """Posterior of the arrays and attributes of a file."""
    parameters = attributes.get("sensor_parameters") or attributes.get("unknowns", "[]")
    prior = _as_prior(json.loads(attributes["prior"]), name)
    before = attributes.get("time_before")
    before = None if before is None else float(before)
    grid = Grid(_numbers(arrays, "arclength"), _numbers(arrays, "time"), before)
    span = float(attributes.get("time_span", 1.0))
    if not 0.0 < span < np.inf:
        raise ValueError(f"its node stands for {span:g} s")
    grid = grid.at_times(grid.time, before, span)
    state = State(*(_numbers(arrays, field) for field in FIELDS if field in arrays))
    blocks = (_numbers(arrays, key) for key in ("information", "information_below"))
    estimated = [_as_sensor_parameter(table) for table in json.loads(parameters)]
    system = BlockTridiagonal(*blocks)
    _require_consistent(grid, state, system, estimated)
    points = [_numbers(arrays, key) for key in _POINTS if key in arrays]
    if points and [p.shape for p in points] != [(2, *field.shape) for field in state.fields()]:
        raise ValueError("where it was linearised does not fit its nodes")
    solve = SolveReport.from_table(json.loads(attributes["solve"]))
    f"{solve.status}{solve.iterations:d}{solve.cost:g}{sum(solve.seconds.values()):g}"  # or raises
    linearized = (
        (State(*(p[0] for p in points)), State(*(p[1] for p in points))) if points else None
    )
    marginals = factor(system).marginals(consume=True)
    marginals = transported(linearized[0] if linearized else state, state, marginals)
    return Posterior(prior, grid, state, system, marginals, solve, estimated, linearized)


def _numbers(arrays: dict[str, Array], name: str) -> Array:
    """Values of a variable. Raises ValueError unless they are finite."""
    values = np.asarray(arrays[name], dtype=float)
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{name} is not finite")
    return values


def _require_consistent(
    grid: Grid,
    state: State,
    system: BlockTridiagonal,
    estimated: Sequence[tuple[SensorParameter, Array]],
) -> None:
    """Raise ValueError unless the shapes are consistent and poses are rigid motions."""
    k, n = grid.shape
    size = sum(parameter.size for parameter, _ in estimated)
    block_size = n * state.dof + size
    wanted = [(k, n, 4, 4), *[(k, n, 6)] * (len(state.fields()) - 1), (k, block_size, block_size)]
    shapes = [field.shape for field in state.fields()] + [system.diagonal.shape]
    values = [v.shape == (k, parameter.size) for parameter, v in estimated]
    if shapes != wanted or system.lower.shape != (k - 1, block_size, block_size) or not all(values):
        raise ValueError(f"arrays of shapes {shapes} do not fit {k} times and {n} arclengths")
    rotation = state.pose[..., :3, :3]
    skew = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max()
    bottom_row = np.abs(state.pose[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max()
    if max(skew, bottom_row) > _SKEW or np.any(np.linalg.det(rotation) < 0.0):
        raise ValueError("a pose is not a rigid motion")


def _json_table(table: dict[str, Any]) -> dict[str, Any]:
    """Copy of a table for JSON: arrays become lists, and infinity None."""
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in table.items()}
    return {k: None if v == np.inf else v for k, v in plain.items()}


def _as_sensor_parameter(table: dict[str, Any]) -> tuple[SensorParameter, Array]:
    values, memory = np.array(table.pop("values")), table.pop("correlation_time")
    table["kind"] = OLD_KINDS.get(table["kind"], table["kind"])
    table["streams"] = tuple(table["streams"])
    return SensorParameter(**table, correlation_time=np.inf if memory is None else memory), values


def _as_prior(document: dict[str, Any], where: str) -> Prior:
    """Prior of a document in the form of a robot file."""
    if "prior" not in document:
        return _prior_of_fields(document)
    table = Table(document, where, GlissandoError)
    entries = table.subtable("prior")
    return prior_class(entries.text("kind")).from_table(entries, table)


def _prior_of_fields(fields: dict[str, Any]) -> Prior:
    """Prior of an older file, which stores the fields of the prior's class."""
    kind = fields.pop("kind")
    arrays = {k: np.array(v) if isinstance(v, list) else v for k, v in fields.items()}
    if fields.get("base"):
        base = BaseVariance if kind == "separable" else BaseDensity
        arrays["base"] = base(**{part: np.array(v) for part, v in fields["base"].items()})
    if "jumps" in arrays:
        arrays["jumps"] = arrays["jumps"].reshape(-1, 6)
    return prior_class(OLD_KINDS.get(kind, kind))(**arrays)
