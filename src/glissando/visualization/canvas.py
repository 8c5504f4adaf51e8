"""Common elements of all figures: canvas, colours, confidence levels, legends and files.

matplotlib is imported only when a figure is drawn; figures have their own Agg canvas, so no window
opens and no global plotting state changes.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from glissando.errors import GlissandoError, needing
from glissando.io.atomic import new_file
from glissando.model.quantiles import chi_square_quantile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM = 1e3
INCH = 25.4  # mm
SIDES = 10.0, 2000.0
"""Smallest and largest side of a figure, mm."""
BAND = float(np.sqrt(chi_square_quantile(0.95, 1)))
"""Half-width of the interval that contains 95 % of one component, in standard deviations."""
AXES = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}  # Okabe and Ito: safe for colour blindness
SENSORS = ("#E69F00", "#56B4E9", "#FFFFFF", "#CC79A7", "#D55E00", "#000000", "#F0E442", "#009E73")
MARKERS = "osD^vP*X"
_LONGEST_NAME = 40  # characters of a name in a figure
_STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.w_pad": 0.1,
    "grid.color": "0.85",
    "legend.frameon": False,
    "pdf.fonttype": 42,  # TrueType, which publishers require
    "svg.fonttype": "none",
    "svg.hashsalt": "glissando",  # the same element names in every file
}
Style: TypeAlias = "Mapping[str, Any]"
"""rcParams of a figure, such as {"font.size": 8}."""
NO_STYLE: Style = {}


def line_colours(count: int) -> list[Any]:
    """Distinct colours on white: colour-blind safe up to six, shades of a colour map beyond."""
    from matplotlib import colormaps

    safe = [c for c in SENSORS if c not in ("#FFFFFF", "#000000")]
    shades = colormaps["viridis"](np.linspace(0.0, 0.95, max(count, 1)))
    return safe[:count] if count <= len(safe) else list(shades)


def gif_rate(rate: float) -> float:
    """Frame rate of a GIF nearest to a rate in Hz: its frames last whole hundredths of a second.

    The result is at most 50 Hz, because browsers ignore a delay of a single hundredth.
    """
    return 100.0 / max(2, round(100.0 / rate)) * (1.0 - 1e-9)  # Pillow rounds delays down


@contextmanager
def gif_frames(figure: Figure, file: Path, rate: float, dpi: int) -> Iterator[Any]:
    """Open a writer of a new GIF file, whose `grab_frame` appends the figure as it is."""
    from matplotlib.animation import PillowWriter

    writer = PillowWriter(fps=rate)  # type: ignore[arg-type]  # any number will do
    with new_file(file) as building, writer.saving(figure, building, dpi=dpi):
        yield writer


@contextmanager
def canvas(width: float, height: float, style: Style = NO_STYLE) -> Iterator[Figure]:
    """Create an empty figure of a size in inches on its own canvas; the style applies inside."""
    with needing("Figures need matplotlib", "plot"):
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    look: dict[Any, Any] = {**_STYLE, **style}
    with matplotlib.rc_context(look):
        yield FigureCanvasAgg(Figure(figsize=(width, height), layout="constrained")).figure


@contextmanager
def panels_on(
    given: Any,
    shape: tuple[int, int],
    size: tuple[float, float],
    style: Style = NO_STYLE,
    **look: Any,
) -> Iterator[Any]:
    """Axes (R, C) of a new figure of `size` in inches, or those given; the style applies inside."""
    if not SIDES[0] <= INCH * min(size) <= INCH * max(size) <= SIDES[1]:
        raise GlissandoError(
            f"A figure of {size[0]:g} × {size[1]:g} inches cannot be; give a size in inches, from "
            f"{SIDES[0] / INCH:.1f} to {SIDES[1] / INCH:.0f}."
        )
    with canvas(*size, style) as figure:
        if given is None:
            yield figure.subplots(*shape, squeeze=False, **look)
            return
        axes = np.asarray(given, dtype=object)
        if axes.size != shape[0] * shape[1]:
            raise GlissandoError(
                f"This figure has {shape[0]} × {shape[1]} axes; {axes.size} were given."
            )
        yield axes.reshape(shape)


def describe(axes: Any, own: bool, entries: dict[str, Any], **look: Any) -> None:
    """Draw a legend: outside the axes of an `own` figure, else inside the axes that were given."""
    if own:
        legend(axes.figure, entries, **look)
    elif entries:
        axes.legend(list(entries.values()), list(entries), handler_map=_tuples())


def legend_entries(axes: Any) -> dict[str, Any]:
    """Legend entries of axes, by label."""
    return dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))


def legend(figure: Any, entries: dict[str, Any], *, ncols: int = 1, **look: Any) -> None:
    """Draw a legend outside the axes, in which a tuple of lines is one entry.

    Args:
        figure: Figure or subfigure.
        entries: What is drawn for each label.
        ncols: Number of columns; there are fewer if these are wider than the figure.
        look: Further options of matplotlib's legend.
    """
    renderer = figure.get_figure(root=True).canvas.get_renderer()
    for columns in range(max(ncols, 1), 0, -1):
        options = {"handler_map": _tuples(), "ncols": columns, **look}
        drawn = figure.legend(list(entries.values()), list(entries), **options)
        if columns == 1 or drawn.get_window_extent(renderer).width <= figure.bbox.width:
            return
        drawn.remove()


def shown_name(name: str) -> str:
    r"""A name from a file as a figure shows it: as it is, shortened in the middle if it is long.

    Line breaks and characters that the font lacks appear as their codes, as on a terminal without
    them. matplotlib would typeset what is between dollars and hide labels that begin with an
    underscore.

    >>> print(shown_name("_$1$"), shown_name("a" * 50 + "b" * 50))
     _\$1\$ aaaaaaaaaaaaaaaaaaaa…bbbbbbbbbbbbbbbbbbbb
    >>> print(shown_name("線 1"))
    \u7dda 1
    """
    from matplotlib import rcParams

    if not (name.isascii() and name.isprintable()):
        drawn = _characters(tuple(rcParams["font.family"]), tuple(rcParams["font.sans-serif"]))
        name = "".join(c if c.isprintable() and ord(c) in drawn else _code(c) for c in name)
    if len(name) > _LONGEST_NAME:
        half = _LONGEST_NAME // 2
        name = f"{name[:half]}…{name[-half:]}"
    return f"{' ' * name.startswith('_')}{name}".replace("$", r"\$")


def _code(character: str) -> str:
    r"""The escape of a character, such as \n or \u7dda."""
    return character.encode("unicode_escape").decode()


@lru_cache
def _characters(families: tuple[str, ...], sans_serif: tuple[str, ...]) -> frozenset[int]:
    """Characters that fonts have, normal and bold; `sans_serif` is what that family stands for."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    weights = []
    for weight in ("normal", "bold"):
        asked = [FontProperties(family=[f], weight=weight) for f in families]
        weights.append(frozenset().union(*(get_font(findfont(f)).get_charmap() for f in asked)))
    return frozenset.intersection(*weights)


