"""The drone of a toy sample, lit: colours of its parts, light, and what the G-buffer sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np

from dronepose import render
from dronepose.camera import Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dronepose.mesh import Mesh

    Array = NDArray[np.float64]
    Picture = NDArray[Any]  # float32

_FINER = 2
"""Samples along each side of a pixel for colours."""
_PALETTE = np.array(
    [
        [0.16, 0.17, 0.18],  # carbon
        [0.62, 0.63, 0.65],  # hull
        [0.30, 0.31, 0.33],
        [0.10, 0.10, 0.11],
        [0.45, 0.46, 0.48],
        [0.75, 0.75, 0.74],
    ],
    np.float32,
)
_FRONT = np.array([0.80, 0.33, 0.12], np.float32)
_BACK = np.array([0.12, 0.13, 0.15], np.float32)


@dataclass(frozen=True, slots=True)
class Model:
    """A mesh with the colours of its faces.

    Args:
        mesh: The drone, metres.
        albedo: ``(F, 3)`` float32, RGB.
    """

    mesh: Mesh
    albedo: Picture


@dataclass(frozen=True, slots=True)
class Light:
    """How a drone is lit.

    Args:
        direction: ``(3,)`` towards the lamp, camera frame, unit.
        up: ``(3,)`` up in the world, camera frame, unit.
        lamp: ``(3,)`` RGB strength of the lamp.
        sky: ``(3,)`` RGB from above.
        ground: ``(3,)`` RGB from below.
        gloss: Strength of the highlight.
        shine: Exponent of the highlight.
    """

    direction: Array
    up: Array
    lamp: Array
    sky: Array
    ground: Array
    gloss: float
    shine: float


def parts(mesh: Mesh) -> NDArray[np.int64]:
    """The connected part that each face belongs to, ``(F,)``, from 0; equal positions are one."""
    _, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    label = np.arange(int(faces.max()) + 1)
    while True:
        least = label[faces].min(axis=1)
        new = label.copy()
        for corner in range(3):
            np.minimum.at(new, faces[:, corner], least)
        new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    return np.unique(label[faces[:, 0]], return_inverse=True)[1].reshape(-1)


def painted(mesh: Mesh, up: Literal["y", "z"]) -> Model:
    """The mesh with a colour for each of its parts, the same every time.

    The largest part is light grey, others of the same size share a grey, and what is in front of
    the outer quarter of the drone is orange, as many drones mark their front by colour.
    """
    part = parts(mesh)
    forward = 0 if up == "z" else 2
    corners = mesh.vertices[mesh.faces]
    low, high = mesh.bounds
    albedo = np.zeros((len(mesh.faces), 3), np.float32)
    sizes: dict[tuple[int, ...], int] = {}
    largest = int(np.argmax(np.bincount(part)))
    for one in range(int(part.max()) + 1):
        here = part == one
        points = corners[here].reshape(-1, 3)
        extent = np.sort(np.ptp(points, axis=0))
        key = tuple(int(x) for x in np.round(extent / (0.02 * mesh.bbox_diagonal)))
        group = sizes.setdefault(key, len(sizes))
        colour = _PALETTE[1] if one == largest else _PALETTE[group % len(_PALETTE)]
        along = (points[:, forward].mean() - low[forward]) / (high[forward] - low[forward])
        thick = extent[1] > 0.03 * mesh.bbox_diagonal
        if one != largest and thick and along > 0.72:
            colour = _FRONT
        elif one != largest and thick and along < 0.25:
            colour = _BACK
        albedo[here] = colour
    return Model(mesh, albedo)


def drawn(
    model: Model,
    camera: Camera,
    R: Array,
    t: Array,
    light: Light,
    *,
    tint: Array,
    normals: Literal["flat", "smooth-angle"],
) -> tuple[Picture, Picture]:
    """The drone without background: its colour, and the share of each pixel that it covers.

    Returns:
        ``(H, W, 3)`` float32, RGB, meant where the second, ``(H, W)`` float32, is above 0.
    """
    size = (camera.width, camera.height)
    n = _FINER
    fine = Camera(
        n * camera.fx, n * camera.fy, n * camera.cx, n * camera.cy, n * size[0], n * size[1]
    )
    seen = render.gbuffer(
        model.mesh, fine, R, t, channels=("mask", "face", "normal", "depth"), normals=normals
    )
    assert seen.mask is not None and seen.face is not None  # noqa: PT018
    colour = np.zeros((fine.height, fine.width, 3), np.float32)
    i, j = np.nonzero(seen.mask)
    if len(i):
        normal = np.asarray(seen.normal)[i, j].astype(np.float64)
        depth = np.asarray(seen.depth)[i, j].astype(np.float64)
        ray = np.stack(
            [(j + 0.5 - fine.cx) / fine.fx * depth, (i + 0.5 - fine.cy) / fine.fy * depth, depth],
            axis=-1,
        )
        view = -ray / np.linalg.norm(ray, axis=1, keepdims=True)
        half = view + light.direction
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        above = 0.5 + 0.5 * (normal @ light.up)[:, None]
        diffuse = np.clip(normal @ light.direction, 0, None)[:, None] * light.lamp
        ambient = light.ground + above * (light.sky - light.ground)
        albedo = model.albedo[seen.face[i, j]] * tint
        mirror = np.clip((normal * half).sum(axis=1), 0, None)[:, None] ** light.shine
        fresnel = 0.04 + 0.5 * (1 - np.clip((normal * view).sum(axis=1), 0, 1)[:, None]) ** 5
        shaded = albedo * (diffuse + ambient) + fresnel * ambient
        colour[i, j] = np.clip(shaded + light.gloss * mirror * light.lamp, 0, 1)
    share = cv2.resize(seen.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    colour = cv2.resize(colour, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    mask = np.asarray(render.silhouette(model.mesh, camera, R[None], t[None]))[0]
    return _spread(colour, share.astype(np.float32)), mask.astype(np.float32)


def _spread(colour: Picture, share: Picture) -> Picture:
    """Premultiplied colours, divided; pixels that no sample hit take the mean of those near."""
    reached = share.copy()
    for _ in range(3):
        empty = reached <= 0
        near = cv2.blur(colour, (3, 3)).astype(np.float32)
        weight = cv2.blur(reached, (3, 3)).astype(np.float32)
        colour = np.where(empty[..., None], near, colour)
        reached = np.where(empty, weight, reached)
    return colour / np.maximum(reached, 1e-6)[..., None]
