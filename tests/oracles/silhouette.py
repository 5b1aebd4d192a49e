"""Masks from their definitions, slowly: polygons by shapely, distances face by face."""

import math

import numpy as np
import shapely

DEFAULT_NEAR = 1e-3


def clipped(vertices, faces, R, t, near=DEFAULT_NEAR):
    """Triangles in the camera frame as polygons ``(n, 3)`` in front of the near plane."""
    points = vertices @ R.T + t
    for face in points[faces]:
        if (face[:, 2] >= near).all():
            yield face
            continue
        polygon = []
        for a, b in zip(face, np.roll(face, -1, axis=0), strict=True):
            if a[2] >= near:
                polygon.append(a)
            if (a[2] >= near) != (b[2] >= near):
                cut = a + (near - a[2]) / (b[2] - a[2]) * (b - a)
                polygon.append(np.array([*cut[:2], near]))
        if len(polygon) >= 3:
            yield np.array(polygon)


def image_polygons(vertices, faces, camera, R, t, near=DEFAULT_NEAR):
    """The polygons in pixels, ``(n, 2)`` each."""
    found = []
    for polygon in clipped(np.asarray(vertices), np.asarray(faces), R, t, near):
        uvw = polygon @ camera.K.T
        found.append(uvw[:, :2] / uvw[:, 2:])
    return found


def union(polygons, grid_size=None):
    """Their union, without those of no area.

    On a grid GEOS is ten times slower; without one it may lose a face where some nearly coincide.
    """
    shapes = [shapely.Polygon(p) for p in polygons]
    return shapely.union_all([s for s in shapes if s.area > 0], grid_size=grid_size)


def area(polygons, camera):
    """Pixels of their union that are inside the image."""
    return union(polygons).intersection(shapely.box(0, 0, camera.width, camera.height)).area


def coverage(polygons, camera, sigma=0.0):
    """``(H, W)`` area of the union in each pixel, blurred by a Gaussian cut at 4 sigma."""
    r = math.ceil(4 * sigma)
    whole = union(polygons, grid_size=1e-10)
    shapely.prepare(whole)
    v, u = np.mgrid[-r : camera.height + r, -r : camera.width + r]
    boxes = shapely.box(u, v, u + 1, v + 1)
    mask = shapely.area(shapely.intersection(boxes, whole))
    if r:
        taps = np.exp(-0.5 * (np.arange(-r, r + 1) / sigma) ** 2)
        taps /= taps.sum()
        mask = np.apply_along_axis(np.convolve, 0, mask, taps, "valid")
        mask = np.apply_along_axis(np.convolve, 1, mask, taps, "valid")
    return mask


def triangles(polygons):
    """Fans of the polygons, ``(n, 3, 2)``."""
    fans = [(p[0], p[k - 1], p[k]) for p in polygons for k in range(2, len(p))]
    return np.array(fans).reshape(-1, 3, 2)


def centres(camera):
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([u, v], axis=-1)


def inside(polygons, camera):
    """``(n, H, W)``: whether a face holds the centre of the pixel."""
    p = centres(camera)
    within = []
    for tri in triangles(polygons):
        sides = []
        for a, b in zip(tri, np.roll(tri, -1, axis=0), strict=True):
            sides.append((b - a)[0] * (p - a)[..., 1] - (b - a)[1] * (p - a)[..., 0])
        sides = np.array(sides)
        within.append((sides > 0).all(axis=0) | (sides < 0).all(axis=0))
    return np.array(within).reshape(-1, camera.height, camera.width)


def holds_anything(tri):
    """Whether a triangle has an area, rounding aside."""
    (ax, ay), (bx, by) = tri[1:] - tri[0]
    return abs(ax * by - ay * bx) > 1e-12 * (np.abs(tri).max() ** 2 + 1)


def squared_distance(p, tri):
    """To the closest of the three sides."""
    found = []
    for a, b in zip(tri, np.roll(tri, -1, axis=0), strict=True):
        d = b - a
        length = d @ d
        s = np.clip((p - a) @ d / length, 0, 1) if length > 0 else np.zeros(p.shape[:-1])
        q = a + s[..., None] * d - p
        found.append((q * q).sum(axis=-1))
    return np.min(found, axis=0)


def hard(polygons, camera):
    """``(H, W)``: 1 where a face holds the centre."""
    return inside(polygons, camera).any(axis=0).astype(float)


def dibr(polygons, camera, delta=7000.0):
    """Chen et al. 2019 over all faces: both sides of the image span [-1, 1]."""
    scale = np.array([2 / camera.width, 2 / camera.height])
    keep = np.ones((camera.height, camera.width))
    for tri in triangles(polygons):
        keep *= 1 - np.exp(-delta * squared_distance(centres(camera) * scale, tri * scale))
    return np.where(hard(polygons, camera) > 0, 1.0, 1 - keep)


def sigmoid(polygons, camera, sigma=1e-4):
    """Liu et al. 2019 over all faces but those of no area: the shorter side spans [-1, 1]."""
    scale = 2 / min(camera.width, camera.height)
    keep = np.ones((camera.height, camera.width))
    for holds, tri in zip(inside(polygons, camera), triangles(polygons), strict=True):
        if not holds_anything(tri):
            continue
        d2 = squared_distance(centres(camera) * scale, tri * scale)
        x = np.where(holds, d2, -d2) / sigma
        keep *= np.exp(-np.logaddexp(0, x))
    return 1 - keep
