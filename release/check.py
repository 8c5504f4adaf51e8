"""`make release`: builds glissando twice, and shows that what is built can be trusted and used.

Everything happens in a temporary folder, from a clean clone of what is committed. Every step ends
in a line with its time; the first that fails ends the run with exit status 1.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from packaging.requirements import Requirement

from bill import SBOM, allowed, bill, licence, metadata
from lock import LOCK, PYTHONS, ROOT, WHEELS, download, locked, run

_TESTS = ("tests/geometry", "tests/io", "tests/solver", "tests/visualization")
_VULNERABLE = "jinja2==2.11.0\n"  # CVE-2020-28493: a service that knows anything knows it
_TOOLS = ("pytest", "hypothesis")  # of the tests; the others skip without theirs


def built(folder: Path) -> Path:
    """Wheels and sdists of two clones, in other places and with other rights, are identical."""
    clones = folder / "first", folder / "somewhere" / "else" / "second"
    date = run("git", "-C", str(ROOT), "log", "-1", "--format=%ct").strip()
    for clone, mask in zip(clones, (0o022, 0o077), strict=True):
        before = os.umask(mask)
        run("git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(clone))
        targets = "--target", "sdist", "--target", "wheel"
        env = os.environ | {"SOURCE_DATE_EPOCH": date}
        run("hatchling", "build", *targets, "--directory", "dist", cwd=clone, env=env)
        os.umask(before)
    first, second = (digests(clone / "dist") for clone in clones)
    require(len(first) == 2 and first == second, f"the builds differ: {first}, {second}")
    for name, digest in first.items():
        print(f"    {name} sha256 {digest}")
    return clones[0]


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of the files in a folder."""
    files = sorted(folder.iterdir())
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def require(holds: object, sentence: str) -> None:
    """End the run with a sentence unless something holds."""
    if not holds:
        raise SystemExit(f"FAILED: {sentence}")


def wheel_of(clone: Path) -> Path:
    """The wheel that was built."""
    (wheel,) = (clone / "dist").glob("*.whl")
    return wheel


def carries_its_bill(clone: Path) -> None:
    """The wheel holds the bill of materials, which is valid CycloneDX and that of the lock file."""
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    with zipfile.ZipFile(wheel_of(clone)) as archive:
        (name,) = (n for n in archive.namelist() if ".dist-info/sboms/" in n)
        text = archive.read(name).decode()
    require(text == SBOM.read_text(encoding="utf-8"), "the wheel's bill is another: make lock")
    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    require(problem is None, f"the bill of materials is no CycloneDX: {problem}")
    print(f"    {name}: {len(json.loads(text)['components'])} packages")


def fetched(folder: Path) -> Path:
    """All files of the lock file come from the index with the hashes that it states."""
    shutil.copy(LOCK, folder)
    with ThreadPoolExecutor(len(PYTHONS)) as pool:
        list(pool.map(lambda python: download(python, folder / python), PYTHONS))
    for python in PYTHONS:
        shutil.copytree(folder / python, folder / WHEELS, dirs_exist_ok=True)
    print(f"    {len(list((folder / WHEELS).iterdir()))} wheels for Python {', '.join(PYTHONS)}")
    return folder / LOCK.name


def may_be_used(folder: Path) -> None:
    """Licences of all that glissando imports are known and compatible, and those of the bill."""
    terms = {name: licence(message) for name, message in metadata(folder / WHEELS).items()}
    refused = {name: text for name, text in terms.items() if not allowed(text)}
    require(not refused, f"licences that are not allowed: {refused}")
    told = bill(folder / PYTHONS[0])
    require(told == SBOM.read_text(encoding="utf-8"), "the bill is old: make lock")
    print(f"    {len(terms)} packages: {', '.join(sorted(set(terms.values())))}")


def audited(folder: Path) -> bool:
    """No package of the lock file, tools included, has a known vulnerability."""
    wanted = "".join(f"{p['name']}=={p['version']}\n" for p in _newest(locked()))
    problems = []
    for service in ("osv", "pypi"):
        said = _audit(service, _VULNERABLE, folder)
        if not said.startswith("Found"):  # it knows nothing, or cannot be reached
            problems.append(
                f"{service} does not know that {_VULNERABLE.strip()} is vulnerable: {said}"
            )
            continue
        said = _audit(service, wanted, folder)
        require(said.startswith("No known"), f"{service}: {said}")
        print(f"    {service}: {said}")
        return True
    print("    NOT AUDITED: no vulnerability service answers here.", *problems, sep="\n    ")
    return False


def _audit(service: str, packages: str, folder: Path) -> str:
    """What pip-audit concludes in the end; a package that a service does not know is an error."""
    listed = folder / "audit.txt"
    listed.write_text(packages)
    words = [
        "--strict",
        "--no-deps",
        "--disable-pip",
        "--progress-spinner",
        "off",
        "--timeout",
        "15",
    ]
    command = [
        "pip-audit",
        "--vulnerability-service",
        service,
        *words,
        "--requirement",
        str(listed),
    ]
    tool = Path(sys.executable).parent / command[0]
    done = subprocess.run([tool, *command[1:]], capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.strip().splitlines() if "WARNING" not in line]
    return lines[-1][:200] if lines else f"exit status {done.returncode}"


