"""What surfaces look like: see :func:`colour`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose._buffers import BUFFERS
from dronepose._gbuffer import _camera, _meshes, _near, _poses, _values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh


class Texture:
    """An image on a surface, prepared for drawing: halved again and again, in linear light.

    Coordinates go from the lower left corner, ``(0, 0)``, to the upper right one, ``(1, 1)``, as in
    OBJ and COLLADA files (glTF counts ``v`` from the top), and repeat.

    Args:
        image: ``(H, W, 3)`` uint8, sRGB, the upper row first; or ``(H, W, 4)``, the last is
            opacity, 255 hides what is behind. Colours are not multiplied by it.

    Raises:
        ValueError: Another shape or dtype, or a side above 16384.

    Example:
        >>> import numpy as np
        >>> Texture(np.zeros((2, 4, 3), np.uint8)).size
        (2, 4)
    """

    def __init__(self, image: NDArray[np.uint8]) -> None:
        array = np.asarray(image)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] not in (3, 4):
            raise ValueError(
                f"image: expected uint8 of shape (H, W, 3 or 4), got {array.dtype} of {array.shape}"
            )
        self._native = _native.Texture(np.ascontiguousarray(array))
        self._opacity = array[..., 3].copy() if array.shape[2] == 4 else None

    @property
    def opacity(self) -> NDArray[np.uint8] | None:
        """``(H, W)``, 255 hides what is behind; ``None`` if all of it does.

        Example:
            >>> Texture(np.zeros((2, 4, 3), np.uint8)).opacity is None
            True
        """
        return self._opacity

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns.

        Example:
            >>> Texture(np.zeros((2, 4, 3), np.uint8)).size
            (2, 4)
        """
        return self._native.size

    @property
    def mean(self) -> tuple[float, float, float]:
        """Mean of linear RGB over the image.

        Example:
            >>> Texture(np.full((2, 4, 3), 255, np.uint8)).mean
            (1.0, 1.0, 1.0)
        """
        red, green, blue = self._native.mean
        return red, green, blue


class Environment:
    """Light from all sides: a panorama in equal steps of longitude and latitude.

    The upper row is the zenith, ``+z`` of the world. The middle column looks along ``+x``, the left
    half to ``+y``. It is blurred once, by the cosine and by the GGX lobes of several roughnesses
    (split sum; Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course).

    Args:
        radiance: ``(H, W, 3)``, linear, at least 0.
        threads: Number of threads, 0 for one a core. Results do not depend on it.

    Raises:
        ValueError: Another shape, or a value that is negative or not finite.

    Example:
        >>> import numpy as np
        >>> Environment(np.full((16, 32, 3), 0.5)).mean
        (0.5, 0.5, 0.5)
    """

    def __init__(self, radiance: ArrayLike, *, threads: int = 0) -> None:
        array = np.ascontiguousarray(radiance, dtype=np.float32)
        if array.ndim != 3 or array.shape[2] != 3:
            raise ValueError(f"radiance: expected shape (H, W, 3), got {array.shape}")
        self._native = _native.Environment(array, threads)

    @property
    def mean(self) -> tuple[float, float, float]:
        """Mean radiance over the sphere, RGB.

        Example:
            >>> Environment(np.full((16, 32, 3), 0.5)).mean
            (0.5, 0.5, 0.5)
        """
        red, green, blue = self._native.mean
        return red, green, blue


@dataclass(frozen=True, slots=True)
class Material:
    """What faces are made of.

    Args:
        colour: Linear RGB, at least 0, or a :class:`Texture`.
        lit: Whether the light of the image falls on it; else the colour is what is seen, as in a
            scan, which holds the light of its day.
        roughness: 0 for a mirror to 1; GGX with the square of it.
        metallic: 0 for plastics and paints, 1 for metals.

    Example:
        >>> Material((0.5, 0.5, 0.5)).lit
        True
    """

    colour: tuple[float, float, float] | Texture
    lit: bool = True
    roughness: float = 0.5
    metallic: float = 0.0


@dataclass(frozen=True, slots=True)
class Light:
    """Light on what is lit in an image.

    Args:
        environment: The panorama.
        strength: Factor of its radiance, at least 0.
        world_from_camera: ``(3, 3)`` rotation from the camera frame to that of the panorama; the
            identity would have the camera look at the zenith.

    Example:
        >>> Light(Environment([[[1, 1, 1]]]), strength=0.5).strength
        0.5
    """

    environment: Environment
    strength: float = 1.0
    world_from_camera: ArrayLike = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, slots=True)
