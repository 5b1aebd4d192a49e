"""What is seen at each pixel, and where it moves: see :func:`gbuffer` and :func:`flow`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from dronepose import _native
from dronepose._arrays import batch_of, floats, rows
from dronepose._buffers import BUFFERS
from dronepose.mesh import Mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from dronepose.camera import Camera

Channel = Literal[
    "mask",
    "depth",
    "face",
    "object",
    "barycentrics",
    "normal",
    "attributes",
    "uv",
    "coverage",
    "coverage_each",
]

_CHANNELS: tuple[str, ...] = get_args(Channel)
_NORMALS = {"flat": "flat", "smooth": "area", "smooth-angle": "angle"}
_LARGEST_SIDE = 16_384


@dataclass(frozen=True, slots=True)
class GBuffer:
    """Planes of :func:`gbuffer`, ``(..., H, W)``, with the leading axes of the poses.

    Planes that were not asked for are ``None``. ``float`` is float32 or float64, as asked for.

    Args:
        mask: bool, whether something is seen at the centre of the pixel.
        depth: float, ``z`` in the camera frame in metres, 0 where nothing is seen.
        face: int32, index of the face in its mesh, -1 where nothing is seen.
        object: int32, index of the mesh, -1 where nothing is seen.
        barycentrics: float ``(..., H, W, 3)``, weights of the corners of the face, on the surface
            (perspective-correct), above or equal 0, of sum 1; zeros where nothing is seen.
        normal: float ``(..., H, W, 3)``, unit normals in the camera frame (x right, y down, z
            forward), on the side of the camera; zeros where nothing is seen.
        attributes: float ``(..., H, W, C)``, interpolated; zeros where nothing is seen.
        uv: float ``(..., H, W, 2)``, interpolated; zeros where nothing is seen.
        coverage: float, share of the samples in the pixel, 0 to 1, that meet a surface; with the
            channel ``"coverage_each"`` ``(..., M, H, W)``, what is seen of each mesh.

    Example:
        >>> GBuffer().depth is None
        True
    """

    mask: NDArray[np.bool_] | None = None
    depth: NDArray[Any] | None = None
    face: NDArray[np.int32] | None = None
    object: NDArray[np.int32] | None = None
    barycentrics: NDArray[Any] | None = None
    normal: NDArray[Any] | None = None
    attributes: NDArray[Any] | None = None
    uv: NDArray[Any] | None = None
    coverage: NDArray[Any] | None = None


@dataclass(frozen=True, slots=True)
class Flow:
    """Optical flow from one image to another, ``(..., H, W)``, with the leading axes of the poses.

    Every pixel of the first image is exactly one of ``visible``, ``occluded``, ``outside``,
    ``behind`` and none of them (nothing is seen there, and no background is given).

    Args:
        flow: float ``(..., H, W, 2)``, the place ``(u, v)`` in the second image minus the centre
            of the pixel, in pixels; zeros where it is not ``valid``.
        visible: bool, the point is seen in the second image too.
        occluded: bool, it is inside the second image, but hidden by something nearer.
        outside: bool, it is outside the second image.
        behind: bool, it is nearer than the near plane or behind the camera.

    Example:
        >>> import numpy as np
        >>> no = np.zeros((1, 1), dtype=bool)
        >>> Flow(np.zeros((1, 1, 2)), ~no, no, no, no).valid
        array([[ True]])
    """

    flow: NDArray[Any]
    visible: NDArray[np.bool_]
    occluded: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    behind: NDArray[np.bool_]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where the flow is known: visible, occluded or outside; bool ``(..., H, W)``.

        Example:
            >>> import numpy as np
            >>> no = np.zeros((1, 1), dtype=bool)
            >>> Flow(np.zeros((1, 1, 2)), no, no, no, ~no).valid
            array([[False]])
        """
        return self.visible | self.occluded | self.outside


def _meshes(mesh: Mesh | Sequence[Mesh]) -> tuple[list[Mesh], bool]:
    """The meshes, and whether it was a sequence of them."""
    several = not isinstance(mesh, Mesh)
    meshes = [mesh] if isinstance(mesh, Mesh) else list(mesh)
    if not meshes:
        raise ValueError("mesh: expected at least one mesh")
    for k, one in enumerate(meshes):
        name = f"mesh[{k}]" if several else "mesh"
        if not isinstance(one, Mesh):
            raise TypeError(f"{name}: expected a Mesh, got {type(one).__name__}")
        if len(one.faces) == 0:
            raise ValueError(f"{name}: a mesh without faces has no surface")
    return meshes, several


