"""A pinhole camera: what turns points of the camera frame into pixels.

Pixel ``(row i, column j)`` covers ``[j, j + 1) x [i, i + 1)``; its centre is
``(u, v) = (j + 0.5, i + 0.5)`` and the image spans ``[0, width] x [0, height]``. A matrix whose
integers are pixel centres (OpenCV's habit) gains half a pixel in ``cx`` and ``cy`` on the way in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics of a pinhole camera without distortion, and the size of its image.

    ``u = fx x/z + skew y/z + cx``, ``v = fy y/z + cy`` for a point ``(x, y, z)`` of the OpenCV
    camera frame (x right, y down, z forward): Hartley & Zisserman, "Multiple View Geometry in
    Computer Vision", 2nd ed., section 6.1.

    Args:
        fx: Focal length in pixels along u, above zero.
        fy: Focal length in pixels along v, above zero.
        cx: Principal point along u, in pixels from the left edge of the image.
        cy: Principal point along v, in pixels from the top edge of the image.
        width: Columns of the image, at least 1.
        height: Rows of the image, at least 1.
        skew: Shear of the pixel grid, in pixels.

    Raises:
        TypeError: An argument is no number.
        ValueError: An argument is outside its range; the message starts with its name.

    Example:
        >>> Camera(500, 500, 320, 240, width=640, height=480).K.tolist()
        [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    skew: float = 0.0

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy", "skew"):
            try:
                value = float(getattr(self, name))
            except (TypeError, ValueError):
                raise TypeError(f"{name}: expected a number, got {getattr(self, name)!r}") from None
            if not math.isfinite(value):
                raise ValueError(f"{name}: expected a finite number, got {value}")
            if name in ("fx", "fy") and value <= 0:
                raise ValueError(
                    f"{name}: expected a focal length above zero, in pixels, got {value}"
                )
            object.__setattr__(self, name, value)
        for name in ("width", "height"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise ValueError(f"{name}: expected a whole number of pixels >= 1, got {value}")
            object.__setattr__(self, name, int(value))

    @property
    def K(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name
        """``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]``, ``(3, 3)`` float64, in pixels.

        Example:
            >>> Camera(500, 500, 320, 240, width=640, height=480, skew=1).K[0].tolist()
            [500.0, 1.0, 320.0]
        """
        import numpy as np

        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @classmethod
    def from_K(cls, K: ArrayLike, width: int, height: int) -> Camera:  # noqa: N802
        """From a camera matrix.

        Args:
            K: ``(3, 3)`` float32 or float64, in pixels, with pixel centres at ``+ 0.5`` (see the
                module).
            width: Columns of the image.
            height: Rows of the image.

        Returns:
            The camera.

        Raises:
            ValueError: ``K`` is not ``(3, 3)``, its lower triangle is not ``0, 0, 0, 1``, or a
                value is outside its range.

        Example:
            >>> Camera.from_K([[500, 0, 320], [0, 510, 240], [0, 0, 1]], 640, 480).fy
            510.0
        """
        import numpy as np

        k = np.asarray(K, dtype=np.float64)
        if k.shape != (3, 3):
            raise ValueError(f"K: expected shape (3, 3), got {k.shape}")
        if not np.array_equal(k[[1, 2, 2, 2], [0, 0, 1, 2]], [0.0, 0.0, 0.0, 1.0]):
            raise ValueError(
                f"K: expected [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}"
            )
        return cls(k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height, skew=k[0, 1])

    @classmethod
    def from_fov(
        cls,
        width: int,
        height: int,
        *,
        horizontal_deg: float | None = None,
        vertical_deg: float | None = None,
    ) -> Camera:
        """From one field of view: square pixels, principal point in the middle of the image.

        Args:
            width: Columns of the image.
            height: Rows of the image.
            horizontal_deg: Angle between the left and the right edge, in degrees, or
            vertical_deg: angle between the top and the bottom edge, in degrees. One of the two.

        Returns:
            The camera.

        Raises:
            ValueError: Not exactly one angle is given, or it is not inside (0, 180) degrees.

        Example:
            The exocentric camera of the UAVA dataset (DronePose, supplement, Dataset):

            >>> round(Camera.from_fov(320, 240, horizontal_deg=64.69).fx, 1)
            252.7
        """
        given = [
            (name, angle, size)
            for name, angle, size in (
                ("horizontal_deg", horizontal_deg, width),
                ("vertical_deg", vertical_deg, height),
            )
            if angle is not None
        ]
        if len(given) != 1:
            raise ValueError("horizontal_deg, vertical_deg: expected exactly one of the two")
        name, angle, size = given[0]
        if not 0 < angle < 180:
            raise ValueError(f"{name}: expected an angle inside (0, 180) degrees, got {angle}")
        f = 0.5 * size / math.tan(math.radians(0.5 * angle))
        return cls(f, f, 0.5 * width, 0.5 * height, width, height)
