"""Files of the robots that come with the package."""

from __future__ import annotations

import os
from pathlib import Path

from glissando.errors import RobotFileError

_SHIPPED = Path(__file__).parent / "robots"


def shipped_robots() -> list[str]:
    """Names of the robots that come with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def beside(folder: Path, name: str) -> str:
    """Path of a file of this name in a folder if it exists, else the name unchanged."""
    return str(folder / name) if name and os.path.isfile(folder / name) else name


def robot_file(name: str | Path) -> Path:
    """Path of the robot file of a shipped robot, given by name, or of any robot, given by path.

    Raises:
        RobotFileError: There is neither such a robot nor such a file.
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