def _poses(
    count: int | None, **poses: ArrayLike
) -> tuple[tuple[int, ...], list[NDArray[np.float64]]]:
    """Rotations and translations as rows, image after image; ``count`` meshes in each, or one."""
    extra = "" if count is None else f"{count}, "
    own = 0 if count is None else 1
    arrays = {}
    for name, values in poses.items():
        trailing = (2 if name.startswith("R") else 1) + own
        tail = "3, 3" if name.startswith("R") else "3"
        array = floats(name, values, f"(..., {extra}{tail})")
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite numbers")
        arrays[name] = (array, trailing)
    batch = batch_of(**arrays)
    flat = []
    for array, trailing in arrays.values():
        tail_shape = array.shape[array.ndim - trailing + own :]
        flat.append(rows(array, batch, trailing).reshape(-1, *tail_shape))
    return batch, flat


def _camera(camera: Camera, name: str) -> tuple[float, float, float, float, float, int, int]:
    for side in ("width", "height"):
        if getattr(camera, side) > _LARGEST_SIDE:
            raise ValueError(
                f"{name}: expected a {side} of at most {_LARGEST_SIDE} pixels, "
                f"got {getattr(camera, side)}"
            )
    return (
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.skew,
        camera.width,
        camera.height,
    )


def _near(near: float | None) -> float | None:
    if near is not None and not 1e-9 <= near <= 1e9:
        raise ValueError(f"near: expected 1e-9 to 1e9 m, got {near}")
    return near


def _double(dtype: DTypeLike) -> bool:
    if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ValueError(f"dtype: expected float32 or float64, got {np.dtype(dtype)}")
    return np.dtype(dtype) == np.dtype(np.float64)


