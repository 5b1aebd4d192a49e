"""What images of a sample say of one another: the numbers that the doctor compares with limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dronepose.synth.encode import DEPTH_SCALE, DRONE_ID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dronepose.camera import Camera

    Array = NDArray[np.float64]
    Floats = NDArray[np.float32]

WINDOW = 5
_FLAT_STEPS = 0.4
_FLAT_SLOPE = 0.02
_ROUNDING = 0.0175
_MOVES = 0.25
_ALIKE = 0.25, 0.1  # pixels, and of the motion
_FEW = 30


def _mean(values: NDArray[Any], mask: NDArray[np.bool_]) -> float:
    return float(values[mask].mean(dtype=np.float64)) if mask.any() else 0.0


def _rays(camera: Camera) -> Array:
    """``K^-1 (u, v, 1)`` of the centres of the pixels, ``(H, W, 3)``."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays: Array = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.K).T
    return rays


def normals_from_depth(camera: Camera, depth: Floats) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals, and where they can be told: where 5 x 5 pixels lie in one plane.

    The inverse depth of a plane is affine in the pixel, so a plane is fitted to each window by
    least squares. A window holds an edge or a crease where the rest is more than the rounding of
    the files and 0.02 pixels on the surface explain. Near surfaces are left out where the rounding
    alone turns the normal by more than a degree.

    Args:
        camera: Of the image.
        depth: ``(H, W)`` metres, 0 is nothing.

    Returns:
        ``(H, W, 3)`` in the camera frame, towards the camera, and ``(H, W)`` bool.
    """
    some = depth > 0
    z = np.where(some, depth, 1.0).astype(np.float64)
    w = np.where(some, 1 / z, 0.0)
    half, count = WINDOW // 2, WINDOW * WINDOW
    k = np.arange(-half, half + 1, dtype=np.float64)
    spread = WINDOW * float((k**2).sum())
    ones = np.ones(WINDOW)

    def along(rows: Array, columns: Array) -> Array:
        edge = cv2.BORDER_CONSTANT
        return np.asarray(cv2.sepFilter2D(w, cv2.CV_64F, columns, rows, borderType=edge), float)

    a, b, c = along(ones, k) / spread, along(k, ones) / spread, along(ones, ones) / count
    square = cv2.boxFilter(
        w * w, cv2.CV_64F, (WINDOW, WINDOW), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    rest = np.maximum(square - spread * (a * a + b * b) - count * c * c, 0) / count
    rms = np.sqrt(rest) * z * z  # of the inverse depth, as depth
    whole = cv2.erode(
        some.astype(np.uint8), np.ones((WINDOW, WINDOW), np.uint8),
        borderType=cv2.BORDER_CONSTANT, borderValue=0,
    )  # fmt: skip
    pixel = z / camera.fx  # metres on the surface
    rounding = DEPTH_SCALE / np.sqrt(12 * spread) / pixel  # standard deviation of the slope
    flat = (whole > 0) & (rms <= _FLAT_STEPS * DEPTH_SCALE + _FLAT_SLOPE * pixel)
    flat &= rounding < _ROUNDING
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    plane = np.stack([a, b, c - a * u - b * v], axis=-1)  # inverse depth = plane . (u, v, 1)
    normal = -(plane @ camera.K)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal / np.maximum(length, 1e-12), flat & (length[..., 0] > 1e-12)


def normals_agree(camera: Camera, depth: Floats, normal: Floats) -> tuple[float, int]:
    """Share of the flat pixels whose two normals are within 5 degrees, and how many are flat."""
    found, flat = normals_from_depth(camera, depth)
    flat &= np.any(normal != 0, axis=-1)
    cosine = (found * normal).sum(axis=-1)
    return _mean(cosine >= np.cos(np.radians(5)), flat), int(flat.sum())


def silhouette_error(drawn: Floats, held: Floats) -> float:
    """Sum of the absolute differences by the area that was drawn."""
    area = float(drawn.sum(dtype=np.float64))
    return float(np.abs(drawn - held).sum(dtype=np.float64)) / max(area, 1.0)


def matte_excess(matte: Floats, silhouette: Floats) -> float:
    """By how much the matte is above the silhouette, by the area of the latter.

    Both are means over 3 x 3 pixels, as the matte is of a few points a pixel.
    """
    smooth = [cv2.blur(x.astype(np.float64), (3, 3)) for x in (matte, silhouette)]
    excess = np.maximum(smooth[0] - smooth[1], 0).sum()
    return float(excess) / max(float(silhouette.sum(dtype=np.float64)), 1.0)


def instance_error(instance: NDArray[Any], matte: Floats) -> float:
    """Share of the first drone's pixels that the matte contradicts.

    A pixel of it where the matte is 0, or another where it is 1.
    """
    drone = instance == DRONE_ID
    wrong = (drone & (matte == 0)) | (~drone & (matte == 1))
    return float(wrong.sum()) / max(int((drone | (matte > 0)).sum()), 1)


def _sampled(image: NDArray[Any], flow: Floats) -> NDArray[Any]:
    """An image of the other time at where the flow leads."""
    height, width = flow.shape[:2]
    v, u = np.mgrid[:height, :width].astype(np.float32)
    found: NDArray[Any] = cv2.remap(
        image.astype(np.float32), u + flow[..., 0], v + flow[..., 1], cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return found


def _calm(flow: Floats, fate: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Where 3 x 3 pixels are known and move alike, so that no edge is in them."""
    ones = np.ones((3, 3), np.uint8)
    reach = [cv2.dilate(flow[..., k], ones) - cv2.erode(flow[..., k], ones) for k in (0, 1)]
    alike = _ALIKE[0] + _ALIKE[1] * np.hypot(flow[..., 0], flow[..., 1])
    calm: NDArray[np.bool_] = (np.maximum(*reach) < alike) & (cv2.erode(fate, ones) > 0)
    return calm


