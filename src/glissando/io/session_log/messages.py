"""Encoding of messages as JSON, and their schemas."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from glissando.errors import GlissandoError

NUMBER, INTEGER, TEXT = {"type": ["number", "null"]}, {"type": "integer"}, {"type": "string"}


def numbers(count: int) -> dict[str, Any]:
    """JSON schema of a list of `count` numbers."""
    return {"type": "array", "items": NUMBER, "minItems": count, "maxItems": count}


def schema(title: str, **properties: Mapping[str, Any]) -> dict[str, Any]:
    """JSON schema of a message with these properties.

    >>> schema("slide.Place", displacement=NUMBER)["properties"]["displacement"]
    {'type': ['number', 'null']}
    """
    return {"title": title, "type": "object", "properties": properties}


def encoded(topic: str, message: Mapping[str, Any]) -> bytes:
    """Encode a message of numbers, texts, lists, dicts and arrays as JSON; NaN becomes null.

    Raises:
        GlissandoError: A number is infinite, or a value has a type that JSON lacks.
    """
    try:
        try:
            text = json.dumps(message, allow_nan=False, default=_as_list)
        except ValueError:
            text = json.dumps(_without_nan(message), allow_nan=False)
    except (TypeError, ValueError) as problem:
        raise GlissandoError(
            f"A message on {topic!r} cannot be written ({problem}); give finite numbers (NaN for "
            f"none), texts, lists, dicts and arrays."
        ) from None
    return text.encode()


def _as_list(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} is not JSON")


def _without_nan(value: Any) -> Any:
    """Value of types that JSON has, with None in place of NaN."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, Mapping):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(part) for part in value]
    return value
