"""Image files to arrays and back, by OpenCV, with errors that name the file and the sample."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, cast

import cv2
import numpy as np

from dronepose._files import write_bytes
from dronepose._png import encode_png
from dronepose.data._errors import DataError, missing

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

_PNG = b"\x89PNG\r\n\x1a\n"


def read_rgb(path: Path, of: str) -> Bytes:
    """An image file as ``(H, W, 3)`` uint8, RGB; grey becomes three equal channels.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: The file is damaged or no image. ``of`` says whose it is.
    """
    found = cv2.imdecode(_content(path, of, "an image"), cv2.IMREAD_COLOR)
    if found is None:
        raise DataError(f"{path}: {of}: cannot be decoded, expected an image")
    return cast("Bytes", cv2.cvtColor(found, cv2.COLOR_BGR2RGB))


def read_rgba(path: Path, of: str) -> Bytes:
    """As :func:`read_rgb`, but ``(H, W, 4)`` where the image has opacity in 8 bits.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: As :func:`read_rgb`.
    """
    found = cv2.imdecode(_content(path, of, "an image"), cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype != np.uint8 or found.ndim != 3 or found.shape[2] != 4:
        return read_rgb(path, of)
    return cast("Bytes", cv2.cvtColor(found, cv2.COLOR_BGRA2RGBA))


def read_mask(path: Path, of: str) -> Bytes:
    """A mask file as ``(H, W)`` uint8; of an image in colour the largest channel.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: The file is damaged or no image. ``of`` says whose it is.
    """
    found = cv2.imdecode(_content(path, of, "a mask"), cv2.IMREAD_UNCHANGED)
    if found is None:
        raise DataError(f"{path}: {of}: cannot be decoded, expected a mask")
    if found.dtype == np.uint16:
        found = (found.astype(np.uint32) * 255 // 65535).astype(np.uint8)
    if found.dtype != np.uint8:
        raise DataError(f"{path}: {of}: expected 8 or 16 bits, got {found.dtype}")
    if found.ndim == 3:
        found = found[..., :3].max(axis=2)
    return cast("Bytes", found)


def write_png(path: Path, image: Bytes) -> None:
    """Write ``(H, W, 3)`` RGB or ``(H, W)`` uint8, whole or not at all.

    Raises:
        ValueError: It is no such image.
        OSError: The file cannot be written.
    """
    write_bytes(path, encode_png(image))


def _content(path: Path, of: str, what: str) -> Bytes:
    if not path.is_file():
        missing(path, f"{what} of {of}")
    content = path.read_bytes()
    if not content:
        raise DataError(f"{path}: {of}: the file is empty, expected {what}")
    if content.startswith(_PNG):
        _check_png(content, path, of)
    elif content.startswith(b"\xff\xd8") and b"\xff\xd9" not in content[-64:]:
        raise DataError(f"{path}: {of}: the JPEG file is cut off")
    return np.frombuffer(content, np.uint8)


def _check_png(content: bytes, path: Path, of: str) -> None:
    """Every chunk is whole and has the right check sum (decoders show half an image silently)."""
    place, kind = len(_PNG), b""
    while kind != b"IEND":
        size = int.from_bytes(content[place : place + 4], "big")
        end = place + 12 + size
        if end > len(content):
            raise DataError(f"{path}: {of}: the PNG file is cut off at byte {len(content)}")
        kind = content[place + 4 : place + 8]
        stated = int.from_bytes(content[end - 4 : end], "big")
        if zlib.crc32(content[place + 4 : end - 4]) != stated:
            raise DataError(f"{path}: {of}: the PNG file is damaged at byte {place}")
        place = end
