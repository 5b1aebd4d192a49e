"""A pose drawn on its frame: axes, box, silhouette and its outline."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from dronepose.render import silhouette

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh

    Bytes = NDArray[np.uint8]
    Array = NDArray[np.float64]

__all__ = ["Rgb", "Style", "color", "draw"]

Rgb = tuple[int, int, int]
#: The same as those of ``dronepose render``, and a few more.
COLORS: dict[str, Rgb] = {
    "black": (0, 0, 0),
    "blue": (52, 104, 240),
    "cyan": (60, 200, 240),
    "green": (46, 170, 66),
    "magenta": (220, 60, 200),
    "orange": (255, 140, 26),
    "red": (226, 54, 54),
    "teal": (0, 168, 150),
    "white": (255, 255, 255),
    "yellow": (250, 214, 40),
}
NEAR = 1e-3
_AXES = ("red", "green", "blue")
_SHIFT = 4  # OpenCV draws in sixteenths of a pixel


def color(text: str) -> Rgb | None:
    """A colour by name or as ``#rrggbb``.

    Args:
        text: Such as ``"orange"``; ``"none"`` for nothing.

    Returns:
        Red, green and blue, 0 to 255; ``None`` for ``"none"``.

    Raises:
        ValueError: The name is unknown; the message lists the known ones.

    Example:
        >>> color("#ff8000")
        (255, 128, 0)
    """
    if text == "none":
        return None
    if text in COLORS:
        return COLORS[text]
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        red, green, blue = bytes.fromhex(text[1:])
        return red, green, blue
    raise ValueError(f"color: expected #rrggbb, none, or one of {', '.join(COLORS)}; got {text!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """What is drawn, and in which colours; ``None`` leaves a part out.

    Attributes:
        fill: Colour of the silhouette.
        contour: Colour of its outline.
        box: Colour of the box around the mesh.
        axes: Whether x (red), y (green) and z (blue) are drawn from the origin of the model.
        alpha: How opaque the silhouette is, 0 to 1.
    """

    fill: Rgb | None = COLORS["teal"]
    contour: Rgb | None = COLORS["orange"]
    box: Rgb | None = COLORS["yellow"]
    axes: bool = True
    alpha: float = 0.4

    def __post_init__(self) -> None:
        if not 0.0 <= self.alpha <= 1.0:
            raise ValueError(f"alpha: expected a number of 0 to 1, got {self.alpha}")


def draw(
    frame: Bytes,
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    *,
    mesh: Mesh | None = None,
    style: Style | None = None,
    label: str = "",
) -> Bytes:
    """A copy of a frame with a pose drawn on it.

    What is behind the camera is cut off; without a mesh there are axes only, 10 cm long.

    Args:
        frame: ``(H, W, 3)`` bytes, RGB.
        camera: The camera of the frame.
        R: ``(3, 3)`` rotation of ``cam_from_model``.
        t: ``(3,)`` translation of ``cam_from_model``, metres.
        mesh: The drone.
        style: Parts and colours.
        label: A line of text in the corner.

    Returns:
        ``(H, W, 3)`` bytes, RGB.

    Raises:
        ValueError: The frame is not of the camera's size, or the pose has a wrong shape or is not
            finite.

    Example:
        >>> from dronepose import Camera, Mesh
        >>> camera = Camera.from_fov(64, 48, vertical_deg=50)
        >>> frame = np.zeros((48, 64, 3), dtype=np.uint8)
        >>> mesh = Mesh.from_file("examples/quadrotor.obj")
        >>> bool(draw(frame, camera, np.eye(3), [0, 0, 1], mesh=mesh).any())
        True
    """
    chosen = Style() if style is None else style
    if frame.shape != (camera.height, camera.width, 3):
        raise ValueError(
            f"frame: expected shape {(camera.height, camera.width, 3)}, got {frame.shape}"
        )
    rotation, translation = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise ValueError(
            f"R, t: expected shapes (3, 3) and (3,), got {rotation.shape} and {translation.shape}"
        )
    if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        raise ValueError("R, t: expected finite numbers")
    out = np.array(frame, dtype=np.uint8, order="C")
    thick = max(1, round(min(camera.height, camera.width) / 240))
    length = 0.1
    if mesh is not None:
        if chosen.fill is not None or chosen.contour is not None:
            mask = silhouette(mesh, camera, rotation[None], translation[None])[0]
            _silhouette(out, np.asarray(mask, dtype=np.float32), chosen, thick)
        low, high = mesh.bounds
        length = 0.5 * float(np.linalg.norm(high - low))
        if chosen.box is not None:
            corners = np.array([[(low, high)[k >> i & 1][i] for i in range(3)] for k in range(8)])
            for a, b in ((a, a | 1 << bit) for a in range(8) for bit in range(3)):
                if a != b:
                    _line(out, camera, rotation, translation, corners[a], corners[b],
                          chosen.box, thick)  # fmt: skip
    if chosen.axes:
        for axis, name in zip(np.eye(3), _AXES, strict=True):
            _line(out, camera, rotation, translation, np.zeros(3), length * axis, COLORS[name],
                  2 * thick)  # fmt: skip
    if label:
        _text(out, label, thick)
    return out


def _silhouette(out: Bytes, mask: NDArray[np.float32], style: Style, thick: int) -> None:
    if style.fill is not None:
        rows, columns = np.nonzero(mask > 0)
        if len(rows):  # only the part around the drone
            part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
            share = style.alpha * mask[part][..., None]
            mixed = out[part] * (1.0 - share) + share * np.array(style.fill, dtype=np.float32)
            out[part] = np.clip(np.rint(mixed), 0, 255).astype(np.uint8)
    if style.contour is not None:
        inside = (mask >= 0.5).astype(np.uint8)
        outlines, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(out, outlines, -1, style.contour, max(1, thick - 1), cv2.LINE_AA)


def _line(
    out: Bytes, camera: Camera, R: Array, t: Array, a: Array, b: Array, rgb: Rgb, thick: int
) -> None:
    """A line of the model frame, cut at the near plane and around the image."""
    p, q = R @ a + t, R @ b + t
    if p[2] < NEAR and q[2] < NEAR:
        return
    if p[2] < NEAR:
        p = p + (NEAR - p[2]) / (q[2] - p[2]) * (q - p)
    if q[2] < NEAR:
        q = q + (NEAR - q[2]) / (p[2] - q[2]) * (p - q)
    ends = []
    for point in (p, q):
        seen = camera.K @ point
        ends.append(seen[:2] / seen[2] - 0.5)  # OpenCV's integers are pixel centres
    kept = _clipped(ends[0], ends[1], np.array([camera.width, camera.height], dtype=np.float64))
    if kept is not None:
        whole = [tuple(int(v) for v in np.rint(end * (1 << _SHIFT))) for end in kept]
        cv2.line(out, whole[0], whole[1], rgb, thick, cv2.LINE_AA, _SHIFT)


def _clipped(a: Array, b: Array, size: Array) -> tuple[Array, Array] | None:
    """The part of a line within one image size around the image (Liang and Barsky, 1984)."""
    low, high = -size, 2.0 * size
    start, stop = 0.0, 1.0
    d = b - a
    for k in range(2):
        for delta, room in ((-d[k], a[k] - low[k]), (d[k], high[k] - a[k])):
            if delta == 0.0:
                if room < 0.0:
                    return None
            elif delta < 0.0:
                start = max(start, room / delta)
            else:
                stop = min(stop, room / delta)
    return None if start > stop else (a + start * d, a + stop * d)


def _text(out: Bytes, label: str, thick: int) -> None:
    scale = 0.45 * thick
    place = (4 * thick, 14 * thick)
    for rgb, width in (((0, 0, 0), 3 * thick), ((255, 255, 255), thick)):
        cv2.putText(out, label, place, cv2.FONT_HERSHEY_SIMPLEX, scale, rgb, width, cv2.LINE_AA)
