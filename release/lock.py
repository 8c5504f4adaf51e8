"""The tested set of packages, as release/pylock.toml.

`make lock` writes it and the bill of materials anew: the newest versions within the ranges of
pyproject.toml, for Linux on x86-64 and the Pythons of PYTHONS. The lock file (PEP 751) names wheels
by file and SHA-256 and by no host: `requirements` makes lines of it for pip, which finds the files
in whatever index it uses.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from packaging.markers import Marker, default_environment

from bill import SBOM, allowed, bill, licence, metadata

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "release" / "pylock.toml"
PYTHONS = ("3.11", "3.12", "3.13")
WHEELS = "wheels"
"""Folder beside the lock file into which `pip download` puts what the lock file names."""
_TAGS = re.compile(r"-(py3|py2\.py3|cp3\d+)-(none|abi3|cp3\d+)-(any|\S*linux\S*_x86_64)\.whl$")
_GLIBC = re.compile(r"manylinux_2_(\d+)_x86_64")
_OLDEST = 28  # the minor version of glibc that wheels may need
_MADE = re.compile(r"-cp(3\d+)-cp3\d+-")  # for one version of Python only


def locked() -> list[dict[str, Any]]:
    """The packages of the lock file."""
    packages: list[dict[str, Any]] = tomllib.loads(LOCK.read_text(encoding="utf-8"))["packages"]
    return packages


def requirements(python: str, *, test: bool = False) -> str:
    """Lines for `pip --require-hashes` on a version of Python: every file of the lock file.

    Args:
        python: The version, such as "3.11".
        test: Whether with what only tests need.
    """
    lines = []
    for package in locked():
        if _wanted(package, python, test=test):
            files = [*package.get("wheels", []), *filter(None, [package.get("sdist")])]
            hashes = " ".join(f"--hash=sha256:{file['hashes']['sha256']}" for file in files)
            lines.append(f"{package['name']}=={package['version']} {hashes}\n")
    return "".join(lines)


def _wanted(package: dict[str, Any], python: str, *, test: bool = False) -> bool:
    place = {"python_version": python, "python_full_version": f"{python}.99"}
    place |= {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "x86_64"}
    place |= {"implementation_name": "cpython", "platform_python_implementation": "CPython"}
    extras = {"extras": frozenset({"test"} if test else ())}
    marker = package.get("marker")
    return marker is None or Marker(marker).evaluate(
        {**default_environment(), **place, **extras}, "lock_file"
    )


def _resolved(extra: str, constraints: str = "") -> list[dict[str, Any]]:
    """The newest packages of an extra, as uv finds them."""
    with tempfile.TemporaryDirectory() as folder:
        out, held = Path(folder, "pylock.toml"), Path(folder, "constraints.txt")
        held.write_text(constraints)
        command = ["uv", "pip", "compile", "--quiet", "--universal", "--python-version", PYTHONS[0]]
        command += ["--extra", extra, "--constraint", str(held), "--format", "pylock.toml"]
        run(*command, "--output-file", str(out), str(ROOT / "pyproject.toml"))
        packages: list[dict[str, Any]] = tomllib.loads(out.read_text(encoding="utf-8"))["packages"]
    return packages


def run(*command: str, **more: Any) -> str:
    """What a program of this environment prints; its error ends the run."""
    tool = Path(sys.executable).parent / command[0]
    words = [str(tool) if tool.exists() else command[0], *command[1:]]
    done = subprocess.run(words, capture_output=True, text=True, check=False, **more)
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:4])} …\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return done.stdout


def lock() -> None:
    """Write the lock file."""
    shipped = _resolved("all")
    fixed = {(p["name"], p["version"]) for p in shipped if any(_wanted(p, v) for v in PYTHONS)}
    tested = _resolved("test", "".join(_constraint(p) for p in shipped))
    lines = [
        "# Written by `make lock`; wheels/ is what `pip download` fills.\n",
        'lock-version = "1.0"\n',
    ]
    lines += [f'requires-python = ">={PYTHONS[0]}"\n', 'created-by = "glissando"\n']
    lines += ["environments = [\"sys_platform == 'linux' and platform_machine == 'x86_64'\"]\n"]
    lines += ['extras = ["test"]\n']
    for package in tested:
        package.pop("index", None)
        marker = package.pop("marker", "")
        tool = (package["name"], package["version"]) not in fixed
        entry = {**package, **({"marker": marker} if marker else {})}
        on = [python for python in PYTHONS if _wanted(entry, python, test=True)]
        if not on:
            continue
        parts = ["'test' in extras"] if tool else []
        if len(on) < len(PYTHONS):
            parts.append(f"python_version >= '{on[0]}' and python_version <= '{on[-1]}'")
        lines.append(
            f'\n[[packages]]\nname = "{package["name"]}"\nversion = "{package["version"]}"\n'
        )
        lines += [f'marker = "{" and ".join(parts)}"\n'] if parts else []
        wheels = [w for w in package.get("wheels", []) if _fits(_name(w))]
        lines += ["wheels = [\n", *(f"    {_entry(w)},\n" for w in wheels), "]\n"] if wheels else []
        lines += [] if wheels else [f"sdist = {_entry(package['sdist'])}\n"]
    LOCK.write_text("".join(lines), encoding="utf-8")


def _constraint(package: dict[str, Any]) -> str:
    marker = package.get("marker", "")
    return f"{package['name']}=={package['version']}" + (f" ; {marker}" if marker else "") + "\n"


def _name(file: dict[str, Any]) -> str:
    return str(file["url"]).rsplit("/", 1)[-1].partition("#")[0]


def _fits(name: str) -> bool:
    """Whether a wheel is for one of the Pythons on Linux."""
    made = _MADE.search(name)
    wanted = {python.replace(".", "") for python in PYTHONS}
    known = "musl" not in name and (made is None or made[1] in wanted)
    glibc = min(map(int, _GLIBC.findall(name)), default=0)
    return bool(_TAGS.search(name)) and known and glibc <= _OLDEST


def _entry(file: dict[str, Any]) -> str:
    name, digest = _name(file), file["hashes"]["sha256"]
    return f'{{ path = "{WHEELS}/{name}", hashes = {{ sha256 = "{digest}" }} }}'


def download(python: str, folder: Path, interpreter: str = sys.executable) -> None:
    """Fetch what the lock file names for a version of Python; pip checks every hash."""
    listed = folder / f"requirements-{python}.txt"
    folder.mkdir(parents=True, exist_ok=True)
    listed.write_text(requirements(python))
    command = [
        "-m",
        "pip",
        "download",
        "--quiet",
        "--require-hashes",
        "--no-deps",
        "--only-binary",
        ":all:",
    ]
    command += ["--python-version", python, "--platform", "manylinux_2_28_x86_64"]
    command += ["--platform", "manylinux_2_17_x86_64", "--platform", "manylinux2014_x86_64"]
    run(interpreter, *command, "--dest", str(folder), "--requirement", str(listed))
    listed.unlink()


def main() -> None:
    """Write the lock file and the bill of materials; refuse a licence that is not allowed."""
    lock()
    with tempfile.TemporaryDirectory() as folder:
        download(PYTHONS[0], Path(folder))
        refused = {
            n: licence(m) for n, m in metadata(Path(folder)).items() if not allowed(licence(m))
        }
        if refused:
            raise SystemExit(f"Licences that are not allowed, or not understood: {refused}")
        SBOM.write_text(bill(Path(folder)), encoding="utf-8")
    print(f"Wrote {LOCK.relative_to(ROOT)} ({len(locked())} packages) and {SBOM.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