def _newest(packages: list[dict[str, str]]) -> list[dict[str, str]]:
    """One entry a package: pip-audit takes each name once."""
    return list({package["name"]: package for package in packages}.values())


def interpreters() -> dict[str, str]:
    """The Pythons of this machine that are tested, by version."""
    homes = [Path.home() / ".pyenv" / "versions", Path.home() / ".local/share/uv/python"]
    found = {}
    for python in PYTHONS:
        names = [shutil.which(f"python{python}"), shutil.which("python3"), sys.executable]
        names += [str(p) for home in homes for p in home.glob(f"*{python}.*/bin/python{python}")]
        for name in filter(None, names):
            ask = "import sys; print('%d.%d' % sys.version_info[:2])"
            try:
                said = run(name, "-c", ask).strip()
            except SystemExit:
                continue
            if said == python:
                found[python] = name
                break
    return found


def environment(place: Path, interpreter: str) -> str:
    """An empty environment with the pip of this one; returns its Python."""
    run(interpreter, "-m", "venv", "--without-pip", str(place))
    return str(place / "bin" / "python")


def pip(python: str, *words: str) -> None:
    """Let this environment's pip install into another."""
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--quiet",
        "--no-compile",
        *words,
    )


def runs_the_script(python: str, folder: Path) -> str:
    """The script of the README in an empty folder, with nothing but what is installed."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (script,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    folder.mkdir(exist_ok=True)
    (folder / "script.py").write_text(script)
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    env = kept | {"GLISSANDO_CACHE": str(folder / "cache")}
    said = run(python, "-I", "-W", "error", "script.py", cwd=folder, env=env)
    require(said.count("± ") == 3 and (folder / "posterior.nc").stat().st_size > 1000, said)
    return said.splitlines()[-1]


def installs(folder: Path, python: str, interpreter: str, wheel: Path) -> None:
    """The wheel and the locked set install without an index, agree, and run README's script."""
    place = folder / f"python{python}"
    inside = environment(place, interpreter)
    pip(inside, "--no-index", "--requirement", str(folder / LOCK.name))
    pip(inside, "--no-index", "--no-deps", str(wheel))
    run(sys.executable, "-m", "pip", "--python", inside, "check")
    print(f"    Python {python}, locked set: {runs_the_script(inside, place / 'empty')}")


def lowest() -> list[str]:
    """The lowest version that pyproject.toml allows of every package, as lines for pip."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"]]
    lines += [
        line
        for name in extras
        if name not in ("all", "docs", "ros2", "test")
        for line in extras[name]
    ]
    wanted = map(Requirement, lines)
    return sorted({f"{r.name}=={next(iter(r.specifier)).version}" for r in wanted})


def works_at_its_lowest(folder: Path, interpreter: str, clone: Path) -> None:
    """The lowest versions of all dependencies pass the fast tests of the rooms in _TESTS."""
    inside = environment(folder / "lowest", interpreter)
    packages = f"{wheel_of(clone)}[all]", *lowest(), *_TOOLS
    run("uv", "pip", "install", "--quiet", "--python", inside, *packages)
    print(f"    lowest versions: {runs_the_script(inside, folder / 'lowest' / 'empty')}")
    # warnings of old packages about each other are no errors of ours
    words = ["-q", "-x", "-m", "not slow and not alone", "--override-ini", "filterwarnings=default"]
    words += ["--override-ini", "addopts=-p no:cacheprovider", *_TESTS]
    cache = folder / "lowest" / "empty" / "cache"
    env = os.environ | {"GLISSANDO_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
    said = run(inside, "-P", "-m", "pytest", *words, cwd=clone, env=env)
    print(f"    lowest versions: {said.strip().splitlines()[-1]}")


def timed(what: Callable[..., object], *given: object) -> object:
    """Run a step and say what it showed, in its own words, and how long it took."""
    began = time.monotonic()
    result = what(*given)
    mark = "ok " if result is not False else "-- "
    print(f"{mark} {time.monotonic() - began:4.0f} s  {what.__doc__.splitlines()[0]}", flush=True)
    return result


def main() -> int:
    """Run all steps; two at a time where they do not build on each other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where the files go")
    out, began = parser.parse_args().out, time.monotonic()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(2) as pool:
        folder = Path(place)
        clone = timed(built, folder)
        timed(carries_its_bill, clone)
        pythons = interpreters()
        require(PYTHONS[0] in pythons, f"Python {PYTHONS[0]} is not on this machine")
        low = pool.submit(timed, works_at_its_lowest, folder, pythons[PYTHONS[0]], clone)
        timed(fetched, folder)
        tried = [
            pool.submit(timed, installs, folder, python, interpreter, wheel_of(clone))
            for python, interpreter in pythons.items()
        ]
        timed(may_be_used, folder)
        clean = timed(audited, folder)
        for one in (low, *tried):
            one.result()
        shutil.copytree(clone / "dist", out, dirs_exist_ok=True)
    missing = [python for python in PYTHONS if python not in pythons]
    print(f"Wrote {out}: all checks passed in {time.monotonic() - began:.0f} s.")
    if missing:
        print(f"Not tested here, as it is not installed: Python {', '.join(missing)}.")
    if not clean:
        print("Not audited: before publishing, run this where a vulnerability service answers.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
