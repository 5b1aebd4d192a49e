"""Settings on their way to Rust, as JSON."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

_DIRECTIONS = {
    "f": (1, 0, 0),
    "b": (-1, 0, 0),
    "l": (0, 1, 0),
    "r": (0, -1, 0),
    "u": (0, 0, 1),
    "d": (0, 0, -1),
}


def encode(settings: dict[str, Any]) -> str:
    """JSON of settings.

    Args:
        settings: Names and values.

    Raises:
        TypeError: A value is no number, text, list or table of these.
        ValueError: A number is not finite; the message starts with its name.
    """
    for name, value in settings.items():
        numbers = value.values() if isinstance(value, dict) else np.ravel(value)
        for number in numbers:
            if isinstance(number, float | np.floating) and not math.isfinite(number):
                raise ValueError(f"{name}: expected finite numbers, got {value}")
    return json.dumps(settings, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"expected numbers and text, got {type(value).__name__}")


def chosen(name: str, value: str, among: Collection[str]) -> str:
    """``value``, if it is one of ``among``.

    Raises:
        ValueError: It is none of them.
    """
    if value not in among:
        words = ", ".join(repr(word) for word in among)
        raise ValueError(f"{name}: expected one of {words}, got {value!r}")
    return value


def axes(name: str, text: str) -> str:
    """``text`` in lower case, if it is three letters of which way the axes of a body point.

    Raises:
        ValueError: It is not three different axes of forward, back, left, right, up, down.
    """
    found = text.lower()
    pairs = ("fb", "lr", "ud")
    if len(found) != 3 or any(sum(found.count(letter) for letter in pair) != 1 for pair in pairs):
        raise ValueError(
            f"{name}: expected which way x, y and z point, as three letters of f b l r u d, such "
            f"as flu (forward, left, up) or frd, got {text!r}"
        )
    return found


def flu_from_axes(letters: str) -> NDArray[np.float64]:
    """What takes a body whose axes point as the letters say to forward, left, up; ``(3, 3)``.

    Args:
        letters: As :func:`axes` gives them.

    Example:
        >>> (flu_from_axes("luf") @ [1, 0, 0]).tolist()
        [0.0, 1.0, 0.0]
    """
    return np.array([_DIRECTIONS[letter] for letter in letters], dtype=np.float64).T


def vector(name: str, value: Any) -> list[float]:
    """Three finite numbers.

    Raises:
        ValueError: There are not three, or one is not finite.
    """
    found: NDArray[np.float64] = np.asarray(value, dtype=np.float64)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"{name}: expected three finite numbers, got {value!r}")
    return [float(x) for x in found]


def points(name: str, value: Any) -> NDArray[np.float64]:
    """Points as ``(N, 3)``, contiguous.

    Raises:
        ValueError: The shape is another, or a number is not finite; the message names the row.
    """
    found = np.ascontiguousarray(value, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3:
        raise ValueError(f"{name}: expected shape (N, 3), got {found.shape}")
    bad = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}]: not finite")
    return found