def _values(
    name: str, given: Any, meshes: list[Mesh], several: bool, shape: str
) -> list[NDArray[np.float64] | None]:
    """Values of each mesh, checked; an empty list if there are none."""
    if given is None:
        return []
    each = list(given) if several else [given]
    if len(each) != len(meshes):
        raise ValueError(f"{name}: expected one array for each of {len(meshes)} meshes")
    out: list[NDArray[np.float64] | None] = []
    for k, (values, mesh) in enumerate(zip(each, meshes, strict=True)):
        label = f"{name}[{k}]" if several else name
        if values is None:
            out.append(None)
            continue
        sizes = {"V": len(mesh.vertices), "F": len(mesh.faces)}
        array = floats(label, values, shape)
        expected = sizes[shape[1]]
        if len(array) != expected:
            raise ValueError(
                f"{label}: expected shape {shape} with {expected} rows, got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"{label}: expected finite numbers")
        out.append(array)
    if len({a.shape[1] for a in out if a is not None}) > 1:
        raise ValueError(f"{name}: expected the same number of channels for every mesh")
    return out


def gbuffer(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    *,
    channels: Sequence[Channel] = ("depth", "face"),
    normals: Literal["flat", "smooth", "smooth-angle"] = "flat",
    attributes: ArrayLike | Sequence[ArrayLike | None] | None = None,
    uv: ArrayLike | Sequence[ArrayLike | None] | None = None,
    samples: int = 4,
    near: float | None = None,
    dtype: DTypeLike = np.float32,
    threads: int = 0,
) -> GBuffer:
    """What is seen at the centre of each pixel: face, depth, normal, interpolated values.

    A z-buffer in float64 over all meshes of a view. Both sides of a triangle are seen; a triangle
    holds its edges and corners, one without area holds nothing. Of meshes at the same depth the
    first is seen, and of its faces that of the lowest index. Faces are cut at the near plane. The
    memory of earlier results is used again when nothing refers to it any more.

    Args:
        mesh: One mesh, or several ``M`` that are drawn into each image together.
        camera: Intrinsics and size of the images, up to 16,384 pixels a side.
        R: Rotations of ``cam_from_model``, ``(..., 3, 3)``; for several meshes ``(..., M, 3, 3)``.
        t: Translations of ``cam_from_model`` in metres, ``(..., 3)``; for several meshes
            ``(..., M, 3)``.
        channels: Which planes to draw, see :class:`GBuffer`. ``"coverage_each"`` is the coverage
            of each mesh.
        normals: Those of the faces (``"flat"``), or interpolated ones of the vertices, which are
            the means of those of the faces around their position by area (``"smooth"``) or by
            angle (``"smooth-angle"``; Thürmer & Wüthrich, JGT 1998), turned to the side of the
            flat ones.
        attributes: Values at the vertices, ``(V, C)``; for several meshes one array each, or
            ``None`` where a mesh has none (zeros). Adds the channel ``"attributes"``.
        uv: Texture coordinates of the corners of each face, ``(F, 3, 2)``, or as ``attributes``
            for several meshes. Adds the channel ``"uv"``.
        samples: The coverage is that of ``samples x samples`` points a pixel, 1 to 16.
        near: Distance to the near plane in metres; ``None`` is 1 mm.
        dtype: float32 or float64; all is computed in float64.
        threads: Number of threads, 0 for one a core. Results do not depend on it.

    Returns:
        The planes, with the leading axes of ``R`` and ``t``.

    Raises:
        ValueError: A shape does not fit, a number is not finite or out of range, a mesh has no
            faces, a channel is unknown or lacks its values; the message starts with the argument.
        TypeError: ``mesh`` holds something else.

    Example:
        >>> import numpy as np
        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> seen = gbuffer(square, Camera(2, 2, 2, 2, 4, 4), np.eye(3), [0, 0, 2.0])
        >>> seen.face.tolist()
        [[-1, -1, -1, -1], [-1, 0, 0, -1], [-1, 1, 0, -1], [-1, -1, -1, -1]]
        >>> seen.depth[1].tolist()
        [0.0, 2.0, 2.0, 0.0]
    """
    meshes, several = _meshes(mesh)
    wanted = [channels] if isinstance(channels, str) else list(channels)
    for name in wanted:
        if name not in _CHANNELS:
            raise ValueError(f"channels: expected some of {', '.join(_CHANNELS)}, got {name!r}")
    if "coverage" in wanted and "coverage_each" in wanted:
        raise ValueError("channels: expected one of coverage and coverage_each")
    if normals not in _NORMALS:
        raise ValueError(f"normals: expected one of {', '.join(_NORMALS)}, got {normals!r}")
    if not 1 <= samples <= 16:
        raise ValueError(f"samples: expected 1 to 16 along a side, got {samples}")
    given = {
        "attributes": _values("attributes", attributes, meshes, several, "(V, C)"),
        "uv": _values("uv", uv, meshes, several, "(F, 3, 2)"),
    }
    for name, values in given.items():
        has_values = any(v is not None for v in values)
        if name in wanted and not has_values:
            raise ValueError(f"{name}: the channel needs values")
        if has_values and name not in wanted:
            wanted.append(name)  # type: ignore[arg-type]
    batch, (flat_R, flat_t) = _poses(len(meshes) if several else None, R=R, t=t)
    double = _double(dtype)
    intrinsics = _camera(camera, "camera")
    image = (len(flat_R) // len(meshes), camera.height, camera.width)
    width = next((v.shape[1] for v in given["attributes"] if v is not None), 0)
    channel_counts = {
        "barycentrics": 3,
        "normal": 3,
        "attributes": width,
        "uv": 2,
        "coverage_each": len(meshes),
    }
    kinds = {"mask": np.bool_, "object": np.int32, "face": np.int32}
    planes = {}
    for name in wanted:
        tail = (channel_counts[name],) if name in channel_counts else ()
        kind = kinds.get(name, np.float64 if double else np.float32)
        planes[str(name)] = BUFFERS.empty((*image, *tail), kind)
    _native.gbuffer(
        [m._native for m in meshes],
        intrinsics,
        flat_R,
        flat_t,
        planes,
        _NORMALS[normals],
        given["attributes"],
        given["uv"],
        samples,
        _near(near),
        double,
        threads,
    )
    shaped = {name: plane.reshape(*batch, *plane.shape[1:]) for name, plane in planes.items()}
    if "coverage_each" in shaped:
        shaped["coverage"] = np.moveaxis(shaped.pop("coverage_each"), -1, -3)
    return GBuffer(**shaped)


def flow(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R0: ArrayLike,
    t0: ArrayLike,
    R1: ArrayLike,
    t1: ArrayLike,
    *,
    camera1: Camera | None = None,
    camera_motion: tuple[ArrayLike, ArrayLike] | None = None,
    background_depth: ArrayLike = np.inf,
    tolerance: float = 1e-6,
    near: float | None = None,
    dtype: DTypeLike = np.float32,
    threads: int = 0,
) -> Flow:
    """Where the point seen at each pixel is in a second image, and whether it is seen there.

    Analytic, for rigid motion of the camera and of each mesh by itself: forward flow from image 0
    to image 1; exchange the two for backward flow. Whether something hides the point is asked at
    its very place in the second image, against every face there, not in a depth image.

    Args:
        mesh: One mesh, or several ``M`` that are drawn into each image together.
        camera: The camera of the first image, and of the second unless ``camera1`` is given.
        R0: Rotations of ``cam_from_model`` in the first image, ``(..., 3, 3)``; for several meshes
            ``(..., M, 3, 3)``.
        t0: Its translations in metres, ``(..., 3)`` or ``(..., M, 3)``.
        R1: Rotations of ``cam_from_model`` in the second image; motion of the camera is in them.
        t1: Its translations in metres.
        camera1: The camera of the second image, if it is another.
        camera_motion: ``(R, t)`` of ``cam1_from_cam0``, ``(..., 3, 3)`` and ``(..., 3)`` in
            metres: gives flow to the background, which does not move in the world. Without it,
            pixels of the background have no flow.
        background_depth: ``z`` of the background in the first camera in metres, ``(...)``, above
            0; infinite: only the turn of the camera counts.
        tolerance: A face hides a point if it is nearer by more than this share of its depth.
        near: Distance to the near plane in metres; ``None`` is 1 mm.
        dtype: Of the flow, float32 or float64; all is computed in float64.
        threads: Number of threads, 0 for one a core. Results do not depend on it.

    Returns:
        The flow and its masks, with the leading axes of the poses.

    Raises:
        ValueError: A shape does not fit, a number is not finite or out of range, or a mesh has no
            faces; the message starts with the argument.
        TypeError: ``mesh`` holds something else.

    Example:
        >>> import numpy as np
        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> camera, eye = Camera(2, 2, 2, 2, 4, 4), np.eye(3)
        >>> moved = flow(square, camera, eye, [0, 0, 2.0], eye, [1.0, 0, 2])
        >>> moved.flow[1, 1].tolist(), int(moved.visible.sum())
        ([1.0, 0.0], 4)
    """
    meshes, several = _meshes(mesh)
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance: expected 0 to below 1, got {tolerance}")
    count = len(meshes) if several else None
    batch, (first_R, first_t, second_R, second_t) = _poses(count, R0=R0, t0=t0, R1=R1, t1=t1)
    background = None
    if camera_motion is not None:
        motion_R = floats("camera_motion[0]", camera_motion[0], "(..., 3, 3)")
        motion_t = floats("camera_motion[1]", camera_motion[1], "(..., 3)")
        depth = floats("background_depth", background_depth, "(...)")
        for k, values in enumerate((motion_R, motion_t)):
            if not np.isfinite(values).all():
                raise ValueError(f"camera_motion[{k}]: expected finite numbers")
        if not (depth > 0).all():
            raise ValueError("background_depth: expected a depth above 0 m, or infinity")
        try:
            background = (rows(motion_R, batch, 2), rows(motion_t, batch, 1), rows(depth, batch, 0))
        except ValueError:
            raise ValueError(
                "camera_motion, background_depth: batch shapes do not fit that of the poses, "
                f"{batch}: {motion_R.shape}, {motion_t.shape}, {depth.shape}"
            ) from None
    vectors, fate = _native.flow(
        [m._native for m in meshes],
        (_camera(camera, "camera"), _camera(camera1 or camera, "camera1")),
        first_R,
        first_t,
        second_R,
        second_t,
        background,
        tolerance,
        _near(near),
        _double(dtype),
        threads,
    )
    fate = fate.reshape(*batch, *fate.shape[1:])
    return Flow(
        vectors.reshape(*batch, *vectors.shape[1:]), fate == 1, fate == 2, fate == 3, fate == 4
    )
