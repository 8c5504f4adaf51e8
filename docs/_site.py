"""Hooks of the site: links that leave docs/, and doctests as blocks of code.

Pages link to source files by path, [`se3.exp`](../src/glissando/geometry/se3.py). In the site
such a link leads to the entry of the function in the reference. Any other linked file outside
docs/ becomes a page of its own.
"""

import posixpath
import re
from pathlib import Path

import griffe
from mkdocs.structure.files import File, InclusionLevel

_ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)\)")
_DOCTEST = re.compile(r"(?:^>>> .*\n?(?:^(?!>>>)\S.*\n?|^\.\.\. .*\n?)*)+", re.MULTILINE)


def _outside(page, target):
    """The path from the root of the checkout of a link that leaves docs/, else None."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return None if path.startswith("docs/") else path


def on_files(files, config):
    """Add a page for each file outside docs/ and src/ that some page links to."""
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


def on_page_markdown(markdown, page, config, files):
    """Let links that leave docs/ lead to the reference, or to the pages made for them."""
    here = page.file.src_uri

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


class Doctests(griffe.Extension):
    """Fence the doctests of docstrings, which Markdown would take for quotations."""

    def on_instance(self, *, obj, **_):
        """Rewrite one docstring."""
        if obj.docstring:
            fenced = _DOCTEST.sub(
                lambda found: f"```pycon\n{found[0].rstrip()}\n```\n", obj.docstring.value
            )
            obj.docstring.value = fenced
