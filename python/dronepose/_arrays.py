"""Array arguments: checked by name and shape here, so that the extension gets float64 rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def floats(name: str, values: ArrayLike, shape: str) -> NDArray[np.float64]:
    """A C-contiguous float64 array of the stated shape.

    ``shape`` is what the message says: ``"(V, 3)"`` has exactly these axes, ``"(..., 3, 3)"`` any
    number of leading ones; letters stand for any size.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged nesting
        raise ValueError(f"{name}: expected an array of shape {shape}: {error}") from None
    if not (np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)):
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    axes = [axis.strip() for axis in shape.strip("()").split(",") if axis.strip()]
    tail = axes[1:] if axes[0] == "..." else axes
    fits = array.ndim >= len(tail) if axes[0] == "..." else array.ndim == len(tail)
    sizes = array.shape[array.ndim - len(tail) :] if tail else ()
    if not fits or any(a.isdigit() and int(a) != n for a, n in zip(tail, sizes, strict=True)):
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    return np.asarray(array, dtype=np.float64, order="C")


def batch_of(**arrays: tuple[NDArray[np.float64], int]) -> tuple[int, ...]:
    """The common leading shape of arrays, each given with its number of trailing axes."""
    leading = {name: a.shape[: a.ndim - trailing] for name, (a, trailing) in arrays.items()}
    try:
        return np.broadcast_shapes(*leading.values())
    except ValueError:
        shapes = ", ".join(f"{name} {a.shape}" for name, (a, _) in arrays.items())
        raise ValueError(f"{', '.join(arrays)}: batch shapes do not fit: {shapes}") from None


def rows(array: NDArray[np.float64], batch: tuple[int, ...], trailing: int) -> NDArray[np.float64]:
    """The array broadcast to the batch and flattened to one leading axis."""
    tail = array.shape[array.ndim - trailing :]
    n = int(np.prod(batch, dtype=np.int64))
    return np.ascontiguousarray(np.broadcast_to(array, (*batch, *tail))).reshape(n, *tail)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The array, marked so that nobody writes to it."""
    array.flags.writeable = False
    return array
