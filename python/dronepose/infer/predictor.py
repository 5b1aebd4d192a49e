"""A network from a file: ONNX by onnxruntime, safetensors by torch; arrays in, arrays out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dronepose.model.metadata import WeightsError, decode

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    Images = NDArray[np.float32]
    Poses = tuple[NDArray[np.float64], NDArray[np.float64]]

__all__ = ["Predictor"]


class _Engine(Protocol):
    def __call__(self, images: Images, K: Images) -> tuple[Any, Any]: ...


class Predictor:
    """Poses of images, from a ``.onnx`` or a ``.safetensors`` file.

    Args:
        path: The weights. An ``.onnx`` file needs onnxruntime only, a ``.safetensors`` file torch.
        threads: Threads of the network; 0 for all cores.

    Attributes:
        path: The file.
        metadata: What it says about itself.
        aware: Whether the network takes the camera into account.
        image_size: ``(height, width)`` of its images.

    Raises:
        OSError: The file cannot be read.
        ImportError: onnxruntime, or torch and its companions, are not installed.
        ValueError: (:class:`dronepose.model.WeightsError`) it is no file of this project, or
            damaged.

    Example:
        >>> Predictor("examples/gt.csv")
        Traceback (most recent call last):
        ...
        dronepose.model.metadata.WeightsError: examples/gt.csv: expected weights: .onnx or .safetensors
    """  # noqa: E501 - a message on one line

    def __init__(self, path: str | os.PathLike[str], threads: int = 0) -> None:
        if isinstance(threads, bool) or threads < 0:
            raise ValueError(f"threads: expected 0 or more, got {threads}")
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"cannot read {self.path}: no such file")
        suffix = self.path.suffix.lower()
        self._run: _Engine
        if suffix == ".onnx":
            self._run, self.metadata = _onnx(self.path, threads)
        elif suffix == ".safetensors":
            self._run, self.metadata = _torch(self.path, threads)
        else:
            raise WeightsError(f"{self.path}: expected weights: .onnx or .safetensors")
        architecture = self.metadata.get("architecture", {})
        self.aware: bool = architecture.get("camera") is not None
        if "image_size" not in self.metadata:
            raise WeightsError(
                f"{self.path}: does not say the size of its images; write it again with "
                "metadata 'image_size' (`dronepose export --size`)"
            )
        self.image_size: tuple[int, int] = self.metadata["image_size"]

    def __call__(self, images: Images, K: NDArray[np.float64]) -> Poses:
        """The pose in each image.

        Args:
            images: ``(B, 3, H, W)`` float32 RGB in ``[0, 1]``, of :attr:`image_size`.
            K: ``(3, 3)`` in pixels of the images; used by networks that are aware of the camera.

        Returns:
            ``R`` ``(B, 3, 3)`` and ``t`` ``(B, 3)`` float64, metres.

        Raises:
            ValueError: The images have another shape, or a pose is not finite.
        """
        if images.ndim != 4 or images.shape[1:] != (3, *self.image_size):
            raise ValueError(
                f"images: expected shape (B, 3, {self.image_size[0]}, {self.image_size[1]}), "
                f"got {images.shape}"
            )
        cameras = np.broadcast_to(np.asarray(K, dtype=np.float32), (len(images), 3, 3))
        R, t = self._run(images, np.array(cameras))
        found = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
        if not all(np.isfinite(each).all() for each in found):
            raise ValueError(f"{self.path}: predicted a pose that is not finite")
        if not np.allclose(found[0] @ found[0].swapaxes(1, 2), np.eye(3), atol=1e-3):
            raise ValueError(f"{self.path}: predicted a matrix that is no rotation")
        return found


def _onnx(path: Path, threads: int) -> tuple[_Engine, dict[str, Any]]:
    try:
        import onnxruntime  # type: ignore[import-untyped,unused-ignore]
    except ImportError as error:
        raise ImportError(
            f"{path}: needs onnxruntime, which is not installed: pip install onnxruntime"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # its own classes
        raise WeightsError(f"{path}: onnxruntime cannot read it: {error}") from error
    metadata = decode(session.get_modelmeta().custom_metadata_map, str(path))
    inputs = [each.name for each in session.get_inputs()]
    outputs = [each.name for each in session.get_outputs()]
    if inputs[:1] != ["image"] or set(inputs) - {"image", "K"} or outputs != ["R", "t"]:
        raise WeightsError(
            f"{path}: expected inputs image (and K) and outputs R, t; found inputs {inputs}, "
            f"outputs {outputs}"
        )

    def run(images: Images, K: Images) -> tuple[Any, Any]:
        given = {"image": images, "K": K}
        R, t = session.run(["R", "t"], {name: given[name] for name in inputs})
        return R, t

    return run, metadata


def _torch(path: Path, threads: int) -> tuple[_Engine, dict[str, Any]]:
    try:
        import torch

        from dronepose.model import model_from_file, read_metadata
    except ImportError as error:
        raise ImportError(
            f'{path}: needs torch: pip install "dronepose[train]"; '
            "an .onnx file (`dronepose export`) runs without it"
        ) from error
    metadata = read_metadata(path)
    model = model_from_file(path)
    if threads:
        torch.set_num_threads(threads)

    def run(images: Images, K: Images) -> tuple[Any, Any]:
        with torch.inference_mode():
            R, t = model(torch.from_numpy(images), torch.from_numpy(K))
        return R.numpy(), t.numpy()

    return run, metadata
