"""Errors of 6D poses, one number for each pose; the loops are in Rust, on all cores.

A pose is ``cam_from_model``: ``p_cam = R @ p_model + t`` with ``R`` a rotation matrix and ``t`` in
metres, OpenCV camera frame (x right, y down, z forward).

Shapes: ``R`` is ``(..., 3, 3)`` and ``t`` is ``(..., 3)``, float32 or float64; the leading axes of
all arguments broadcast as in NumPy, and the result has their common shape, ``()`` for single
poses. Results are float64. An empty batch gives an empty result.

Rotations: a matrix that departs from orthonormality (largest element of ``|R R^T - I|``) by at
most 1e-2 is replaced by the nearest rotation, with a ``UserWarning`` above 1e-5, which single
precision stays below; anything else is refused with a ``ValueError`` that names argument and row.
An argument that holds no real numbers is a ``TypeError``.

Every function takes ``threads``: 0 uses all cores. The result does not depend on it.

"DronePose" is Albanis et al., "DronePose: Photorealistic UAV-Assistant Dataset Synthesis for 3D
Pose Estimation via a Smooth Silhouette Loss", ECCV Workshops 2020, whose section 5, "Metrics",
names the metrics of its tables.

Example:
    >>> import numpy as np
    >>> from dronepose import Mesh, metrics
    >>> mesh = Mesh.from_file("examples/quadrotor.obj")
    >>> R, t = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 4.0]])
    >>> metrics.add(mesh, R, t + [0.03, 0.0, 0.04], R, t).round(9).tolist()
    [0.05, 0.05]
    >>> metrics.npe(t + [0.0, 0.0, 0.1], t).round(9).tolist()
    [0.05, 0.025]
"""

from dronepose.evaluation import evaluate
from dronepose.metrics.pose import (
    acc,
    cpe,
    npe,
    orientation_error,
    symmetric_orientation_error,
    translation_error,
)
from dronepose.metrics.projection import mspd, projection_error
from dronepose.metrics.scores import auc
from dronepose.metrics.symmetry import Symmetries
from dronepose.metrics.vertices import add, add_recall, adds, mssd

__all__ = [
    "Symmetries",
    "acc",
    "add",
    "add_recall",
    "adds",
    "auc",
    "cpe",
    "evaluate",
    "mspd",
    "mssd",
    "npe",
    "orientation_error",
    "projection_error",
    "symmetric_orientation_error",
    "translation_error",
]
