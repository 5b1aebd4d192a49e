"""Memory for images that is used again.

A fresh batch of 64 x 240 x 320 float32 costs more in page faults than drawing into it, so memory of
arrays that nobody refers to any more is kept, up to a limit, and handed out again.

There is no lock: every step is one operation that Python makes atomic. So nothing waits here, be it
in a thread, in a forked child or in a finalizer that the garbage collector runs in the middle of
:meth:`Buffers.empty`.
"""

from __future__ import annotations

import math
import os
import weakref
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

_SMALLEST = 1 << 18
"""Bytes below which the allocator does as well."""

_LIMIT = 1 << 28
"""Bytes that are kept while nobody uses them."""


class _Owner:
    """What all views of one array refer to: it goes when the last of them has gone.

    An array would not do, for views refer past it to what holds its memory, and nor would a
    memoryview; at an object that is neither, with the array interface (version 3), they stop.
    """

    __slots__ = ("__array_interface__", "__weakref__")

    def __init__(
        self, memory: NDArray[np.uint8], shape: tuple[int, ...], kind: np.dtype[Any]
    ) -> None:
        data = memory.__array_interface__["data"]
        self.__array_interface__ = {
            "shape": shape,
            "typestr": kind.str,
            "data": data,
            "version": 3,
        }


class Buffers:
    """Arrays whose memory comes back when the last view of it is gone.

    Args:
        limit: Bytes that are kept at most while they are not in use.
    """

    def __init__(self, limit: int = _LIMIT) -> None:
        self._limit = limit
        self._free: dict[int, NDArray[np.uint8]] = {}

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A C-contiguous array with arbitrary content, as :func:`numpy.empty`."""
        kind = np.dtype(dtype)
        size = math.prod(shape) * kind.itemsize
        if not _SMALLEST <= size <= self._limit:
            return np.empty(shape, kind)
        memory = self._take(size)
        owner = _Owner(memory, shape, kind)
        weakref.finalize(owner, self._give_back, memory).atexit = False
        return np.asarray(owner)

    def kept(self) -> int:
        """Bytes that are kept and not in use."""
        return sum(memory.nbytes for memory in self._free.copy().values())

    def clear(self) -> None:
        """Let go of what is not in use."""
        self._free = {}

    def _take(self, size: int) -> NDArray[np.uint8]:
        for key, memory in reversed(self._free.copy().items()):  # the latest may be in the cache
            if size <= memory.nbytes <= 2 * size:
                mine = self._free.pop(key, None)
                if mine is not None:
                    return mine
        return np.empty(size, np.uint8)

    def _give_back(self, memory: NDArray[np.uint8]) -> None:
        free = self._free
        free[id(memory)] = memory
        while sum(m.nbytes for m in free.copy().values()) > self._limit:
            oldest = next(iter(free.copy()), None)
            if oldest is None:
                return
            free.pop(oldest, None)


BUFFERS = Buffers()
"""The buffers of this process."""

if hasattr(os, "register_at_fork"):
    # A child's first write to inherited memory would copy every page of it.
    os.register_at_fork(after_in_child=BUFFERS.clear)
