"""Kinds of masks and their widths, and what Kaolin and PyTorch3D call them."""

from __future__ import annotations

import math
import sys
from typing import Any, Literal, NamedTuple

Mode = Literal["coverage", "hard", "dibr", "sigmoid"]

MODES = ("coverage", "hard", "dibr", "sigmoid")

_ONE_DEVIATION = math.log(0.8413447460685429 / 0.15865525393145707)
"""``d^2 / sigma`` where a sigmoid is as low as a Gaussian edge one deviation outside."""


class Settings(NamedTuple):
    """A mode as the extension takes it."""

    mode: str
    width: float
    cutoff: tuple[float, int] | None


def settings(
    mode: str,
    sigma: float,
    delta: float,
    sigma_ndc: float,
    kaolin_cutoff: tuple[float, int | None] | None,
    pytorch3d_cutoff: tuple[float, int] | None,
) -> Settings:
    """The one width and cut-off that the mode uses; ranges are checked by the extension."""
    if mode not in MODES:
        raise ValueError(f"mode: expected 'coverage', 'hard', 'dibr' or 'sigmoid', got {mode!r}")
    if kaolin_cutoff is not None and mode != "dibr":
        raise ValueError(f"kaolin_cutoff: belongs to mode 'dibr', got mode {mode!r}")
    if pytorch3d_cutoff is not None and mode != "sigmoid":
        raise ValueError(f"pytorch3d_cutoff: belongs to mode 'sigmoid', got mode {mode!r}")
    if mode == "dibr":
        cutoff = _pair("kaolin_cutoff", "(boxlen, knum)", kaolin_cutoff, no_count=sys.maxsize)
        return Settings(mode, delta, cutoff)
    if mode == "sigmoid":
        expected = "(blur_radius, faces_per_pixel)"
        return Settings(mode, sigma_ndc, _pair("pytorch3d_cutoff", expected, pytorch3d_cutoff))
    return Settings(mode, sigma if mode == "coverage" else 0.0, None)


def _pair(
    name: str,
    expected: str,
    cutoff: tuple[float, int | None] | None,
    no_count: int | None = None,
) -> tuple[float, int] | None:
    """A length and a count, which ``no_count`` stands for where it is ``None``."""
    if cutoff is None:
        return None
    try:
        length, count = cutoff
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected {expected}, got {cutoff!r}") from None
    count = no_count if count is None else count
    if count is None or not math.isfinite(count) or int(count) != count or count < 1:
        raise ValueError(f"{name}: expected {expected} with a whole number >= 1, got {cutoff!r}")
    return float(length), int(count)


def image_size(height: int, width: int) -> tuple[int, int]:
    """The two, refused by name unless an image has so many rows and columns."""
    for name, value in (("height", height), ("width", width)):
        if not 1 <= value <= 65535:
            raise ValueError(f"{name}: expected 1 to 65535 pixels, got {value}")
    return height, width


def thread_count(name: str, threads: int) -> int:
    """The number, refused by name if it is none."""
    if threads < 0:
        raise ValueError(f"{name}: expected 0 (all cores) or more, got {threads}")
    return threads


