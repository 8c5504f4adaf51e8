"""A laboratory's constants, from a recording in which truth and sensors tell of one motion.

Where truth's bodies are mounted and how the sensors sit is found with the shape, from all of them
at once. Found from the errors of an estimate without truth, as `predict` finds them, what a wrong
sensor mount does to that estimate would pass for a mount of the truth.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.predictive import APART, constants_of, telling
from glissando.errors import GlissandoError, NotConvergedWarning
from glissando.estimation.batch import SolverOptions, estimate
from glissando.io.recording import Recording
from glissando.io.robot_file import parse_robot
from glissando.io.toml_table import Table
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings

_OF_A_RECORDING = ("time_offset", "bias")  # kinds that the next recording has its own of
_LOOSE = {"frame": (3e-3, 0.01), "mount": (2e-3, 0.05)}  # m, rad: how far off truth may be
_LATE = 0.02  # s: how late its stamps may be
_OPTIONS = SolverOptions(max_iterations=25)


def locate(
    document: Document,
    recording: Recording,
    window: tuple[float, float],
    use: Sequence[str],
    truth: Sequence[str],
) -> tuple[Document, tuple[SensorParameter, ...]]:
    """The robot file with its sensors' constants known, and the constants (known) of the truth.

    Truth counts as a sensor of the robot file's noise here, late by one delay. Unknowns of the file
    that drift, and delays and biases, belong to a recording and stay as they are.
    """
    robot = parse_robot(Table(document, "located", GlissandoError))
    sensors, bodies = (recording.readings(names, robot, window)[0] for names in (use, truth))
    loose = [replace(c, std=np.repeat(_LOOSE[c.kind], 3)) for c in constants_of(bodies)]
    readings = in_motion([*sensors, *bodies], bodies)
    late = SensorParameter(
        "truth delay", "time_offset", tuple(truth), np.zeros(1), np.array([_LATE])
    )
    shift = 2.0 * _LATE  # no reading may be moved off the grid
    inner = [
        r.select((r.time > window[0] + shift) & (r.time < window[1] - shift)) for r in readings
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)
        posterior = estimate(
            robot.prior,
            robot.grid(*window),
            inner,
            sensor_parameters=[*robot.sensor_parameters, *loose, late],
            options=_OPTIONS,
        )

    def found(unknown: SensorParameter) -> SensorParameter:
        values, _ = posterior.unknown(unknown.name)
        return replace(unknown, value=values[len(values) // 2], std=0.0 * unknown.std)

    known = copy.deepcopy(document)
    entries = known.get("sensor_parameters", [])
    for entry, unknown in zip(entries, robot.sensor_parameters, strict=True):
        holds = np.isinf(unknown.correlation_time) and unknown.kind not in _OF_A_RECORDING
        if holds and not unknown.known:
            entry["value"] = found(unknown).value.tolist()
            del entry["std"]
    return known, tuple(found(u) for u in [*loose, late])


def in_motion(readings: Sequence[Readings], truth: Sequence[Readings]) -> list[Readings]:
    """Readings without the stretches of time in which no truth is elsewhere than before.

    Of a robot that rests they say the same again; what drifts meanwhile would pass for constant,
    and so would what the prior expects of that one shape.
    """
    told = np.concatenate([np.unique(telling(t).time // APART) for t in truth if len(t)])
    return [r.select(np.isin(r.time // APART, told)) for r in readings]


def lasting(constants: Sequence[SensorParameter]) -> tuple[SensorParameter, ...]:
    """Those constants that hold for other recordings as well."""
    return tuple(c for c in constants if c.kind not in _OF_A_RECORDING)
