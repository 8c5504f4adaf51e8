"""A parser to try, and samples of files for it."""

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


_LONGEST = 60  # time nodes of a damaged recording that is estimated
ROWS = 60  # of each stream that are kept: damage does not need many
Files = dict[str, bytes]


def damaged(rng, files: Files) -> Files:
    """The files, one of them damaged as its kind may be."""
    name = pick(rng, sorted(files))
    return {**files, name: mutated_file(rng, name, files[name])}


@dataclass(frozen=True)
class Parser:
    """A reader, and what it reads.

    Attributes:
        name: What it reads.
        samples: Sound files by name, or one entry of bytes that come over a line.
        read: Reads them from a folder as a command does, and may write into another.
        mutate: Damages them.
        share: Of the mutations that other parsers get; less where reading is dear.
    """

    name: str
    samples: list[Files]
    read: Callable[[Files, Path, Path], object]
    mutate: Callable[[np.random.Generator, Files], Files] = damaged
    share: float = 1.0


def files_below(folder: Path) -> Files:
    """Every file below a folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def shortened(source: Path) -> Files:
    """A recording with the first rows of each stream."""
    out = {}
    for name, data in files_below(source).items():
        if name.endswith(".csv"):
            data = b"\n".join(data.splitlines()[: ROWS + 2]) + b"\n"
        if name.endswith((".csv", ".toml")):
            out[name] = data
    return out
