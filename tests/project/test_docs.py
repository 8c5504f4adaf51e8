"""The README and the docs are run: their Python blocks, and the numbers that code prints."""

import ast
import importlib
import json
import re
import tomllib
from pathlib import Path

import pytest

from glissando.experiments.claims import judge, load_claims
from glissando.experiments.page import page as page_of
from glissando.model.priors import registry

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SCRIPTS = [
    page
    for page in PAGES
    if page.parent.name in ("tutorials", "how-to")
    or page.name in ("conventions.md", "recordings.md")
]
"""Pages whose blocks are run in order, in one namespace; the blocks of all others stand alone."""


def blocks(language, pages=PAGES):
    for page in pages:
        found = re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.DOTALL)
        for number, block in enumerate(found):
            yield pytest.param(block, id=f"{page.name}-{number}")


@pytest.mark.slow
@pytest.mark.parametrize("page", SCRIPTS, ids=lambda p: p.name)
def test_a_page_to_follow_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_PRIORS", dict(registry._PRIORS))  # a page may add a prior
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL):
        exec(compile(block, page.name, "exec"), names)
    for picture in re.findall(r"!\[[^\]]*\]\(([\w.-]+)\)", page.read_text()):
        assert (tmp_path / picture).stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("block", list(blocks("python", [p for p in PAGES if p not in SCRIPTS])))
def test_python_blocks_run(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "page", "exec"), {"__name__": "page"})


@pytest.mark.parametrize("block", list(blocks("toml")))
def test_toml_blocks_parse(block):
    assert tomllib.loads(block)


def test_the_script_in_the_readme_is_short():
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(block.strip().splitlines()) <= 16


def test_the_reference_has_all_that_pages_and_examples_import():
    """A class or function is found under its module, its package or the top level."""
    reference = "".join(page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    named = set(re.findall(r"^::: (\S+)", reference, re.MULTILINE))
    missing = {}
    for file in [*PAGES, *sorted((ROOT / "examples").rglob("*.py"))]:
        code = file.read_text()
        if file.suffix == ".md":
            code = "\n".join(re.findall(r"```python\n(.*?)```", code, re.DOTALL))
        for line in ast.walk(ast.parse(code)):
            if isinstance(line, ast.ImportFrom) and line.module.startswith("glissando."):
                for name in line.names:
                    found = getattr(importlib.import_module(line.module), name.name, None)
                    if not callable(found):  # a module, or a constant of one
                        continue
                    if not named & {found.__module__, f"glissando.{name.name}"}:
                        missing[f"{found.__module__}.{name.name}"] = file.name
    assert missing == {}


def test_the_page_of_the_reproduction_is_written_from_its_record_and_every_claim_holds():
    folder = ROOT / "docs" / "reproduction"
    record = json.loads((folder / "results.json").read_text())
    assert page_of(record) == (folder / "reproduction.md").read_text()
    assert not record["quick"]
    assert record["seeds"]["table"] >= 100
    assert [c["id"] for c in record["claims"]] == [c.id for c in load_claims()]
    assert [v.ours for v in judge(load_claims(), record["results"])] == [
        c["ours"] for c in record["claims"]
    ]
    assert not any(c["verdict"] == "FAILS" for c in record["claims"])
