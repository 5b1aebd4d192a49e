"""Silhouettes of a mesh under poses and their gradients, depth, normals and flow, in NumPy.

A point of the model is in the camera at ``p_cam = R @ p_model + t`` (OpenCV axes, metres) and in
the image at ``u = (fx x + skew y)/z + cx``, ``v = fy y/z + cy``. Pixel ``(row i, column j)`` covers
``[j, j + 1) x [i, i + 1)``. Triangles are cut at the near plane, so nothing behind the camera is
drawn; both sides of a triangle count, and meshes may be open.

Four kinds of silhouettes (``mode``):

``"coverage"``
    The area of the union of the projected triangles inside the pixel, exactly, then a Gaussian of
    ``sigma`` pixels. Depends on the silhouette only: neither on the order, the winding nor the
    number of its triangles. The gradient is that of the area as the outline moves (Reynolds'
    transport theorem), blurred alike.
``"hard"``
    1 where the centre of the pixel is inside a triangle, 0 elsewhere. Its gradient is zero.
``"dibr"``
    ``1 - prod_f (1 - exp(-delta d_f^2))`` over all faces outside the silhouette, 1 inside, with the
    distance ``d_f`` in Kaolin's NDC (both sides of the image span ``[-1, 1]``): Chen et al.,
    NeurIPS 2019.
``"sigmoid"``
    ``1 - prod_f (1 - sigmoid(-d_f |d_f| / sigma_ndc))``, ``d_f`` negative inside, in PyTorch3D's
    NDC (the shorter side spans ``[-1, 1]``): Liu et al., ICCV 2019.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose import _native
from dronepose._appearance import (
    Colours,
    Environment,
    Light,
    Material,
    Texture,
    colour,
    srgb_bytes,
    srgb_linear,
)
from dronepose._arrays import floats
from dronepose._buffers import BUFFERS
from dronepose._gbuffer import Flow, GBuffer, flow, gbuffer
from dronepose._softness import (
    from_kaolin,
    from_pytorch3d,
    image_size,
    settings,
    thread_count,
)
from dronepose.camera import Camera
from dronepose.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from dronepose._softness import Mode, Settings

    Array = NDArray[np.float64]
    Mask = NDArray[np.float32] | NDArray[np.float64]

__all__ = [
    "Colours",
    "Environment",
    "Flow",
    "GBuffer",
    "Light",
    "Material",
    "SilhouetteGradients",
    "Texture",
    "colour",
    "flow",
    "from_kaolin",
    "from_pytorch3d",
    "gbuffer",
    "silhouette",
    "silhouette_gradients",
    "silhouette_vjp",
    "srgb_bytes",
    "srgb_linear",
    "tangent",
]


@dataclass(frozen=True, slots=True)
class SilhouetteGradients:
    """Derivatives of ``sum(upstream * silhouette(...))``.

    Attributes:
        R: ``(B, 3, 3)`` float64, ``R`` taken as a free matrix; see :func:`tangent`.
        t: ``(B, 3)`` float64, for each metre.
        K: ``(B, 3, 3)`` float64, for ``fx, skew, cx, fy, cy``, for each pixel; 0 elsewhere.
        vertices: ``(V, 3)`` float64, for each metre in the model frame, summed over the batch; for
            a sequence of meshes one such array each; ``None`` if not asked for.
    """

    R: Array
    t: Array
    K: Array
    vertices: Array | list[Array] | None


def silhouette(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    *,
    mode: Mode = "coverage",
    sigma: float = 0.0,
    delta: float = 7000.0,
    sigma_ndc: float = 1e-4,
    near: float | None = None,
    kaolin_cutoff: tuple[float, int | None] | None = None,
    pytorch3d_cutoff: tuple[float, int] | None = None,
    dtype: DTypeLike | None = None,
    out: Mask | None = None,
    threads: int = 0,
) -> Mask:
    """Masks of a mesh under many poses; see the module for what each mode draws.

    Computed in float64 whatever ``dtype``, but for modes ``"dibr"`` and ``"sigmoid"`` with float32,
    which are right to about 2e-5; the same to the bit for any number of threads. The memory of
    earlier results is used again when nothing refers to it any more.

    Args:
        mesh: One mesh, or a sequence of ``B``, one for each pose.
        camera: Intrinsics and size of the images.
        R: ``(B, 3, 3)`` float32 or float64, rotations of ``cam_from_model``. Used as they are: any
            finite matrix is drawn.
        t: ``(B, 3)`` float32 or float64, translations of ``cam_from_model``, metres.
        mode: ``"coverage"``, ``"hard"``, ``"dibr"`` or ``"sigmoid"``.
        sigma: Blur of mode ``"coverage"``, standard deviation in pixels, 0 to 1000.
        delta: Inverse squared width of mode ``"dibr"``, NDC; above zero.
        sigma_ndc: Squared width of mode ``"sigmoid"``, NDC; above zero.
        near: Distance of the near plane in metres, above zero; ``None`` is 1 mm.
        kaolin_cutoff: ``(boxlen, knum)`` of Kaolin, for parity with its pixels in mode ``"dibr"``;
            all faces whose box holds a pixel count where ``knum`` is ``None``; ``None`` is exact.
            See :func:`from_kaolin`.
        pytorch3d_cutoff: ``(blur_radius, faces_per_pixel)`` of PyTorch3D, for parity in mode
            ``"sigmoid"``; ``None`` is exact. See :func:`from_pytorch3d`.
        dtype: float32 (the default) or float64.
        out: Written to and returned, ``(B, H, W)``, C-contiguous.
        threads: 0 for all cores.

    Returns:
        ``(B, H, W)``, in ``[0, 1]``; 0 where nothing is in front of the near plane.

    Raises:
        TypeError: ``mesh`` is no mesh, ``camera`` no camera, or an argument holds no real numbers.
        ValueError: A shape or dtype is wrong, a value is not finite or out of its range, or a mesh
            has no faces; the message starts with the name.

    Example:
        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> camera = Camera(4, 4, 2, 2, width=8, height=6)
        >>> masks = silhouette(square, camera, [np.eye(3)], [[0, 0, 2]])
        >>> float(masks.sum())  # 4 px / m, at 2 m: the square is 2 x 2 pixels
        4.0
    """
    chosen = settings(mode, sigma, delta, sigma_ndc, kaolin_cutoff, pytorch3d_cutoff)
    batch = _batch(mesh, camera, R, t)
    shape = (len(batch[1]), *image_size(camera.height, camera.width))
    out = BUFFERS.empty(shape, _dtype(dtype)) if out is None else _writable(out, shape, dtype)
    _native.silhouette(*batch, *chosen, near, thread_count("threads", threads), out, False)
    return out


def silhouette_gradients(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    upstream: ArrayLike,
    *,
    mode: Mode = "coverage",
    sigma: float = 0.0,
    delta: float = 7000.0,
    sigma_ndc: float = 1e-4,
    near: float | None = None,
    kaolin_cutoff: tuple[float, int | None] | None = None,
    pytorch3d_cutoff: tuple[float, int] | None = None,
    vertices: bool = True,
    threads: int = 0,
) -> SilhouetteGradients:
    """Gradients of ``sum(upstream * silhouette(mesh, camera, R, t, ...))``.

    What torch would call the backward pass: ``upstream`` is the gradient of a loss for the masks.
    Outlines are found again; :func:`silhouette_vjp` keeps them.
    Sums are added in a fixed order: the same bits for any number of threads.

    Args:
        mesh: As in :func:`silhouette`, and so are all arguments without a text here.
        camera: Intrinsics and size of the images.
        R: ``(B, 3, 3)`` float32 or float64.
        t: ``(B, 3)`` float32 or float64, metres.
        upstream: ``(B, H, W)`` float32 or float64, derivative of a number for each pixel.
        mode: ``"hard"`` has a gradient of zero everywhere.
        sigma: Blur of mode ``"coverage"``, pixels.
        delta: Inverse squared width of mode ``"dibr"``, NDC.
        sigma_ndc: Squared width of mode ``"sigmoid"``, NDC.
        near: Distance of the near plane in metres; ``None`` is 1 mm.
        kaolin_cutoff: ``(boxlen, knum)`` of mode ``"dibr"``. Which faces they leave out counts as
            constant, as in Kaolin.
        pytorch3d_cutoff: ``(blur_radius, faces_per_pixel)`` of mode ``"sigmoid"``, alike.
        vertices: Whether the gradient for the vertices is computed too.
        threads: 0 for all cores.

    Returns:
        The gradients.

    Raises:
        TypeError: As in :func:`silhouette`.
        ValueError: As in :func:`silhouette`, or ``upstream`` is not ``(B, H, W)``.

    Example:
        A square of 1 m, 2 m away, seen through a focal length of 4 px, has ``(4 / z)^2`` pixels:
        a sideways motion changes nothing, one along z changes ``-32 / z^3``.

        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> camera = Camera(4, 4, 2, 2, width=8, height=6)
        >>> gradients = silhouette_gradients(
        ...     square, camera, [np.eye(3)], [[0, 0, 2]], np.ones((1, 6, 8))
        ... )
        >>> (gradients.t + 0.0).round(9).tolist()
        [[0.0, 0.0, -4.0]]
    """
    chosen = settings(mode, sigma, delta, sigma_ndc, kaolin_cutoff, pytorch3d_cutoff)
    drawn = _Drawn(
        _batch(mesh, camera, R, t),
        chosen,
        near,
        thread_count("threads", threads),
        image_size(camera.height, camera.width),
        isinstance(mesh, Mesh),
    )
    return drawn.gradients(upstream, vertices, None)


def silhouette_vjp(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    *,
    mode: Mode = "coverage",
    sigma: float = 0.0,
    delta: float = 7000.0,
    sigma_ndc: float = 1e-4,
    near: float | None = None,
    kaolin_cutoff: tuple[float, int | None] | None = None,
    pytorch3d_cutoff: tuple[float, int] | None = None,
    dtype: DTypeLike | None = None,
    threads: int = 0,
) -> tuple[Mask, Callable[..., SilhouetteGradients]]:
    """Masks, and the function that carries a gradient for them back.

    What :func:`silhouette` and :func:`silhouette_gradients` return, to the same bits, for little
    more than the first of them: mode ``"coverage"`` keeps the outlines, some 40 kB an image of
    320 x 240 for a drone of 5,000 faces, as long as the function is referred to.

    Args:
        mesh: As in :func:`silhouette`, and so are all arguments without a text here.
        camera: Intrinsics and size of the images.
        R: ``(B, 3, 3)`` float32 or float64.
        t: ``(B, 3)`` float32 or float64, metres.
        mode: Modes other than ``"coverage"`` are drawn again for the gradient.
        sigma: Blur of mode ``"coverage"``, pixels.
        delta: Inverse squared width of mode ``"dibr"``, NDC.
        sigma_ndc: Squared width of mode ``"sigmoid"``, NDC.
        near: Distance of the near plane in metres; ``None`` is 1 mm.
        kaolin_cutoff: ``(boxlen, knum)`` of mode ``"dibr"``.
        pytorch3d_cutoff: ``(blur_radius, faces_per_pixel)`` of mode ``"sigmoid"``.
        dtype: float32 (the default) or float64.
        threads: 0 for all cores.

    Returns:
        The masks ``(B, H, W)``, and ``pull_back(upstream, *, vertices=True)``, which returns
        :class:`SilhouetteGradients` of ``sum(upstream * masks)`` and may be called many times.

    Raises:
        TypeError: As in :func:`silhouette`.
        ValueError: As in :func:`silhouette`; by ``pull_back``, if ``upstream`` is not
            ``(B, H, W)``.

    Example:
        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> camera = Camera(4, 4, 2, 2, width=8, height=6)
        >>> masks, pull_back = silhouette_vjp(square, camera, [np.eye(3)], [[0, 0, 2]])
        >>> float(masks.sum()), (pull_back(np.ones((1, 6, 8))).t + 0.0).round(9).tolist()
        (4.0, [[0.0, 0.0, -4.0]])
    """
    chosen = settings(mode, sigma, delta, sigma_ndc, kaolin_cutoff, pytorch3d_cutoff)
    models, rotations, translations, cameras = _batch(mesh, camera, R, t)
    drawn = _Drawn(
        (models, rotations.copy(), translations.copy(), cameras),
        chosen,
        near,
        thread_count("threads", threads),
        image_size(camera.height, camera.width),
        isinstance(mesh, Mesh),
    )
    out = BUFFERS.empty(drawn.shape, _dtype(dtype))
    traces = _native.silhouette(*drawn.batch, *chosen, near, drawn.threads, out, True)

    def pull_back(upstream: ArrayLike, *, vertices: bool = True) -> SilhouetteGradients:
        return drawn.gradients(upstream, vertices, traces)

    return out, pull_back


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A batch of masks, for its gradients."""

    batch: tuple[list[_native.Model], Array, Array, Array]
    chosen: Settings
    near: float | None
    threads: int
    size: tuple[int, int]
    single: bool

    @property
    def shape(self) -> tuple[int, int, int]:
        return (len(self.batch[1]), *self.size)

    def gradients(
        self, upstream: ArrayLike, vertices: bool, traces: _native.Traces | None
    ) -> SilhouetteGradients:
        given = np.asarray(upstream)
        if given.dtype != np.float32:
            given = floats("upstream", given, "(B, H, W)")
        if given.shape != self.shape:
            raise ValueError(f"upstream: expected shape {self.shape}, got {given.shape}")
        found = _native.silhouette_gradients(
            *self.batch,
            *self.chosen,
            self.near,
            self.threads,
            np.ascontiguousarray(given),
            vertices,
            traces,
        )
        of_vertices: Array | list[Array] | None = found[3]
        if not vertices:
            of_vertices = None
        elif self.single:
            of_vertices = found[3][0]
        return SilhouetteGradients(found[0], found[1], found[2], of_vertices)


