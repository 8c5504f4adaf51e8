"""Pages agree with the code: functions, equations, names in files, pictures."""

import argparse
import importlib
import re
import runpy
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

import glissando
from glissando.cli.main import build_parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MATH = (DOCS / "math.md").read_text(encoding="utf-8")
LINKED = re.findall(r"\[`([\w.]+)`\]\(\.\./src/(glissando/[\w/]+)\.py\)", MATH)
SHOWN = re.findall(r"^::: (\S+)$", "\n".join(p.read_text() for p in DOCS.glob("api/*.md")), re.M)


def named(dotted):
    """The module, or what a module holds, of a dotted name."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        try:
            module = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[k:], module)
    raise AssertionError(f"nothing is named {dotted}")


@pytest.mark.parametrize(("text", "file"), sorted(set(LINKED)))
def test_a_function_that_the_mathematics_links_to_is_in_that_file(text, file):
    module = file.replace("/", ".")
    name = text.removeprefix(module.rpartition(".")[2] + ".")
    assert named(f"{module}.{name}").__module__ == module


def test_every_equation_is_linked_to_what_computes_it():
    items = re.split(r"\n- \*\*\((?=\d)", MATH)[1:]
    assert len(items) >= 20
    for item in items:
        assert "](../src/" in item.split("\n\n")[0], item[:60]


def test_equations_become_mathml_and_code_stays_code():
    pytest.importorskip("latex2mathml")
    marked, equations = runpy.run_path(str(DOCS / "_site.py"))["marked"], []
    text = "a $x_1$ b `$PATH` c\n```sh\necho $A $B\n```\n$$\\frac{a}{b}$$ end $5 alone"
    out = marked(text, equations)
    assert out == "a equation0here b `$PATH` c\n```sh\necho $A $B\n```\nequation1here end $5 alone"
    assert len(equations) == 2
    assert 'display="inline"' in equations[0]
    assert 'display="block"' in equations[1]
    assert "<mfrac>" in equations[1]
    for page in DOCS.rglob("*.md"):
        found = []
        marked(page.read_text(encoding="utf-8"), found)
        assert not [e for e in found if "\\" in e], page.name  # a command that is not understood


def test_every_equation_that_the_code_names_is_on_the_page():
    numbered = set(re.findall(r"\*\*\((\d+'?)\)\*\*", MATH))
    for file in (ROOT / "src" / "glissando").rglob("*.py"):
        for said in re.findall(r"(?i:equations?) (\([^A-Za-z.]*\))", file.read_text()):
            assert set(re.findall(r"\((\d+'?)\)", said)) <= numbered, (file, said)


def test_the_reference_shows_every_public_name_once():
    assert len(SHOWN) == len(set(SHOWN))
    shown = [named(name) for name in SHOWN]
    held = [vars(s).values() for s in shown if type(s) is type(glissando)]
    everything = {id(x) for x in (*shown, *(value for values in held for value in values))}
    for name in glissando.__all__:
        assert id(getattr(glissando, name)) in everything, name


def test_the_page_for_matlab_states_the_variables_and_dimensions_of_the_file(tmp_path):
    import xarray

    page = (DOCS / "how-to" / "other-tools.md").read_text(encoding="utf-8")
    robot = glissando.load_robot("tdcr466")
    tip = np.tile(np.eye(4), (4, 1, 1))
    tip[:, 2, 3] = robot.length
    time, place = np.linspace(0, 0.2, 4), np.full(4, robot.length)
    seen = glissando.PoseReadings(time=time, arclength=place, values=tip, cov=1e-6)
    posterior = glissando.estimate(robot.prior, robot.grid(0.0, 0.2), [seen])
    glissando.save_posterior(posterior, tmp_path / "posterior.nc")
    with xarray.open_dataset(tmp_path / "posterior.nc", engine="h5netcdf") as file:
        read = re.findall(r"(\w+) = ncread\(file, '(\w+)'\); +% ([\dKN x]*)", page)
        letters = {file.sizes["time"]: "K", file.sizes["arclength"]: "N"}
        assert len(read) >= 9
        for _, name, size in read:
            turned = [letters.get(n, str(n)) for n in file[name].shape[::-1]]
            assert size.split(" x ")[: len(turned)] == turned, name
        rows = re.findall(r"^\| `(\w+)` \| ([\w, ]+) \| (.*) \|$", page, re.M)
        assert {name for name, _, _ in rows} == {
            n for n in file.variables if file[n].dtype.kind == "f"
        }
        for name, dimensions, units in rows:
            assert list(file[name].dims) == dimensions.split(", "), name
            assert file[name].attrs.get("units", units) == units or name in ("std", "cov")
        assert {"prior", "sensor_parameters", "solve"} <= set(file.attrs)
        assert list(file["component"].values[[0, 3, 6, 12]]) == [
            *("pose_x", "pose_rx", "strain_x", "velocity_x")
        ]


def test_the_first_page_shows_every_figure_of_the_reproduction():
    first_page = (DOCS / "index.md").read_text(encoding="utf-8")
    figures = [p for p in (DOCS / "reproduction").iterdir() if p.suffix in (".png", ".gif")]
    assert len(figures) >= 6
    for figure in figures:
        assert f"(reproduction/{figure.name})" in first_page


def test_tutorials_are_short_enough_to_be_read():
    for page in (DOCS / "tutorials").glob("*.md"):
        assert len(page.read_text(encoding="utf-8").splitlines()) <= 130, page.name


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    listed = re.findall(r"[\w./-]+\.md", navigation)
    assert len(listed) == len(set(listed))
    made = {"commands.md", "promises.md"}  # by docs/_site.py
    assert set(listed) == made | {p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md")}


def test_the_page_of_commands_names_every_option_of_every_command():
    pytest.importorskip("latex2mathml")
    page = runpy.run_path(str(DOCS / "_site.py"))["commands_page"]()
    sections = dict(re.findall(r"^## glissando (\w+)\n(.*?)(?=^## |\Z)", page, re.M | re.S))
    parser = build_parser()
    (commands,) = (a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    assert sections.keys() == commands.keys()
    for name, command in commands.items():
        for action in command._actions:
            for flag in set(action.option_strings) - {"-h", "--help"}:
                assert f"`{flag}" in sections[name] or f", {flag}" in sections[name], (name, flag)
        assert f"glissando {name} " in sections[name].partition("```")[2]
