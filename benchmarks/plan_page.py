"""Write a part of a page: the text between <!-- NAME --> and <!-- /NAME -->."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "planning.md"


def table(heads, rows):
    """Lines of a Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]


def number(value):
    """Number as text with about three digits."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def write(name, lines, page=PAGE):
    """Replace the part of a page with a name by lines."""
    text = page.read_text(encoding="utf-8")
    part = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not part.search(text):
        raise SystemExit(f"{page.name} has no part <!-- {name} -->")
    body = "\n".join(["", *lines, "", ""])
    page.write_text(part.sub(lambda m: m[1] + body + m[2], text), encoding="utf-8")
    print("\n".join(lines))
