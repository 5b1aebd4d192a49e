"""From a frame of any size to the image that a network expects, with the camera that fits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from dronepose.camera import Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

__all__ = ["Fit"]


@dataclass(frozen=True, slots=True)
class Fit:
    """How frames of one size become images of a network, and the cameras of both.

    Attributes:
        frame: Camera of the frames as they come.
        network: Camera of the images that the network sees.
        map: ``(2, 3)``, pixels of the frame to pixels of the image, centres at ``+ 0.5``.
        note: What was assumed or changed, for people; empty if nothing was.
    """

    frame: Camera
    network: Camera
    map: NDArray[np.float64]
    note: str

    @classmethod
    def plan(
        cls,
        frame_size: tuple[int, int],
        image_size: tuple[int, int],
        *,
        intrinsics: NDArray[np.float64] | None,
        camera: Camera | None,
        aware: bool,
        letterbox: bool = True,
    ) -> Fit:
        """Decide once for all frames of a size.

        A network that is aware of the camera gets the frame scaled into its image with bars around
        and the ``K`` of that. Any other knows one camera, ``intrinsics``. If the camera of the
        frames is given, they are warped so that every ray falls on the pixel that it has in the
        network's camera (``K_network K_frame^-1``). If it is not, the frames are scaled, with bars
        where the aspect ratio differs, and the scaled image is *taken to be* of the network's
        camera.

        Args:
            frame_size: ``(height, width)`` of the frames.
            image_size: ``(height, width)`` of the network's images.
            intrinsics: ``(3, 3)``, the network's camera in pixels of its images, if known.
            camera: The camera of the frames, if known.
            aware: Whether the network takes ``K``.
            letterbox: Whether bars are allowed; if not, another aspect ratio is refused.

        Returns:
            The plan.

        Raises:
            ValueError: The camera is for frames of another size, no camera is known, or the aspect
                ratio differs by more than a pixel and bars are not allowed.

        Example:
            >>> K = np.array([[250.0, 0, 160], [0, 250, 120], [0, 0, 1]])
            >>> fit = Fit.plan((480, 640), (240, 320), intrinsics=K, camera=None, aware=False)
            >>> fit.frame.fx
            500.0
        """
        (rows, columns), (height, width) = frame_size, image_size
        if camera is not None and (camera.height, camera.width) != frame_size:
            raise ValueError(
                f"camera: is for {camera.width}x{camera.height}, the frames are {columns}x{rows}"
            )
        if intrinsics is None and camera is None:
            raise ValueError(
                "camera: the weights hold no intrinsics; give the camera of the frames"
            )
        if camera is not None and not aware and intrinsics is not None:
            map_ = (intrinsics @ np.linalg.inv(camera.K))[:2]
            note = "" if np.allclose(map_, np.eye(2, 3)) else "warped to the network's camera"
            return cls(camera, Camera.from_K(intrinsics, width, height), map_, note)
        map_, note = _letterbox(frame_size, image_size, letterbox)
        into = np.vstack([map_, [0.0, 0.0, 1.0]])
        if camera is None:
            assert intrinsics is not None  # refused above
            k = np.linalg.inv(into) @ intrinsics
            camera = Camera.from_K(_clean(k), columns, rows)
            assumed = (
                f"the camera of the weights is assumed: fx {camera.fx:.1f}, fy {camera.fy:.1f}"
            )
            note = f"{note}; {assumed}" if note else assumed
        elif intrinsics is None and not aware:
            assumed = "the weights hold no intrinsics: taken to be for the camera given"
            note = f"{note}; {assumed}" if note else assumed
        seen = Camera.from_K(_clean(into @ camera.K), width, height)
        return cls(camera, seen, map_, note)

    def image(self, frame: Bytes) -> NDArray[np.float32]:
        """The network's image of a frame.

        Args:
            frame: ``(height, width, 3)`` bytes, RGB, of the planned size.

        Returns:
            ``(3, H, W)`` float32 in ``[0, 1]``, C-contiguous; black where the frame has nothing.

        Raises:
            ValueError: The frame has another size.

        Example:
            >>> K = np.array([[250.0, 0, 160], [0, 250, 120], [0, 0, 1]])
            >>> fit = Fit.plan((480, 640), (240, 320), intrinsics=K, camera=None, aware=False)
            >>> fit.image(np.full((480, 640, 3), 255, dtype=np.uint8)).shape
            (3, 240, 320)
        """
        expected = (self.frame.height, self.frame.width, 3)
        if frame.shape != expected:
            raise ValueError(f"frame: expected shape {expected}, got {frame.shape}")
        height, width = self.network.height, self.network.width
        map_ = self.map
        scale = float(np.sqrt(abs(np.linalg.det(map_[:, :2]))))
        if scale < 0.9:  # average first: a bilinear look-up alone would skip pixels
            rows = max(1, round(frame.shape[0] * scale))
            columns = max(1, round(frame.shape[1] * scale))
            grow = np.diag([frame.shape[1] / columns, frame.shape[0] / rows, 1.0])
            frame = cv2.resize(frame, (columns, rows), interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
            map_ = map_ @ grow
        # OpenCV's integers are pixel centres.
        map_ = map_.copy()
        map_[:, 2] += map_[:, :2] @ [0.5, 0.5] - 0.5
        if frame.shape[:2] != (height, width) or not np.allclose(map_, np.eye(2, 3), atol=1e-9):
            frame = cv2.warpAffine(frame, map_, (width, height), flags=cv2.INTER_LINEAR)  # type: ignore[assignment]
        return np.ascontiguousarray(frame.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)


def _letterbox(
    frame_size: tuple[int, int], image_size: tuple[int, int], allowed: bool
) -> tuple[NDArray[np.float64], str]:
    """The largest copy of the frame that fits, in the middle."""
    (rows, columns), (height, width) = frame_size, image_size
    scale = min(height / rows, width / columns)
    w, h = max(1, round(columns * scale)), max(1, round(rows * scale))
    left, top = (width - w) // 2, (height - h) // 2
    note = ""
    if width - w > 1 or height - h > 1:
        sides = f"{top} rows above" if height - h > 1 else f"{left} columns at the left"
        note = (
            f"frames of {columns}x{rows} have another aspect ratio than the network's "
            f"{width}x{height}"
        )
        if not allowed:
            raise ValueError(f"{note}; expected the same ratio, or --fit letterbox")
        note += f": letterboxed to {w}x{h}, {sides} and as many opposite"
    else:  # a pixel of rounding is no bar
        w, h, left, top = width, height, 0, 0
    return np.array([[w / columns, 0.0, left], [0.0, h / rows, top]]), note


def _clean(k: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exact zeros and one where a camera matrix has them."""
    k = k / k[2, 2]
    k[1, 0] = k[2, 0] = k[2, 1] = 0.0
    k[2, 2] = 1.0
    return k
