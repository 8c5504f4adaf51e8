"""Export of posteriors and streams as trajectories for other programs: TUM, CSV, MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry.se3 import Array, inverse, pose, quaternion
from glissando.io.atomic import new_file
from glissando.io.csv_stream import Stream, write_named
from glissando.io.provenance import stated_format
from glissando.io.query_csv import write_query
from glissando.io.session_log import NUMBER, TEXT, SessionWriter, numbers, schema

_VECTOR = schema("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
_QUATERNION = schema("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
_POSE = schema("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_TIME = schema("time", sec={"type": "integer"}, nsec={"type": "integer"})
_STAMPED = {"timestamp": _TIME, "frame_id": TEXT}
_MANY = {"type": "array"}
_CHUNK = 200  # times evaluated at once, to bound memory
SCHEMAS = {
    "/shape": schema("foxglove.PosesInFrame", **_STAMPED, poses={**_MANY, "items": _POSE}),
    "/tip": schema("foxglove.PoseInFrame", **_STAMPED, pose=_POSE),
    "/estimate": schema(
        "glissando.Estimate",
        time=NUMBER,  # s
        arclength={**_MANY, "items": NUMBER},  # m, one a pose
        position={**_MANY, "items": numbers(3)},  # m, world frame
        quaternion={**_MANY, "items": numbers(4)},  # w, x, y, z; body to world
        cov_pose={**_MANY, "items": {**_MANY, "items": numbers(6)}},  # [linear, angular], body
    ),
}
"""Topics of an exported MCAP file and the JSON schemas of their messages."""


def export(
    posterior: Posterior,
    out: str | Path,
    *,
    arclength: Array | None = None,
    rate: float | None = None,
) -> int:
    """Write poses of a posterior to a .tum (.txt), .csv or .mcap file.

    Args:
        posterior: Posterior to evaluate.
        out: File to write; its suffix chooses the format.
        arclength: Arclengths (N,), m; by default the tip for TUM, else the nodes.
        rate: Poses a second; by default at the time nodes.

    Returns:
        Number of times.

    Raises:
        GlissandoError: The suffix is unknown, the rate is invalid, several arclengths are given
            for TUM, or times below zero for MCAP.
        OutsideGridError: An arclength is off the robot.
    """
    out = Path(out)
    writers = {".tum": _write_tum, ".txt": _write_tum, ".csv": _write_csv, ".mcap": _write_mcap}
    suffix = out.suffix.lower()
    if suffix not in writers:
        raise GlissandoError(
            f"{out.name} says no format; give --out a name in {', '.join(writers)}."
        )
    nodes = posterior.grid.arclength
    if arclength is None:
        arclength = nodes[-1:] if writers[suffix] is _write_tum else nodes
    arclength = np.asarray(arclength, dtype=float)
    time = _times(posterior.grid.time, rate)
    posterior.grid.require(arclength, np.full_like(arclength, time[0]), "Export")
    if out.is_dir():
        raise GlissandoError(f"{out} is a folder; give --out the name of a file.")
    with new_file(out) as building:
        writers[suffix](posterior, building, time, arclength)
    return time.size


def export_stream(stream: Stream, out: str | Path) -> int:
    """Write the rows of a stream, such as ground truth, to a .tum (.txt) or .csv file.

    A TUM file holds poses T_wb of the cross-section, as that of a posterior does: the mount T_bc of
    the sensor is removed. For a stream of positions its rotations are identities and the mount is
    not removed.

    Args:
        stream: Stream of a recording, in the world frame.
        out: File to write; its suffix chooses the format.

    Returns:
        Number of rows.

    Raises:
        GlissandoError: The suffix is unknown, or the stream has no positions.
    """
    out, rows = Path(out), stream.rows
    suffix = out.suffix.lower()
    if suffix == ".csv":
        write_named(out, rows)
        return rows.time.size
    if suffix not in (".tum", ".txt"):
        raise GlissandoError(f"{out.name}: a stream is written as .tum, .txt or .csv.")
    if rows.values.shape[1:] == (4, 4):
        poses = rows.values @ inverse(stream.mount)
    elif rows.kind == "position":
        poses = pose(np.eye(3), rows.values)
    else:
        raise GlissandoError(f"{stream.name} is a {rows.kind}; a trajectory needs positions.")
    order = np.argsort(rows.time, kind="stable")
    rotation = np.roll(quaternion(poses[:, :3, :3]), -1, axis=1)
    table = np.column_stack([rows.time, poses[:, :3, 3], rotation])[order]
    with new_file(out) as building:
        np.savetxt(building, table, "%.15g")
    return rows.time.size


def _times(nodes: Array, rate: float | None) -> Array:
    if rate is None:
        return nodes
    count = np.ptp(nodes) * rate
    if not (rate > 0.0 and count < 1e7):
        raise GlissandoError(f"A rate of {rate:g} Hz cannot be; give poses a second.")
    return np.minimum(nodes[0] + np.arange(int(count + 1e-9) + 1) / rate, nodes[-1])


def _write_tum(posterior: Posterior, building: Path, time: Array, arclength: Array) -> None:
    """Write lines of `t x y z qx qy qz qw`, the format of evo and other SLAM tools."""
    if arclength.size != 1:
        raise GlissandoError(
            f"A TUM file holds one trajectory; give one --arclength, not {arclength.size}."
        )
    at = posterior.at(arclength[0], time)
    table = np.column_stack([time, at.position, np.roll(at.quaternion, -1, axis=1)])
    np.savetxt(building, table, "%.15g")


def _write_csv(posterior: Posterior, building: Path, time: Array, arclength: Array) -> None:
    when, where = (a.ravel() for a in np.meshgrid(time, arclength, indexing="ij"))
    write_query(posterior, (when, where), building)


def _write_mcap(posterior: Posterior, building: Path, time: Array, arclength: Array) -> None:
    if time[0] < 0.0:
        raise GlissandoError(
            f"MCAP has no times before zero, and the posterior begins at {time[0]:g} s."
        )
    clocks = {"format": stated_format("posterior"), "monotonic_ns": "0", "wall_ns": "0"}
    with SessionWriter(building, clocks) as log:
        for topic, described in SCHEMAS.items():
            log.add_topic(topic, described)
        for chunk in np.array_split(time, time.size // _CHUNK + 1):
            estimate = posterior.at(arclength, chunk[:, None])
            for k, t in enumerate(chunk.tolist()):
                now = round(1e9 * t)
                for topic, message in _messages(estimate, k, t, arclength).items():
                    log.write(topic, message, now)


def _messages(
    estimate: StateEstimate, k: int, time: float, arclength: Array
) -> dict[str, dict[str, Any]]:
    """Messages at the k-th time of an estimate (K, N), by topic."""
    at = StateEstimate(*(getattr(estimate, name)[k] for name in vars(estimate)))
    now = round(1e9 * time)
    stamp = {"timestamp": {"sec": now // 10**9, "nsec": now % 10**9}, "frame_id": "world"}
    poses = [
        {
            "position": dict(zip("xyz", p, strict=True)),
            "orientation": dict(zip("wxyz", q, strict=True)),
        }
        for p, q in zip(at.position.tolist(), at.quaternion.tolist(), strict=True)
    ]
    return {
        "/shape": {**stamp, "poses": poses},
        "/tip": {**stamp, "pose": poses[int(np.argmax(arclength))]},
        "/estimate": {
            "time": time,
            "arclength": arclength,
            "position": at.position,
            "quaternion": at.quaternion,
            "cov_pose": at.cov[:, :6, :6],
        },
    }
