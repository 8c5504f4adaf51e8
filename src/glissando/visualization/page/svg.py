"""Dot charts as inline SVG in the colours of their page, for print, light and dark modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

COLOURS = ("var(--z)", "var(--x)", "var(--y)", "#a54d8a", "#b08900", "var(--ink)")
_WIDE, _LEFT, _RIGHT, _TALL = 560.0, 110.0, 20.0, 26.0


@dataclass(frozen=True)
class Dot:
    """A value, and the bounds that it should lie in; None for no bounds."""

    value: float
    bounds: tuple[float, float] | None = None


def chart(
    rows: Sequence[str],
    series: Mapping[str, Sequence[Dot | None]],
    unit: str,
    *,
    end: float | None = None,
    marks: Sequence[float] | None = None,
) -> str:
    """Draw an SVG chart with dots of every series in named rows, on an axis from zero.

    Args:
        rows: Names of the rows.
        series: Dots, one for each row, by name of the series; bounds are drawn as bars.
        unit: Label of the axis.
        end: End of the axis; None for a round number beyond the largest value.
        marks: Reference values, one for each row.
    """
    most, step = _axis(max((d.value for c in series.values() for d in c if d), default=0.0), end)
    bottom = _TALL * len(rows) + 8

    def x(value: float) -> float:
        return _LEFT + min(value / most, 1.0) * (_WIDE - _LEFT - _RIGHT)

    parts = []
    for k in range(round(most / step) + 1):
        parts.append(_line(x(k * step), 4, x(k * step), bottom, "var(--rule)", 1))
        parts.append(_text(x(k * step), bottom + 16, f"{k * step:g}", "middle"))
    parts.append(_text(_WIDE - _RIGHT, bottom + 32, unit, "end"))
    for i, row in enumerate(rows):
        y = _TALL * (i + 0.5) + 4
        parts.append(_text(_LEFT - 10, y + 4, row, "end"))
        if marks:
            parts.append(_line(x(marks[i]), y - 11, x(marks[i]), y + 11, "var(--ink)", 2))
        for k, (name, column) in enumerate(series.items()):
            off = y + 9.0 * ((k + 0.5) / len(series) - 0.5) * (len(series) > 1)
            parts += _dot(column[i], x, off, colour(k), f"{name}, {row}")
    height = f"{bottom + 38:.0f}"
    label = escape(f"{unit}, {', '.join(series)}")
    box = f'viewBox="0 0 {_WIDE:.0f} {height}" style="max-width:{_WIDE:.0f}px"'
    return f'<svg {box} role="img" aria-label="{label}">{"".join(parts)}</svg>'


def colour(series: int) -> str:
    """Colour of a series."""
    return COLOURS[series % len(COLOURS)]


def key(names: Sequence[str]) -> str:
    """HTML legend of the series' colours."""
    dots = (
        f'<span class="key"><i style="background:{colour(k)}"></i>{escape(name)}</span>'
        for k, name in enumerate(names)
    )
    return f'<p class="keys">{"".join(dots)}</p>'


def _dot(dot: Dot | None, x: Callable[[float], float], y: float, fill: str, name: str) -> list[str]:
    if dot is None:
        return []
    bar = [_line(x(dot.bounds[0]), y, x(dot.bounds[1]), y, fill, 6, 0.3)] if dot.bounds else []
    tip = f"<title>{escape(name)}: {dot.value:.4g}</title>"
    return [
        *bar,
        f'<circle cx="{x(dot.value):.1f}" cy="{y:.1f}" r="5" fill="{fill}">{tip}</circle>',
    ]


def _axis(largest: float, end: float | None) -> tuple[float, float]:
    """End of the axis, and the step of its ticks."""
    largest = end or largest or 1.0
    power = 10.0 ** float(f"{largest:e}".split("e")[1])
    step = next(n * power for n in (0.2, 0.5, 1.0, 2.0) if largest <= 6 * n * power)
    return end or -(-largest // step) * step, step


def _line(
    x1: float, y1: float, x2: float, y2: float, stroke: str, width: float, opacity: float = 1
) -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{stroke}" stroke-width="{width}" opacity="{opacity}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'