def tangent(grad_R: ArrayLike, R: ArrayLike) -> NDArray[np.float64]:
    """The gradient for a small turn: ``dL/dw`` at ``w = 0`` of ``R <- exp([w]x) R``.

    ``w`` is a vector in the camera frame, radians: ``dL/dw = vee(M - M^T)`` with
    ``M = dL/dR R^T`` (Sola et al., "A micro Lie theory", 2018, section IV.B).

    Args:
        grad_R: ``(..., 3, 3)`` gradient for ``R`` as a free matrix.
        R: ``(..., 3, 3)`` the rotations.

    Returns:
        ``(..., 3)`` float64, for each radian.

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong.

    Example:
        >>> tangent([[0, -1, 0], [1, 0, 0], [0, 0, 0]], np.eye(3)).tolist()
        [0.0, 0.0, 2.0]
    """
    rotation = floats("R", R, "(..., 3, 3)")
    m = floats("grad_R", grad_R, "(..., 3, 3)") @ np.swapaxes(rotation, -1, -2)
    m = m - np.swapaxes(m, -1, -2)
    return np.stack([m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]], axis=-1)


def _batch(
    mesh: Mesh | Sequence[Mesh], camera: Camera, R: ArrayLike, t: ArrayLike
) -> tuple[list[_native.Model], Array, Array, Array]:
    """Models, rotations, translations and the one camera matrix."""
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a dronepose.Camera, got {type(camera).__name__}")
    rotations, translations = floats("R", R, "(B, 3, 3)"), floats("t", t, "(B, 3)")
    if len(rotations) != len(translations):
        raise ValueError(
            f"t: expected {len(rotations)} translations as there are rotations, "
            f"got shape {translations.shape}"
        )
    meshes = [mesh] if isinstance(mesh, Mesh) else mesh
    if not isinstance(meshes, Sequence):
        raise TypeError(f"mesh: expected a dronepose.Mesh or a sequence, got {type(mesh).__name__}")
    for each in meshes:
        if not isinstance(each, Mesh):
            raise TypeError(f"mesh: expected a dronepose.Mesh, got {type(each).__name__}")
    if not isinstance(mesh, Mesh) and len(meshes) != len(rotations):
        raise ValueError(f"mesh: expected one for each of {len(rotations)} poses, got {len(mesh)}")
    # One mesh many times is prepared once.
    return [each._native.model() for each in meshes], rotations, translations, camera.K[None]


def _dtype(dtype: DTypeLike | None) -> np.dtype[Any]:
    kind = np.dtype(np.float32 if dtype is None else dtype)
    if kind not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ValueError(f"dtype: expected float32 or float64, got {kind}")
    return kind


def _writable(out: Mask, shape: tuple[int, ...], dtype: DTypeLike | None) -> Mask:
    if not isinstance(out, np.ndarray):
        raise TypeError(f"out: expected an array, got {type(out).__name__}")
    expected = _dtype(out.dtype if dtype is None else dtype)
    if out.shape != shape or out.dtype != expected:
        raise ValueError(
            f"out: expected shape {shape} of {expected}, got {out.shape} of {out.dtype}"
        )
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise ValueError("out: expected a C-contiguous array that can be written to")
    return out
