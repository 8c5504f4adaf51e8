"""Plan of a study: settings from a TOML file, and a cell for every combination and seed."""

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
"""Value of a setting; None to take that of the robot file."""

_MOST = 1_000_000  # most cells of a study


class StudyError(GlissandoError):
    """A study's file is invalid, or its folder holds other results."""


def _number(table: Table, key: str, *, positive: bool = True) -> Value:
    value = table.number(key, positive=positive)
    if value < 0.0:
        raise table.fail(key, f"is {value:g}; give a number from zero up.")
    return value


_SEEDS = 2**32  # largest count


def _count(table: Table, key: str, default: int | None = None, *, least: int = 1) -> int:
    value = table.number(key, default, positive=False)
    if value != int(value) or not least <= value <= _SEEDS:
        raise table.fail(key, f"is {value:g}; give a whole number from {least} to {_SEEDS:,}.")
    return int(value)


_FACTOR = partial(_number, positive=False)
_SCALED = [part for part in PARTS if part not in ("roll", "gyro", "accelerometer")]
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
"""Settings of a study: function that reads each, and its default.

`robot` is simulated; `prior` is the robot file for the estimate, empty for `robot`. Lengths are in
m, times in s. `noise` scales all imperfections of the coil; the settings after it scale one part.
"""


_MOVING = "oscillate", "traverse"
_OF_SLIDES = {"at": ("hold",), "stroke": _MOVING, "speed": _MOVING, "cycles": _MOVING}


@dataclass(frozen=True)
class Cell:
    """One combination of settings with one seed.

    Attributes:
        id: Hash of the scene, the content of its files, and the seed.
        settings: Values of all settings by name.
        seed: Seed of robot and noise.
        scene: Scene of these settings.
    """

    id: str
    settings: dict[str, Value]
    seed: int
    scene: Scene


@dataclass(frozen=True)
class Study:
    """A sweep over combinations of settings.

    Attributes:
        name: Name of the study.
        axes: Values of the settings that are combined, by name.
        fixed: Values of the settings that all cells share, by name.
        seeds: Seeds of robot and noise, the same for all combinations, so that these are compared
            on the same draws.
        folder: Folder in which robot and shape files are searched.
    """

    name: str
    axes: dict[str, list[Value]]
    fixed: dict[str, Value]
    seeds: range
    folder: Path

    def __len__(self) -> int:
        """Number of cells."""
        return int(np.prod([len(values) for values in self.axes.values()])) * len(self.seeds)

    def cells(self) -> list[Cell]:
        """All cells, seeds varying fastest. Raises GlissandoError for an impossible scene."""
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
    """Read the study of a TOML file. Raises StudyError naming the key that is wrong."""
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
    """Raise StudyError for settings that have no effect with the slides of the study."""
    slides = axes.get("slide") or [fixed.get("slide", SETTINGS["slide"][1])]
    for key in (*fixed, *axes):
        of = _OF_SLIDES.get(key, ())
        if of and not {*of} & {*slides}:
            named = ", ".join(map(str, slides))
            raise table.fail(key, f"changes nothing with slide = {named}: leave it out.")


def _read(table: Table, read: Callable[[Table, str], Any]) -> dict[str, Any]:
    """Read the settings of a table; for an unknown key, raise an error that names a similar one."""
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
    """Scene of settings. Raises GlissandoError for an impossible one.

    By default, stroke and speed are those of the robot's stage, and cycles last for the duration.
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
    for part_of in (path, prior, grid):  # each raises for an impossible scene
        part_of(scene)
    if known_robot(scene).length != known.rod.length:
        raise StudyError(
            f"prior {settings['prior']!r} is of a robot of {known_robot(scene).length:g} m and "
            f"robot {settings['robot']!r} of {known.rod.length:g} m; give one of the same length."
        )
    return scene


def _content(name: str) -> str:
    """SHA-256 of a file's content, so that an id depends on it; a name of no file unchanged."""
    file = Path(name)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else name
