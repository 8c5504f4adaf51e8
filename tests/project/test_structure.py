"""The house keeps its shape: no circle of files, few at the root, no way round the contract."""

import ast
import re
from pathlib import Path

import grimp
import pytest

SOURCE = Path(__file__).parents[2] / "src" / "glissando"
MODULES = sorted(SOURCE.rglob("*.py"))


def test_no_files_import_each_other_in_a_circle():
    graph = grimp.build_graph("glissando")
    left = {m: set(graph.find_modules_directly_imported_by(m)) for m in graph.modules}
    while leaves := [module for module, imported in left.items() if not imported]:
        for module in leaves:
            del left[module]
        for imported in left.values():
            imported.difference_update(leaves)
    assert not left, f"in circles, or above one: {sorted(left)}"


def test_the_root_holds_little_but_packages():
    names = {path.name for path in SOURCE.iterdir() if path.suffix == ".py"}
    assert names == {"__init__.py", "__main__.py", "errors.py"}


def test_what_keeps_time_stands_where_make_test_looks_for_it():
    """Tests marked `alone` are collected from tests/hardware only."""
    tests = Path(__file__).parents[1]
    marked = {path for path in tests.rglob("test_*.py") if "mark" + ".alone" in path.read_text()}
    assert marked
    assert all(tests / "hardware" in path.parents for path in marked)


def test_tests_import_nothing_from_benchmarks():
    """Tests of benchmarks stand beside these, and what is in tests/support has its name first."""
    tests = Path(__file__).parents[1]
    own = {path.stem for folder in (tests, tests / "support") for path in folder.glob("*.py")}
    programs = {path.stem for path in (tests.parent / "benchmarks").glob("*.py")} - own
    for path in tests.rglob("*.py"):
        names = set(re.findall(r"^\s*(?:import|from) (\w+)", path.read_text(), re.MULTILINE))
        names |= set(re.findall(r"importorskip\([\"'](\w+)", path.read_text()))
        assert not names & programs, path.name


def test_the_list_of_benchmarks_says_of_each_what_it_says_of_itself():
    folder = Path(__file__).parents[2] / "benchmarks"
    texts = {path.name: path.read_text() for path in folder.glob("*.py")}
    programs = {name: text for name, text in texts.items() if "__main__" in text}
    rows = re.findall(
        r"^\| \[`(\w+\.py)`\]\(\1\) \| (.*?) \|", (folder / "README.md").read_text(), re.M
    )
    assert dict(rows) == {
        name: (ast.get_docstring(ast.parse(text)) or "").splitlines()[0]
        for name, text in programs.items()
    }


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_the_package_is_imported_at_the_top_of_files_only(path):
    """A function that imports a room could go round the contract of layers."""
    tree = ast.parse(path.read_text())
    inner = {node for top in ast.walk(tree) if isinstance(top, ast.FunctionDef)
             for node in ast.walk(top)}  # fmt: skip
    for node in inner:
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith("glissando"), ast.unparse(node)
        elif isinstance(node, ast.Import):
            assert not any(name.name.startswith("glissando") for name in node.names)
