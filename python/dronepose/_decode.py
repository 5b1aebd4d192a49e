"""Dataclasses from JSON."""

from __future__ import annotations

import dataclasses
import types
import typing
from functools import cache
from typing import Any, TypeVar

_T = TypeVar("_T")


@cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def decode(cls: type[_T], data: dict[str, Any], extra: dict[str, Any] | None = None) -> _T:
    """An instance of a dataclass from a JSON object; keys that it does not know are ignored."""
    values: dict[str, Any] = dict(extra or {})
    rest = dict(data)
    hints = _hints(cls)  # type: ignore[arg-type]  # a class is hashable
    flattened: str | None = None
    for f in dataclasses.fields(cls):  # type: ignore[arg-type]  # every caller passes a dataclass
        if "internal" in f.metadata:
            continue
        key = f.metadata.get("key", f.name)
        if "flatten" in f.metadata:
            flattened = f.name
        elif key in rest:
            values[f.name] = _value(hints[f.name], rest.pop(key))
    if flattened is not None:
        values[flattened] = _value(hints[flattened], rest)
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{cls.__name__}: {error}") from None


def _value(hint: Any, value: Any) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return _value(next(a for a in args if a is not type(None)), value)
    if origin is list:
        return [_value(args[0], v) for v in value]
    if origin is dict:
        return {k: _value(args[1], v) for k, v in value.items()}
    if origin is tuple:
        return tuple(value)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return decode(hint, value)
    return value
