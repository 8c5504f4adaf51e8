"""Public promises and the tests that show them, as a table: `python tests/support/promises.py`."""

import ast
import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = tomllib.loads((ROOT / "tests" / "promises.toml").read_text(encoding="utf-8"))


@cache
def tests_in(file):
    """Names of the tests in a file, below tests/ unless of benchmarks; whether they are slow."""
    path = (ROOT if file.startswith("benchmarks/") else ROOT / "tests") / file
    if not path.is_file():
        return {}
    nodes = ast.parse(path.read_text(encoding="utf-8")).body
    return {
        node.name: any("slow" in ast.unparse(mark) for mark in node.decorator_list)
        for node in nodes
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


def is_there(test):
    """Whether a test exists, by FILE::NAME."""
    file, _, name = test.partition("::")
    return name in tests_in(file)


def page_text(page):
    """The text of a page of the site, white space as single blanks."""
    folder = ROOT if page == "README.md" else ROOT / "docs"
    return " ".join((folder / page).read_text(encoding="utf-8").split())


def holes():
    """Sentences on promises whose words or tests are not there."""
    for promise in TABLE["promise"]:
        says = f"{promise['page']}, {promise['says']!r}"
        if promise["says"] not in page_text(promise["page"]):
            yield f"{says}: these words do not stand there"
        if not promise["tests"]:
            yield f"{says}: no test shows it"
        for test in promise["tests"]:
            if not is_there(test):
                yield f"{says}: there is no test {test}"


def matrix_page():
    """The table as a page of the site."""
    promises = TABLE["promise"]
    lines = [
        "# Promises and their tests\n",
        "Every public promise, in the words of its page, and the tests of `tests/` that show it. A "
        "test fails if a promise has none, if its words have left the page, or if a row of the "
        "README or a page of this site has no promise.\n",
        f"{len(promises)} promises, {len({t for p in promises for t in p['tests']})} tests.\n",
        "| page | says | shown by |\n|---|---|---|",
    ]
    for promise in promises:
        to = "../README.md" if promise["page"] == "README.md" else promise["page"]
        says = promise["says"].replace("|", "\\|").replace("[", "\\[").replace("`", "")
        tests = "<br>".join(f"`{test.replace('::', '` `')}`" for test in promise["tests"])
        lines.append(f"| [{promise['page'].removesuffix('.md')}]({to}) | {says} | {tests} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(matrix_page())
    raise SystemExit("\n".join(holes()) or 0)
