"""Hooks of the site: links that leave docs/, doctests as blocks of code, the page of commands.

Pages link to source files by path, [`se3.exp`](../src/glissando/geometry/se3.py). In the site
such a link leads to the entry of the function in the reference. Any other linked file outside
docs/ becomes a page of its own. The page commands.md is made of the parsers of the command line,
promises.md of tests/promises.toml.
Equations, $…$ and $$…$$ in LaTeX, become MathML here, which browsers show by themselves: nothing is
fetched, and nothing runs in the page.
"""

import argparse
import posixpath
import re
import runpy
from pathlib import Path

import griffe
from latex2mathml.converter import convert
from mkdocs.structure.files import File, InclusionLevel

from glissando.cli.main import build_parser

_ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)\)")
_DOCTEST = re.compile(r"(?:^>>> .*\n?(?:^(?!>>>)\S.*\n?|^\.\.\. .*\n?)*)+", re.MULTILINE)


def _outside(page, target):
    """The path from the root of the checkout of a link that leaves docs/, else None."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return None if path.startswith("docs/") else path


def on_files(files, config):
    """Add the pages that are made, and one for each file outside docs/ and src/ that is linked."""
    files.append(File.generated(config, "commands.md", content=commands_page()))
    promises = runpy.run_path(str(_ROOT / "tests" / "support" / "promises.py"))
    files.append(File.generated(config, "promises.md", content=promises["matrix_page"]()))
    linked = set()
    for page in files.documentation_pages():
        found = (_outside(page.src_uri, target) for _, target in _LINK.findall(page.content_string))
        linked |= {path for path in found if path and not path.startswith("src/")}
    for path in sorted(linked):
        text = (_ROOT / path).read_text(encoding="utf-8")
        content = f"# {path}\n\n````{Path(path).suffix[1:]}\n{text}````\n"
        made = File.generated(config, f"files/{path}.md", content=content)
        made.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(made)
    return files


def commands_page():
    """The command line's parsers as a page: what each command does, its options, its examples."""
    parser = build_parser()
    (commands,) = (a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    parts = ["# Commands", f"{parser.description} Every command explains itself with `--help`."]
    for name, command in commands.items():
        parts += [f"## glissando {name}", command.description.strip()]
        positional = [a for a in command._actions if not a.option_strings]
        optional = [a for a in command._actions if a.option_strings and a.dest != "help"]
        usage = " ".join([f"glissando {name}", *map(_value, positional), "[options]"])
        parts += [f"```\n{usage}\n```", "| | |\n|---|---|\n" + _rows([*positional, *optional])]
        examples, _, status = command.epilog.strip().partition("\n\n")
        lines = "\n".join(line.removeprefix("  ") for line in examples.splitlines()[1:])
        parts += [f"```\n{lines}\n```", status.strip()]
    return "\n\n".join(part for part in parts if part) + "\n"


def _rows(actions):
    """Lines of a table: each option as it is typed, and its help."""
    shown = ((", ".join(a.option_strings), _value(a), a.help or "") for a in actions)
    cells = ((f"{flags} {value}".strip().replace("|", "\\|"), text) for flags, value, text in shown)
    return "\n".join(f"| `{typed}` | {text.replace('|', '&#124;')} |" for typed, text in cells)


def _value(action):
    """What stands behind an option, or in an argument's place."""
    if action.nargs == 0:
        return ""
    names = action.metavar or "|".join(map(str, action.choices or [action.dest.upper()]))
    return " ".join([names] if isinstance(names, str) else names)


def on_page_markdown(markdown, page, config, files):
    """Mark equations; let links that leave docs/ lead to the reference, or to their pages."""
    here, page.meta["equations"] = page.file.src_uri, []
    markdown = marked(markdown, page.meta["equations"])

    def inside(link):
        text, path = link[1], _outside(here, link[2])
        if path is None:
            return link[0]
        if path.startswith("src/"):
            module = path.removeprefix("src/").removesuffix(".py").replace("/", ".")
            name = text.strip("`").removeprefix(f"{module.rpartition('.')[2]}.")
            return f"[{text}][{module}.{name}]"
        to = posixpath.relpath(f"files/{path}.md", posixpath.dirname(here) or ".")
        return f"[{text}]({to})"

    return _LINK.sub(inside, markdown)


_EQUATION = re.compile(
    r"^ *```.*?^ *```|`[^`\n]+`|\$\$(.+?)\$\$|\$([^$\n]+)\$", re.MULTILINE | re.DOTALL
)
_MARK = re.compile(r"equation(\d+)here")


def on_page_content(html, page, config, files):
    """Put the equations of a page, as MathML, where their marks are."""
    return _MARK.sub(lambda found: page.meta["equations"][int(found[1])], html)


def marked(markdown, equations):
    """The text with a mark for each $equation$ outside code, and their MathML in the list."""

    def mark(found):
        if not (found[1] or found[2]):
            return found[0]  # code
        display = "block" if found[1] else "inline"
        equations.append(convert((found[1] or found[2]).strip(), display=display))
        return f"equation{len(equations) - 1}here"

    return _EQUATION.sub(mark, markdown)


class Doctests(griffe.Extension):
    """Fence the doctests of docstrings, which Markdown would take for quotations."""

    def on_instance(self, *, obj, **_):
        """Rewrite one docstring."""
        if obj.docstring:
            fenced = _DOCTEST.sub(
                lambda found: f"```pycon\n{found[0].rstrip()}\n```\n", obj.docstring.value
            )
            obj.docstring.value = fenced
