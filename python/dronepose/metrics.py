"""Errors of 6D poses, one number for each pose; the loops are in Rust, on all cores.

A pose is ``cam_from_model``: ``p_cam = R @ p_model + t`` with ``R`` a rotation matrix and ``t`` in
metres, OpenCV camera frame (x right, y down, z forward).

Shapes: ``R`` is ``(..., 3, 3)`` and ``t`` is ``(..., 3)``, float32 or float64; the leading axes of
all arguments broadcast as in NumPy, and the result has their common shape, ``()`` for single
poses. Results are float64. An empty batch gives an empty result.

Rotations: a matrix that departs from orthonormality (largest element of ``|R R^T - I|``) by at
most 1e-2 is replaced by the nearest rotation, with a ``UserWarning`` above 1e-5, which single
precision stays below; anything else is refused with a ``ValueError`` that names argument and row.

Every function takes ``threads``: 0 uses all cores. The result does not depend on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose._arrays import batch_of, floats, rows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh

    _Array = NDArray[np.float64]
    _Poses = tuple[_Array, _Array, _Array, _Array]

__all__ = [
    "Symmetries",
    "acc",
    "add",
    "add_recall",
    "adds",
    "auc",
    "cpe",
    "mspd",
    "mssd",
    "npe",
    "orientation_error",
    "projection_error",
    "symmetric_orientation_error",
    "translation_error",
]


class Symmetries:
    """The transforms under which a model looks the same, the identity always included.

    As in the BOP challenge: discrete transforms, each combined with the steps of every continuous
    axis.

    Args:
        discrete: ``(S, 4, 4)`` or ``(S, 3, 3)`` rigid transforms ``model_from_model``, translation
            in metres. The identity may be left out.
        continuous: Pairs ``(axis, offset)`` of 3 numbers each: any turn about ``axis`` through the
            point ``offset`` (metres).
        max_step: Largest step of a continuous symmetry, as a fraction of the model's diameter that
            a point on its surface moves; BOP uses 0.01 (315 turns).

    Raises:
        ValueError: A shape is wrong, a transform is no rigid motion, or an axis is zero.

    Example:
        >>> import numpy as np
        >>> half_turn = np.diag([-1.0, -1.0, 1.0])
        >>> Symmetries(half_turn[None]).transforms.shape
        (2, 4, 4)
    """

    __slots__ = ("_native",)

    def __init__(
        self,
        discrete: ArrayLike | None = None,
        continuous: Sequence[tuple[ArrayLike, ArrayLike]] = (),
        *,
        max_step: float = 0.01,
    ) -> None:
        if discrete is None:
            m = np.empty((0, 4, 4))
        elif np.shape(discrete)[-2:] == (3, 3):
            r = floats("discrete", discrete, "(S, 3, 3)")
            m = np.tile(np.eye(4), (len(r), 1, 1))
            m[:, :3, :3] = r
        else:
            m = floats("discrete", discrete, "(S, 4, 4)")
        if m.size and not np.array_equal(m[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (len(m), 1))):
            raise ValueError("discrete: expected the last row 0 0 0 1 in every transform")
        axes = [
            np.concatenate(
                [
                    floats(f"continuous[{k}] axis", axis, "(3,)"),
                    floats(f"continuous[{k}] offset", offset, "(3,)"),
                ]
            )
            for k, (axis, offset) in enumerate(continuous)
        ]
        if not max_step > 0:
            raise ValueError(f"max_step: expected a step above zero, got {max_step}")
        self._native = _native.Symmetries(
            np.ascontiguousarray(m[:, :3, :3]),
            np.ascontiguousarray(m[:, :3, 3]),
            np.ascontiguousarray(axes).reshape(-1, 6),
            float(max_step),
        )

    @classmethod
    def from_bop(cls, info: Mapping[str, Any], *, max_step: float = 0.01) -> Symmetries:
        """From an object's entry in BOP's ``models_info.json`` (translations in millimetres).

        Args:
            info: The entry, with ``symmetries_discrete`` (16 numbers each, row by row) and
                ``symmetries_continuous`` (``axis``, ``offset``); either may be absent.
            max_step: As in the class.

        Returns:
            The symmetries in metres.

        Raises:
            ValueError: As in the class.

        Example:
            >>> axis = {"axis": [0, 0, 1], "offset": [0, 0, 0]}
            >>> len(Symmetries.from_bop({"symmetries_continuous": [axis]}))
            315
        """
        discrete = floats(
            "symmetries_discrete",
            np.reshape(info.get("symmetries_discrete", []), (-1, 4, 4)),
            "(S, 4, 4)",
        ).copy()
        discrete[:, :3, 3] *= 1e-3
        continuous = [
            (np.asarray(s["axis"]), np.asarray(s["offset"], dtype=np.float64) * 1e-3)
            for s in info.get("symmetries_continuous", [])
        ]
        return cls(discrete, continuous, max_step=max_step)

    @property
    def transforms(self) -> NDArray[np.float64]:
        """All transforms ``(S, 4, 4)`` float64 in metres, the identity first."""
        return self._native.transforms()

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"Symmetries({len(self)} transforms)"


def _symmetries(symmetries: Symmetries | ArrayLike | None) -> _native.Symmetries:
    if not isinstance(symmetries, Symmetries):
        symmetries = Symmetries(symmetries)
    return symmetries._native


def _poses(
    R_est: ArrayLike, t_est: ArrayLike, R_gt: ArrayLike, t_gt: ArrayLike
) -> tuple[_Poses, tuple[int, ...]]:
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


def _translations(
    t_est: ArrayLike, t_gt: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, ...]]:
    est, gt = floats("t_est", t_est, "(..., 3)"), floats("t_gt", t_gt, "(..., 3)")
    batch = batch_of(t_est=(est, 1), t_gt=(gt, 1))
    return rows(est, batch, 1), rows(gt, batch, 1), batch


def translation_error(
    t_est: ArrayLike, t_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Distance between the translations, ``|t_est - t_gt|``, in metres.

    Args:
        t_est: ``(..., 3)``, metres.
        t_gt: ``(..., 3)``, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, in the unit of the arguments.

    Raises:
        ValueError: A shape is wrong, or a value is not finite.

    Example:
        >>> float(translation_error([0.0, 3.0, 4.0], [0.0, 0.0, 0.0]))
        5.0
    """
    est, gt, batch = _translations(t_est, t_gt)
    return _native.translation_error(est, gt, threads).reshape(batch)