class Colours:
    """Planes of :func:`colour`, float32, with the leading axes of the poses.

    Over a background ``b``: ``rgb + (1 - share + veil)[..., None] * b``; bytes by
    :func:`srgb_bytes`.

    Args:
        rgb: ``(..., H, W, 3)``, linear, times the covered share of the pixel and the opacity there.
        share: ``(..., H, W)``, that share, 0 to 1.
        shares: ``(..., M, H, W)``, the share in which each mesh is seen: anti-aliased mattes.
        veil: ``(..., H, W)``, the share that shows what is behind the nearest surface, by textures
            with opacity; what that is, a second image says without those faces.

    Example:
        >>> import numpy as np
        >>> pixel = np.zeros((1, 1))
        >>> Colours(np.zeros((1, 1, 3)), pixel, pixel[None], pixel).rgb.shape
        (1, 1, 3)
    """

    rgb: NDArray[np.float32]
    share: NDArray[np.float32]
    shares: NDArray[np.float32]
    veil: NDArray[np.float32]


def _made(material: Material) -> tuple[Any, list[float], tuple[float, float] | None]:
    lit = (material.roughness, material.metallic) if material.lit else None
    if isinstance(material.colour, Texture):
        return material.colour._native, [0.0, 0.0, 0.0], lit
    red, green, blue = (float(c) for c in material.colour)
    return None, [red, green, blue], lit


def colour(
    mesh: Mesh | Sequence[Mesh],
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    *,
    materials: Material | Sequence[Material] | Sequence[Sequence[Material]],
    material_of_face: ArrayLike | Sequence[ArrayLike | None] | None = None,
    uv: ArrayLike | Sequence[ArrayLike | None] | None = None,
    lights: Light | Sequence[Light] | None = None,
    normals: Literal["flat", "smooth-angle"] = "smooth-angle",
    samples: int = 4,
    near: float | None = None,
    threads: int = 0,
) -> Colours:
    """Colours of surfaces, anti-aliased, in linear light.

    What is seen is found at ``samples x samples`` points a pixel. Each face in a pixel is shaded
    once, at the mean of its points, with textures filtered over the footprint of the pixel
    (trilinear, up to four times longer than wide). All meshes share a z-buffer.

    Args:
        mesh: One mesh, or several ``M`` that are drawn into each image together.
        camera: Intrinsics and size of the images.
        R: Rotations of ``cam_from_model``, ``(..., 3, 3)``; for several meshes ``(..., M, 3, 3)``.
        t: Translations in metres, ``(..., 3)``; for several meshes ``(..., M, 3)``.
        materials: One for all faces, or a list; for several meshes a list for each.
        material_of_face: Index of the material of each face, ``(F,)``; for several meshes one array
            each, or ``None`` where the first material is that of all faces.
        uv: Texture coordinates of the corners of each face, ``(F, 3, 2)``; for several meshes one
            array each, or ``None`` where a mesh has none.
        lights: One for all images, or one for each; needed where a material is lit.
        normals: Of lit meshes: those of the faces, or interpolated ones of the vertices, which are
            means over the faces around their position by angle (Thürmer & Wüthrich, JGT 1998).
        samples: Points along a side of a pixel, 1 to 8.
        near: Distance to the near plane in metres; ``None`` is 1 mm.
        threads: Number of threads, 0 for one a core. Results do not depend on it.

    Returns:
        The planes, with the leading axes of ``R`` and ``t``.

    Raises:
        ValueError: A shape does not fit, a number is not finite or out of range, a material or
            light is missing; the message starts with the argument.
        TypeError: ``mesh`` holds something else.

    Example:
        >>> import numpy as np
        >>> from dronepose import Camera, Mesh
        >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> red = Material((1.0, 0.0, 0.0), lit=False)
        >>> camera = Camera(2, 2, 2, 2, 4, 4)
        >>> seen = colour(square, camera, np.eye(3), [0, 0, 2.0], materials=red)
        >>> seen.rgb[1, 1].tolist(), seen.share[1, 1].item(), seen.share[0, 0].item()
        ([1.0, 0.0, 0.0], 1.0, 0.0)
    """
    meshes, several = _meshes(mesh)
    if normals not in ("flat", "smooth-angle"):
        raise ValueError(f"normals: expected flat or smooth-angle, got {normals!r}")
    if not 1 <= samples <= 8:
        raise ValueError(f"samples: expected 1 to 8 along a side, got {samples}")
    lists: list[Any] = list(materials) if several else [materials]  # type: ignore[arg-type]
    if len(lists) != len(meshes):
        raise ValueError(f"materials: expected one list for each of {len(meshes)} meshes")
    made = [[_made(m) for m in ([x] if isinstance(x, Material) else x)] for x in lists]
    corners = _values("uv", uv, meshes, several, "(F, 3, 2)") or [None] * len(meshes)
    of_faces = _indices(material_of_face, meshes, several)
    batch, (flat_R, flat_t) = _poses(len(meshes) if several else None, R=R, t=t)
    images = len(flat_R) // len(meshes)
    every = [] if lights is None else [lights] * images if isinstance(lights, Light) else lights
    given = []
    for k, light in enumerate(every):
        turn = np.asarray(light.world_from_camera, dtype=np.float64)
        if turn.shape != (3, 3) or not np.isfinite(turn).all():
            raise ValueError(f"lights[{k}]: world_from_camera: expected a finite (3, 3) matrix")
        given.append((light.environment._native, float(light.strength), turn.ravel().tolist()))
    size = (images, camera.height, camera.width)
    out = BUFFERS.empty((*size, 4), np.float32)
    shares = BUFFERS.empty((*size, len(meshes)), np.float32)
    veil = BUFFERS.empty(size, np.float32)
    _native.colours(
        [m._native for m in meshes],
        _camera(camera, "camera"),
        flat_R,
        flat_t,
        corners,
        made,
        of_faces,
        given,
        normals != "flat",
        samples,
        _near(near),
        threads,
        out,
        shares,
        veil,
    )
    shaped = out.reshape(*batch, *out.shape[1:])
    each = np.moveaxis(shares.reshape(*batch, *shares.shape[1:]), -1, -3)
    return Colours(shaped[..., :3], shaped[..., 3], each, veil.reshape(*batch, *veil.shape[1:]))


