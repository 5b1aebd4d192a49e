"""Faces that one can see through, such as the discs that stand for turning rotors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dronepose.mesh import Mesh
from dronepose.render import Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dronepose.synth.asset import Asset

__all__ = ["opaque_part", "see_through"]

_STEPS = 8
"""Points along a side of a face at which its texture is looked at."""


def see_through(asset: Asset) -> NDArray[np.bool_]:
    """Which faces have a texture that is not opaque all over them.

    Args:
        asset: With ``F`` faces. Their textures are looked at in 45 points each.

    Returns:
        ``(F,)``.

    Example:
        >>> from dronepose.synth import Asset
        >>> see_through(Asset.plain(Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])))
        array([False])
    """
    found = np.zeros(len(asset.mesh.faces), bool)
    grid = [(i, j) for i in range(_STEPS + 1) for j in range(_STEPS + 1 - i)]
    # A little inside of the face: its corners are often on the rim of the image.
    weights = (np.array([(i, j, _STEPS - i - j) for i, j in grid]) + 1e-4) / (_STEPS + 3e-4)
    for k, material in enumerate(asset.materials):
        opacity = material.colour.opacity if isinstance(material.colour, Texture) else None
        if opacity is None:
            continue
        faces = np.flatnonzero(asset.material_of_face == k)
        u, v = np.moveaxis(np.einsum("pc,fck->fpk", weights, asset.uv[faces]), -1, 0)
        height, width = opacity.shape
        columns = np.floor(u % 1 * width).astype(np.intp).clip(0, width - 1)
        rows = np.floor((1 - v) % 1 * height).astype(np.intp).clip(0, height - 1)
        found[faces] = (opacity[rows, columns] < 255).any(axis=1)
    return found


def opaque_part(asset: Asset) -> Asset | None:
    """What is seen behind the faces that one can see through: the others.

    Args:
        asset: The asset.

    Returns:
        Itself if it has none, ``None`` if it has no others.

    Example:
        >>> from dronepose.synth import Asset
        >>> square = Asset.plain(Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
        >>> opaque_part(square) is square
        True
    """
    keep = ~see_through(asset)
    if keep.all():
        return asset
    if not keep.any():
        return None
    mesh = Mesh(asset.mesh.vertices, np.asarray(asset.mesh.faces)[keep])
    kept = (asset.material_of_face[keep], asset.uv[keep])
    return replace(asset, mesh=mesh, material_of_face=kept[0], uv=kept[1])
