"""Poses in pictures, videos and cameras, drawn on the frames; runs from ONNX without torch.

Needs NumPy and OpenCV, and ``onnxruntime`` for ``.onnx`` files (or torch and its companions for
``.safetensors``): ``pip install "dronepose[video]" onnxruntime``.
"""

from __future__ import annotations

try:
    import cv2  # noqa: F401
except ImportError as error:
    raise ImportError(
        'dronepose.infer needs OpenCV, which is not installed: pip install "dronepose[video]"'
    ) from error

from dronepose.infer.filters import Track, jitter, noise, one_euro, rts
from dronepose.infer.frames import Fit
from dronepose.infer.overlay import Style, color, draw
from dronepose.infer.predictor import Predictor
from dronepose.infer.sources import Source

__all__ = [
    "Fit",
    "Predictor",
    "Source",
    "Style",
    "Track",
    "color",
    "draw",
    "jitter",
    "noise",
    "one_euro",
    "rts",
]
