"""Short representations of objects that hold large arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

_FEW, _LONGEST = 6, 100  # array elements and characters up to which a value is shown whole


class ShortRepr:
    """Base class of dataclasses whose repr gives shapes of arrays and sizes of lists.

    Instances compare by identity, since a comparison of arrays has no single truth value.
    """

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.__repr__ = _brief  # type: ignore[method-assign]
        cls.__eq__ = object.__eq__  # type: ignore[method-assign]
        cls.__hash__ = object.__hash__  # type: ignore[method-assign]


def _brief(thing: Any) -> str:
    names = [f.name for f in fields(thing) if f.repr] if is_dataclass(thing) else vars(thing)
    parts = (f"{name}={_shown(getattr(thing, name))}" for name in names if name[0] != "_")
    return f"{type(thing).__name__}({', '.join(parts)})"


def _shown(value: Any) -> str:
    """Short text for a value."""
    if isinstance(value, np.ndarray):
        if value.size <= _FEW and value.ndim <= 1:
            return "[" + ", ".join(f"{v:.4g}" for v in value.ravel()) + "]"
        ends = f", {value[0]:.4g} … {value[-1]:.4g}" if value.ndim == 1 and value.size else ""
        return f"<array {value.shape}{ends}>"
    if isinstance(value, Mapping):
        return "{" + ", ".join(map(str, value)) + "}"
    if isinstance(value, list | tuple) and len(repr(value)) > _LONGEST:
        kinds = " or ".join(dict.fromkeys(type(part).__name__ for part in value))
        return f"<{len(value)} × {kinds}>"
    text = repr(value)
    return text if len(text) <= _LONGEST else f"<{type(value).__name__}>"
