"""Scores over many errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from dronepose._arrays import floats

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def auc(
    errors: ArrayLike,
    max_error: float = 0.1,
    *,
    n_total: int | None = None,
    method: Literal["exact", "ycb"] = "exact",
) -> float:
    """Area under the curve of recall over threshold, from 0 to ``max_error``, in ``[0, 1]``.

    Xiang et al., "PoseCNN", RSS 2018. Exact: the mean of ``max(0, 1 - e / max_error)``. The tool
    box of their YCB-Video data set takes the right edge of each step, which adds
    ``d / (n max_error)`` with ``d`` the largest error that is at most ``max_error``; a single
    sample at 9 cm scores 1.0 there.

    Args:
        errors: ``(N,)`` float32 or float64, not negative, e.g. from
            :func:`dronepose.metrics.add` in metres; infinity for a missing prediction.
        max_error: End of the curve, in the unit of the errors; 10 cm by custom.
        n_total: Number of ground-truth poses if some have no entry in ``errors``.
        method: ``"exact"`` or ``"ycb"``.

    Returns:
        The area divided by ``max_error``, without unit.

    Raises:
        TypeError: ``errors`` holds no real numbers.
        ValueError: There is no error, one is NaN or negative, ``n_total`` is less than their
            number, ``max_error`` is not above zero, or the method is unknown.

    Example:
        >>> round(auc([0.0, 0.05, 0.2]), 6)
        0.5
    """
    e = floats("errors", errors, "(N,)")
    n = len(e) if n_total is None else n_total
    if n < max(len(e), 1):
        raise ValueError(
            f"n_total: expected at least {max(len(e), 1)} poses for {len(e)} errors, got {n}"
        )
    if not (np.isfinite(max_error) and max_error > 0):
        raise ValueError(f"max_error: expected a finite length above zero, got {max_error}")
    if np.isnan(e).any() or (e < 0).any():
        row = int(np.argmax(np.isnan(e) | (e < 0)))
        raise ValueError(f"errors[{row}]: expected a distance >= 0, got {e[row]}")
    if method not in ("exact", "ycb"):
        raise ValueError(f"method: expected 'exact' or 'ycb', got {method!r}")
    inside = e[e <= max_error]
    area = float(np.sum(1.0 - inside / max_error)) / n
    if method == "ycb" and inside.size:
        area += float(inside.max()) / (max_error * n)
    return area
