"""Distances between the vertices of the model under two poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dronepose import _native
from dronepose._arrays import floats
from dronepose.metrics._arguments import poses
from dronepose.metrics.symmetry import native_symmetries

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from dronepose.mesh import Mesh
    from dronepose.metrics.symmetry import Symmetries


def add(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Average distance of the model's vertices under the two poses, in metres.

    ADD of Hinterstoisser et al., "Model Based Training, Detection and Pose Estimation of
    Texture-Less 3D Objects in Heavily Cluttered Scenes", ACCV 2012; "6D Pose error" in DronePose,
    section 5. The mean is over all vertices of the mesh, as they stand in the file.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong, a value is not finite or a matrix is no rotation; the message
            names the row.

    Warns:
        UserWarning: Matrices that are nearly rotations were replaced by the nearest ones.

    Example:
        Half a turn moves the vertices by 0, 0.6 and 0.8 m:

        >>> import numpy as np
        >>> from dronepose import Mesh
        >>> mesh = Mesh([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0]], [[0, 1, 2]])
        >>> t = [0.0, 0.0, 2.0]
        >>> round(float(add(mesh, np.diag([-1.0, -1.0, 1.0]), t, np.eye(3), t)), 6)
        0.466667
    """
    pairs, batch = poses(R_est, t_est, R_gt, t_gt)
    return _native.add(mesh._native, *pairs, threads).reshape(batch)


def adds(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """ADD-S (ADI): average distance from a vertex in the true pose to the nearest estimated one.

    Hinterstoisser et al., ACCV 2012, in the direction of BOP (Hodan et al., "BOP: Benchmark for 6D
    Object Pose Estimation", ECCV 2018) and YCB-Video (Xiang et al., "PoseCNN", RSS 2018): for each
    vertex under the ground truth the nearest vertex under the estimate. Exact, not sampled.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres; at most :func:`add`.

    Raises:
        TypeError, ValueError: As :func:`add`.

    Example:
        A square looks the same after half a turn:

        >>> import numpy as np
        >>> from dronepose import Mesh
        >>> square = Mesh([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], [])
        >>> t = [0.0, 0.0, 9.0]
        >>> round(float(adds(square, np.diag([-1.0, -1.0, 1.0]), t, np.eye(3), t)), 9)
        0.0
    """
    pairs, batch = poses(R_est, t_est, R_gt, t_gt)
    return _native.adds(mesh._native, *pairs, threads).reshape(batch)


def add_recall(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    thresholds_m: ArrayLike,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Share of the poses whose ADD is below each threshold.

    "6D Pose-k" in DronePose, section 5, which takes k percent of the diagonal of the model. Equal
    to ``(add(...) < threshold).mean()`` and several times faster, for most poses are decided by
    bounds without looking at the vertices.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        thresholds_m: ``(T,)`` float32 or float64, or a number, metres; the comparison is strict.
            The paper's are 2, 5 and 10 % of ``mesh.bbox_diagonal``.
        threads: 0 for all cores.

    Returns:
        ``(T,)`` (``()`` for a number) float64 in ``[0, 1]``.

    Raises:
        TypeError: As :func:`add`.
        ValueError: As :func:`add`, a threshold is not finite, or there is no pose: a share of
            nothing is undefined.

    Example:
        >>> import numpy as np
        >>> from dronepose import Mesh
        >>> mesh = Mesh.from_file("examples/quadrotor.obj")
        >>> R, t = np.eye(3), np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 4.0]])
        >>> off = [[0.0, 0.02, 0.0], [0.0, 0.0, 0.2]]
        >>> k = np.array([0.02, 0.05, 0.10])
        >>> add_recall(mesh, R, t + off, R, t, k * mesh.bbox_diagonal).tolist()
        [0.0, 0.5, 0.5]
    """
    thresholds = floats("thresholds_m", thresholds_m, "(...,)")
    if thresholds.ndim > 1:
        raise ValueError(f"thresholds_m: expected shape (T,), got {thresholds.shape}")
    if not np.isfinite(thresholds).all():
        raise ValueError("thresholds_m: expected finite lengths in metres")
    pairs, _ = poses(R_est, t_est, R_gt, t_gt)
    n = len(pairs[0])
    if n == 0:
        raise ValueError("R_est: at least one pose is needed")
    passes = _native.add_passes(mesh._native, *pairs, np.atleast_1d(thresholds), threads)
    return (passes / n).reshape(thresholds.shape)


def mssd(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    symmetries: Symmetries | ArrayLike | None = None,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Maximum symmetry-aware surface distance, in metres.

    ``min over S of max over p of |est p - gt S p|``: Hodan et al., "BOP Challenge 2020 on 6D Object
    Localization", ECCV Workshops 2020.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        symmetries: :class:`Symmetries`, or its discrete transforms; none by default.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres.

    Raises:
        TypeError, ValueError: As :func:`add` and :class:`Symmetries`.

    Example:
        >>> import numpy as np
        >>> from dronepose import Mesh
        >>> square = Mesh([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], [])
        >>> half_turn, t = np.diag([-1.0, -1.0, 1.0]), [0.0, 0.0, 9.0]
        >>> round(float(mssd(square, half_turn, t, np.eye(3), t)), 6)
        2.828427
        >>> round(float(mssd(square, half_turn, t, np.eye(3), t, half_turn[None])), 9)
        0.0
    """
    pairs, batch = poses(R_est, t_est, R_gt, t_gt)
    return _native.mssd(mesh._native, *pairs, native_symmetries(symmetries), threads).reshape(batch)
