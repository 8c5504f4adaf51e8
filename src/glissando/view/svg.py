"""Small charts as inline SVG, in the colours of the page: they print, and follow light and dark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

COLOURS = ("var(--z)", "var(--x)", "var(--y)", "#a54d8a", "#b08900", "var(--ink)")
_WIDE = 560


def rows_of_dots(
    rows: Sequence[str], values: Mapping[str, Sequence[float | None]], unit: str
) -> str:
    """A dot a series in each named row, from zero to the right; None is left out."""
    known = [v for column in values.values() for v in column if v is not None]
    most, step = _scale(max(known, default=0.0))
    left, tall = 110, 24
    bottom = tall * len(rows) + 8

    def x(value: float) -> float:
        return left + value / most * (_WIDE - left - 20)

    parts = []
    for k in range(round(most / step) + 1):
        at = x(k * step)
        parts.append(_line(at, 4, at, bottom, "var(--rule)"))
        parts.append(_text(at, bottom + 16, f"{k * step:g}", "middle"))
    parts.append(_text(_WIDE - 20, bottom + 32, unit, "end"))
    for i, row in enumerate(rows):
        y = tall * (i + 0.5) + 4
        parts.append(_text(left - 10, y + 4, row, "end"))
        for colour, (name, column) in zip(_cycle(len(values)), values.items(), strict=True):
            value = column[i]
            if value is not None:
                tip = f"<title>{escape(name)}, {escape(row)}: {value:.3g} {unit}</title>"
                circle = f'<circle cx="{x(value):.1f}" cy="{y:.1f}" r="5.5" fill="{colour}">'
                parts.append(f"{circle}{tip}</circle>")
    return _svg(parts, bottom + 38, f"{unit} by site")


def coverage(series: Mapping[str, Sequence[tuple[float, float, float, float]]]) -> str:
    """Shares of errors inside ellipsoids, each (nominal, actual, low, high), against nominal ones.

    The bar is where an honest estimate's share stays with probability 95 %.
    """
    side, left, top = 250.0, 46.0, 8.0

    def x(share: float) -> float:
        return left + side * share

    def y(share: float) -> float:
        return top + side * (1.0 - share)

    parts = [_line(x(0), y(0), x(1), y(1), "var(--faint)")]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(_line(x(0), y(share), x(1), y(share), "var(--rule)"))
        parts.append(_text(left - 8, y(share) + 4, f"{100 * share:g}", "end"))
        parts.append(_text(x(share), top + side + 18, f"{100 * share:g}", "middle"))
    parts.append(_text(x(0.5), top + side + 36, "errors that should lie inside (%)", "middle"))
    parts.append(_text(x(1) + 14, y(0.5) + 4, "errors that do (%)", "start"))
    for i, (colour, (name, points)) in enumerate(
        zip(_cycle(len(series)), series.items(), strict=True)
    ):
        shift = 6.0 * (i - 0.5 * (len(series) - 1))
        for nominal, actual, low, high in points:
            at = x(nominal) + shift
            parts.append(_line(at, y(low), at, y(high), colour, 5, 0.3))
            tip = f"<title>{escape(name)}: {100 * actual:.1f} % in {100 * nominal:g} %</title>"
            circle = f'<circle cx="{at:.1f}" cy="{y(actual):.1f}" r="4.5" fill="{colour}">'
            parts.append(f"{circle}{tip}</circle>")
    return _svg(parts, top + side + 42, "coverage")


def key(names: Sequence[str]) -> str:
    """Which colour is which series."""
    dots = (
        f'<span class="key"><i style="background:{colour}"></i>{escape(name)}</span>'
        for colour, name in zip(_cycle(len(names)), names, strict=True)
    )
    return f'<p class="keys">{"".join(dots)}</p>'


def _cycle(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _scale(largest: float) -> tuple[float, float]:
    """A round number not below the largest, and the step of its marks."""
    largest = largest or 1.0
    power = 10.0 ** float(f"{largest:e}".split("e")[1])
    step = next(n * power for n in (0.2, 0.5, 1.0, 2.0) if largest <= 6 * n * power)
    marks = int(-(-largest * (1 + 1e-9) // step))
    return marks * step, step


def _line(
    x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1, opacity: float = 1
) -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width}" opacity="{opacity}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _svg(parts: Sequence[str], height: float, label: str) -> str:
    box = f'viewBox="0 0 {_WIDE} {height:.0f}" style="max-width:{_WIDE}px"'
    return f'<svg {box} role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'
