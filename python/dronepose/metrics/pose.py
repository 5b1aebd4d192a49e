"""Errors of the pose itself: of its position, of its orientation, and of both."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dronepose import _native
from dronepose.metrics._arguments import poses, rotations, translations
from dronepose.metrics.symmetry import native_symmetries

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from dronepose.metrics.symmetry import Symmetries


def translation_error(
    t_est: ArrayLike, t_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Distance between the translations, ``|t_est - t_gt|``, in metres.

    The numerator of :func:`npe`; the centimetres of AccX (DronePose, section 5).

    Args:
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres (the unit of the arguments).

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong, or a value is not finite; the message names the row.

    Example:
        >>> float(translation_error([0.0, 3.0, 4.0], [0.0, 0.0, 0.0]))
        5.0
    """
    est, gt, batch = translations(t_est, t_gt)
    return _native.translation_error(est, gt, threads).reshape(batch)


def npe(t_est: ArrayLike, t_gt: ArrayLike, *, threads: int = 0) -> NDArray[np.float64]:
    """Normalised position error, ``|t_est - t_gt| / |t_gt|``, without unit.

    NPE in DronePose, section 5; defined by Kisantal et al., "Satellite Pose Estimation Challenge:
    Dataset, Competition Design, and Results", IEEE TAES 2020.

    Args:
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the same unit; none may be zero.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, without unit.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong, a value is not finite, or a row of ``t_gt`` is zero; the
            message names the row.

    Example:
        >>> float(npe([0.0, 0.0, 2.5], [0.0, 0.0, 2.0]))
        0.25
    """
    est, gt, batch = translations(t_est, t_gt)
    return _native.npe(est, gt, threads).reshape(batch)


def orientation_error(
    R_est: ArrayLike, R_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Angle of the rotation between estimate and ground truth, in radians.

    OE in DronePose, section 5, as Kisantal et al., IEEE TAES 2020, define it. Computed as
    ``2 atan2(|v|, |w|)`` of the relative quaternion: exact near 0 and pi, where the usual arc
    cosine is off by up to 4e-8 rad in double and 5e-4 rad in single precision.

    Args:
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, radians in ``[0, pi]``.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong, or a matrix is no rotation; the message names the row.

    Warns:
        UserWarning: Matrices that are nearly rotations were replaced by the nearest ones.

    Example:
        >>> import numpy as np
        >>> float(orientation_error(np.diag([-1.0, -1.0, 1.0]), np.eye(3))) == np.pi
        True
    """
    est, gt, batch = rotations(R_est, R_gt)
    return _native.orientation_error(est, gt, threads).reshape(batch)


def symmetric_orientation_error(
    R_est: ArrayLike,
    R_gt: ArrayLike,
    symmetries: Symmetries | ArrayLike | None,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Smallest angle between the estimate and any pose that looks like the ground truth, radians.

    ``min over S of angle(R_est, R_gt R_S)``, as in the evaluator of GDR-Net (Wang et al., CVPR
    2021).

    Args:
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        symmetries: :class:`Symmetries`, or its discrete transforms; ``None`` for none.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, radians in ``[0, pi]``.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: As :func:`orientation_error` and :class:`Symmetries`.

    Example:
        >>> import numpy as np
        >>> half_turn = np.diag([-1.0, -1.0, 1.0])
        >>> float(symmetric_orientation_error(half_turn, np.eye(3), half_turn[None]))
        0.0
    """
    est, gt, batch = rotations(R_est, R_gt)
    errors = _native.symmetric_orientation_error(est, gt, native_symmetries(symmetries), threads)
    return errors.reshape(batch)


def cpe(
    R_est: ArrayLike, t_est: ArrayLike, R_gt: ArrayLike, t_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Combined pose error: :func:`npe` plus :func:`orientation_error` in radians.

    CPE in DronePose, section 5; its mean is the score of the SPEED challenge (Kisantal et al., IEEE
    TAES 2020).

    Args:
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the same unit; none may be zero.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, a ratio plus radians.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: As :func:`npe` and :func:`orientation_error`.

    Example:
        >>> import numpy as np
        >>> float(cpe(np.eye(3), [0.0, 0.0, 2.5], np.eye(3), [0.0, 0.0, 2.0]))
        0.25
    """
    (r_est, p_est, r_gt, p_gt), batch = poses(R_est, t_est, R_gt, t_gt)
    errors = _native.npe(p_est, p_gt, threads) + _native.orientation_error(r_est, r_gt, threads)
    return errors.reshape(batch)


def acc(
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    x: float = 5.0,
    *,
    threads: int = 0,
) -> NDArray[np.bool_]:
    """AccX: whether each pose is closer than ``x`` degrees *and* ``x`` centimetres.

    AccX in DronePose, section 5. Both comparisons are strict. The mean of the result is the
    accuracy; a missing prediction has to be counted as wrong by the caller.

    Args:
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        x: Degrees and centimetres, above zero; the paper uses 2, 5 and 10.
        threads: 0 for all cores.

    Returns:
        ``(...)`` bool.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: As :func:`orientation_error`, or ``x`` is not above zero.

    Example:
        >>> import numpy as np
        >>> bool(acc(np.eye(3), [0.0, 0.0, 2.04], np.eye(3), [0.0, 0.0, 2.0], x=5))
        True
    """
    if not x > 0:
        raise ValueError(f"x: expected degrees and centimetres above zero, got {x}")
    (r_est, p_est, r_gt, p_gt), batch = poses(R_est, t_est, R_gt, t_gt)
    angle = np.degrees(_native.orientation_error(r_est, r_gt, threads))
    distance = _native.translation_error(p_est, p_gt, threads)
    # 100 * metres < x, as the authors write it: metres < x / 100 differs in the last bit.
    passes: NDArray[np.bool_] = (angle < x) & (distance * 100.0 < x)
    return passes.reshape(batch)
