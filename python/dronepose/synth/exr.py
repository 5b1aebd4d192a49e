"""OpenEXR files of light, by the package OpenEXR: OpenCV is built without them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose.synth.asset import AssetError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["read_exr"]

MOST_COLUMNS = 16_384
_DARK = 1e-3


def read_exr(path: Path) -> NDArray[np.float32]:
    """The radiance in an EXR file.

    Values just below zero, as lossy compression (DWAA, DWAB) leaves them, become zero: those above
    a thousandth of the largest value in size are kept, for who reads it to refuse.

    Args:
        path: The file; its first part, with the channels R, G and B, or Y alone.

    Returns:
        ``(H, W, 3)``, linear RGB.

    Raises:
        ImportError: The package OpenEXR is missing.
        AssetError: The file is broken, cut off, too large, or has other channels.
        OSError: It cannot be read.

    Example:
        >>> read_exr(Path("studio.exr")).shape  # doctest: +SKIP
        (512, 1024, 3)
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise ImportError(
            f"{path}: reading EXR needs the package OpenEXR, which is not installed: "
            'pip install "dronepose[synth]"; or convert the file to Radiance, for example with '
            f"oiiotool {path.name} -o {path.stem}.hdr"
        ) from error
    path.open("rb").close()  # for an error of the system that names the file
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            low, high = (np.asarray(x, np.int64) for x in file.header()["dataWindow"])
            shown = [np.asarray(x, np.int64) for x in file.header()["displayWindow"]]
        width, height = (int(x) for x in high - low + 1)
        if 0 < width <= MOST_COLUMNS and 0 < height <= MOST_COLUMNS:
            with OpenEXR.File(str(path), separate_channels=True) as file:
                channels = dict(file.channels().items())
                planes = {name: np.asarray(channels[name].pixels) for name in channels}
    except Exception as error:  # whatever the library makes of a broken file
        raise AssetError(
            f"{path}: cannot be read as EXR, it is broken or cut off: {error}"
        ) from None
    if not (0 < width <= MOST_COLUMNS and 0 < height <= MOST_COLUMNS):
        raise AssetError(f"{path}: expected at most {MOST_COLUMNS} pixels a side, got "
                         f"{width} x {height}")  # fmt: skip
    if not (np.array_equal(low, shown[0]) and np.array_equal(high, shown[1])):
        raise AssetError(f"{path}: holds a part of its picture only (its data window is another "
                         "than its display window)")  # fmt: skip
    return _radiance(path, planes, (height, width))


def _radiance(
    path: Path, planes: dict[str, NDArray[Any]], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Colours of the channels, as float32."""
    names = "RGB" if {*"RGB"} <= planes.keys() else "Y"
    if names == "Y" and ("Y" not in planes or {"RY", "BY"} & planes.keys()):
        found = ", ".join(sorted(planes)) or "none"
        raise AssetError(f"{path}: expected the channels R, G and B, or Y alone, found {found}")
    picked = [planes[name] for name in names]
    if any(plane.shape != size for plane in picked):
        raise AssetError(f"{path}: its channels are of different sizes")
    rgb = np.stack([picked[k % len(picked)] for k in range(3)], axis=-1).astype(np.float32)
    with np.errstate(invalid="ignore"):
        dark = (rgb < 0) & (rgb > -_DARK * rgb.max())
    return np.where(dark, np.float32(0), rgb)
