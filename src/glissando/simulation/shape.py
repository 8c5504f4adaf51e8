"""A solved shape: pose, strain and internal wrench at any arclength."""

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
    """Cross-sections of a rod, with the leading shape of the query.

    `pose` (…, 4, 4) T_wb; `strain` (…, 6); `wrench` (…, 6) that the rod's material carries, [force
    N, moment N m] in the body frame, the tendons' share not in it.
    """

    pose: Array
    strain: Array
    wrench: Array


@dataclass(frozen=True)
class Shape:
    """A rod at rest: strain at the points of its mesh and poses at the edges of the elements."""

    rod: Rod
    mesh: Mesh
    strain: Array
    edges: Array

    def at(self, arclength: ArrayLike) -> Section:
        """Cross-sections at arclengths (…) in metres. Raises SimulationError off the rod."""
        s = np.asarray(arclength, dtype=float)
        require_on(self.rod, s)
        flat = s.ravel()
        strains = np.broadcast_to(self.strain, (flat.size, *self.strain.shape))
        edges = np.broadcast_to(self.edges, (flat.size, *self.edges.shape))
        pose = self.mesh.pose_at(strains, edges, flat)
        strain = self.mesh.interpolate(strains, flat)
        wrench = self.rod.stiffness * (strain - self.rod.rest(flat))
        return Section(
            pose.reshape(*s.shape, 4, 4), strain.reshape(*s.shape, 6), wrench.reshape(*s.shape, 6)
        )


def require_on(rod: Rod, arclength: Array) -> None:
    """Raise SimulationError unless every arclength is on the rod."""
    off = ~((arclength >= -1e-9) & (arclength <= rod.length + 1e-9))
    if np.any(off):
        raise SimulationError(
            f"Arclength {arclength[off].ravel()[0]:g} m is off a rod of {rod.length:g} m; give "
            f"0 to {rod.length:g} m."
        )
