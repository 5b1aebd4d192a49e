"""The pose network: an image in, a rotation and a translation out; its weights, and ONNX.

A backbone of torchvision, fully connected layers with ELU, a rotation in the continuous 6D form
and a translation: DronePose, section 4 (Albanis et al., ECCV workshops 2020); Zhou et al., "On the
Continuity of Rotation Representations in Neural Networks", CVPR 2019. Nothing is ever downloaded.

Names are imported when they are first used: ``dronepose.model.metadata`` works without torch, the
rest needs ``pip install "dronepose[train]"``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dronepose.model.backbones import backbone_names
    from dronepose.model.metadata import WeightsError, file_sha256
    from dronepose.model.network import PoseNet, PoseOutput
    from dronepose.model.onnx_export import OnnxReport, export_onnx
    from dronepose.model.weights import load_weights, model_from_file, read_metadata, save_weights

__all__ = [
    "OnnxReport",
    "PoseNet",
    "PoseOutput",
    "WeightsError",
    "backbone_names",
    "export_onnx",
    "file_sha256",
    "load_weights",
    "model_from_file",
    "read_metadata",
    "save_weights",
]

_HOME = {
    "OnnxReport": "onnx_export",
    "PoseNet": "network",
    "PoseOutput": "network",
    "WeightsError": "metadata",
    "backbone_names": "backbones",
    "export_onnx": "onnx_export",
    "file_sha256": "metadata",
    "load_weights": "weights",
    "model_from_file": "weights",
    "read_metadata": "weights",
    "save_weights": "weights",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'dronepose.model' has no attribute {name!r}")
    try:
        module = import_module(f"dronepose.model.{_HOME[name]}")
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing == "dronepose":
            raise
        wanted = "onnx onnxscript onnxruntime" if "onnx" in missing else '"dronepose[train]"'
        raise ImportError(
            f"dronepose.model.{name} needs {missing}, which is not installed: pip install {wanted}"
        ) from error
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
