"""Write a part of docs/planning.md: what stands between <!-- NAME --> and <!-- /NAME -->."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "planning.md"


def table(heads, rows):
    """Lines of a table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]


def number(value):
    """Three digits or so."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def write(name, lines):
    """Put lines in place of the part of that name."""
    text = PAGE.read_text(encoding="utf-8")
    part = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not part.search(text):
        raise SystemExit(f"{PAGE.name} has no part <!-- {name} -->")
    body = "\n".join(["", *lines, "", ""])
    PAGE.write_text(part.sub(lambda m: m[1] + body + m[2], text), encoding="utf-8")
    print("\n".join(lines))
