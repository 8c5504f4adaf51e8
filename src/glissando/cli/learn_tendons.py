"""Learning of [tendons] and [mechanics] by `glissando learn`, from tendons and a tip marker."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.learn_tendons import (
    LearnedTendons,
    TendonData,
    learn_tendons,
    spread,
)
from glissando.cli.outputs import write_robot
from glissando.cli.say import say
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Stream
from glissando.io.recording import Recording
from glissando.io.robot_file import load_robot
from glissando.model.robot import Robot
from glissando.model.tendons.replicate import TIP

_TURNED, _SHIFTED = np.radians(3.0), 5e-3  # rad, m: smaller changes of a frame are not reported
_POOR = 0.25  # share of the tip's motion: larger errors mean that the model does not fit
_WITHOUT_EFFECT = ("use", "truth", "hold_out", "only", "calibrate", "joint", "alike", "steps")


def is_of_tendons(recordings: Sequence[Recording], options: argparse.Namespace) -> bool:
    """Whether to learn [tendons] and [mechanics] from these recordings.

    That is so if tendons and the tip are the only streams, or if there are others but no option is
    given that applies to those.
    """
    streams = [s for recording in recordings for s in recording.streams.values()]
    if not any(stream.rows.kind == "tendon" for stream in streams):
        return False
    if all(stream.rows.kind == "tendon" or stream.name == TIP for stream in streams):
        return True
    return any(map(_is_tip, streams)) and not _options_without_effect(options)


def learn_from_tendons(
    recordings: Sequence[Recording], document: Document, options: argparse.Namespace
) -> int:
    """Learn [tendons] and [mechanics], write the robot file, and print its errors.

    Args:
        recordings: Recordings, each with a stream of kind tendon and positions named tip.
        document: Document of the robot file to start from.
        options: Options of `glissando learn`.

    Returns:
        Exit status.

    Raises:
        RecordingError: A recording lacks one of the streams, or an option has no effect.
    """
    _require_effect(options)
    window = options.window or (-np.inf, np.inf)
    parts = [_rows(recording, *window) for recording in recordings]
    displacement, tip = (np.concatenate(column) for column in zip(*parts, strict=True))
    robot = load_robot(options.robot)
    learned = learn_tendons(robot, TendonData.of(displacement, tip), say)
    write_robot(_document(document, learned.robot), options.robot, options.out)
    report = _report(learned, len(tip), str(options.out))
    if moved := _frame_moved(robot, learned.robot):
        say(moved)
    if learned.held_out_rmse > _POOR * spread(tip):
        say(
            f"! Rows left out err by {100 * learned.held_out_rmse / spread(tip):.0f} % of how far "
            f"the tip moves: are tendons in the order and of the sign that {options.robot} says, "
            f"positive when pulled, and angles in radians?"
        )
    if options.json:
        print(json.dumps(report))
        return 0
    print(
        f"The tip errs by {report['rmse_mm']:.3g} mm on the {len(tip)} rows learned from, by "
        f"{report['rmse_left_out_mm']:.3g} mm on rows left out.\nOnly the marker judges this: a "
        f"turn of its tracker's frame, rest curvature and angles of tendons trade with each other, "
        f"so in the robot's own frame poses are as unsure as the prior leaves these.\n"
        f"Wrote {options.out}. Now: "
        f"glissando predict --robot {options.out} --tendons commands.csv --out predicted"
    )
    return 0


def _frame_moved(before: Robot, learned: Robot) -> str:
    """A sentence if learning changed the stated frame of the marker's tracker, else empty."""
    if not any(p.kind == "frame" and TIP in p.streams for p in before.sensor_parameters):
        return ""
    poses = [se3.exp(robot.stated_transform("frame", TIP)) for robot in (before, learned)]
    turn = float(np.linalg.norm(se3.log(se3.inverse(poses[0]) @ poses[1])[3:]))
    shift = float(np.linalg.norm(poses[1][:3, 3] - poses[0][:3, 3]))
    if turn < _TURNED and shift < _SHIFTED:
        return ""
    return (
        f"! The stated frame of {TIP!r} was turned by {np.degrees(turn):.3g} degrees and moved by "
        f"{1e3 * shift:.3g} mm to fit, as if the tracker stood elsewhere. If it was measured, turn "
        f"the angles of [tendons] instead, and learn again."
    )


