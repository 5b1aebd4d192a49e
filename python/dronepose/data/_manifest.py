"""What writers and readers of the project's layout agree on."""

from __future__ import annotations

FORMAT = "dronepose-folder-1"
SPLITS = ("train", "val", "test")
CONVENTIONS = {
    "pose": "cam_from_model: p_cam = R p_model + t",
    "camera_axes": "OpenCV: x right, y down, z forward",
    "unit": "m",
    "quaternion": "Hamilton, scalar first",
    "pixel_centre": 0.5,
}