def warp_errors(
    here: NDArray[Any], there: NDArray[Any], flow: Floats, fate: NDArray[np.uint8]
) -> tuple[float, float, int]:
    """Mean difference of the colours, warped and not, over the visible pixels that move.

    Pixels on edges of the motion are left out: their colours are a mix of two surfaces.

    Args:
        here: ``(H, W, 3)`` colour, 8 bits.
        there: The same at the other time.
        flow: ``(H, W, 2)`` pixels from here to there.
        fate: ``(H, W)``, 1 is visible.

    Returns:
        The two means, of 255, and the number of pixels.
    """
    moves = (fate == 1) & (np.hypot(flow[..., 0], flow[..., 1]) > _MOVES) & _calm(flow, fate)
    difference = np.abs(_sampled(there, flow) - here).mean(axis=-1)
    still = np.abs(there.astype(np.float32) - here).mean(axis=-1)
    return _mean(difference, moves), _mean(still, moves), int(moves.sum())


def flow_consistency(
    forward: tuple[Floats, NDArray[np.uint8]], backward: tuple[Floats, NDArray[np.uint8]]
) -> tuple[float, int]:
    """Share of visible pixels that come back within half a pixel, and how many were looked at.

    Pixels that come to lie on an edge of the motion there, or beside something unknown, are left
    out.
    """
    (there, fate), (back, fate_there) = forward, backward
    calm = _calm(back, fate_there).astype(np.float32)
    lands = _sampled(calm, there) > 0.999
    looked = (fate == 1) & lands
    rest = there + _sampled(back, there)
    return _mean(np.hypot(rest[..., 0], rest[..., 1]) < 0.5, looked), int(looked.sum())


def flow_against_pose(
    camera: Camera,
    depth: Floats,
    drone: NDArray[np.bool_],
    flow: tuple[Floats, NDArray[np.uint8]],
    first: tuple[Array, Array],
    second: tuple[Array, Array],
) -> tuple[float, int]:
    """Median distance, in pixels, of the drone's flow from what depth and the two poses say.

    Args:
        camera: Of the image.
        depth: ``(H, W)`` metres.
        drone: ``(H, W)``, where the drone is.
        flow: And what became of each point.
        first: ``cam_from_model`` of the image.
        second: The same at the other time.

    Returns:
        The median, and the number of pixels.
    """
    some = drone & (depth > 0) & (flow[1] > 0)
    if not some.any():
        return 0.0, 0
    points = (_rays(camera) * depth[..., None])[some]
    model = (points - first[1]) @ first[0]
    moved = model @ second[0].T + second[1]
    seen = moved @ camera.K.T
    v, u = np.nonzero(some)
    place = seen[:, :2] / np.maximum(seen[:, 2:], 1e-6) - np.stack([u, v], axis=1) - 0.5
    return float(np.median(np.hypot(*(place - flow[0][some]).T))), int(some.sum())


def box_holds(mask: Floats, place: Array, margin: float = 2.0) -> bool | None:
    """Whether a point is in the box of a mask; ``None`` where the mask is cut off or empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    low = np.array([columns[0], rows[0]])
    high = np.array([columns[-1] + 1, rows[-1] + 1])
    if (low == 0).any() or (high == mask.shape[::-1]).any():
        return None
    return bool((place >= low - margin).all() and (place <= high + margin).all())


def enough(count: int) -> bool:
    """Whether so many pixels can be judged."""
    return count >= _FEW
