"""What a release is made of: ranges, lock file, bill of materials and licences agree."""

import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

pytest.importorskip("packaging")
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "release"))
import bill  # noqa: E402
import lock  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
BILL = json.loads(bill.SBOM.read_text(encoding="utf-8"))


def direct(*extras):
    """Requirements of the package and of some of its extras."""
    lines = [*PROJECT["dependencies"], *(line for name in extras for line in EXTRAS[name])]
    return [Requirement(line) for line in lines if not line.startswith("glissando")]


def test_the_lock_file_holds_every_dependency_within_its_range():
    locked = {}
    for package in lock.locked():
        locked.setdefault(package["name"], []).append(package["version"])
    for requirement in direct(*(name for name in EXTRAS if name != "ros2")):
        versions = locked.get(canonicalize_name(requirement.name), [])
        assert any(requirement.specifier.contains(version) for version in versions), requirement


def test_the_lock_file_names_wheels_by_hash_and_by_no_host():
    assert "://" not in lock.LOCK.read_text(encoding="utf-8")
    for package in lock.locked():
        files = [*package.get("wheels", []), *filter(None, [package.get("sdist")])]
        assert files, package["name"]
        for file in files:
            assert re.fullmatch(r"[0-9a-f]{64}", file["hashes"]["sha256"])
            assert file["path"].startswith("wheels/")
    for python in lock.PYTHONS:
        few, all_of_it = lock.requirements(python), lock.requirements(python, test=True)
        assert set(few.splitlines()) < set(all_of_it.splitlines())
        names = [line.partition("==")[0] for line in all_of_it.splitlines()]
        assert len(names) == len(set(names)), python
        assert "pytest" in names
        assert "pytest==" not in few


def test_the_bill_of_materials_is_that_of_the_lock_file():
    root = BILL["metadata"]["component"]
    assert (root["name"], root["version"]) == ("glissando", PROJECT["version"])
    listed = {f"{c['name']}=={c['version']}" for c in BILL["components"]}
    wanted = {line.partition(" ")[0] for line in lock.requirements(lock.PYTHONS[0]).splitlines()}
    assert listed == wanted
    needed = {c["name"] for c in BILL["components"] if c["scope"] == "required"}
    assert {canonicalize_name(r.name) for r in direct()} <= needed
    assert "pyarrow" not in needed


def test_licences_that_are_not_allowed_are_refused():
    terms = {c["name"]: c["licenses"][0]["expression"] for c in BILL["components"]}
    assert {name: text for name, text in terms.items() if not bill.allowed(text)} == {}
    for text in ("MIT", "Apache-2.0 OR GPL-3.0-only", "BSD-3-Clause AND (MIT OR GPL-2.0-only)"):
        assert bill.allowed(text), text
    for text in ("GPL-3.0-only", "MIT AND AGPL-3.0-only", "MIT AND (GPL-2.0-only)", "none stated"):
        assert not bill.allowed(text), text


def test_every_lower_bound_is_a_version_that_can_be_tested():
    """One lower bound a package, in all extras the same."""
    bounds = {}
    for requirement in direct(*(name for name in EXTRAS if name not in ("docs", "ros2", "test"))):
        (specifier,) = requirement.specifier
        assert specifier.operator == ">=", requirement
        assert bounds.setdefault(requirement.name, specifier.version) == specifier.version
    assert {
        "h5py": "3.11",
        "matplotlib": "3.10",
        "rosbags": "0.10.9",
        "shtab": "1.9.2",
    }.items() <= (bounds.items())
