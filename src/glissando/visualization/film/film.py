"""Write an animation of a posterior as a looped GIF, or with ffmpeg as MP4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.io.atomic import new_file
from glissando.model.evenly import evenly_chosen
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings
from glissando.visualization.canvas import canvas
from glissando.visualization.film.frames import frames_at
from glissando.visualization.film.stage import INCHES, Stage

Progress = Callable[[int, int], None]  # frames done, frames in all

_LONGEST = 12.0  # s, duration to which a longer motion is accelerated unless `seconds` is given
_FASTEST = 50.0  # Hz: a GIF's delays are whole hundredths of a second, two at least in browsers
_NEARLY_WHITE = [*range(248), *[255] * 8] * 3  # Pillow would quantise white to 252, a grey


def save_animation(
    posterior: Posterior,
    readings: Sequence[Readings],
    truth: Sequence[Readings],
    path: str | Path,
    *,
    seconds: float | None = None,
    rate: float = 12.0,
    width: int = 900,
    progress: Progress | None = None,
) -> Path:
    """Write a film of the robot in its 95 % tube and of its uncertainty, complete or not at all.

    Args:
        posterior: Estimate to show, drawn in the world frame and millimetres.
        readings: Streams of the sensors, whose positions are shown.
        truth: Streams of the truth, drawn as by `shape_figure`.
        path: A .gif, which loops, or an .mp4, which needs ffmpeg.
        seconds: Duration of the film; None for that of the motion, 12 s at most.
        rate: Frames a second, 50 at most.
        width: Width in pixels, 100 or more.
        progress: Called after each frame with the numbers of frames done and in all.

    Returns:
        The path written; without ffmpeg an .mp4 becomes a .gif beside it.

    Raises:
        GlissandoError: The suffix is another, a number is out of range, the grid has a single
            arclength, or matplotlib is not installed.
    """
    path, grid = Path(path), posterior.grid
    span = float(grid.time[-1] - grid.time[0])
    seconds = (min(span, _LONGEST) or 1.0) if seconds is None else seconds
    _require(path, grid, seconds, rate, width)
    count = max(1, round(seconds * rate)) if span else 1
    times = np.linspace(grid.time[0], grid.time[-1], count)
    with canvas(*INCHES) as figure:
        if path.suffix.lower() == ".mp4" and not _has_ffmpeg():
            path = path.with_suffix(".gif")
        write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_gif
        frames = frames_at(posterior, readings, truth, times)
        stage = Stage(figure, frames, width, span / seconds or 1.0)
        with new_file(path) as building:
            write(stage, building, rate, progress or (lambda done, frames: None))
    return path


def _require(path: Path, grid: Grid, seconds: float, rate: float, width: int) -> None:
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise GlissandoError(f"{path.name} is not an animation: end it in .gif or .mp4.")
    if not (np.isfinite(seconds) and seconds > 0.0 and 0.0 < rate <= _FASTEST and width >= 100):
        raise GlissandoError(
            f"No animation lasts {seconds:g} s at {rate:g} frames a second, {width} pixels wide: "
            f"give seconds above 0, a rate up to {_FASTEST:g} and a width of 100 or more."
        )
    if grid.arclength.size == 1:
        raise GlissandoError("A grid of a single arclength has no body to animate; give two.")


def _has_ffmpeg() -> bool:
    from matplotlib.animation import FFMpegWriter

    return bool(FFMpegWriter.isAvailable())


def _write_mp4(stage: Stage, building: Path, rate: float, progress: Progress) -> None:
    """Encode every frame with ffmpeg."""
    from matplotlib.animation import FFMpegWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide, high = stage.size
    sheet = FigureCanvasAgg(Figure((wide / 100, high / 100), dpi=100)).figure  # of a frame's size
    image = sheet.figimage(np.zeros((high, wide, 3), dtype=np.uint8))
    pace: Any = rate  # matplotlib's annotation is int, but ffmpeg accepts a float
    writer = FFMpegWriter(fps=pace, codec="h264")
    try:
        with writer.saving(sheet, str(building), 100):
            for k in range(stage.frames.time.size):
                image.set_data(np.asarray(stage.picture(k)))
                writer.grab_frame()
                progress(k + 1, stage.frames.time.size)
    except (CalledProcessError, BrokenPipeError):
        raise GlissandoError(
            "ffmpeg could not encode the animation: give a path that ends in .gif."
        ) from None


def _write_gif(stage: Stage, building: Path, rate: float, progress: Progress) -> None:
    """Encode all frames with one palette, so that Pillow stores only the changes between them."""
    from PIL import Image

    count = stage.frames.time.size
    some = evenly_chosen(count, 8)
    sample = np.concatenate([np.asarray(stage.picture(k).point(_NEARLY_WHITE)) for k in some])
    palette = Image.fromarray(sample).quantize(kmeans=1)
    pictures = []
    for k in range(count):
        picture = stage.picture(k).point(_NEARLY_WHITE)
        pictures.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
        progress(k + 1, count)
    ends = np.round(np.arange(count + 1) * 100.0 / rate)  # a delay is a whole number of 10 ms
    look = {"duration": (10 * np.diff(ends)).tolist(), "loop": 0}
    pictures[0].save(building, "GIF", save_all=True, append_images=pictures[1:], **look)
