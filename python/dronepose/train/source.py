"""What training needs to know about its data beside the samples: mesh and camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dronepose.camera import Camera

if TYPE_CHECKING:
    from dronepose.data import PoseDataModule


def mesh_file(given: str | None, data: PoseDataModule) -> Path | None:
    """The mesh that was asked for, or that of the data set; ``None`` if there is neither."""
    if given is not None:
        return Path(given)
    found: Path | None = getattr(data.training_set(), "mesh_file", None)
    return found


def camera_of(data: PoseDataModule) -> Camera | None:
    """The camera of the images as they are trained on; ``None`` if each has its own."""
    found: Camera | None = getattr(data.training_set(), "camera", None)
    if found is None or data.height is None or data.width is None:
        return found
    across, down = data.width / found.width, data.height / found.height
    return Camera(
        found.fx * across,
        found.fy * down,
        found.cx * across,
        found.cy * down,
        skew=found.skew * across,
        width=data.width,
        height=data.height,
    )
