"""Losses of poses and of silhouettes, for training.

Everything takes float32 or float64 tensors on any device, is safe under autocast (half precision is
computed from float32 copies) and in ``torch.compile``, and gives one number for each sample before
``reduction``: ``"mean"`` (with ``weight``, the weighted mean), ``"sum"`` or ``"none"``. On the CPU
the blurs and their gradients are in Rust, elsewhere the same formulas are torch's own. Masks are
``(B, H, W)`` in ``[0, 1]``; what the losses are good for is in ``docs/losses.md``. NaN in gives NaN
out. Each function says what it takes; needs ``pip install "dronepose[torch]"``.

"DronePose" is Albanis et al., "DronePose: Photorealistic UAV-Assistant Dataset Synthesis for 3D
Pose Estimation via a Smooth Silhouette Loss", ECCV Workshops 2020.
"""

try:
    import torch  # noqa: F401
except ImportError as error:
    raise ImportError(
        'dronepose.losses needs PyTorch, which is not installed: pip install "dronepose[torch]"'
    ) from error

from dronepose.losses.modules import (
    BlurredLoss,
    GIoULoss,
    IoULoss,
    OutlineLoss,
    PoseLoss,
    RotationLoss,
    SmoothLoss,
    TanimotoLoss,
    TotalLoss,
    TranslationLoss,
    silhouette_loss,
)
from dronepose.losses.overlap import giou_authors, giou_loss, iou_loss
from dronepose.losses.pose import (
    AUTHORS_LAMBDA_EXO,
    AUTHORS_LAMBDA_POSE,
    pose_loss,
    rotation_loss,
    total_loss,
    translation_loss,
)
from dronepose.losses.reach import blurred_loss, outline_loss, smooth_loss, tanimoto_loss

__all__ = [
    "AUTHORS_LAMBDA_EXO",
    "AUTHORS_LAMBDA_POSE",
    "BlurredLoss",
    "GIoULoss",
    "IoULoss",
    "OutlineLoss",
    "PoseLoss",
    "RotationLoss",
    "SmoothLoss",
    "TanimotoLoss",
    "TotalLoss",
    "TranslationLoss",
    "blurred_loss",
    "giou_authors",
    "giou_loss",
    "iou_loss",
    "outline_loss",
    "pose_loss",
    "rotation_loss",
    "silhouette_loss",
    "smooth_loss",
    "tanimoto_loss",
    "total_loss",
    "translation_loss",
]
