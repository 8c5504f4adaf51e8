"""Where every part of a continuum robot is, at every moment, and how sure.

A recording's readings and a Gaussian prior, continuous in arclength and time, become a posterior:
pose, strain and velocity with their covariance anywhere along the robot, any time.

>>> import numpy as np
>>> from glissando import CoilReadings, load_robot, estimate, uniform_grid
>>> robot = load_robot("tdcr466")
>>> grid = uniform_grid(robot.length, nodes=5, start=0.0, stop=1.0, rate=10.0)
>>> tip = np.tile(np.eye(4), (11, 1, 1))
>>> tip[:, 2, 3] = 0.466
>>> coil = CoilReadings(time=np.linspace(0, 1, 11), arclength=np.full(11, 0.466), values=tip,
...                     cov=[1e-6, 1e-6, 1e-6, 1e-4, 1e-4])
>>> posterior = estimate(robot.prior, grid, [coil])
>>> at = posterior.at(arclength=[0.233, 0.466], time=0.5)
>>> bool(at.std_position[1] < at.std_position[0])  # surest where the coil is
True
"""

import ast as _ast
from importlib import import_module as _import_module
from pathlib import Path as _Path
from typing import Any as _Any

__version__ = "0.1.0"

_STUB = _ast.parse(_Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_MODULES = {
    name.name: str(statement.module)
    for statement in _STUB.body
    if isinstance(statement, _ast.ImportFrom)
    for name in statement.names
}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> _Any:
    """The name from the module that `__init__.pyi` imports it from, which is imported now."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _import_module(_MODULES[name])
    if not hasattr(module, name):
        _import_module(f"{_MODULES[name]}.{name}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    return __all__
