"""Augmentation that keeps image, mask, camera and pose consistent.

A homography ``A`` that takes pixels of the image to pixels of the augmented one is allowed only
where a pinhole camera and a rigid pose explain the result exactly:

- scale, crop and shift: ``A`` is affine along the axes and ``K' = A K``; the pose stays;
- a turn of the image by ``phi`` about its principal point is what a camera that turns about its
  optical axis sees: ``R' = Rz(phi) R``, ``t' = Rz(phi) t``, and ``A = K Rz(phi) K^-1``, which is
  exact for any focal lengths, also where ``fx`` is not ``fy``.

There is **no mirror image**. A flip of the image is what a camera sees of the mirrored drone:
``diag(-1, 1, 1) R`` has determinant -1 and is no rotation. A real drone is not its own mirror image
(propellers turn, labels, an antenna on one side), and where it nearly is, a flipped image with a
"corrected" pose teaches the network that two different poses look the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    from dronepose.data.sample import Raw

    Array = NDArray[np.float64]

_TRIES = 10
_BORDERS = {"reflect": cv2.BORDER_REFLECT_101, "black": cv2.BORDER_CONSTANT}


@dataclass(frozen=True, slots=True)
class GeometricAugmentation:
    """Random turn about the optical axis, scale and shift; see the module.

    The size of the image stays. Where more than ``1 - keep`` of the drone's visible area would
    leave the image, another draw is made, ten at most; then the sample stays as it is.

    Args:
        rotation_deg: Largest turn about the optical axis either way, degrees, 0 to 180.
        scale: Smallest and largest factor of the focal length; above 1 is a crop.
        shift: Largest shift along each side either way, as a share of the side, 0 to 1.
        keep: Share of the drone's area, as it was seen, that has to stay in the image, 0 to 1. A
            sample without a mask keeps its projected origin instead.
        border: What is outside the image: ``"reflect"`` or ``"black"``. The mask is 0 there, so
            reflect only where the drone rarely touches the border.
        probability: With which a sample is changed at all, 0 to 1.

    Raises:
        ValueError: A value is out of its range; the message starts with its name.

    Example:
        >>> from dronepose.data import Raw
        >>> augment = GeometricAugmentation(rotation_deg=15)
        >>> K = np.array([[4.0, 0, 3], [0, 4, 2], [0, 0, 1]])
        >>> raw = Raw(np.zeros((4, 6, 3), np.uint8), None, K, np.eye(3), np.array([0, 0, 1.0]), "a")
        >>> augment(raw, np.random.default_rng(0)).size
        (4, 6)
    """

    rotation_deg: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    shift: float = 0.0
    keep: float = 0.8
    border: str = "black"
    probability: float = 1.0

    def __post_init__(self) -> None:
        ranges = {"rotation_deg": 180, "shift": 1, "keep": 1, "probability": 1}
        for name, most in ranges.items():
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected 0 to {most}, got {getattr(self, name)}")
        least, largest = self.scale
        if not 0 < least <= largest < 100:
            raise ValueError(f"scale: expected 0 < smallest <= largest < 100, got {self.scale}")
        if self.border not in _BORDERS:
            raise ValueError(f"border: expected one of {', '.join(_BORDERS)}, got {self.border!r}")

    def __call__(self, raw: Raw, generator: np.random.Generator) -> Raw:
        """The sample changed at random.

        Args:
            raw: The sample.
            generator: Where all randomness comes from.

        Returns:
            A new sample of the same size and name.

        Example:
            See the class.
        """
        if generator.random() >= self.probability:
            return raw
        for _ in range(_TRIES):
            changed = self._draw(raw, generator)
            if changed is not None:
                return changed
        return raw

    def _draw(self, raw: Raw, generator: np.random.Generator) -> Raw | None:
        angle = np.radians(generator.uniform(-1, 1) * self.rotation_deg)
        factor = float(np.exp(generator.uniform(*np.log(self.scale))))
        height, width = raw.size
        shift = generator.uniform(-1, 1, 2) * self.shift * np.array([width, height])
        turned = rotated(raw, float(angle), pixels=False)
        cx, cy = width / 2, height / 2
        A = np.array(
            [
                [factor, 0, (1 - factor) * cx + shift[0]],
                [0, factor, (1 - factor) * cy + shift[1]],
                [0, 0, 1],
            ]
        )
        full = A @ _turn_of_image(raw.K, float(angle))
        if not self._keeps(raw, full, factor):
            return None
        return replace(
            _warped(raw, full, _BORDERS[self.border]), K=A @ turned.K, R=turned.R, t=turned.t
        )

    def _keeps(self, raw: Raw, A: Array, factor: float) -> bool:
        height, width = raw.size
        if raw.mask is None or not raw.mask.any():
            place = A @ (raw.K @ (raw.t / raw.t[2]))
            return bool(0 <= place[0] < width and 0 <= place[1] < height)
        before = float(raw.mask.sum(dtype=np.float64)) * factor**2
        after = float(_warp(raw.mask, A, cv2.BORDER_CONSTANT).sum(dtype=np.float64))
        return after >= self.keep * before


def rotated(raw: Raw, angle: float, *, pixels: bool = True) -> Raw:
    """The sample as a camera turned about its optical axis sees it.

    Args:
        raw: The sample.
        angle: Radians; positive turns the content of the image from x (right) to y (down),
            clockwise to the eye.
        pixels: Whether image and mask are turned too.

    Returns:
        The sample with ``R' = Rz R``, ``t' = Rz t`` and the same ``K``.

    Raises:
        numpy.linalg.LinAlgError: ``K`` has no inverse.

    Example:
        >>> from dronepose.data import Raw
        >>> K = np.array([[4.0, 0, 3], [0, 4, 2], [0, 0, 1]])
        >>> raw = Raw(np.zeros((4, 6, 3), np.uint8), None, K, np.eye(3), np.array([1, 0, 1.0]), "a")
        >>> rotated(raw, np.pi / 2).t.round(9).tolist()
        [0.0, 1.0, 1.0]
    """
    turn = _about_z(angle)
    if pixels:
        raw = _warped(raw, _turn_of_image(raw.K, angle), cv2.BORDER_CONSTANT)
    return replace(raw, R=turn @ raw.R, t=turn @ raw.t)


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turn_of_image(K: Array, angle: float) -> Array:
    A: Array = K @ _about_z(angle) @ np.linalg.inv(K)
    return A


def _warped(raw: Raw, A: Array, border: int) -> Raw:
    mask = None if raw.mask is None else _warp(raw.mask, A, cv2.BORDER_CONSTANT)
    return replace(raw, image=_warp(raw.image, A, border), mask=mask)


def _warp(plane: NDArray[np.uint8], A: Array, border: int) -> NDArray[np.uint8]:
    """``plane`` under an affine ``A`` whose pixel centres are at ``+ 0.5``."""
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    integer = np.linalg.inv(half) @ A @ half  # OpenCV counts pixel centres as whole numbers
    height, width = plane.shape[:2]
    out = cv2.warpAffine(
        plane, integer[:2], (width, height), flags=cv2.INTER_LINEAR, borderMode=border
    )
    return out.astype(np.uint8, copy=False)


@dataclass(frozen=True, slots=True)
class PhotometricAugmentation:
    """Random colour, blur, noise and erased rectangles, by torchvision; the pose stays.

    Args:
        brightness: Factor ``1 +- brightness``, 0 to 1.
        contrast: Factor ``1 +- contrast``, 0 to 1.
        saturation: Factor ``1 +- saturation``, 0 to 1.
        hue: Largest turn of the hue either way, 0 to 0.5 turns.
        blur: Largest standard deviation of a Gaussian, pixels.
        noise: Largest standard deviation of normal noise, in units of full white.
        erase: Probability of a rectangle of 2 to 10 % of the image that is replaced by noise.
        probability: With which a sample is changed at all, 0 to 1.

    Raises:
        ValueError: A value is out of its range; the message starts with its name.

    Example:
        >>> augment = PhotometricAugmentation(brightness=0.2, noise=0.02)
        >>> augment(torch.rand(3, 4, 6), np.random.default_rng(0)).shape
        torch.Size([3, 4, 6])
    """

    brightness: float = 0.3
    contrast: float = 0.3
    saturation: float = 0.3
    hue: float = 0.05
    blur: float = 1.0
    noise: float = 0.02
    erase: float = 0.0
    probability: float = 1.0

    def __post_init__(self) -> None:
        ranges = {"brightness": 1.0, "contrast": 1.0, "saturation": 1.0, "hue": 0.5, "blur": 50.0}
        ranges |= {"noise": 1.0, "erase": 1.0, "probability": 1.0}
        for name, most in ranges.items():
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected 0 to {most:g}, got {getattr(self, name)}")

    def __call__(self, image: Tensor, generator: np.random.Generator) -> Tensor:
        """The image changed at random.

        Args:
            image: ``(3, H, W)`` float32 in ``[0, 1]``.
            generator: Where all randomness comes from; torch's own generators are not touched.

        Returns:
            A new image, in ``[0, 1]``.

        Example:
            See the class.
        """
        if generator.random() >= self.probability:
            return image
        # Takes a second: not where it is not used.
        from torchvision.transforms.v2 import functional

        factors = {
            name: 1 + generator.uniform(-1, 1) * getattr(self, name)
            for name in ("brightness", "contrast", "saturation")
        }
        order: list[tuple[Any, float]] = [
            (functional.adjust_brightness, factors["brightness"]),
            (functional.adjust_contrast, factors["contrast"]),
            (functional.adjust_saturation, factors["saturation"]),
            (functional.adjust_hue, generator.uniform(-1, 1) * self.hue),
        ]
        for k in generator.permutation(len(order)):
            adjust, value = order[k]
            image = adjust(image, float(value))
        sigma = generator.uniform(0, 1) * self.blur
        if sigma > 0.1:
            size = 2 * int(np.ceil(3 * sigma)) + 1
            if size // 2 < min(image.shape[1:]):
                image = functional.gaussian_blur(image, [size, size], [float(sigma)])
        deviation = generator.uniform(0, 1) * self.noise
        if deviation > 0:
            image = image + float(deviation) * _normal(image.shape, generator)
        if generator.random() < self.erase:
            height, width = image.shape[1:]
            area, aspect = generator.uniform(0.02, 0.1), np.exp(generator.uniform(-1, 1))
            h = max(1, min(height, int(np.sqrt(area * height * width * aspect))))
            w = max(1, min(width, int(np.sqrt(area * height * width / aspect))))
            i, j = generator.integers(height - h + 1), generator.integers(width - w + 1)
            fill = 0.5 + 0.2 * _normal((3, h, w), generator)
            image = functional.erase(image, int(i), int(j), h, w, fill)
        return image.clamp(0, 1)


def _normal(shape: tuple[int, ...], generator: np.random.Generator) -> Tensor:
    return torch.from_numpy(generator.standard_normal(shape, dtype=np.float32))
