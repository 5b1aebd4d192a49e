"""A flight and a scene's anchors to try things out with, for who has neither."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dronepose._files import beside
from dronepose.geometry import quat_wxyz_from_matrix

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SECONDS, ROWS_A_SECOND = 30, 50
SPACING = 2.5
GRAVITY = 9.81


def example_anchors() -> Array:
    """Twelve places in four by three rooms, ``(12, 3)`` metres.

    Returns:
        The anchors, at the height of eyes.

    Example:
        >>> example_anchors().shape
        (12, 3)
    """
    return np.array(
        [[SPACING * (k % 4), SPACING * (k // 4), 1.5 + 0.04 * (k % 3)] for k in range(12)]
    )


def example_flight() -> tuple[Array, Array, Array]:
    """A smooth flight through these rooms: a Lissajous figure, nose ahead, tilted as it speeds up.

    Returns:
        ``(N,)`` seconds, ``(N, 3)`` metres, ``(N, 4)`` ``world_from_body``, scalar first.

    Example:
        >>> time, positions, quat_wxyz = example_flight()
        >>> len(time) == len(positions) == len(quat_wxyz)
        True
    """
    time = np.arange(SECONDS * ROWS_A_SECOND + 1) / ROWS_A_SECOND
    turns = 2 * np.pi * np.array([2, 3, 5]) / SECONDS
    size = np.array([1.5 * SPACING + 0.4, SPACING + 0.4, 0.4])
    middle = np.array([1.5 * SPACING, SPACING, 1.5])
    phase = time[:, None] * turns + np.array([0.3, 0.0, 1.0])
    positions = middle + size * np.sin(phase)
    velocity = size * turns * np.cos(phase)
    thrust = -size * turns**2 * np.sin(phase) + np.array([0.0, 0.0, GRAVITY])
    up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    left = np.cross(up, velocity)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    R = np.stack([np.cross(left, up), left, up], axis=2)
    return time, positions, quat_wxyz_from_matrix(R)


def write_example(folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Writes the example: ``flight.txt`` (TUM) and ``anchors.csv``.

    Args:
        folder: Where to; made if it is not there.

    Returns:
        The paths, ``flight`` and ``anchors``.

    Raises:
        OSError: They cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as name:
        ...     sorted(path.name for path in write_example(name).values())
        ['anchors.csv', 'flight.txt']
    """
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    time, positions, quat_wxyz = example_flight()
    lines = ["# time(s) x y z qx qy qz qw, world z up, body forward-left-up"]
    for t, p, q in zip(time, positions, np.roll(quat_wxyz, -1, axis=1), strict=True):
        lines.append(" ".join([f"{t:.2f}", *(f"{x:.7f}" for x in (*p, *q))]))
    anchors = ["id,x,y,z"]
    anchors += [f"room-{k:02d},{x},{y},{z}" for k, (x, y, z) in enumerate(example_anchors())]
    paths = {"flight": root / "flight.txt", "anchors": root / "anchors.csv"}
    for name, text in (("flight", lines), ("anchors", anchors)):
        with beside(paths[name]) as part:
            part.write_text("\n".join(text) + "\n", encoding="utf-8")
    return paths
