"""What is behind the drone of a toy sample: drawn from random numbers, or cut from photographs."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dronepose.data._errors import DataError, missing

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Picture = NDArray[Any]  # float32

_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff", ".hdr"})


def procedural(height: int, width: int, generator: np.random.Generator) -> Picture:
    """A background of random kind: an outdoor horizon, a room, clutter, or smooth noise.

    Args:
        height: Rows.
        width: Columns.
        generator: Where all randomness comes from.

    Returns:
        ``(H, W, 3)`` float32, RGB in ``[0, 1]``.

    Raises:
        ValueError: A size is negative.

    Example:
        >>> procedural(6, 8, np.random.default_rng(0)).shape
        (6, 8, 3)
    """
    kinds: list[Callable[[int, int, np.random.Generator], Picture]] = [
        _outdoor,
        _room,
        _clutter,
        _smooth,
    ]
    kind = kinds[generator.choice(4, p=[0.35, 0.35, 0.2, 0.1])]
    picture = kind(height, width, generator)
    grain = noise(height, width, generator, channels=1, coarsest=24)
    picture = picture + np.float32(generator.uniform(0.0, 0.08)) * (grain - 0.5)
    blur = generator.uniform(0.0, 1.6) * height / 120
    if blur > 0.3:
        picture = cv2.GaussianBlur(picture, (0, 0), blur).astype(np.float32)
    return _single(np.clip(picture, 0, 1))


def noise(
    height: int,
    width: int,
    generator: np.random.Generator,
    *,
    channels: int = 3,
    coarsest: int = 3,
) -> Picture:
    """Value noise: grids of random numbers, each twice as fine and half as strong as the last.

    Args:
        height: Rows.
        width: Columns.
        generator: Where all randomness comes from.
        channels: 1 or 3.
        coarsest: Nodes of the first grid along the width.

    Returns:
        ``(H, W, channels)`` float32 in ``[0, 1]``.

    Raises:
        ValueError: A size is negative.

    Example:
        >>> noise(6, 8, np.random.default_rng(0), channels=1).shape
        (6, 8, 1)
    """
    total = np.zeros((height, width, channels), np.float32)
    weight, nodes, strength = 0.0, coarsest, 1.0
    while nodes < width and strength > 0.05:
        grid = generator.random((max(2, nodes * height // width), nodes, channels), np.float32)
        fine = cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        total += strength * fine.reshape(height, width, channels).astype(np.float32)
        weight, nodes, strength = weight + strength, nodes * 2, strength * 0.55
    if weight == 0:
        return generator.random((height, width, channels), np.float32)
    return _single(np.clip(total / weight, 0, 1))


def _single(values: Any) -> Picture:
    return np.asarray(values, dtype=np.float32)


def _colour(generator: np.random.Generator, low: float, high: float, vivid: float) -> Picture:
    """A colour around a random grey."""
    grey = generator.uniform(low, high)
    hue = generator.uniform(-vivid, vivid, 3)
    return _single(np.clip(grey + hue - hue.mean(), 0, 1))


def _ramp(height: int, width: int, generator: np.random.Generator) -> Picture:
    """A plane of light from 0 to 1 in a random direction, ``(H, W, 1)``."""
    angle = generator.uniform(0, 2 * np.pi)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    plane = np.cos(angle) * x / width + np.sin(angle) * y / height
    plane = (plane - plane.min()) / max(float(np.ptp(plane)), 1e-6)
    return _single(plane[..., None])


def _rectangle(
    picture: Picture,
    generator: np.random.Generator,
    centre: tuple[float, float],
    half: tuple[float, float],
    colour: Picture,
    tilt: float = 0.0,
) -> None:
    """A shaded, textured rectangle, drawn with soft edges; sizes in pixels, ``tilt`` in radians."""
    c, s = np.cos(tilt), np.sin(tilt)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.asarray(half)
    corners = corners @ np.array([[c, s], [-s, c]]) + np.asarray(centre)
    height, width = picture.shape[0], picture.shape[1]
    alpha = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(alpha, np.round(corners * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    light = 1 + np.float32(generator.uniform(0, 0.35)) * (_ramp(height, width, generator) - 0.5)
    cover = alpha[..., None].astype(np.float32) / 255
    picture += cover * (colour * light - picture)


def _outdoor(height: int, width: int, generator: np.random.Generator) -> Picture:
    """Sky with clouds, a horizon with buildings or trees, and ground."""
    horizon = height * generator.uniform(0.35, 1.15)
    y = (np.arange(height, dtype=np.float32)[:, None, None] + 0.5) / max(horizon, 1.0)
    zenith = np.array([0.3, 0.5, 0.8]) * generator.uniform(0.6, 1.15)
    grey = generator.uniform(0.45, 0.9)
    zenith = zenith + generator.uniform(0, 1) * (grey - zenith)  # from blue to overcast
    haze = 0.45 * zenith + 0.55 * _colour(generator, 0.7, 0.95, 0.06)
    sky = (zenith + np.clip(y, 0, 1) ** 1.5 * (haze - zenith)).astype(np.float32)
    clouds = noise(height, width, generator, channels=1, coarsest=3)
    amount = np.clip((clouds - generator.uniform(0.4, 0.7)) * 4, 0, 1) * np.float32(0.8)
    picture = sky + amount * (np.float32(generator.uniform(0.75, 1.0)) - sky)
    for _ in range(generator.integers(0, 9)):
        half = (width * generator.uniform(0.02, 0.14), height * generator.uniform(0.03, 0.25))
        colour = _colour(generator, 0.15, 0.65, 0.08)
        _rectangle(picture, generator, (width * generator.random(), horizon), half, colour)
    if generator.random() < 0.6:  # a line of trees
        crown = noise(2, width, generator, channels=1, coarsest=8)[0, :, 0]
        top = horizon - height * generator.uniform(0.05, 0.35) * crown
        below = np.clip(np.arange(height)[:, None] - top[None] + 0.5, 0, 1)[..., None]
        leaves = noise(height, width, generator, channels=1, coarsest=20)
        green = np.array([0.22, 0.32, 0.14], np.float32) * np.float32(generator.uniform(0.6, 1.5))
        picture += below.astype(np.float32) * (green * (0.4 + leaves) - picture)
    below = np.clip(np.arange(height)[:, None, None] - horizon + 0.5, 0, 1).astype(np.float32)
    soil = np.array([[0.35, 0.42, 0.2], [0.5, 0.45, 0.38], [0.45, 0.45, 0.46]], np.float32)
    ground = soil[generator.integers(3)] * np.float32(generator.uniform(0.6, 1.3))
    texture = noise(height, width, generator, channels=1, coarsest=10)
    picture += below * (ground * (0.6 + 0.8 * texture) - picture)
    return _single(picture)


def _room(height: int, width: int, generator: np.random.Generator) -> Picture:
    """A wall and a floor, with doors, windows, pictures and furniture."""
    wall = _colour(generator, 0.4, 0.9, 0.07)
    light = 0.65 + np.float32(0.55) * _ramp(height, width, generator)
    picture = (wall * light).astype(np.float32)
    if generator.random() < 0.5:  # a second wall
        corner = width * generator.uniform(0.15, 0.85)
        lean = generator.uniform(-0.05, 0.05)
        x, y = np.arange(width)[None, :, None], np.arange(height)[:, None, None]
        side = np.clip(x - corner - lean * y + 0.5, 0, 1).astype(np.float32)
        picture *= 1 - side * np.float32(generator.uniform(0.1, 0.4))
    for _ in range(generator.integers(1, 7)):  # pictures, windows, doors
        half = (width * generator.uniform(0.03, 0.13), height * generator.uniform(0.04, 0.25))
        centre = (width * generator.random(), height * generator.uniform(0.1, 0.6))
        _rectangle(picture, generator, centre, half, _colour(generator, 0.1, 1.0, 0.12))
        if generator.random() < 0.7:
            inside = (half[0] * 0.82, half[1] * 0.86)
            _rectangle(picture, generator, centre, inside, _colour(generator, 0.2, 1.0, 0.16))
    edge = height * generator.uniform(0.55, 1.05)
    slope = generator.uniform(-0.15, 0.15)
    x, y = np.arange(width)[None, :, None], np.arange(height)[:, None, None]
    below = np.clip(y - edge - slope * (x - width / 2) + 0.5, 0, 1).astype(np.float32)
    floor = np.array([0.5, 0.38, 0.26], np.float32)  # wood, or a carpet of any colour
    if generator.random() < 0.5:
        floor = _colour(generator, 0.2, 0.7, 0.1)
    depth = np.clip((y - edge) / height, 0.02, None).astype(np.float32)
    angle = generator.uniform(-1.0, 1.0)
    planks = np.sin((x - width / 2 + angle * width * depth) / width / (0.25 + depth) * 60)
    stripes = 1 + np.float32(generator.uniform(0, 0.12)) * np.sign(planks).astype(np.float32)
    picture += below * (floor * stripes * light - picture)
    for _ in range(generator.integers(0, 5)):  # furniture that stands on the floor
        half = (width * generator.uniform(0.04, 0.2), height * generator.uniform(0.05, 0.22))
        centre = (width * generator.random(), edge + height * generator.uniform(-0.1, 0.2))
        _rectangle(picture, generator, centre, half, _colour(generator, 0.1, 0.7, 0.12))
    return _single(picture)


def _clutter(height: int, width: int, generator: np.random.Generator) -> Picture:
    """Rectangles and lines in every direction."""
    picture = _smooth(height, width, generator)
    for _ in range(generator.integers(6, 26)):
        half = (width * generator.uniform(0.01, 0.2), height * generator.uniform(0.01, 0.15))
        centre = (width * generator.random(), height * generator.random())
        colour = _colour(generator, 0.05, 0.95, 0.15)
        _rectangle(picture, generator, centre, half, colour, generator.uniform(0, np.pi))
    return _single(picture)


def _smooth(height: int, width: int, generator: np.random.Generator) -> Picture:
    """Noise between two colours."""
    a, b = _colour(generator, 0.1, 0.6, 0.12), _colour(generator, 0.4, 0.95, 0.12)
    share = noise(height, width, generator, channels=1, coarsest=int(generator.integers(2, 8)))
    share = np.clip((share - 0.5) * np.float32(generator.uniform(1, 3)) + 0.5, 0, 1)
    return _single(a + share * (b - a))


class Photographs:
    """Backgrounds cut from the images of a folder.

    An image twice as wide as high counts as a panorama of the full sphere and is looked into in a
    random direction through a camera of the given field of view; of others a random part is taken.
    Radiance (``.hdr``) is exposed so that its median becomes a middle grey.

    Args:
        folder: Its ``.png``, ``.jpg``, ``.webp``, ``.bmp``, ``.tif`` and ``.hdr`` files are used,
            sorted by name.
        horizontal_deg: Field of view for panoramas, degrees.

    Raises:
        FileNotFoundError: There is no such folder.
        DataError: It holds no images.

    Example:
        >>> Photographs("photos", 64.69)(120, 160, np.random.default_rng(0))  # doctest: +SKIP
    """

    def __init__(self, folder: str | Path, horizontal_deg: float) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            missing(self.folder, "a folder of background images")
        files = sorted(p for p in self.folder.iterdir() if p.suffix.lower() in _SUFFIXES)
        if not files:
            raise DataError(f"{self.folder}: no images, expected {' '.join(sorted(_SUFFIXES))}")
        self.files = files
        self.horizontal_deg = horizontal_deg
        self._kept: tuple[Path, Picture] | None = None

    def hashes(self) -> dict[str, str]:
        """SHA-256 of each file, by its name.

        Example:
            >>> Photographs("photos", 64.69).hashes()  # doctest: +SKIP
            {'atrium.hdr': '5f70bf18a086...'}
        """
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in self.files}

    def __call__(self, height: int, width: int, generator: np.random.Generator) -> Picture:
        """A background, ``(H, W, 3)`` float32 in ``[0, 1]``."""
        whole = self._read(self.files[generator.integers(len(self.files))])
        rows, columns = whole.shape[:2]
        if columns == 2 * rows:
            picture = self._look(whole, height, width, generator)
        else:
            scale = min(columns / width, rows / height) * generator.uniform(0.5, 1.0)
            size = max(1, int(height * scale)), max(1, int(width * scale))
            top = int(generator.integers(rows - size[0] + 1))
            left = int(generator.integers(columns - size[1] + 1))
            part = whole[top : top + size[0], left : left + size[1]]
            how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
            picture = cv2.resize(part, (width, height), interpolation=how).astype(np.float32)
            if generator.random() < 0.5:
                picture = picture[:, ::-1]
        gain = np.float32(generator.uniform(0.7, 1.25))
        return np.ascontiguousarray(np.clip(gain * picture, 0, 1))

    def _look(
        self, whole: Picture, height: int, width: int, generator: np.random.Generator
    ) -> Picture:
        """A pinhole view into an equirectangular image."""
        focal = 0.5 * width / np.tan(np.radians(0.5 * self.horizontal_deg))
        y, x = np.mgrid[0:height, 0:width] + 0.5
        ray = np.stack([(x - width / 2) / focal, (y - height / 2) / focal, np.ones_like(x)], -1)
        pitch = np.radians(generator.uniform(-20, 20))
        c, s = np.cos(pitch), np.sin(pitch)
        ray = ray @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T
        azimuth = np.arctan2(ray[..., 0], ray[..., 2]) + generator.uniform(0, 2 * np.pi)
        down = np.arctan2(ray[..., 1], np.hypot(ray[..., 0], ray[..., 2]))
        rows, columns = whole.shape[:2]
        u = (azimuth / (2 * np.pi) % 1.0) * columns - 0.5
        v = (down / np.pi + 0.5) * rows - 0.5
        seen = cv2.remap(
            whole,
            u.astype(np.float32),
            v.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        return seen.astype(np.float32)

    def _read(self, path: Path) -> Picture:
        if self._kept is not None and self._kept[0] == path:
            return self._kept[1]
        found = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
        if found is None:
            raise DataError(f"{path}: cannot be decoded, expected a background image")
        picture = cv2.cvtColor(found, cv2.COLOR_BGR2RGB).astype(np.float32)
        if found.dtype == np.uint8:
            picture /= 255
        elif found.dtype == np.uint16:
            picture /= 65535
        else:
            middle = max(float(np.median(picture)), 1e-6)
            picture = np.clip(picture * (0.18 / middle), 0, 1) ** (1 / 2.2)
        self._kept = (path, picture)
        return picture
