"""The package as others get it: its wheel, its public names, its pages."""

import ast
import importlib.util
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import glissando

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "glissando"
MODULES = sorted(SOURCE.rglob("*.py"))
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *(p for room in ("docs", "tests") for p in sorted((ROOT / room).rglob("*.md"))),
]


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("hatchling") is None,
    reason="hatchling, which builds the wheel, is not installed",
)
def test_the_wheel_holds_all_that_is_imported_or_read(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    command += ["--quiet", "--wheel-dir", tmp_path, ROOT]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"glissando-{glissando.__version__}-py3")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    wanted = {path.relative_to(SOURCE.parent).as_posix() for path in MODULES}
    wanted |= {
        f"glissando/io/robots/{name}.toml" for name in ("tdcr466", "sliding700", "extensible1m")
    }
    wanted |= {"glissando/py.typed", "glissando/experiments/claims.toml"}
    assert wanted <= held
    assert f"glissando-{glissando.__version__}.dist-info/sboms/sbom.cdx.json" in held
    assert not [name for name in held if name.startswith("tests")]


def test_every_data_file_is_one_that_a_wheel_takes():
    """Hatch packs what git does not ignore: nothing that is read at run time may be."""
    ignored = subprocess.run(
        ["git", "check-ignore", *(p for p in SOURCE.rglob("*") if p.suffix in (".toml", ".typed"))],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ignored.stdout == ""


def public(tree, name=""):
    """Public functions, classes and methods of a module's tree, by dotted name."""
    for node in ast.iter_child_nodes(tree):
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        if isinstance(node, kinds) and not node.name.startswith("_"):
            yield f"{name}{node.name}", node
            if isinstance(node, ast.ClassDef):
                yield from public(node, f"{name}{node.name}.")


@pytest.mark.parametrize("module", MODULES, ids=lambda p: p.relative_to(SOURCE).as_posix())
def test_every_public_name_has_a_docstring_that_begins_with_a_sentence(module):
    tree = ast.parse(module.read_text(encoding="utf-8"))
    for name, node in [("the module", tree), *public(tree)]:
        text = ast.get_docstring(node)
        assert text, f"{name} says nothing"
        first = text.split("\n\n")[0].strip()
        assert first[-1] in ".:?", f"{name}: {first!r}"


def test_what_is_public_is_there_and_in_order():
    assert glissando.__all__ == sorted(glissando.__all__)
    for name in glissando.__all__:
        assert getattr(glissando, name).__doc__


def slug(heading):
    """The anchor that a page gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_to_files_and_headings_that_are_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target or target.startswith("mailto:"):
            continue
        file, _, anchor = target.partition("#")
        to = page if not file else (page.parent / file).resolve()
        assert to.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", to.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert anchor in [slug(h) for h in headings], target


def test_the_citation_is_of_this_version_and_names_the_paper():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {glissando.__version__}\n" in text
    assert "cff-version: 1.2.0" in text
    for name in ("Walsh", "Teetaert", "Diller", "Barfoot", "Burgner-Kahrs", "Sliding Sensors"):
        assert name in text


def test_versions_agree_and_the_changelog_knows_them():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f'version = "{glissando.__version__}"' in project
    assert f"## {glissando.__version__}\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
