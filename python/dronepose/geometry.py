"""Rotations in every form people store them, to and from 3 x 3 matrices.

The arithmetic is the core's, in float64: quaternions of any norm are normalised without overflow,
and what is no rotation is refused with its row rather than turned into one. A rotation has no frame
of its own: what the quaternion turns from and to, the matrix does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from dronepose import _native
from dronepose._arrays import floats

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "matrix_from_6d",
    "matrix_from_axis_angle",
    "matrix_from_quat_wxyz",
    "matrix_from_quat_xyzw",
    "quat_wxyz_from_matrix",
]


def matrix_from_quat_wxyz(quat_wxyz: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices of Hamilton quaternions, scalar first.

    Hamilton's product, ``i j = k``: Solà, "Quaternion kinematics for the error-state Kalman
    filter", 2017.

    Args:
        quat_wxyz: ``(..., 4)`` float32 or float64, ``(w, x, y, z)`` of any norm above 1e-12; ``q``
            and ``-q`` are one rotation.

    Returns:
        ``(..., 3, 3)`` float64.

    Raises:
        TypeError: The argument holds no real numbers.
        ValueError: A wrong shape, a value that is not finite, or a quaternion of zero norm; the
            message names the row.

    Example:
        >>> matrix_from_quat_wxyz([0, 0, 0, 2]).tolist()  # half a turn about z
        [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    q = floats("quat_wxyz", quat_wxyz, "(..., 4)")
    return _native.matrix_from_quat_wxyz(q.reshape(-1, 4)).reshape(*q.shape[:-1], 3, 3)


def matrix_from_quat_xyzw(quat_xyzw: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices of Hamilton quaternions, scalar last (SciPy, ROS, Unity).

    As :func:`matrix_from_quat_wxyz` but for the order.

    Args:
        quat_xyzw: ``(..., 4)`` float32 or float64, ``(x, y, z, w)`` of any norm above 1e-12.

    Returns:
        ``(..., 3, 3)`` float64.

    Raises:
        TypeError, ValueError: As :func:`matrix_from_quat_wxyz`.

    Example:
        >>> matrix_from_quat_xyzw([0, 0, 1, 0]).tolist()
        [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    q = floats("quat_xyzw", quat_xyzw, "(..., 4)")
    return _native.matrix_from_quat_xyzw(q.reshape(-1, 4)).reshape(*q.shape[:-1], 3, 3)


def matrix_from_axis_angle(axis_angle: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices of rotation vectors: Rodrigues' formula, the exponential map.

    Args:
        axis_angle: ``(..., 3)`` float32 or float64; the direction is the axis, the length the angle
            in radians, right-handed.

    Returns:
        ``(..., 3, 3)`` float64.

    Raises:
        TypeError: The argument holds no real numbers.
        ValueError: A wrong shape, or a value that is not finite; the message names the row.

    Example:
        >>> matrix_from_axis_angle([0, 0, 0]).diagonal().tolist()
        [1.0, 1.0, 1.0]
    """
    r = floats("axis_angle", axis_angle, "(..., 3)")
    return _native.matrix_from_axis_angle(r.reshape(-1, 3)).reshape(*r.shape[:-1], 3, 3)


def matrix_from_6d(
    rotation_6d: ArrayLike, layout: Literal["columns", "rows"] = "columns"
) -> NDArray[np.float64]:
    """Rotation matrices of the continuous 6D form, by Gram-Schmidt.

    Zhou et al., "On the Continuity of Rotation Representations in Neural Networks", CVPR 2019; the
    output of DronePose's rotation head.

    Args:
        rotation_6d: ``(..., 6)`` float32 or float64: two vectors of three numbers, the first keeps
            its direction.
        layout: Whether they are the first two columns of the matrix (Zhou et al., DronePose) or its
            first two rows (PyTorch3D).

    Returns:
        ``(..., 3, 3)`` float64.

    Raises:
        TypeError: The argument holds no real numbers.
        ValueError: A wrong shape or layout, a value that is not finite, or vectors that are zero
            or parallel; the message names the row.

    Example:
        >>> matrix_from_6d([2, 0, 0, 1, 1, 0]).diagonal().tolist()
        [1.0, 1.0, 1.0]
    """
    if layout not in ("columns", "rows"):
        raise ValueError(f"layout: expected 'columns' or 'rows', got {layout!r}")
    d = floats("rotation_6d", rotation_6d, "(..., 6)")
    matrices = _native.matrix_from_6d(d.reshape(-1, 6), layout == "rows")
    return matrices.reshape(*d.shape[:-1], 3, 3)


def quat_wxyz_from_matrix(R: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternions, scalar first and not negative, of rotation matrices.

    Args:
        R: ``(..., 3, 3)`` float32 or float64. A matrix that departs from orthonormality by at most
            1e-2 is replaced by the nearest rotation.

    Returns:
        ``(..., 4)`` float64, ``(w, x, y, z)`` with ``w >= 0``.

    Raises:
        TypeError: The argument holds no real numbers.
        ValueError: A wrong shape, or a matrix that is no rotation; the message names the row.

    Warns:
        UserWarning: A matrix departs from orthonormality by more than 1e-5 and was replaced.

    Example:
        >>> quat_wxyz_from_matrix([[1, 0, 0], [0, 1, 0], [0, 0, 1]]).tolist()
        [1.0, 0.0, 0.0, 0.0]
    """
    m = floats("R", R, "(..., 3, 3)")
    return _native.quat_wxyz_from_matrix(m.reshape(-1, 3, 3)).reshape(*m.shape[:-2], 4)
