"""Write an animation of a posterior as a looped GIF, or with ffmpeg as MP4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from subprocess import CalledProcessError
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings
from glissando.visualization.figures import _canvas
from glissando.visualization.film.frames import frames_at
from glissando.visualization.film.stage import INCHES, Stage

Progress = Callable[[int, int], None]  # frames done, frames in all

_LONGEST = 12.0  # s: a longer motion is sped up to this unless told
_FASTEST = 50.0  # Hz: a gif's delays are hundredths of a second, and browsers refuse a single one
_COLOURS, _EXACT = 192, 4  # of a gif, and how many of them are the commonest as they are
_CODE = np.array([1 << 16, 1 << 8, 1])  # of a colour as one number


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
    """Write a film of the robot in its 3σ tube and of its confidence; the path written.

    World frame, millimetres; sensors are where `readings` say, `truth` as in `shape_figure`. The
    film lasts `seconds` (the motion's own time up to 12 s unless given) at `rate` frames a second
    and is `width` pixels wide; `progress(done, all)` is called after each frame. A path in .gif
    is a looped GIF; one in .mp4 needs ffmpeg, and without it becomes a .gif beside. The file
    appears whole or not at all. Raises GlissandoError for another ending, for numbers out of range,
    for a grid of a single arclength, and without matplotlib.
    """
    path, grid = Path(path), posterior.grid
    span = float(grid.time[-1] - grid.time[0])
    seconds = (min(span, _LONGEST) or 1.0) if seconds is None else seconds
    _require(path, grid, seconds, rate, width)
    count = max(1, round(seconds * rate)) if span else 1
    times = np.linspace(grid.time[0], grid.time[-1], count)
    with _canvas(*INCHES) as figure:
        if path.suffix.lower() == ".mp4" and not _has_ffmpeg():
            path = path.with_suffix(".gif")
        write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_gif
        frames = frames_at(posterior, readings, truth, times)
        stage = Stage(figure, frames, width, span / seconds or 1.0)
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as building:
            part = Path(building, path.name)
            write(stage, part, rate, progress or (lambda done, frames: None))
            part.replace(path)
    return path


def _require(path: Path, grid: Grid, seconds: float, rate: float, width: int) -> None:
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise GlissandoError(f"{path.name} is no animation: give a path that ends in .gif or .mp4.")
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


def _write_mp4(stage: Stage, path: Path, rate: float, progress: Progress) -> None:
    """Encode every frame with ffmpeg."""
    from matplotlib.animation import FFMpegWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide, high = stage.size
    sheet = FigureCanvasAgg(Figure((wide / 100, high / 100), dpi=100)).figure  # a frame and no more
    image = sheet.figimage(np.zeros((high, wide, 3), dtype=np.uint8))
    pace: Any = rate  # matplotlib asks for an int, ffmpeg does not
    writer = FFMpegWriter(fps=pace, codec="h264")
    try:
        with writer.saving(sheet, str(path), 100):
            for k in range(stage.frames.time.size):
                image.set_data(np.asarray(stage.picture(k)))
                writer.grab_frame()
                progress(k + 1, stage.frames.time.size)
    except (CalledProcessError, BrokenPipeError):
        raise GlissandoError(
            "ffmpeg could not encode the animation: give a path that ends in .gif."
        ) from None


def _write_gif(stage: Stage, path: Path, rate: float, progress: Progress) -> None:
    """Give every frame one palette and write what differs from the frame before."""
    from PIL import Image

    count = stage.frames.time.size
    some = np.unique(np.linspace(0, count - 1, 8).round().astype(int))
    colours, nearest = _palette(np.concatenate([np.asarray(stage.picture(k)) for k in some]))
    pictures = []
    for k in range(count):
        picture = Image.fromarray(nearest[_bins(np.asarray(stage.picture(k)))])
        picture.putpalette(colours.tobytes())
        pictures.append(picture)
        progress(k + 1, count)
    ends = np.round(np.arange(count + 1) * 100.0 / rate)  # a delay is a whole number of 10 ms
    look = {"duration": (10 * np.diff(ends)).tolist(), "loop": 0, "optimize": True}
    pictures[0].save(path, "GIF", save_all=True, append_images=pictures[1:], **look)


def _bins(pixels: NDArray[np.uint8]) -> NDArray[np.int32]:
    """The bin of a colour in a table of 64³."""
    red, green, blue = np.moveaxis(pixels.astype(np.int32) >> 2, -1, 0)
    return red << 12 | green << 6 | blue


def _palette(pixels: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Colours (C, 3) for pixels (…, 3), and the nearest of them (64³) for every bin.

    The commonest are kept as they are, and rare ones count for more than their share.
    """
    from PIL import Image

    code, count = np.unique(pixels.astype(np.int32) @ _CODE, return_counts=True)
    order = np.argsort(-count)
    found = (code[order, None] // _CODE % 256).astype(np.uint8)
    weight = np.ceil(np.sqrt(count[order])).astype(int)
    rare = np.repeat(found[_EXACT:], weight[_EXACT:], axis=0)
    chosen = Image.fromarray(rare[None]).quantize(_COLOURS - _EXACT, kmeans=1).getpalette()
    rest = np.array(chosen, dtype=np.uint8).reshape(-1, 3)[: _COLOURS - _EXACT]
    colours = np.concatenate([found[:_EXACT], rest])
    middles = 4.0 * np.stack(np.unravel_index(np.arange(64**3), (64, 64, 64)), axis=-1) + 1.5
    nearest = cKDTree(colours).query(middles)[1].astype(np.uint8)
    nearest[_bins(colours[:_EXACT])] = np.arange(_EXACT)
    return colours, nearest
