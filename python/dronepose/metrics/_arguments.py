"""Pose arguments: checked by name, broadcast and flattened to rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dronepose._arrays import batch_of, floats, rows

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]
    Poses = tuple[Array, Array, Array, Array]


def poses(
    R_est: ArrayLike, t_est: ArrayLike, R_gt: ArrayLike, t_gt: ArrayLike
) -> tuple[Poses, tuple[int, ...]]:
    """The four arguments as rows, and the batch shape."""
    arrays = {
        "R_est": (floats("R_est", R_est, "(..., 3, 3)"), 2),
        "t_est": (floats("t_est", t_est, "(..., 3)"), 1),
        "R_gt": (floats("R_gt", R_gt, "(..., 3, 3)"), 2),
        "t_gt": (floats("t_gt", t_gt, "(..., 3)"), 1),
    }
    batch = batch_of(**arrays)
    r_est, p_est, r_gt, p_gt = (rows(a, batch, trailing) for a, trailing in arrays.values())
    return (r_est, p_est, r_gt, p_gt), batch


def rotations(R_est: ArrayLike, R_gt: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """The two arguments as rows, and the batch shape."""
    est, gt = floats("R_est", R_est, "(..., 3, 3)"), floats("R_gt", R_gt, "(..., 3, 3)")
    batch = batch_of(R_est=(est, 2), R_gt=(gt, 2))
    return rows(est, batch, 2), rows(gt, batch, 2), batch


def translations(t_est: ArrayLike, t_gt: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """The two arguments as rows, and the batch shape."""
    est, gt = floats("t_est", t_est, "(..., 3)"), floats("t_gt", t_gt, "(..., 3)")
    batch = batch_of(t_est=(est, 1), t_gt=(gt, 1))
    return rows(est, batch, 1), rows(gt, batch, 1), batch
