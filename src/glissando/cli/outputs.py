"""What commands write: never over what they read or what was recorded."""

from __future__ import annotations

from pathlib import Path

from glissando.errors import GlissandoError
from glissando.io.session_recording import LOG

_TOML = "recording.toml"
_DATA = ".csv", ".mcap", ".nc", ".json"


def require_spared(option: str, out: Path, *inputs: str | Path | None) -> None:
    """Make sure, before any work is done, that a file to write replaces no data.

    Args:
        option: The option that names the file, such as --out.
        out: File to write.
        inputs: Files and folders that the command reads; None where one is not given.

    Raises:
        GlissandoError: The file is one of the inputs, or data in one of them or in a recording.
    """
    if not out.exists():
        return
    real, given = out.resolve(), [Path(each).resolve() for each in inputs if each is not None]
    held = any(
        folder in given or any((folder / name).is_file() for name in (_TOML, LOG))
        for folder in (real.parent, out.parent.resolve())
    )
    if real in given or (held and (real.name == _TOML or real.suffix in _DATA)):
        raise GlissandoError(f"{option} {out} would replace data; give another name or folder.")
