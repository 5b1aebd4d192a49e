"""Distances between the vertices of the model in the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dronepose import _native
from dronepose.metrics._arguments import poses
from dronepose.metrics.symmetry import native_symmetries

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh
    from dronepose.metrics._arguments import Poses
    from dronepose.metrics.symmetry import Symmetries


def _projection(
    mesh: Mesh,
    pairs: Poses,
    camera: Camera,
    symmetries: _native.Symmetries,
    threads: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c = camera
    intrinsics = (c.fx, c.fy, c.cx, c.cy, c.skew, c.width, c.height)
    return _native.projection(mesh._native, *pairs, symmetries, intrinsics, threads)


def mspd(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    camera: Camera,
    symmetries: Symmetries | ArrayLike | None = None,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Maximum symmetry-aware projection distance, in pixels.

    :func:`dronepose.metrics.mssd` measured in the image: Hodan et al., "BOP Challenge 2020 on 6D
    Object Localization", ECCV Workshops 2020.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        camera: The camera; pixel centres are at ``+ 0.5``.
        symmetries: :class:`Symmetries`, or its discrete transforms; none by default.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, pixels; infinite where a vertex is at or behind the camera, for which
        no projection exists.

    Raises:
        TypeError, ValueError: As :func:`dronepose.metrics.mssd`.

    Example:
        At 2 m, 2 cm are a hundredth of the focal length:

        >>> import numpy as np
        >>> from dronepose import Camera, Mesh
        >>> mesh, R = Mesh([[0, 0, 0], [0.3, 0, 0]], []), np.eye(3)
        >>> camera = Camera(500, 500, 320, 240, width=640, height=480)
        >>> round(float(mspd(mesh, R, [0.02, 0.0, 2.0], R, [0.0, 0.0, 2.0], camera)), 6)
        5.0
    """
    pairs, batch = poses(R_est, t_est, R_gt, t_gt)
    return _projection(mesh, pairs, camera, native_symmetries(symmetries), threads)[0].reshape(
        batch
    )


def projection_error(
    mesh: Mesh,
    R_est: ArrayLike,
    t_est: ArrayLike,
    R_gt: ArrayLike,
    t_gt: ArrayLike,
    camera: Camera,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Mean distance of the projected vertices under the two poses, in pixels.

    Brachmann et al., "Uncertainty-Driven 6D Pose Estimation of Objects and Scenes from a Single RGB
    Image", CVPR 2016; a pose below 5 pixels usually counts as correct.

    Args:
        mesh: The model, vertices in metres in the model frame.
        R_est: ``(..., 3, 3)`` float32 or float64, estimated rotations, camera from model.
        t_est: ``(..., 3)`` float32 or float64, estimated translations in the camera frame, metres.
        R_gt: ``(..., 3, 3)`` float32 or float64, true rotations, camera from model.
        t_gt: ``(..., 3)`` float32 or float64, true translations in the camera frame, metres.
        camera: The camera; pixel centres are at ``+ 0.5``.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, pixels; infinite where a vertex is at or behind the camera.

    Raises:
        TypeError, ValueError: As :func:`dronepose.metrics.add`.

    Example:
        >>> import numpy as np
        >>> from dronepose import Camera, Mesh
        >>> mesh, R = Mesh([[0, 0, 0], [0.3, 0, 0]], []), np.eye(3)
        >>> camera = Camera(500, 500, 320, 240, width=640, height=480)
        >>> bool(projection_error(mesh, R, [0.01, 0.0, 2.0], R, [0.0, 0.0, 2.0], camera) < 5)
        True
    """
    pairs, batch = poses(R_est, t_est, R_gt, t_gt)
    return _projection(mesh, pairs, camera, native_symmetries(None), threads)[1].reshape(batch)
