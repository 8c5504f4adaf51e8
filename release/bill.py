"""Licences of the packages that glissando imports, and the bill of materials of its wheel."""

from __future__ import annotations

import json
import re
import tomllib
import uuid
import zipfile
from collections.abc import Iterable
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
SBOM = ROOT / "release" / "sbom.cdx.json"
_SPDX = {  # licences by the words in which metadata state them, in small letters
    "apache 2.0": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "any-osi": "MIT",  # "under any licence that the OSI approved"
    "bsd": "BSD-3-Clause",
    "bsd license": "BSD-3-Clause",
    "mit license": "MIT",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
}
_TERMS = (
    "MIT MIT-0 MIT-CMU BSD-2-Clause BSD-3-Clause Apache-2.0 ISC PSF-2.0 Python-2.0 Zlib 0BSD HPND "
    "Unlicense CC0-1.0 BSL-1.0 LLVM-exception MPL-2.0"
)
ALLOWED = frozenset(_TERMS.split())
"""Licences of packages that one under MIT may import; of MPL-2.0 as long as they are unchanged.

An expression is allowed if every part joined by AND is, and one of those joined by OR.
"""


def allowed(expression: str) -> bool:
    """Whether a licence expression permits what glissando does with a package.

    >>> allowed("BSD-3-Clause AND (GPL-3.0-only OR MIT)"), allowed("GPL-3.0-only")
    (True, False)
    """
    inner = re.sub(r"\(([^()]*)\)", lambda m: "MIT" if allowed(m[1]) else "refused", expression)
    if inner != expression:
        return allowed(inner)
    choices = (re.split(r" AND | WITH ", choice) for choice in expression.split(" OR "))
    return any(all(part.strip() in ALLOWED for part in parts) for parts in choices)


def metadata(wheels: Path) -> dict[str, Message]:
    """The metadata of the wheels in a folder, by normalised name."""
    found = {}
    for wheel in sorted(wheels.glob("*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            (name,) = (
                n for n in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", n)
            )
            message = message_from_bytes(archive.read(name))
        found[canonicalize_name(message["Name"])] = message
    return found


def licence(message: Message) -> str:
    """The licence of a package as an SPDX expression; its own words where they are not known."""
    if message["License-Expression"]:
        return str(message["License-Expression"])
    stated = [
        c.rsplit(" :: ", 1)[-1] for c in message.get_all("Classifier", []) if "License ::" in c
    ]
    first = str(message["License"] or "").strip().splitlines()[:1]
    words = [w for w in (*stated, *first) if w and w != "OSI Approved"]
    known = [w if w in ALLOWED else _SPDX.get(w.lower(), w) for w in words]
    sound = [text for text in known if allowed(text)]
    return sound[-1] if sound else " / ".join(words)[:80] or "none stated"


def bill(wheels: Path) -> str:
    """The bill of materials (CycloneDX 1.6) of a folder of wheels: what glissando imports.

    The same wheels give the same text: no date, and a serial number that is made of the content.
    """
    from cyclonedx.model.bom import Bom
    from cyclonedx.model.component import Component, ComponentScope, ComponentType
    from cyclonedx.model.license import LicenseExpression
    from cyclonedx.output.json import JsonV1Dot6
    from packageurl import PackageURL

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = metadata(wheels)
    core = _closure(project["dependencies"], found)

    def component(name: str, version: str, terms: str, kind: Any, scope: Any) -> Component:
        url = PackageURL("pypi", name=name, version=version)
        told = [LicenseExpression(terms)]
        return Component(
            name=name,
            version=version,
            type=kind,
            scope=scope,
            purl=url,
            bom_ref=str(url),
            licenses=told,
        )

    library = ComponentType("library")
    parts = {
        name: component(
            name, message["Version"], licence(message), library,
            ComponentScope.REQUIRED if name in core else ComponentScope.OPTIONAL,
        )
        for name, message in found.items()
    }  # fmt: skip
    bom = Bom(components=parts.values())
    root = component("glissando", project["version"], project["license"], library, None)
    bom.metadata.component = root
    extras = project["optional-dependencies"]
    shipped = [
        line
        for name, lines in extras.items()
        if name not in ("all", "docs", "test")
        for line in lines
    ]
    bom.register_dependency(
        root, [parts[n] for n in _names([*project["dependencies"], *shipped], found)]
    )
    for name, message in found.items():
        bom.register_dependency(parts[name], [parts[n] for n in _needs(message, found)])
    document = json.loads(JsonV1Dot6(bom).output_as_string())
    del document["metadata"]["timestamp"], document["serialNumber"]
    document["metadata"].pop("tools", None)
    text = json.dumps(document, sort_keys=True)
    document["serialNumber"] = f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, text)}"
    return json.dumps(document, indent=1, sort_keys=True) + "\n"


def _names(lines: Iterable[str], found: dict[str, Any]) -> list[str]:
    """Names of the packages that are there, of lines of requirements that hold here."""
    wanted = (Requirement(line) for line in lines)
    here = (r for r in wanted if r.marker is None or r.marker.evaluate({"extra": ""}))
    return sorted({canonicalize_name(r.name) for r in here} & found.keys())


def _needs(message: Message, found: dict[str, Any]) -> list[str]:
    return _names(message.get_all("Requires-Dist", []), found)


def _closure(lines: Iterable[str], found: dict[str, Any]) -> set[str]:
    """All packages that some bring with them."""
    left, reached = _names(lines, found), set()
    while left:
        name = left.pop()
        if name not in reached:
            reached.add(name)
            left += _needs(found[name], found)
    return reached
