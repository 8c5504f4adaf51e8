"""Checks of the arguments of estimators, which raise errors before any computation."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from difflib import get_close_matches
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import (
    EstimateWarning,
    GlissandoError,
    OutsideGridError,
    SensorError,
    UnobservableError,
)
from glissando.geometry.se3 import Array
from glissando.model.field_checks import is_number
from glissando.model.grid import SAME, Grid
from glissando.model.mechanics import Mechanics, implausible
from glissando.model.priors.prior import Prior
from glissando.model.robot import LONGEST, Robot
from glissando.model.sensors.own_jacobian import require_own_jacobian
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions

_FAR = 5.0  # standard deviations of an offset beyond the grid that are allowed
_LIKE = 0.75  # similarity of names above which one may be misspelt


def model_of(
    model: Prior | Robot, sensor_parameters: Sequence[SensorParameter] | None
) -> tuple[Prior, Sequence[SensorParameter]]:
    """Prior of a model, and its sensor parameters unless others are given.

    Args:
        model: A robot, or a prior, which has no sensor parameters.
        sensor_parameters: Sensor parameters to use instead, or None.
    """
    if isinstance(model, Robot):
        own = model.sensor_parameters if sensor_parameters is None else sensor_parameters
        return model.prior, own
    return model, () if sensor_parameters is None else sensor_parameters


def static_model(
    model: Prior | Robot, readings: Sequence[Readings]
) -> tuple[Prior, list[Readings]]:
    """Prior of a model, and readings of static shapes corrected for its sensor parameters.

    Args:
        model: A robot, or a prior, which has no sensor parameters.
        readings: The readings.

    Raises:
        SensorError: A sensor parameter of the readings is uncertain.
    """
    prior, sensor_parameters = model_of(model, None)
    names = {r.name for r in readings}
    for parameter in sensor_parameters:
        if not parameter.known and names.intersection(parameter.streams):
            raise SensorError(
                f"The robot's sensor parameter {parameter.name!r} is uncertain, and static shapes "
                f"estimate none; give one whose std is zero, or robot.prior to leave it out."
            )
    known = [parameter for parameter in sensor_parameters if parameter.known]
    return prior, [corrected(r, known) for r in readings]


def require_batch(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    sensor_parameters: Sequence[SensorParameter],
    initial: State | None,
    options: SolverOptions | None,
) -> None:
    """Raise GlissandoError if the arguments of a batch estimate are wrong."""
    require_kind(grid, Grid, "grid", "give robot.grid(first, last) or a Grid")
    require_model(prior, grid.arclength, sensor_parameters)
    require_list(readings, Readings, "readings")
    _require_once(readings)
    _warn_of_unmatched_names(readings, sensor_parameters)
    require_options(options)
    for parameter in sensor_parameters:
        for r in readings:
            if r.name in parameter.streams and len(r):
                _require_plausible(grid, r, parameter)
    if initial is not None:
        require_kind(initial, State, "initial state", "give posterior.states_on(grid) or a State")
        if initial.pose.shape[:2] != grid.shape:
            raise OutsideGridError(
                f"The initial state has {initial.pose.shape[:2]} nodes and the grid {grid.shape}; "
                f"give a state of this grid."
            )
    require_base(prior, readings)
    require_jacobians(prior, grid.arclength, readings)
    if len(readings) and not any(map(len, readings)):
        warnings.warn(
            f"None of the streams ({', '.join(r.label for r in readings)}) has a reading: the "
            f"estimate is the prior. Are their window and names right?",
            EstimateWarning,
            stacklevel=3,
        )


def require_jacobians(prior: Prior, arclength: Array, readings: Sequence[Readings]) -> None:
    """Raise SensorError if a user-defined sensor's Jacobian is not that of its residual."""
    own = [r for r in readings if not type(r).__module__.startswith("glissando.")]
    if own:
        rest = prior.rest_state(Grid(arclength, [0.0])).take(0)
        for r in own:
            require_own_jacobian(r, rest)


def _require_once(readings: Sequence[Readings]) -> None:
    """Raise SensorError if the same readings are given twice, as they would count twice."""
    for one, other in combinations(readings, 2):
        names = ("time", "arclength", "values", "mount")
        fields = ((getattr(r, name) for r in (one, other)) for name in names)
        alike = type(one) is type(other) and len(one) > 1
        if one is other or (alike and all(np.array_equal(*each) for each in fields)):
            raise SensorError(
                f"{one.label} and {other.label} are the same readings, which would count twice; "
                f"give each once."
            )


def _warn_of_unmatched_names(
    readings: Sequence[Readings], sensor_parameters: Sequence[SensorParameter]
) -> None:
    """Warn if sensor parameters belong to no readings, and a name may be missing or misspelt."""
    names = {r.name for r in readings}
    theirs = sorted({name for p in sensor_parameters for name in p.streams})
    if not theirs or names.intersection(theirs):
        return
    if "" in names or any(get_close_matches(name, theirs, 1, _LIKE) for name in names):
        warnings.warn(
            f"The sensor parameters are of streams {', '.join(theirs)}, and the readings of "
            f"{', '.join(sorted(r.label for r in readings))}: they change nothing. Give readings "
            f"the name of their stream.",
            EstimateWarning,
            stacklevel=4,
        )


