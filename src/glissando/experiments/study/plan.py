"""What a study asks: settings as a TOML file names them, and a cell for every combination."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.experiments.scenes import ROBOT, Scene, bench, grid, known_robot, path, prior
from glissando.io.shipped_robots import beside, shipped_robots
from glissando.io.toml_table import read_toml
from glissando.model.table import Table
from glissando.simulation.imperfections import PARTS

Value = str | float | int | bool | None
"""A setting's value; None is left to the robot file."""

_MOST = 1_000_000  # cells


class StudyError(GlissandoError):
    """A study's file, or the folder it is to fill, is not as it should be."""


def _number(table: Table, key: str, *, positive: bool = True) -> Value:
    value = table.number(key, positive=positive)
    if value < 0.0:
        raise table.fail(key, f"is {value:g}; give a number from zero up.")
    return value


_SEEDS = 2**32  # more are no count


def _count(table: Table, key: str, default: int | None = None, *, least: int = 1) -> int:
    value = table.number(key, default, positive=False)
    if value != int(value) or not least <= value <= _SEEDS:
        raise table.fail(key, f"is {value:g}; give a whole number from {least} to {_SEEDS:,}.")
    return int(value)


_FACTOR = partial(_number, positive=False)
_SCALED = [part for part in PARTS if part not in ("roll", "gyro", "accelerometer")]  # of the coil
_NOISE = [part for part in _SCALED if part not in ("mocap", "set")]

SETTINGS: dict[str, tuple[Callable[[Table, str], Value], Value]] = {
    "robot": (Table.text, ROBOT),
    "prior": (Table.text, ""),
    "shape": (Table.text, "C"),
    "slide": (partial(Table.text, choices=("hold", "oscillate", "traverse")), "oscillate"),
    "at": (_FACTOR, 0.0),
    "stroke": (_number, None),
    "speed": (_number, None),
    "cycles": (_count, None),
    "duration": (_number, 15.0),
    "nodes": (partial(_count, least=2), None),
    "time_rate": (_number, None),
    **dict.fromkeys(("still", "paced", "dynamic"), (Table.flag, False)),
    "noise": (_FACTOR, 1.0),
    **dict.fromkeys(_SCALED, (_FACTOR, 1.0)),
}
"""What a study may set: how each is read, and its value unless given.

`robot` is simulated and `prior`, unless empty the same, a robot file estimated with. Lengths m,
times s. `noise` scales every imperfection of the coil, and those after it one part each.
"""


_MOVING = "oscillate", "traverse"
_OF_SLIDES = {"at": ("hold",), "stroke": _MOVING, "speed": _MOVING, "cycles": _MOVING}


@dataclass(frozen=True)
class Cell:
    """One combination of settings with one seed.

    Attributes:
        id: A hash of what the settings mean, files' contents included, and of the seed.
        settings: Value of every setting by its name.
        seed: Seed of robot and noise.
        scene: What the settings make.
    """

    id: str
    settings: dict[str, Value]
    seed: int
    scene: Scene


@dataclass(frozen=True)
class Study:
    """A sweep over combinations of settings.

    Attributes:
        name: What the study is called.
        axes: Values of the settings that are combined.
        fixed: Values of the settings that all cells share.
        seeds: Seeds of robot and noise, the same in every combination, which are so compared on the
            same draws.
        folder: Where robot and shape files are looked for.
    """

    name: str
    axes: dict[str, list[Value]]
    fixed: dict[str, Value]
    seeds: range
    folder: Path

    def __len__(self) -> int:
        """The number of cells."""
        return int(np.prod([len(values) for values in self.axes.values()])) * len(self.seeds)

    def cells(self) -> list[Cell]:
        """Every cell, seeds varying fastest. Raises GlissandoError for an impossible scene."""
        defaults = {name: default for name, (_, default) in SETTINGS.items()} | self.fixed
        return [
            cell
            for values in product(*self.axes.values())
            for cell in self._cells(defaults | dict(zip(self.axes, values, strict=True)))
        ]

    def _cells(self, settings: dict[str, Value]) -> Iterator[Cell]:
        scene = _scene(settings, self.folder)
        files = {key: _content(getattr(scene, key)) for key in ("robot", "prior", "shape")}
        for seed in self.seeds:
            text = json.dumps({**vars(scene), **files, "seed": seed}, sort_keys=True)
            cell = hashlib.sha256(text.encode()).hexdigest()[:16]
            yield Cell(cell, settings, seed, scene)


