"""Static shape of a rod: pose, strain and internal wrench at any arclength."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Rod


@dataclass(frozen=True)
class Section:
    """Cross-sections of a rod; leading dimensions are those of the query.

    Attributes:
        pose: Poses T_wb (…, 4, 4).
        strain: Strains (…, 6).
        wrench: Internal wrenches (…, 6) of the rod's material, without the tendons' part: [force N,
            moment N m] in the body frame.
    """

    pose: Array
    strain: Array
    wrench: Array


@dataclass(frozen=True)
class Shape:
    """Static shape of a rod.

    Attributes:
        rod: The rod.
        mesh: Mesh with G points.
        strain: Strain at the points (G, 6).
        edges: Poses at the edges of the elements (E + 1, 4, 4).
    """

    rod: Rod
    mesh: Mesh
    strain: Array
    edges: Array

    def at(self, arclength: ArrayLike) -> Section:
        """Cross-sections at arclengths (…), m. Raises SimulationError for any off the rod."""
        s = np.asarray(arclength, dtype=float)
        strains = np.broadcast_to(self.strain, (s.size, *self.strain.shape))
        edges = np.broadcast_to(self.edges, (s.size, *self.edges.shape))
        return sections(self.rod, self.mesh, strains, edges, s)


def require_on_rod(rod: Rod, arclength: Array) -> None:
    """Raise SimulationError unless all arclengths (…) are on the rod."""
    off = arclength[~((arclength >= -1e-9) & (arclength <= rod.length + 1e-9))]
    if off.size:
        raise SimulationError(
            f"Arclength {off[0]:g} m is off a rod of {rod.length:g} m; give 0 to {rod.length:g} m."
        )


def sections(rod: Rod, mesh: Mesh, strain: Array, edges: Array, arclength: Array) -> Section:
    """Cross-sections at arclengths (…), each of its own shape.

    Args:
        rod: Rod of all shapes.
        mesh: Mesh of all shapes.
        strain: Strains at the points (M, G, 6), one for each of the M arclengths.
        edges: Poses at the edges of the elements (M, E + 1, 4, 4).
        arclength: Arclengths (…), m.

    Raises:
        SimulationError: An arclength is off the rod.
    """
    require_on_rod(rod, arclength)
    flat, lead = arclength.ravel(), arclength.shape
    values = mesh.interpolate(strain, flat)
    pose, wrench = mesh.pose_at(strain, edges, flat), rod.stiffness * (values - rod.rest(flat))
    return Section(pose.reshape(*lead, 4, 4), values.reshape(*lead, 6), wrench.reshape(*lead, 6))
