"""The mechanical prior from the tables of a robot file."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.model.mechanics import Mechanics, read_mechanics
from glissando.model.priors.mechanical.inertia import Inertia
from glissando.model.priors.prior_table import read_rest
from glissando.model.table import Table


def read_fields(prior: Table, robot: Table) -> dict[str, Any]:
    """Fields of the prior, from the [prior] table of a robot file and the file with [mechanics]."""
    mechanics = read_mechanics(robot)
    if mechanics is None:
        raise robot.fail("[mechanics]", "is missing; a mechanical prior needs this table.")
    names = ("psd_load", "psd_strain_error", "var_tip")
    fields = {name: prior.vector(name, 6, positive=True) for name in names}
    fields |= read_rest(robot, len(mechanics.stiffness))
    points = prior.places("points")
    if points.size:
        fields |= {"points": points, "var_points": prior.rows("var_points", points.size, 6)}
    base = robot.subtable("base")
    fields |= {"base_pose": base.pose(), "var_base": base.vector("var_pose", 6, positive=True)}
    base.close()
    return {
        "mechanics": mechanics,
        "inertia": _inertia(prior, mechanics),
        "time_scale": prior.number("time_scale"),
        **fields,
    }


def _inertia(prior: Table, mechanics: Mechanics) -> Inertia | None:
    """Inertia from the table [prior.inertia], or None without it."""
    table = prior.table("inertia")
    if table is None:
        return None
    if np.any(mechanics.mass_per_length == 0.0):
        raise table.fail("[prior.inertia]", "needs the mass of [mechanics]; give its density.")
    return Inertia.from_table(table)