def load_study(file: Path) -> Study:
    """The study of a TOML file. Raises StudyError naming the key that is wrong."""
    table = read_toml(file, StudyError)
    name = table.text("name", file.stem)
    first, seeds = _count(table, "first_seed", 0, least=0), _count(table, "seeds", 1)
    fixed, axes = (
        _read(entries, read) if (entries := table.table(key)) else {}
        for key, read in (("fixed", _fixed), ("grid", _axis))
    )
    table.close()
    both = sorted(set(fixed) & set(axes))
    if both:
        raise table.fail(both[0], "is in [fixed] and in [grid]; leave one of them.")
    _require_effect(table, fixed, axes)
    study = Study(name, axes, fixed, range(first, first + seeds), file.resolve().parent)
    if len(study) > _MOST:
        raise StudyError(f"{file.name} asks for {len(study):,} cells; ask for {_MOST:,} at most.")
    return study


def _require_effect(table: Table, fixed: dict[str, Value], axes: dict[str, list[Value]]) -> None:
    """Refuse settings that change nothing, whose results would look as if they did not matter."""
    slides = axes.get("slide") or [fixed.get("slide", SETTINGS["slide"][1])]
    for key in (*fixed, *axes):
        of = _OF_SLIDES.get(key, ())
        if of and not {*of} & {*slides}:
            named = ", ".join(map(str, slides))
            raise table.fail(key, f"changes nothing with slide = {named}: leave it out.")


def _read(table: Table, read: Callable[[Table, str], Any]) -> dict[str, Any]:
    """The settings of a table; a key that is none is an error that names the one it resembles."""
    settings = {key: read(table, key) for key in table.names() if key in SETTINGS}
    for name in SETTINGS:
        table.skip(name)
    table.close()
    return settings


def _fixed(table: Table, key: str) -> Value:
    return SETTINGS[key][0](table, key)


def _axis(table: Table, key: str) -> list[Value]:
    values = table.peek(key)
    if not isinstance(values, list) or not values:
        raise table.fail(key, f"is {values!r}; give a list of values to combine.")
    axis = [_fixed(Table({key: value}, table.where, StudyError), key) for value in values]
    if len(set(axis)) < len(axis):
        raise table.fail(key, f"is {values!r}; give each value once.")
    return axis


def _scene(settings: dict[str, Value], folder: Path) -> Scene:
    """The scene of settings; raises GlissandoError for an impossible one.

    What is not given is the robot's: stroke and speed of its stage, and as many cycles as last.
    """
    given: dict[str, Any] = dict(settings)
    for key in ("robot", "prior"):
        if given[key] not in shipped_robots():
            given[key] = beside(folder, given[key])
    known = bench(given["robot"])
    if given["shape"] not in known.shapes:
        given["shape"] = beside(folder, given["shape"])
    noise = given.pop("noise")
    stage = known.full_slide if given["slide"] == "traverse" else known.slide
    given["stroke"] = given["stroke"] or stage.stroke
    given["speed"] = given["speed"] or stage.speed
    lasting = ceil(given["duration"] * given["speed"] / (2.0 * given["stroke"]))
    given["cycles"] = given["cycles"] or max(1, lasting)
    factors = []
    for part in _SCALED:
        factor = given.pop(part) * (noise if part in _NOISE else 1.0)
        if factor != 1.0:
            factors += [(field, factor) for field in PARTS[part]]
    scene = Scene(**given, flaws=tuple(factors))
    known.shape(scene.shape)
    for part_of in (path, prior, grid):  # each raises for what cannot be
        part_of(scene)
    if known_robot(scene).length != known.rod.length:
        raise StudyError(
            f"prior {settings['prior']!r} is of a robot of {known_robot(scene).length:g} m and "
            f"robot {settings['robot']!r} of {known.rod.length:g} m; give one of the same length."
        )
    return scene


def _content(name: str) -> str:
    """A digest of a file, so that a cell is another when its robot is; a name as it is."""
    file = Path(name)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else name