def npe(t_est: ArrayLike, t_gt: ArrayLike, *, threads: int = 0) -> NDArray[np.float64]:
    """Normalised position error, ``|t_est - t_gt| / |t_gt|``, without unit.

    DronePose, section 4; Kisantal et al., "Satellite Pose Estimation Challenge", 2020.

    Args:
        t_est: ``(..., 3)``.
        t_gt: ``(..., 3)``, in the same unit; none may be zero.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64.

    Raises:
        ValueError: A shape is wrong, a value is not finite, or a row of ``t_gt`` is zero.

    Example:
        >>> float(npe([0.0, 0.0, 2.5], [0.0, 0.0, 2.0]))
        0.25
    """
    est, gt, batch = _translations(t_est, t_gt)
    return _native.npe(est, gt, threads).reshape(batch)


def orientation_error(
    R_est: ArrayLike, R_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Angle of the rotation between estimate and ground truth, in radians.

    ``2 atan2(|v|, |w|)`` of the relative quaternion: exact near 0 and pi, where the usual arc
    cosine is off by up to 4e-8 rad in double and 5e-4 rad in single precision.

    Args:
        R_est: ``(..., 3, 3)``.
        R_gt: ``(..., 3, 3)``.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64 in ``[0, pi]``.

    Raises:
        ValueError: A shape is wrong, or a matrix is no rotation; the message names the row.

    Example:
        >>> import numpy as np
        >>> float(orientation_error(np.diag([-1.0, -1.0, 1.0]), np.eye(3))) == np.pi
        True
    """
    est, gt = floats("R_est", R_est, "(..., 3, 3)"), floats("R_gt", R_gt, "(..., 3, 3)")
    batch = batch_of(R_est=(est, 2), R_gt=(gt, 2))
    return _native.orientation_error(rows(est, batch, 2), rows(gt, batch, 2), threads).reshape(
        batch
    )


def symmetric_orientation_error(
    R_est: ArrayLike,
    R_gt: ArrayLike,
    symmetries: Symmetries | ArrayLike | None,
    *,
    threads: int = 0,
) -> NDArray[np.float64]:
    """Smallest angle between the estimate and any pose that looks like the ground truth, radians.

    ``min over S of angle(R_est, R_gt R_S)``, as in GDR-Net's evaluator.

    Args:
        R_est: ``(..., 3, 3)``.
        R_gt: ``(..., 3, 3)``.
        symmetries: :class:`Symmetries`, or its discrete transforms.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64 in ``[0, pi]``.

    Raises:
        ValueError: As :func:`orientation_error` and :class:`Symmetries`.

    Example:
        >>> import numpy as np
        >>> half_turn = np.diag([-1.0, -1.0, 1.0])
        >>> float(symmetric_orientation_error(half_turn, np.eye(3), half_turn[None]))
        0.0
    """
    est, gt = floats("R_est", R_est, "(..., 3, 3)"), floats("R_gt", R_gt, "(..., 3, 3)")
    batch = batch_of(R_est=(est, 2), R_gt=(gt, 2))
    return _native.symmetric_orientation_error(
        rows(est, batch, 2), rows(gt, batch, 2), _symmetries(symmetries), threads
    ).reshape(batch)


def cpe(
    R_est: ArrayLike, t_est: ArrayLike, R_gt: ArrayLike, t_gt: ArrayLike, *, threads: int = 0
) -> NDArray[np.float64]:
    """Combined pose error: :func:`npe` plus :func:`orientation_error` in radians.

    DronePose, section 4; its mean is the SPEED 2019 score.

    Args:
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``; none may be zero.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64.

    Raises:
        ValueError: As :func:`npe` and :func:`orientation_error`.

    Example:
        >>> import numpy as np
        >>> float(cpe(np.eye(3), [0.0, 0.0, 2.5], np.eye(3), [0.0, 0.0, 2.0]))
        0.25
    """
    (r_est, p_est, r_gt, p_gt), batch = _poses(R_est, t_est, R_gt, t_gt)
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

    Both comparisons are strict. DronePose, section 4. The mean of the result is the accuracy; a
    missing prediction has to be counted as wrong by the caller.

    Args:
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        x: Degrees and centimetres, above zero; the paper uses 2, 5 and 10.
        threads: 0 for all cores.

    Returns:
        ``(...)`` bool.

    Raises:
        ValueError: As :func:`orientation_error`, or ``x`` is not above zero.

    Example:
        >>> import numpy as np
        >>> bool(acc(np.eye(3), [0.0, 0.0, 2.04], np.eye(3), [0.0, 0.0, 2.0], x=5))
        True
    """
    if not x > 0:
        raise ValueError(f"x: expected degrees and centimetres above zero, got {x}")
    (r_est, p_est, r_gt, p_gt), batch = _poses(R_est, t_est, R_gt, t_gt)
    angle = np.degrees(_native.orientation_error(r_est, r_gt, threads))
    distance = _native.translation_error(p_est, p_gt, threads)
    # 100 * metres < x, as the authors write it: metres < x / 100 differs in the last bit.
    passes: NDArray[np.bool_] = (angle < x) & (distance * 100.0 < x)
    return passes.reshape(batch)


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

    Hinterstoisser et al., ACCV 2012; "6D Pose error" in DronePose. The mean is over all vertices
    of the mesh, as they stand in the file.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres.

    Raises:
        ValueError: A shape is wrong, a value is not finite or a matrix is no rotation.

    Example:
        >>> add(mesh, R_est, t_est, R_gt, t_gt).mean()  # doctest: +SKIP
    """
    poses, batch = _poses(R_est, t_est, R_gt, t_gt)
    return _native.add(mesh._native, *poses, threads).reshape(batch)


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

    Hinterstoisser et al., ACCV 2012, in the direction of BOP and YCB-Video: for each vertex under
    the ground truth the nearest vertex under the estimate. Exact, not sampled.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres; at most :func:`add`.

    Raises:
        ValueError: As :func:`add`.

    Example:
        >>> adds(mesh, R_est, t_est, R_gt, t_gt).mean()  # doctest: +SKIP
    """
    poses, batch = _poses(R_est, t_est, R_gt, t_gt)
    return _native.adds(mesh._native, *poses, threads).reshape(batch)


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
    """Share of the poses whose ADD is below each threshold ("6D Pose-k" in DronePose).

    Equal to ``(add(...) < threshold).mean()`` and several times faster, for most poses are decided
    by bounds without looking at the vertices.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        thresholds_m: ``(T,)`` or a number, metres; the comparison is strict. The paper's are 2, 5
            and 10 % of ``mesh.bbox_diagonal``.
        threads: 0 for all cores.

    Returns:
        ``(T,)`` (``()`` for a number) float64 in ``[0, 1]``.

    Raises:
        ValueError: As :func:`add`, or there is no pose: a share of nothing is undefined.

    Example:
        >>> k = np.array([0.02, 0.05, 0.10])
        >>> add_recall(mesh, *est, *gt, k * mesh.bbox_diagonal)  # doctest: +SKIP
    """
    thresholds = floats("thresholds_m", thresholds_m, "(...,)")
    if thresholds.ndim > 1:
        raise ValueError(f"thresholds_m: expected shape (T,), got {thresholds.shape}")
    if not np.isfinite(thresholds).all():
        raise ValueError("thresholds_m: expected finite lengths in metres")
    poses, _ = _poses(R_est, t_est, R_gt, t_gt)
    n = len(poses[0])
    if n == 0:
        raise ValueError("R_est: at least one pose is needed")
    passes = _native.add_passes(mesh._native, *poses, np.atleast_1d(thresholds), threads)
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

    ``min over S of max over p of |est p - gt S p|``: Hodan et al., "BOP Challenge 2020", ECCVW.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        symmetries: :class:`Symmetries`, or its discrete transforms; none by default.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, metres.

    Raises:
        ValueError: As :func:`add` and :class:`Symmetries`.

    Example:
        >>> mssd(mesh, R_est, t_est, R_gt, t_gt).max()  # doctest: +SKIP
    """
    poses, batch = _poses(R_est, t_est, R_gt, t_gt)
    return _native.mssd(mesh._native, *poses, _symmetries(symmetries), threads).reshape(batch)


def _projection(
    mesh: Mesh,
    poses: _Poses,
    camera: Camera,
    symmetries: _native.Symmetries,
    threads: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c = camera
    intrinsics = (c.fx, c.fy, c.cx, c.cy, c.skew, c.width, c.height)
    return _native.projection(mesh._native, *poses, symmetries, intrinsics, threads)


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

    :func:`mssd` measured in the image: Hodan et al., "BOP Challenge 2020", ECCVW.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        camera: The camera.
        symmetries: :class:`Symmetries`, or its discrete transforms; none by default.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, pixels; infinite where a vertex is at or behind the camera, for which
        no projection exists.

    Raises:
        ValueError: As :func:`mssd`.

    Example:
        >>> camera = Camera.from_fov(320, 240, horizontal_deg=64.69)  # doctest: +SKIP
        >>> mspd(mesh, R_est, t_est, R_gt, t_gt, camera).max()  # doctest: +SKIP
    """
    poses, batch = _poses(R_est, t_est, R_gt, t_gt)
    return _projection(mesh, poses, camera, _symmetries(symmetries), threads)[0].reshape(batch)


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

    Brachmann et al., CVPR 2016; a pose below 5 pixels usually counts as correct.

    Args:
        mesh: The model, metres.
        R_est: ``(..., 3, 3)``.
        t_est: ``(..., 3)``, metres.
        R_gt: ``(..., 3, 3)``.
        t_gt: ``(..., 3)``, metres.
        camera: The camera.
        threads: 0 for all cores.

    Returns:
        ``(...)`` float64, pixels; infinite where a vertex is at or behind the camera.

    Raises:
        ValueError: As :func:`add`.

    Example:
        >>> projection_error(mesh, R_est, t_est, R_gt, t_gt, camera) < 5  # doctest: +SKIP
    """
    poses, batch = _poses(R_est, t_est, R_gt, t_gt)
    return _projection(mesh, poses, camera, _symmetries(None), threads)[1].reshape(batch)


def auc(
    errors: ArrayLike,
    max_error: float = 0.1,
    *,
    n_total: int | None = None,
    method: Literal["exact", "ycb"] = "exact",
) -> float:
    """Area under the curve of recall over threshold, from 0 to ``max_error``, in ``[0, 1]``.

    Exact: the mean of ``max(0, 1 - e / max_error)``. YCB-Video's tool box (PoseCNN, RSS 2018)
    takes the right edge of each step, which adds ``d / (n max_error)`` with ``d`` the largest
    error that is at most ``max_error``; a single sample at 9 cm scores 1.0 there.

    Args:
        errors: ``(N,)`` errors, not negative, e.g. from :func:`add` in metres; infinity for a
            missing prediction.
        max_error: End of the curve, in the unit of the errors; 10 cm by custom.
        n_total: Number of ground-truth poses if some have no entry in ``errors``.
        method: ``"exact"`` or ``"ycb"``.

    Returns:
        The area divided by ``max_error``.

    Raises:
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
