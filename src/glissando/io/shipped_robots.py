"""The files of the robots that come with the package."""

from __future__ import annotations

import os
from pathlib import Path

from glissando.errors import RobotFileError

_SHIPPED = Path(__file__).parent / "robots"


def shipped_robots() -> list[str]:
    """Names of the robots that come with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def beside(folder: Path, name: str) -> str:
    """The file of this name in a folder, else the name: of a shipped robot, or a path."""
    return str(folder / name) if name and os.path.isfile(folder / name) else name


def robot_file(name: str | Path) -> Path:
    """The file of a shipped robot by name, or of any robot by path.

    Raises:
        RobotFileError: There is none.
    """
    if str(name) in shipped_robots():
        return _SHIPPED / f"{name}.toml"
    path = Path(name)
    if not os.path.exists(path):
        raise RobotFileError(
            f"There is no robot named {str(name)!r} and no such file; give a TOML file or one of "
            f"{', '.join(shipped_robots())}."
        )
    return path