def _require_effect(options: argparse.Namespace) -> None:
    """Raise RecordingError if an option is given that has no effect on learning from tendons."""
    given = _options_without_effect(options)
    if given:
        raise RecordingError(
            f"--{given[0].replace('_', '-')} has no effect on what is learned from tendons: all "
            f"numbers of [tendons] and the marker {TIP!r}, until they settle. Leave it out; "
            f"--window chooses rows."
        )


def _options_without_effect(options: argparse.Namespace) -> list[str]:
    """Names of given options that have no effect on learning from tendons."""
    return [name for name in _WITHOUT_EFFECT if getattr(options, name) not in (None, False)]


def _is_tip(stream: Stream) -> bool:
    return stream.name == TIP and stream.rows.kind == "position"


def _rows(recording: Recording, start: float, stop: float) -> tuple[Array, Array]:
    """Displacements (M, T) and tip positions (M, 3), m, at the common times in a window."""
    streams = recording.streams.values()
    tendons = next((s.rows for s in streams if s.rows.kind == "tendon"), None)
    tip = next((s.rows for s in streams if _is_tip(s)), None)
    if tendons is None or tip is None:
        lacks = "stream of kind tendon" if tendons is None else f"positions named {TIP!r}"
        raise RecordingError(f"{recording.name} has no {lacks}; tendons are learned from both.")
    _, tendon_rows, tip_rows = np.intersect1d(tendons.time, tip.time, return_indices=True)
    if not tendon_rows.size:
        raise RecordingError(
            f"{recording.name}: tendons and {TIP} have no time in common; give them one clock."
        )
    inside = (tendons.time[tendon_rows] >= start) & (tendons.time[tendon_rows] <= stop)
    if not inside.any():
        first, last = tendons.time[tendon_rows][[0, -1]]
        raise RecordingError(
            f"{recording.name}: no row lies within --window {start:g} {stop:g}; the rows go from "
            f"{first:.6g} to {last:.6g} s."
        )
    tendon_rows, tip_rows = tendon_rows[inside], tip_rows[inside]
    displacement = tendons.values[tendon_rows][:, : np.size(tendons.settings["radius"])]
    return displacement, tip.values[tip_rows]


def _document(document: Document, robot: Robot) -> Document:
    """Copy of a robot document with the values of a learned robot."""
    assert robot.tendons is not None
    prior = robot.prior.to_table()
    sensors = dict(document.get("sensors", {}))
    position = dict(sensors.get("position", {})) | {"std": robot.sensor_std["position"].tolist()}
    known: list[dict[str, Any]] = [
        {"name": p.name, "kind": p.kind, "streams": list(p.streams), "value": p.value.tolist()}
        for p in robot.sensor_parameters
        if TIP in p.streams
    ]
    others = [p for p in document.get("sensor_parameters", []) if TIP not in p["streams"]]
    return {
        **document,
        **{name: prior[name] for name in ("rest_strain", "rest_slope", "mechanics")},
        "tendons": robot.tendons.to_table(),
        "sensors": sensors | {"position": position},
        "sensor_parameters": others + known,
    }


def _report(learned: LearnedTendons, rows: int, out: str) -> dict[str, Any]:
    tendons = learned.robot.tendons
    assert tendons is not None
    return {
        "out": out,
        "rows": rows,
        "rmse_mm": 1e3 * learned.rmse,
        "rmse_left_out_mm": 1e3 * learned.held_out_rmse,
        "tendons": tendons.to_table(),
    }
