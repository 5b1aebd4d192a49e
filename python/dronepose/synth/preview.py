"""A picture of a mesh from four sides, for people to see what a file holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dronepose.camera import Camera
from dronepose.render import Light, colour, srgb_bytes
from dronepose.synth.inputs import example_light

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dronepose.synth.asset import Asset

__all__ = ["preview"]

_BACKGROUND = 0.9
_SIDES = ((0.6, 0.35), (2.2, 0.35), (4.0, -0.3), (0.0, 1.45))
"""Azimuth and elevation of the cameras, radians, about the z axis of the file."""


def preview(asset: Asset, *, size: int = 240, samples: int = 4) -> NDArray[np.uint8]:
    """The mesh from three sides and from above, lit, on light grey.

    Args:
        asset: The mesh with its materials, z up.
        size: Pixels along a side of each of the four pictures.
        samples: Points along a side of a pixel, 1 to 8.

    Returns:
        ``(size, 4 size, 3)`` uint8, sRGB.

    Raises:
        ValueError: The mesh has no size, or no faces.

    Example:
        >>> from dronepose.synth.inputs import read_drone
        >>> preview(read_drone("example")[0], size=32).shape
        (32, 128, 3)
    """
    low, high = asset.mesh.bounds
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    if radius <= 0:
        raise ValueError("asset: all vertices are at one place")
    camera = Camera.from_fov(size, size, horizontal_deg=40.0)
    distance = radius / np.sin(np.radians(19.0))
    R, t, lights = [], [], []
    light = example_light("warm")
    for azimuth, elevation in _SIDES:
        ahead = -np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(ahead, right), ahead])
        R.append(turn)
        t.append(-turn @ middle + [0, 0, distance])
        lights.append(Light(light, 0.8, turn.T))
    drawn = colour(
        asset.mesh,
        camera,
        np.stack(R),
        np.stack(t),
        materials=list(asset.materials),
        material_of_face=asset.material_of_face,
        uv=asset.uv,
        lights=lights,
        samples=samples,
        near=1e-3 * radius if radius > 1e-6 else None,
    )
    pictures = srgb_bytes(drawn.rgb + (1 - drawn.share[..., None]) * _BACKGROUND)
    return np.concatenate(list(pictures), axis=1)