def _tuples() -> dict[Any, Any]:
    """Legend handler that draws a tuple of lines as one entry."""
    from matplotlib.legend_handler import HandlerTuple

    return {tuple: HandlerTuple(ndivide=None, pad=0.4)}


def require_ending(path: Path) -> None:
    """Raise GlissandoError unless a file has the suffix of a figure."""
    if path.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise GlissandoError(f"{str(path)!r} is not a figure: end it in .png, .pdf or .svg.")


def save_figure(drawn: Any, path: str | Path) -> Path:
    """Write a figure in the format of its suffix, completely or not at all; returns the path.

    The same figure gives the same bytes, because no date is written.

    Args:
        drawn: Axes, an array of axes as the functions of figures return it, or a figure.
        path: Path that ends in .png, .pdf or .svg.

    Raises:
        GlissandoError: The suffix is another, the text leaves no room, or writing failed.
    """
    path = Path(path)
    require_ending(path)
    figure = np.ravel(np.asarray(drawn, dtype=object))[0].figure
    undated = {".pdf": "CreationDate", ".svg": "Date"}.get(path.suffix.lower())
    metadata = {undated: None} if undated else None
    with canvas(1.0, 1.0), new_file(path) as building, _with_room(figure):  # for the style's fonts
        figure.savefig(building, dpi=150, metadata=metadata)
    return path


@contextmanager
def _with_room(figure: Figure) -> Iterator[None]:
    """Raise GlissandoError if the text leaves no room for the axes when the figure is drawn."""
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "constrained_layout not applied")
        try:
            yield
        except UserWarning:
            width, height = INCH * figure.get_size_inches()
            raise GlissandoError(
                f"A figure of {width:.3g} × {height:.3g} mm has no room for its axes beside its "
                f"text; give a larger size or a smaller font."
            ) from None
