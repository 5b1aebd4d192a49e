"""A hall to fly in, made by a formula: walls, floor, boxes, with textures that hold their light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dronepose.mesh import Mesh
from dronepose.render import Material, Texture, srgb_bytes
from dronepose.synth.asset import Asset, merged

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Picture = NDArray[np.float64]
    Kind = Callable[[tuple[int, int], np.random.Generator], Picture]

__all__ = ["example_hall"]

LOW = (-2.4, -2.4, 0.0)
HIGH = (9.9, 7.4, 3.2)
_TEXELS = 64
"""Texels a metre."""


def example_hall(seed: int = 0) -> Asset:
    """The hall around the anchors of :func:`dronepose.synth.write_example`, unlit.

    A closed box of 12.3 x 9.8 x 3.2 m with floor boards, bricks, plaster and beams, and boxes along
    the walls; lamps and the dark of corners are in the textures.

    Args:
        seed: Of textures and boxes.

    Returns:
        The scene, metres, z up.

    Raises:
        ValueError: ``seed`` is negative.

    Example:
        >>> hall = example_hall()
        >>> len(hall.mesh.faces), hall.mesh.bounds[1].tolist()
        (252, [9.9, 7.4, 3.2])
    """
    generator = np.random.default_rng([seed, 7])
    low, high = np.array(LOW), np.array(HIGH)
    parts = []
    for axis, side in ((2, 0), (2, 1), (0, 0), (0, 1), (1, 0), (1, 1)):
        kind = _boards if (axis, side) == (2, 0) else (_bricks, _plaster, _plaster)[axis]
        parts.append(_wall(low, high, axis, (low, high)[side][axis], kind, generator, dark=0.55))
    for k in range(20):
        size = generator.uniform([0.3, 0.3, 0.3], [0.9, 0.9, 1.9])
        along = generator.uniform(low[:2] + 0.1, high[:2] - size[:2] - 0.1)
        axis = k % 2  # two walls in turn, so that the middle stays free
        edge = generator.integers(2)
        along[axis] = (low[axis] + 0.02, high[axis] - size[axis] - 0.02)[edge]
        first = np.array([*along, 0.0])
        parts.append(_box(first, first + size, generator))
    return merged(parts).look(lit=False)


def _box(low: Picture, high: Picture, generator: np.random.Generator) -> Asset:
    """Six sides of one painted colour."""
    colour = generator.uniform(0.05, 0.8, 3)
    faces = []
    for axis in range(3):
        for side in (low, high):
            shade = 1.0 if axis == 2 else generator.uniform(0.55, 0.95)
            kind = _painted(colour * shade)
            faces.append(_wall(low, high, axis, side[axis], kind, generator, dark=0.8))
    return merged(faces)


def _wall(
    first: Picture,
    last: Picture,
    axis: int,
    at: float,
    kind: Kind,
    generator: np.random.Generator,
    *,
    dark: float,
) -> Asset:
    """A rectangle across an axis with a texture of its own, darker towards its corners."""
    u, v = ((1, 2), (0, 2), (0, 1))[axis]
    size = (last[u] - first[u], last[v] - first[v])
    points = np.empty((4, 3))
    points[:, axis] = at
    points[:, u] = first[u] + size[0] * np.array([0, 1, 1, 0])
    points[:, v] = first[v] + size[1] * np.array([0, 0, 1, 1])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces]
    shape = (max(8, round(size[1] * _TEXELS)), max(8, round(size[0] * _TEXELS)))
    linear = kind(shape, generator) * _light(shape, dark, generator)[..., None]
    material = Material(Texture(srgb_bytes(np.clip(linear, 0, 1))), lit=False)
    return Asset(Mesh(points, faces), (material,), np.zeros(2, np.uint32), corners)


def _light(shape: tuple[int, int], dark: float, generator: np.random.Generator) -> Picture:
    """Two soft lamps, and less light in the corners."""
    y, x = (np.arange(n) / n for n in shape)
    edge = np.minimum.outer(np.minimum(y, 1 - y), np.minimum(x, 1 - x)) * min(shape) / _TEXELS
    out = dark + (1 - dark) * (1 - np.exp(-edge / 0.35))
    for _ in range(2):
        cy, cx = generator.uniform(0.1, 0.9, 2)
        reach = generator.uniform(0.15, 0.35)
        out = out * (0.8 + 0.35 * np.exp(-((y[:, None] - cy) ** 2 + (x - cx) ** 2) / reach**2))
    found: Picture = out
    return found


def _noise(shape: tuple[int, int], cell: int, generator: np.random.Generator) -> Picture:
    """Smooth noise of mean 0, about -1 to 1, with a feature every so many texels."""
    height, width = (n // cell + 2 for n in shape)
    grid = generator.normal(0, 0.5, (height, width))
    rows, columns = (np.arange(n) / cell for n in shape)
    i, j = rows.astype(int), columns.astype(int)
    a, b = (rows - i)[:, None], columns - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    upper = grid[i][:, j] * (1 - b) + grid[i][:, j + 1] * b
    lower = grid[i + 1][:, j] * (1 - b) + grid[i + 1][:, j + 1] * b
    found: Picture = upper * (1 - a) + lower * a
    return found


def _painted(colour: Picture) -> Kind:
    """Paint of one colour, with stains and a darker rim."""

    def kind(shape: tuple[int, int], generator: np.random.Generator) -> Picture:
        stain = 1 + 0.12 * _noise(shape, 16, generator) + 0.08 * _noise(shape, 4, generator)
        rim = np.ones(shape)
        rim[:2], rim[-2:], rim[:, :2], rim[:, -2:] = 0.6, 0.6, 0.6, 0.6
        found: Picture = (stain * rim)[..., None] * colour
        return found

    return kind


def _plaster(shape: tuple[int, int], generator: np.random.Generator) -> Picture:
    """Plaster with a picture or two."""
    colour = generator.uniform(0.45, 0.75, 3)
    out: Picture = (1 + 0.1 * _noise(shape, 24, generator) + 0.05 * _noise(shape, 3, generator))[
        ..., None
    ] * colour
    for _ in range(4):
        h, w = generator.integers(24, 80, 2)
        if h + 8 < shape[0] and w + 8 < shape[1]:
            y, x = generator.integers(4, shape[0] - h - 4), generator.integers(4, shape[1] - w - 4)
            out[y - 3 : y + h + 3, x - 3 : x + w + 3] = generator.uniform(0.02, 0.2, 3)
            inner = generator.uniform(0.1, 0.8, 3) * (
                1 + 0.5 * _noise((int(h), int(w)), 9, generator)[..., None]
            )
            out[y : y + h, x : x + w] = inner
    return out


def _bricks(shape: tuple[int, int], generator: np.random.Generator) -> Picture:
    """Courses of bricks."""
    height, width = 8, 20
    rows, columns = np.arange(shape[0]) // height, np.arange(shape[1])
    shifted = columns[None] + (rows % 2)[:, None] * (width // 2)
    count = shape[1] // width + 3
    tone = generator.uniform(0.7, 1.15, (rows.max() + 1, count))
    brick = tone[rows[:, None], shifted // width]
    mortar = (np.arange(shape[0]) % height == 0)[:, None] | (shifted % width == 0)
    colour = np.array([0.42, 0.17, 0.11])
    grain = 1 + 0.1 * _noise(shape, 3, generator)
    found: Picture = np.where(mortar[..., None], 0.45, (brick * grain)[..., None] * colour)
    return found


def _boards(shape: tuple[int, int], generator: np.random.Generator) -> Picture:
    """Floor boards along the first direction."""
    width = 11
    board = np.arange(shape[0]) // width
    tone = generator.uniform(0.75, 1.15, board.max() + 1)[board]
    grain = (
        1
        + 0.18
        * np.repeat(_noise((shape[0], shape[1] // 12 + 1), 2, generator), 12, axis=1)[:, : shape[1]]
    )
    gap = np.where(np.arange(shape[0]) % width == 0, 0.35, 1.0)
    colour = np.array([0.45, 0.28, 0.14])
    found: Picture = ((tone * gap)[:, None] * grain)[..., None] * colour
    return found