def _indices(given: Any, meshes: list[Mesh], several: bool) -> list[NDArray[np.uint32] | None]:
    if given is None:
        return [None] * len(meshes)
    each = list(given) if several else [given]
    if len(each) != len(meshes):
        raise ValueError(f"material_of_face: expected one array for each of {len(meshes)} meshes")
    out: list[NDArray[np.uint32] | None] = []
    for k, values in enumerate(each):
        name = f"material_of_face[{k}]" if several else "material_of_face"
        if values is None:
            out.append(None)
            continue
        array = np.asarray(values)
        if array.dtype.kind not in "iu" or array.ndim != 1 or (array.size and array.min() < 0):
            raise ValueError(f"{name}: expected shape (F,) of indices, got {array.dtype}")
        out.append(np.ascontiguousarray(array, dtype=np.uint32))
    return out


def srgb_linear(encoded: ArrayLike) -> NDArray[np.float32]:
    """Linear light of sRGB bytes (IEC 61966-2-1).

    Args:
        encoded: uint8 of any shape.

    Returns:
        float32 of the same shape, 0 to 1.

    Raises:
        ValueError: ``encoded`` is not uint8.

    Example:
        >>> srgb_linear(np.array([0, 188, 255], np.uint8)).round(3).tolist()
        [0.0, 0.503000020980835, 1.0]
    """
    array = np.ascontiguousarray(encoded)
    if array.dtype != np.uint8:
        raise ValueError(f"encoded: expected uint8, got {array.dtype}")
    return _native.srgb_linear(array.ravel()).reshape(array.shape)


def srgb_bytes(linear: ArrayLike) -> NDArray[np.uint8]:
    """Linear light as sRGB bytes (IEC 61966-2-1), the nearest ones.

    Args:
        linear: Of any shape; clamped to 0 to 1, NaN is 0.

    Returns:
        uint8 of the same shape.

    Raises:
        ValueError: ``linear`` holds no numbers.

    Example:
        >>> srgb_bytes([0.0, 0.5, 1.0]).tolist()
        [0, 188, 255]
    """
    array = np.ascontiguousarray(linear, dtype=np.float32)
    return _native.srgb_bytes(array.ravel()).reshape(array.shape)
