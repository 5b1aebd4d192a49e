"""Modalities as image files, and back: the encodings are those of ``ENCODINGS``."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import cv2
import numpy as np

from dronepose._png import encode_png

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "DEPTH_SCALE",
    "DRONE_ID",
    "ENCODINGS",
    "decode_depth",
    "decode_flow",
    "decode_normal",
    "encode_depth",
    "encode_flow",
    "encode_normal",
    "png",
    "read_png",
]

DEPTH_SCALE = 0.5e-3
"""Metres of a step of a depth image: 16 bits reach 32.7 m."""

DRONE_ID = 2
"""Of the first drone in an image of instances; those of further drones follow."""

ENCODINGS = {
    "colour": "PNG, 8 bits, sRGB",
    "depth": f"PNG, 16 bits, z of the camera frame in steps of {DEPTH_SCALE} m, 0 is nothing",
    "normal_map": "PNG, 16 bits, RGB = 32767.5 (n + 1) of the camera frame (x right, y down, z "
    "forward), towards the camera; 0, 0, 0 is nothing",
    "silhouette": "PNG, 8 bits, exact share of the pixel that the drone covers, hidden or not",
    "matte": "PNG, 8 bits, share of the pixel in which the drone is seen",
    "instance": "PNG, 8 bits, 0 nothing, 1 scene, 2 and on the drones",
    "flow": "PNG, 16 bits, as KITTI: R = 64 u + 32768, G = 64 v + 32768 pixels from this image to "
    "the other time, B = 1 seen there, 2 hidden there, 3 outside, 0 unknown",
}


def png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    r"""The bytes of a PNG of ``(H, W)`` or RGB ``(H, W, 3)``, quickly made.

    Raises:
        ValueError: It cannot be encoded.

    Example:
        >>> png(np.zeros((2, 2), np.uint8))[:4]
        b'\x89PNG'
    """
    return encode_png(image, compression=1)


def read_png(content: bytes) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The image of a PNG, RGB where it has colours.

    Raises:
        ValueError: It is none.

    Example:
        >>> read_png(png(np.full((1, 1, 3), (1, 2, 3), np.uint8))).tolist()
        [[[1, 2, 3]]]
    """
    found = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None:
        raise ValueError("content: expected a PNG")
    return cast("NDArray[np.uint8]", found[..., ::-1] if found.ndim == 3 else found)


def encode_depth(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Metres ``(H, W)`` to steps of :data:`DEPTH_SCALE`; what is further than they reach is 0.

    Example:
        >>> encode_depth(np.array([[0.0, 1.0, 99.0]], np.float32)).tolist()
        [[0, 2000, 0]]
    """
    steps = np.rint(depth / DEPTH_SCALE)
    return np.where(steps <= 65_535, steps, 0).astype(np.uint16)


def decode_depth(steps: NDArray[np.uint16]) -> NDArray[np.float32]:
    """The inverse of :func:`encode_depth`.

    Example:
        >>> decode_depth(np.array([[2000]], np.uint16)).tolist()
        [[1.0]]
    """
    return (steps * np.float32(DEPTH_SCALE)).astype(np.float32)


def encode_normal(normal: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Unit normals ``(H, W, 3)`` to 16 bits; zeros stay zeros.

    Example:
        >>> encode_normal(np.array([[[0, 0, -1.0]]], np.float32)).tolist()
        [[[32768, 32768, 0]]]
    """
    steps: NDArray[np.uint16] = np.rint(32767.5 * (normal + 1)).astype(np.uint16)
    x, y, z = np.moveaxis(normal, -1, 0)
    steps[(x == 0) & (y == 0) & (z == 0)] = 0
    return steps


def decode_normal(image: NDArray[np.uint16]) -> NDArray[np.float32]:
    """The inverse of :func:`encode_normal`.

    Example:
        >>> decode_normal(np.zeros((1, 1, 3), np.uint16)).tolist()
        [[[0.0, 0.0, 0.0]]]
    """
    some = np.any(image != 0, axis=-1, keepdims=True)
    return np.where(some, image.astype(np.float32) / np.float32(32767.5) - 1, 0).astype(np.float32)


def encode_flow(
    flow: NDArray[np.float32], visible: NDArray[np.bool_], occluded: NDArray[np.bool_],
    outside: NDArray[np.bool_],
) -> NDArray[np.uint16]:  # fmt: skip
    """Flow ``(H, W, 2)`` in pixels and what became of each point, as KITTI's files and a bit more.

    Example:
        >>> yes = np.ones((1, 1), bool)
        >>> encode_flow(np.array([[[1.5, -2.0]]], np.float32), yes, ~yes, ~yes).tolist()
        [[[32864, 32640, 1]]]
    """
    found = np.zeros((*flow.shape[:2], 3), np.uint16)
    found[..., :2] = np.clip(np.rint(64 * flow) + 32_768, 0, 65_535)
    found[..., 2] = visible + 2 * occluded.astype(np.uint8) + 3 * outside.astype(np.uint8)
    found[found[..., 2] == 0] = 0
    return found


def decode_flow(image: NDArray[np.uint16]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Flow ``(H, W, 2)`` in pixels, and ``(H, W)``: 0 unknown, 1 seen, 2 hidden, 3 outside.

    Example:
        >>> flow, fate = decode_flow(np.array([[[32864, 32640, 1]]], np.uint16))
        >>> flow.tolist(), fate.tolist()
        ([[[1.5, -2.0]]], [[1]])
    """
    fate = image[..., 2].astype(np.uint8)
    flow = (image[..., :2].astype(np.float32) - 32_768) / 64
    return np.where(fate[..., None] > 0, flow, 0).astype(np.float32), fate
