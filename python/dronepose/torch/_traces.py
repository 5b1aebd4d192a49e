"""Traces of the masks of the last forward passes, found again by content.

A gradient needs the outline that a mask of mode ``"coverage"`` was drawn from, or the product that
a soft mask is made of. They cannot travel as an output of the operator (the size of an
outline depends on the values), so they wait here under the very numbers they were made of until the
backward pass takes them; one that is not found is made again, to the same bits. There is no lock:
the entries are one tuple that is replaced as a whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dronepose import _native

_ENTRIES = 8
_BYTES = 1 << 26
"""Memory that is kept at most, in bytes, the latest entry aside."""


class Key(NamedTuple):
    """What masks are made of: models, poses and cameras, and everything else by value."""

    models: tuple[int, ...]
    numbers: tuple[bytes, bytes, bytes]
    options: tuple[int, int, str, float, tuple[float, int] | None, float | None]


class _Entry(NamedTuple):
    key: Key
    models: list[_native.Model]
    """So that the identities in the key stay theirs."""
    traces: _native.Traces


_kept: tuple[_Entry, ...] = ()


def key_of(
    batch: tuple[
        list[_native.Model], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]
    ],
    shape: tuple[int, int],
    mode: str,
    softness: float,
    limit: tuple[float, int] | None,
    near: float | None,
) -> Key:
    """The key of masks of ``shape`` ``(H, W)``."""
    models, R, t, K = batch
    numbers = (R.tobytes(), t.tobytes(), K.tobytes())
    return Key(tuple(map(id, models)), numbers, (*shape, mode, softness, limit, near))


def keep(key: Key, models: list[_native.Model], traces: _native.Traces) -> None:
    """Keep traces, and drop the oldest where there are too many."""
    global _kept
    found, size = [_Entry(key, models, traces)], 0
    for entry in _kept[: _ENTRIES - 1]:
        size += entry.traces.nbytes
        if size > _BYTES:
            break
        if entry.key != key:
            found.append(entry)
    _kept = tuple(found)


def take(key: Key) -> _native.Traces | None:
    """The traces kept under a key, which are not kept any longer; ``None`` if there are none."""
    global _kept
    entries = _kept
    for entry in entries:
        if entry.key == key:
            _kept = tuple(e for e in entries if e is not entry)
            return entry.traces
    return None
