"""A posterior at its nodes as variables with names, dimensions, units and frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from glissando.errors import needing
from glissando.estimation.loads import load_places
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.io.provenance import stated_format
from glissando.model.priors.mechanical.prior import MechanicalPrior

if TYPE_CHECKING:
    import xarray

_SIX = ["x", "y", "z", "rx", "ry", "rz"]
FIELDS: tuple[str, ...] = ("pose", "strain", "velocity", "strain_rate", "inertia")
COMPONENTS = [f"{field}_{part}" for field in FIELDS for part in _SIX]
"""Names of a node's components in the order of every covariance.

18 for all priors, 24 with a strain rate, 30 with inertia.
"""

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]
"""Dimensions, values and attributes by name."""


def to_xarray(posterior: Posterior) -> xarray.Dataset:
    """Mean, standard deviation and covariance at the nodes, with names and units.

    Raises:
        GlissandoError: xarray is not installed.
    """
    with needing("Labelled arrays need xarray", "netcdf"):
        import xarray
    return xarray.Dataset(*labelled(posterior))


def labelled(posterior: Posterior) -> tuple[Variables, Variables, dict[str, Any]]:
    """Variables, coordinates and attributes of a data set of a posterior at its nodes."""
    dof, six = posterior.state.dof, "component6"
    variables = _states(posterior)
    if isinstance(posterior.prior, MechanicalPrior):
        variables |= _loads(posterior, posterior.prior)
    names = {
        "axis": ["x", "y", "z"],
        "quaternion_part": ["w", "x", "y", "z"],
        six: _SIX,
        "component": COMPONENTS[:dof],
        "component_": COMPONENTS[:dof],
    }
    coordinates: Variables = {
        "time": (("time",), posterior.grid.time, {"units": "s"}),
        "arclength": (("arclength",), posterior.grid.arclength, {"units": "m"}),
        **{name: ((name,), np.array(each, dtype=object), {}) for name, each in names.items()},
    }
    if "load" in variables:
        coordinates["place"] = variables.pop("place")
    attributes = {
        "title": "Posterior of a continuum robot's motion",
        "format": stated_format("posterior"),
    }
    return variables, coordinates, attributes


def _states(posterior: Posterior) -> Variables:
    """Means, standard deviations and covariances at the nodes."""
    k, n = posterior.grid.shape
    state, dof = posterior.state, posterior.state.dof
    of_nodes = posterior.marginals.cov[:, : n * dof, : n * dof]
    cov = np.einsum("kninj->knij", of_nodes.reshape(k, n, dof, n, dof))
    node, six = ("time", "arclength"), "component6"
    std = np.sqrt(np.einsum("knii->kni", cov))
    units = ["m", "rad", "1", "1/m", "m/s", "rad/s", "1/s", "1/m/s", "m/s²", "m/s³"]
    mixed = ", ".join(units[: dof // 3])
    variables: Variables = {
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


def _loads(posterior: Posterior, prior: MechanicalPrior) -> Variables:
    """Internal wrenches at the nodes, and external loads at the arclengths where the prior has any.

    Each has means and standard deviations, in N and N m, body frame.
    """
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
        "place": (("place",), place, {"units": "m"}),
    }
