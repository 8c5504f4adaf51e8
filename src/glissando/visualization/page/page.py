"""A scene as one self-contained HTML file, without network, library or server."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from glissando import __version__
from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.estimation.given import require_kind, require_list
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.covariance import symmetric_root
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.visualization.arrows import Arrows
from glissando.visualization.canvas import MM
from glissando.visualization.page.scene import Progress, Scene, scene_of

_NAN_CODE = 65535  # code of NaN
_UPPER_TRIANGLE = np.triu_indices(3)


def save_view(
    posterior: Posterior,
    path: str | Path,
    *,
    readings: Sequence[Readings] = (),
    truth: Sequence[Readings] = (),
    title: str = "Posterior",
    window: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the robot over time with its confidence as one self-contained HTML file.

    Args:
        posterior: Estimate to show.
        path: File to write; its folder is created if it is missing.
        readings: Streams of the sensors, whose positions are shown.
        truth: Streams of the truth, drawn beside the estimate in the world frame.
        title: Title of the page.
        window: First and last time, s; None for the whole estimate.
        progress: Called with the numbers of moments done and in all.

    Returns:
        The path written.

    Raises:
        OutsideGridError: The window is off the grid.
        GlissandoError: The grid has a single arclength.
    """
    require_kind(posterior, Posterior, "posterior", "give what estimate returned, then the file")
    for name, streams in (("readings", readings), ("truth", truth)):
        require_list(streams, Readings, f"streams of {name}")
    scene = scene_of(posterior, readings, truth, window=window, progress=progress)
    path = Path(path)
    write_text(path, page(scene, title, subtitle(posterior, scene)))
    return path


def subtitle(posterior: Posterior, scene: Scene) -> str:
    """Text with the time span shown and the outcome of the solver."""
    solve, time = posterior.solve, scene.time
    span = seconds(time[0], time[-1])
    return f"{span} s; estimate {solve.status}, {solve.iterations} iterations"


def page(scene: Scene, title: str, subtitle: str) -> str:
    """HTML page of a scene. Coordinates are rounded to a step stated on the page."""
    content = contents(scene)
    coarse = 0.5 * MM * max(content[name]["step"] for name in ("centre", "root"))
    scripts = ("scene.js", "stage.js", "panels.js", "page.js", "hands.js")
    footer = (
        f"glissando {__version__}. World frame, parallel view; positions and deviations are rounded"
        f" by up to {coarse:.2g} mm."
    )
    return Template(asset("page.html")).substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        footer=escape(footer),
        style=asset("page.css"),
        scene=json.dumps(content, separators=(",", ":")).replace("<", "\\u003c"),
        script="\n".join(asset(name) for name in scripts),
    )


def asset(name: str) -> str:
    """Text of a file of the page's scripts, styles and templates."""
    return (files("glissando.visualization.page") / "web" / name).read_text(encoding="utf-8")


def contents(scene: Scene) -> dict[str, Any]:
    """Data of a scene for the page: packed arrays, bounds, and the end of the colour scale (m)."""
    centre = scene.pose[..., :3, 3]
    std = np.linalg.norm(scene.root, axis=(-2, -1))
    top = max(float(np.quantile(std, 0.99)), 1e-9)
    misses = scene.miss[np.isfinite(scene.miss)]
    tall = 1.08 * max(float(std.max()), top, float(np.quantile(misses, 0.99)) if misses.size else 0)
    return {
        "sigmas": SIGMAS_95,
        "tube": None if scene.tube is None else vars(scene.tube),
        "top": top,
        "tall": min(tall, 4.0 * top),
        "low": centre.min(axis=(0, 1)).tolist(),
        "high": centre.max(axis=(0, 1)).tolist(),
        "time": scene.time.round(6).tolist(),
        "arclength": scene.arclength.tolist(),
        "centre": packed(centre),
        "quaternion": packed(se3.quaternion(scene.pose[..., :3, :3])),
        "root": packed(scene.root[..., *_UPPER_TRIANGLE]),
        "sensors": scene.sensors,
        "place": packed(scene.place),
        "sites": scene.sites,
        "site_place": packed(scene.site_place),
        "truth": packed(scene.truth),
        "miss": packed(scene.miss),
        "nees": packed(np.minimum(scene.nees, 1e3)),
        "arrows": None if scene.arrows is None else _forces(scene.arrows),
        "solids": [
            {
                **vars(solid),
                "vertices": solid.vertices.round(6).tolist(),
                "triangles": solid.triangles.tolist(),
            }
            for solid in scene.solids
        ],
    }


def _forces(arrows: Arrows) -> dict[str, Any]:
    """Forces and symmetric square roots of their covariances, scaled to metres of the picture."""
    return {
        "place": arrows.place.tolist(),
        "words": arrows.words,
        "unit": arrows.unit,
        "length": arrows.length,
        "force": packed(arrows.scale * arrows.force),
        "root": packed(arrows.scale * symmetric_root(arrows.cov)[..., *_UPPER_TRIANGLE]),
    }


def packed(values: Array) -> dict[str, Any]:
    """Quantise an array to 16 bits in base64: value = low + step q, with q = 65535 for NaN.

    The rounding error is at most half a step, and a step is 1/65534 of the array's range.
    """
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / (_NAN_CODE - 1)
    whole = np.nan_to_num(np.round((values - low) / (step or 1.0)), nan=_NAN_CODE)
    data = base64.b64encode(whole.astype("<u2").tobytes()).decode("ascii")
    return {"shape": list(values.shape), "low": low, "step": step, "data": data}
