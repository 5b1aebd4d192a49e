"""Prepared meshes of the last calls, found again by content.

A training loop hands over the same faces, and often the same vertices, step after step; backward
asks for what forward had. There is no lock: the entries are one tuple that is replaced as a whole,
so at worst a thread prepares what another just did.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dronepose import _native

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ENTRIES = 8
_ELEMENTS = 1 << 21
"""Vertices and faces that are kept at most, the latest entry aside; 100 to 200 bytes each."""


class _Entry(NamedTuple):
    faces: NDArray[np.integer]
    vertices: NDArray[np.float64]
    models: list[_native.Model]

    def elements(self) -> int:
        return len(self.models) * (int(self.vertices.shape[-2]) + len(self.faces))


_kept: tuple[_Entry, ...] = ()


def models(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> list[_native.Model]:
    """One model for vertices ``(V, 3)``, ``B`` of them for ``(B, V, 3)``."""
    global _kept
    kept, family = _kept, None
    for entry in kept:
        if not _same(entry.faces, faces):
            continue
        if _same(entry.vertices, vertices):
            if entry is not kept[0]:
                _kept = (entry, *(e for e in kept if e is not entry))
            return entry.models
        if family is None and entry.vertices.shape[-2] == vertices.shape[-2] and entry.models:
            family = entry.models[0]
    made = _make(vertices, faces, family)
    # Copies: the caller may write to its tensors.
    entry = _Entry(faces.copy(), vertices.copy(), made)
    _kept = _fitting((entry, *kept))
    return made


def _fitting(entries: tuple[_Entry, ...]) -> tuple[_Entry, ...]:
    """The first, and those after it that there is room for."""
    found, elements = [entries[0]], entries[0].elements()
    for entry in entries[1:_ENTRIES]:
        elements += entry.elements()
        if elements > _ELEMENTS:
            break
        found.append(entry)
    return tuple(found)


def _same(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    a, b = a.reshape(-1), b.reshape(-1)  # most differences show at the beginning
    return np.array_equal(a[:64], b[:64]) and np.array_equal(a, b)


def _make(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], family: _native.Model | None
) -> list[_native.Model]:
    found: list[_native.Model] = []
    single = vertices.ndim == 2
    for k, each in enumerate(vertices[None] if single else vertices):
        try:
            if family is None:
                family = _native.Model(each, _indices(faces, len(each)))
                found.append(family)
            else:
                found.append(family.with_vertices(each))
        except ValueError as error:
            if single:
                raise
            raise type(error)(f"mesh {k} of the batch: {error}") from None
    return found


def _indices(faces: NDArray[np.integer], count: int) -> NDArray[np.uint32]:
    """As the extension takes them; a negative one would wrap around."""
    if faces.size:
        bad = ((faces < 0) | (faces >= count)).any(axis=1)
        if bad.any():
            k = int(np.argmax(bad))
            raise _native.MeshError(
                f"faces: face {k} is {faces[k].tolist()}, expected vertices 0 to {count - 1}"
            )
    return np.ascontiguousarray(faces, dtype=np.uint32)
