"""Images with a known pose: data sets, augmentation and loaders for training.

Every data set gives :class:`Sample`: an image, its camera matrix with pixel centres at ``+ 0.5``,
and the pose ``cam_from_model`` (OpenCV axes, metres). What is missing or broken is named by file,
line and sample.

Names are imported when they are first used: :func:`write_toyset` needs OpenCV only, the data sets
need ``pip install "dronepose[train]"``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dronepose.data._errors import DataError
    from dronepose.data.augment import GeometricAugmentation, PhotometricAugmentation
    from dronepose.data.bop import BopDataset
    from dronepose.data.folder import FolderDataset, read_manifest
    from dronepose.data.module import PoseDataModule
    from dronepose.data.sample import PoseDataset, Raw, Sample
    from dronepose.data.toyset import ToySettings, render_toy_sample, write_toyset
    from dronepose.data.uava import UavaDataset

_HOME = {
    "BopDataset": "bop",
    "DataError": "_errors",
    "FolderDataset": "folder",
    "GeometricAugmentation": "augment",
    "PhotometricAugmentation": "augment",
    "PoseDataModule": "module",
    "PoseDataset": "sample",
    "Raw": "sample",
    "Sample": "sample",
    "ToySettings": "toyset",
    "UavaDataset": "uava",
    "read_manifest": "folder",
    "render_toy_sample": "toyset",
    "write_toyset": "toyset",
}

__all__ = [
    "BopDataset",
    "DataError",
    "FolderDataset",
    "GeometricAugmentation",
    "PhotometricAugmentation",
    "PoseDataModule",
    "PoseDataset",
    "Raw",
    "Sample",
    "ToySettings",
    "UavaDataset",
    "read_manifest",
    "render_toy_sample",
    "write_toyset",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'dronepose.data' has no attribute {name!r}")
    try:
        value = getattr(import_module(f"dronepose.data.{_HOME[name]}"), name)
    except ModuleNotFoundError as error:
        absent = (error.name or "").partition(".")[0]
        if absent == "dronepose":
            raise
        raise ImportError(
            f"dronepose.data.{name} needs {absent}, which is not installed: "
            'pip install "dronepose[train]"'
        ) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