def require_base(prior: Prior, readings: Sequence[Readings]) -> None:
    """Raise UnobservableError if neither the prior nor a reading fixes the base."""
    if not prior.fixes_base and not any(r.fixes_base and len(r) for r in readings):
        raise UnobservableError(
            "Nothing fixes the base: the robot has no [base] and no pose, coil or position stream "
            "is used. Give the robot a [base], or use a stream that fixes it."
        )


def require_model(
    prior: Prior, arclength: Array, sensor_parameters: Sequence[SensorParameter] = ()
) -> None:
    """Raise GlissandoError for a wrong prior, nodes in mm or off the base, or equal names."""
    if isinstance(prior, type) or not hasattr(prior, "rest_state"):
        raise GlissandoError(f"The prior is a {type(prior).__name__}; give a Robot or a Prior.")
    longest = float(np.max(arclength, initial=0.0))
    if longest > LONGEST:
        raise OutsideGridError(
            f"The arclength nodes reach {longest:g} m; give metres, not millimetres."
        )
    if prior.fixes_base and arclength.size and abs(arclength.flat[0]) > SAME:
        raise OutsideGridError(
            f"The arclength nodes begin at {arclength.flat[0]:g} m, and the prior says where the "
            f"base stands; begin at 0, or give a prior without a base."
        )
    mechanics = getattr(prior, "mechanics", None)
    if isinstance(mechanics, Mechanics) and arclength.size == 1:
        raise OutsideGridError(
            "The only arclength node is the base, and a prior of mechanics needs the rod's tip as "
            "well; give two arclength nodes or more."
        )
    wrong = implausible(mechanics, longest) if isinstance(mechanics, Mechanics) else None
    if wrong is not None:
        raise GlissandoError(f"Mechanics: {wrong[0]} {wrong[1]}")
    names = set()
    for parameter in require_list(sensor_parameters, SensorParameter, "sensor parameters"):
        if parameter.name in names:
            raise SensorError(f"Two sensor parameters are named {parameter.name!r}; rename one.")
        names.add(parameter.name)


def _require_plausible(grid: Grid, readings: Readings, parameter: SensorParameter) -> None:
    """Raise if a mount would have no effect, or an offset shifts most readings off the grid."""
    if parameter.kind == "mount" and not readings.mounted:
        raise SensorError(
            f"{readings.label}: readings of kind {readings.kind} have no mount; leave sensor "
            f"parameter {parameter.name!r} out."
        )
    if parameter.kind not in ("arclength_offset", "time_offset"):
        return
    nodes, unit = (grid.time, "s") if parameter.kind == "time_offset" else (grid.arclength, "m")
    at = getattr(parameter.shift(readings, parameter.value), parameter.along)
    margin = min(_FAR * float(parameter.std[0]), float(np.ptp(nodes)))
    if np.mean((at < nodes[0] - margin) | (at > nodes[-1] + margin)) > 0.5:
        raise OutsideGridError(
            f"Sensor parameter {parameter.name!r} is {parameter.value[0]:g} {unit}, which puts "
            f"most readings of {readings.label} outside [{nodes[0]:g}, {nodes[-1]:g}] {unit}; give "
            f"{'metres' if unit == 'm' else 'seconds'}."
        )


def arclength_nodes(given: ArrayLike) -> Array:
    """Arclength nodes (N,) as an array; raises OutsideGridError unless they are numbers."""
    try:
        nodes = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        nodes = np.zeros(0)
    if nodes.ndim != 1 or not nodes.size:
        raise OutsideGridError(f"The arclength nodes are {given!r}; give a list of metres.")
    return nodes


def require_options(options: SolverOptions | None) -> None:
    """Raise GlissandoError for options of another class, such as a dict."""
    if options is not None:
        require_kind(options, SolverOptions, "options", "give SolverOptions(max_iterations=…)")


def require_gate(gate: float | None) -> None:
    """Raise SensorError unless a gate is a probability, or None."""
    if gate is not None and not (is_number(gate) and 0.0 < gate < 1.0):
        raise SensorError(
            f"The gate is {gate!r}; give the chance, between 0 and 1, below which a reading is "
            f"refused, or None."
        )


def require_window(window: int) -> None:
    """Raise OutsideGridError unless a window is a whole number of time nodes."""
    if not isinstance(window, int | np.integer):
        raise OutsideGridError(
            f"The window is {window!r}; give a whole number of time nodes, of which a robot has "
            f"time_rate a second."
        )
    if window < 1:
        raise OutsideGridError(f"A window of {window} time nodes is empty; give 1 or more.")


def require_kind(given: Any, kind: type | tuple[type, ...], name: str, advice: str) -> None:
    """Raise GlissandoError, with the argument's name, unless it is of a class."""
    if not isinstance(given, kind):
        raise GlissandoError(f"The {name} is a {type(given).__name__}; {advice}.")


def require_list(given: Any, kind: type, name: str) -> Any:
    """The list, if all its entries are of one class; raises SensorError otherwise."""
    if isinstance(given, kind) or not isinstance(given, Collection):
        raise SensorError(
            f"The {name} are a {type(given).__name__} and go in a list; give a list of "
            f"{kind.__name__}."
        )
    for entry in given:
        if not isinstance(entry, kind):
            raise SensorError(
                f"The {name} hold a {type(entry).__name__}; give a list of {kind.__name__}."
            )
    return given
