"""The posterior as a NetCDF-4 (HDF5) file: names, units, and everything needed to query it again.

xarray, MATLAB and any HDF5 reader open it. The information matrix is stored, not the covariances
(they are denser and follow from it); standard deviations and node covariances are written too, for
readers who only look.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior, SolveReport
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor

if TYPE_CHECKING:
    import xarray

_FORMAT = "glissando posterior 1"
_SIX = ["x", "y", "z", "rx", "ry", "rz"]
_FIELDS = ("pose", "strain", "velocity", "strain_rate")
COMPONENTS = [f"{field}_{part}" for field in _FIELDS for part in _SIX]
"""Names of a node's components in the order of every covariance; 18, or 24 with a strain rate."""


def _xarray() -> Any:
    try:
        import h5netcdf
        import h5py
        import xarray
    except ImportError:
        raise GlissandoError(
            "Saving and loading posteriors needs xarray, h5netcdf and h5py; "
            "run pip install 'glissando[netcdf]'."
        ) from None
    del h5netcdf, h5py
    return xarray


def to_xarray(posterior: Posterior) -> xarray.Dataset:
    """Mean, standard deviation and covariance at the nodes, with names and units."""
    k, n = posterior.grid.shape
    state = posterior.state
    dof = state.dof
    of_nodes = posterior.marginals.cov[:, : n * dof, : n * dof]
    blocks = of_nodes.reshape(k, n, dof, n, dof)
    cov = np.einsum("kninj->knij", blocks)
    node, six = ("time", "arclength"), "component6"
    std = np.sqrt(np.einsum("knii->kni", cov))
    mixed = ", ".join(["m", "rad", "1", "1/m", "m/s", "rad/s", "1/s", "1/m/s"][: dof // 3])
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
        units = {"units": "1/s, 1/m/s", "frame": "body"}
        variables["strain_rate"] = ((*node, six), state.strain_rate, units)
    coordinates = {
        "time": ("time", posterior.grid.time, {"units": "s"}),
        "arclength": ("arclength", posterior.grid.arclength, {"units": "m"}),
        "axis": ["x", "y", "z"],
        "quaternion_part": ["w", "x", "y", "z"],
        six: _SIX,
        "component": COMPONENTS[:dof],
        "component_": COMPONENTS[:dof],
    }
    attributes = {"title": "Posterior of a continuum robot's motion", "format": _FORMAT}
    dataset: xarray.Dataset = _xarray().Dataset(variables, coordinates, attributes)
    return dataset


def save(posterior: Posterior, path: Path) -> None:
    """Write the posterior; `load` gives it back with the same answers.

    Raises GlissandoError when the file cannot be written.
    """
    dataset = to_xarray(posterior)
    dataset["pose"] = (("time", "arclength", "row", "column"), posterior.state.pose)
    dataset["information"] = (("time", "slab", "slab_"), posterior.system.diagonal)
    dataset["information_below"] = (("time_step", "slab", "slab_"), posterior.system.lower)
    dataset.attrs["prior"] = json.dumps(_as_table(posterior.prior))
    dataset.attrs["unknowns"] = json.dumps(
        [_plain({**vars(u), "values": values}) for u, values in posterior.sensor_parameters]
    )
    dataset.attrs["solve"] = json.dumps(vars(posterior.solve))
    packed = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding = dict.fromkeys(("information", "information_below", "cov"), packed)
    try:
        dataset.to_netcdf(path, engine="h5netcdf", encoding=encoding)
    except OSError as problem:
        raise GlissandoError(f"{path} cannot be written ({problem}).") from None


_PRIORS: dict[str, tuple[type[Any], type[Any]]] = {
    "kinematic": (WhiteNoisePrior, BaseDensity),
    "separable": (SeparablePrior, BaseVariance),
}


def _as_table(prior: Prior) -> dict[str, Any]:
    """A prior's kind and fields, arrays as lists."""
    kind = next(kind for kind, (made, _) in _PRIORS.items() if isinstance(prior, made))
    table: dict[str, Any] = {"kind": kind}
    for name, value in vars(prior).items():
        table[name] = _plain(vars(value)) if name == "base" and value is not None else value
    return _plain(table)


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """The table with arrays as lists, and None for infinity, which JSON lacks."""
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in table.items()}
    return {k: None if v == np.inf else v for k, v in plain.items()}


def _as_unknown(table: dict[str, Any]) -> tuple[SensorParameter, Array]:
    values, memory = np.array(table.pop("values")), table.pop("correlation_time")
    memory = np.inf if memory is None else memory
    return SensorParameter(
        **{**table, "streams": tuple(table["streams"]), "correlation_time": memory}
    ), values


def _as_prior(table: dict[str, Any]) -> Prior:
    prior, base = _PRIORS[table.pop("kind")]
    for name, value in table.items():
        if isinstance(value, list):
            table[name] = np.array(value)
        elif isinstance(value, dict):
            table[name] = base(**{part: np.array(given) for part, given in value.items()})
    if "jumps" in table:
        table["jumps"] = table["jumps"].reshape(-1, 6)
    made: Prior = prior(**table)
    return made


def load(path: Path) -> Posterior:
    """Read a posterior written by `save`. Raises GlissandoError for any other file."""
    try:
        with _xarray().open_dataset(path, engine="h5netcdf") as opened:
            dataset = opened.load()
    except (OSError, ValueError) as problem:
        raise GlissandoError(f"{path} cannot be read as NetCDF ({problem}).") from None
    if dataset.attrs.get("format") != _FORMAT:
        raise GlissandoError(f"{path} is not a glissando posterior; give a file that save wrote.")
    grid = Grid(dataset["arclength"].values, dataset["time"].values)
    names = [n for n in _FIELDS if n in dataset]
    fields = (dataset[name].values for name in names)
    system = BlockTridiagonal(dataset["information"].values, dataset["information_below"].values)
    solve = SolveReport(**json.loads(dataset.attrs["solve"]))
    sensor_parameters = [_as_unknown(u) for u in json.loads(dataset.attrs.get("unknowns", "[]"))]
    return Posterior(
        _as_prior(json.loads(dataset.attrs["prior"])),
        grid,
        State(*fields),
        system,
        factor(system).marginals(consume=True),
        solve,
        sensor_parameters,
    )
