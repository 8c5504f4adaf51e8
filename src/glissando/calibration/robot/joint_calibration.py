"""Joint calibration of frames and mounts, from a recording with both truth and sensors.

Mounts of the truth's bodies and of the sensors are estimated jointly with the shape. If the truth's
were estimated afterwards, from errors against truth as `predict` does, they would absorb the effect
of a wrong sensor mount.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.predictive import (
    APART,
    Start,
    constants_of,
    in_motion,
)
from glissando.errors import GlissandoError, RecordingError
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.io.robot_file import parse_robot
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.table import Table
from glissando.solver.gauss_newton import SolverOptions

_OF_A_RECORDING = ("time_offset", "bias")  # kinds that differ between recordings
_PRIOR_STD = {"frame": (3e-3, 0.01), "mount": (2e-3, 0.05)}  # m, rad: of the truth's constants
_LATE = 0.02  # s: prior standard deviation of the truth's delay
_OPTIONS = SolverOptions(25, tolerance=1.0, settled=5)  # later, weights would drift with delays


def locate(
    document: Document,
    recording: Recording,
    window: tuple[float, float],
    use: Sequence[str],
    truth: Sequence[str],
) -> tuple[Document, tuple[SensorParameter, ...], dict[str, Array], Start]:
    """Estimate the constants of sensors and truth jointly with the shape.

    Args:
        document: The robot file. Its delays, biases and drifting parameters stay unchanged.
        recording: A recording with sensors and truth.
        window: First and last time, s.
        use: Names of the sensors.
        truth: Names of the truth streams. They share a frame and a delay, and have the noise that
            the robot file states for sensors of their kind.

    Returns:
        The robot file with its sensors' constants fixed at the estimate, the truth's constants
        likewise, standard deviations of all estimated parameters by name, and an initial guess for
        the window's estimate.
    """
    robot = parse_robot(Table(document, "located", GlissandoError))
    sensors, bodies = (recording.readings(names, robot, window)[0] for names in (use, truth))
    constants = [replace(c, std=np.repeat(_PRIOR_STD[c.kind], 3)) for c in constants_of(bodies)]
    readings = while_moving([*sensors, *bodies], bodies)
    std = np.array([_LATE])
    constants += [SensorParameter("truth delay", "time_offset", tuple(truth), np.zeros(1), std)]
    shift = 2.0 * _LATE  # margin, so that a delay moves no reading off the grid
    start, stop = window[0] + shift, window[1] - shift
    inner = [r.select((r.time > start) & (r.time < stop)) for r in readings]
    if not all(any(len(r) for r in inner if r.name in names) for names in (use, truth)):
        raise RecordingError(
            f"From {seconds(start)} to {seconds(stop)} s ({1e3 * shift:g} ms inside the window, "
            f"for the delay's sake) there are no readings of sensors and of truth while the robot "
            f"moves; choose a longer window."
        )
    parameters = [*robot.sensor_parameters, *constants]
    posterior = estimate_in_passing(
        robot.prior, robot.grid(*window, inner), inner, parameters, _OPTIONS
    )

    def estimated(parameter: SensorParameter) -> SensorParameter:
        values, _ = posterior.parameter(parameter.name)
        return replace(parameter, value=values[len(values) // 2], std=0.0 * parameter.std)

    found = {parameter.name for parameter, _ in posterior.sensor_parameters}
    known = copy.deepcopy(document)
    entries = known.get("sensor_parameters", [])
    for entry, parameter in zip(entries, robot.sensor_parameters, strict=True):
        constant = np.isinf(parameter.correlation_time) and parameter.kind not in _OF_A_RECORDING
        if constant and not parameter.known and parameter.name in found:
            entry["value"] = estimated(parameter).value.tolist()
            del entry["std"]
    uncertain = [p for p in parameters if p.name in found]  # others have no stream here
    deviations = {p.name: _std(posterior, p.name) for p in uncertain}
    return known, tuple(map(estimated, constants)), deviations, Start.of(posterior)


def _std(posterior: Posterior, name: str) -> Array:
    """Standard deviations of a sensor parameter at the middle time node."""
    _, cov = posterior.parameter(name)
    return np.sqrt(np.diagonal(cov[len(cov) // 2]))


def while_moving(readings: Sequence[Readings], truth: Sequence[Readings]) -> list[Readings]:
    """Readings from those intervals of APART seconds in which any truth stream has moved.

    Many readings at one shape would give drifts and the prior's bias at that shape the weight of
    constants.

    Args:
        readings: The streams to select from.
        truth: Truth streams.
    """
    moving = in_motion(truth)
    return [r.select(np.isin(r.time // APART, moving)) for r in readings]


def lasting(constants: Sequence[SensorParameter]) -> tuple[SensorParameter, ...]:
    """Constants that hold for other recordings as well: all but delays and biases."""
    return tuple(c for c in constants if c.kind not in _OF_A_RECORDING)


def without_constants(document: Document, truth: Sequence[str]) -> Document:
    """Robot file without the truth's frame and mounts of an earlier calibration.

    Args:
        document: The robot file.
        truth: Names of the truth streams, whose constants are estimated again.
    """
    found = {"truth frame", *(f"{name} mount" for name in truth)}

    def recalibrated(entry: Document) -> bool:
        of_truth = set(truth).issuperset(entry["streams"])
        return "std" not in entry and entry["name"] in found and of_truth

    entries = document.get("sensor_parameters", [])
    return {**document, "sensor_parameters": [each for each in entries if not recalibrated(each)]}
