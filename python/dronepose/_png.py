"""Images as PNG files, by OpenCV."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["encode_png"]


def encode_png(
    image: NDArray[np.uint8] | NDArray[np.uint16], compression: int | None = None
) -> bytes:
    r"""The bytes of a PNG of ``(H, W)`` or RGB ``(H, W, 3)``, of 8 or 16 bits.

    Args:
        image: The image.
        compression: zlib's level, 0 to 9; ``None`` is OpenCV's own choice, which also has another
            strategy than any level that is given.

    Raises:
        ValueError: It cannot be encoded.

    Example:
        >>> encode_png(np.zeros((2, 2), np.uint8))[:4]
        b'\x89PNG'
    """
    plain = cast("NDArray[np.uint8]", np.ascontiguousarray(image))  # or of 16 bits
    shown = cv2.cvtColor(plain, cv2.COLOR_RGB2BGR) if plain.ndim == 3 else plain
    options = [] if compression is None else [cv2.IMWRITE_PNG_COMPRESSION, compression]
    done, content = cv2.imencode(".png", shown, options)
    if not done:
        raise ValueError(f"image: {image.dtype} of shape {image.shape} cannot be encoded as PNG")
    found: bytes = content.tobytes()
    return found
