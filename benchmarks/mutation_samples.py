"""Parser under test, and sample files for it."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mutation_kinds import (
    mutated_file,
    pick,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))


_LONGEST = 60  # time nodes: longer damaged recordings are not estimated
ROWS = 60  # rows kept of each stream, to save time
Files = dict[str, bytes]


def damaged(rng, files: Files) -> Files:
    """Files with a random one damaged by the method for its suffix."""
    name = pick(rng, sorted(files))
    return {**files, name: mutated_file(rng, name, files[name])}


@dataclass(frozen=True)
class Parser:
    """A parser under test with its samples.

    Attributes:
        name: Name of the format.
        samples: Valid files by name, or one entry "line" with bytes of a connection.
        read: Function that reads files from a folder as a command does, and may write to another.
        mutate: Function that damages files.
        share: Number of mutations relative to other parsers; less for slow parsers.
    """

    name: str
    samples: list[Files]
    read: Callable[[Files, Path, Path], object]
    mutate: Callable[[np.random.Generator, Files], Files] = damaged
    share: float = 1.0


def files_below(folder: Path) -> Files:
    """Contents of all files below a folder, by relative path."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def shortened(source: Path) -> Files:
    """Files of a recording with the first ROWS rows of each stream."""
    out = {}
    for name, data in files_below(source).items():
        if name.endswith(".csv"):
            data = b"\n".join(data.splitlines()[: ROWS + 2]) + b"\n"
        if name.endswith((".csv", ".toml")):
            out[name] = data
    return out
