"""Silhouettes with gradients and 6D pose metrics for drones, computed in Rust.

One convention everywhere: OpenCV camera (x right, y down, z forward), metres, radians; a pose is
``cam_from_model``, ``p_cam = R @ p_model + t``; quaternion arguments name their order.

Names are imported when they are first used, so that ``import dronepose`` loads neither NumPy nor
torch and the command ``dronepose-eval`` starts at once.

Example:
    >>> import dronepose
    >>> result = dronepose.evaluate("examples/predictions.csv", "examples/gt.csv")
    >>> result.metrics.acc["5"].percent_of_gt
    84.3
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dronepose import evaluation, geometry, metrics, render
    from dronepose._native import MeshError, __version__
    from dronepose.camera import Camera
    from dronepose.evaluation import Evaluation, evaluate
    from dronepose.mesh import Mesh, MeshCheck
    from dronepose.metrics import Symmetries

__all__ = [
    "Camera",
    "Evaluation",
    "Mesh",
    "MeshCheck",
    "MeshError",
    "Symmetries",
    "__version__",
    "evaluate",
    "evaluation",
    "geometry",
    "metrics",
    "render",
]

_HOME = {
    "Camera": "camera",
    "Evaluation": "evaluation",
    "Mesh": "mesh",
    "MeshCheck": "mesh",
    "MeshError": "_native",
    "Symmetries": "metrics",
    "__version__": "_native",
    "evaluate": "evaluation",
}
_MODULES = frozenset(
    {
        "camera",
        "cli",
        "data",
        "evaluation",
        "geometry",
        "infer",
        "losses",
        "mesh",
        "metrics",
        "model",
        "render",
        "synth",
        "torch",
        "train",
    }
)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"dronepose.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'dronepose' has no attribute {name!r}")
    value = getattr(import_module(f"dronepose.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