def from_kaolin(
    sigmainv: float = 7000.0,
    *,
    boxlen: float | None = None,
    knum: float | None = None,
    height: int | None = None,
    width: int | None = None,
) -> dict[str, Any]:
    """Arguments of ``silhouette`` for the soft mask of Kaolin's ``dibr_rasterization``.

    Kaolin: ``p = exp(-sigmainv d^2)``, ``d`` in a frame where both sides of the image span
    ``[-1, 1]``, for faces whose box grown by ``boxlen`` holds the pixel, at most ``knum`` of them
    (Chen et al., "Learning to Predict 3D Objects with an Interpolation-based Differentiable
    Renderer", NeurIPS 2019).

    With ``height`` and ``width``, ``sigma`` is the blur of mode ``"coverage"`` that is as wide:
    ``exp(-sigmainv d^2)`` is a Gaussian of ``1 / sqrt(2 sigmainv)``, and a unit of ``d`` is half an
    image; of the two sides the geometric mean is taken. Use it as
    ``silhouette(..., mode="coverage", sigma=from_kaolin(7000.0, height=240, width=320)["sigma"])``.

    Args:
        sigmainv: Kaolin's inverse squared width; DronePose uses its default, 7000.
        boxlen: Kaolin's cut-off in the same frame (its default is 0.02), for parity with its
            pixels. Without ``boxlen`` and ``knum`` the mask is exact: every face counts.
        knum: Kaolin's number of faces a pixel (its default is 30), for parity; ``math.inf`` for all
            whose grown box holds it.
        height: Rows of the image, for ``sigma``.
        width: Columns of the image, for ``sigma``.

    Returns:
        ``mode``, ``delta``; ``kaolin_cutoff`` if asked for; ``sigma`` in pixels if the size is
        given.

    Raises:
        ValueError: A value is not above zero, or only one of height and width is given.

    Example:
        >>> from dronepose.render import from_kaolin
        >>> from_kaolin(7000.0, boxlen=0.02)
        {'mode': 'dibr', 'delta': 7000.0, 'kaolin_cutoff': (0.02, 30)}
        >>> round(from_kaolin(7000.0, height=240, width=320)["sigma"], 2)
        1.17
    """
    every = knum == math.inf
    _positive(sigmainv=sigmainv, boxlen=boxlen, knum=None if every else knum)
    found: dict[str, Any] = {"mode": "dibr", "delta": float(sigmainv)}
    if boxlen is not None or knum is not None:
        found["kaolin_cutoff"] = (
            0.02 if boxlen is None else float(boxlen),
            30 if knum is None else None if every else int(knum),
        )
    size = _both(height, width)
    if size is not None:
        found["sigma"] = 0.5 * math.sqrt(size[0] * size[1]) / math.sqrt(2.0 * sigmainv)
    return found


def from_pytorch3d(
    sigma: float = 1e-4,
    blur_radius: float | None = None,
    faces_per_pixel: int = 50,
    *,
    height: int | None = None,
    width: int | None = None,
) -> dict[str, Any]:
    """Arguments of ``silhouette`` for PyTorch3D's ``SoftSilhouetteShader``.

    PyTorch3D: ``p = sigmoid(-d^2 / sigma)``, ``d^2`` negative inside, in a frame where the shorter
    side of the image spans ``[-1, 1]``, for the ``faces_per_pixel`` nearest faces with
    ``d^2 < blur_radius`` (Ravi et al., "Accelerating 3D Deep Learning with PyTorch3D", 2020; the
    formula is that of Liu et al., "Soft Rasterizer", ICCV 2019).

    With ``height`` and ``width``, ``sigma`` of the result is the blur in pixels of mode
    ``"coverage"`` that is as wide: both masks of a straight edge have fallen to 0.159 at a distance
    of ``sqrt(1.668 sigma)``, which is one standard deviation.

    Args:
        sigma: ``BlendParams.sigma``, a squared width; 1e-4 is PyTorch3D's default.
        blur_radius: ``RasterizationSettings.blur_radius``, a squared length; ``None`` leaves out
            both cut-offs, and the mask is exact: every face counts.
        faces_per_pixel: ``RasterizationSettings.faces_per_pixel``, used with ``blur_radius``.
        height: Rows of the image, for ``sigma``.
        width: Columns of the image, for ``sigma``.

    Returns:
        ``mode``, ``sigma_ndc``; ``pytorch3d_cutoff`` if asked for; ``sigma`` in pixels if the size
        is given.

    Raises:
        ValueError: A value is not above zero, or only one of height and width is given.

    Example:
        >>> from dronepose.render import from_pytorch3d
        >>> from_pytorch3d(1e-4)
        {'mode': 'sigmoid', 'sigma_ndc': 0.0001}
        >>> round(from_pytorch3d(1e-4, height=240, width=320)["sigma"], 2)
        1.55
    """
    _positive(sigma=sigma, blur_radius=blur_radius, faces_per_pixel=faces_per_pixel)
    found: dict[str, Any] = {"mode": "sigmoid", "sigma_ndc": float(sigma)}
    if blur_radius is not None:
        found["pytorch3d_cutoff"] = (float(blur_radius), int(faces_per_pixel))
    size = _both(height, width)
    if size is not None:
        found["sigma"] = 0.5 * min(size) * math.sqrt(_ONE_DEVIATION * sigma)
    return found


def _positive(**values: float | None) -> None:
    for name, value in values.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name}: expected a finite number above zero, got {value}")


def _both(height: int | None, width: int | None) -> tuple[int, int] | None:
    if height is None and width is None:
        return None
    if height is None or width is None:
        raise ValueError("height, width: expected both or neither")
    return image_size(height, width)
