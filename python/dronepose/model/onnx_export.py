"""The network as an ONNX file, checked in onnxruntime against torch."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import onnx
import onnxruntime  # type: ignore[import-untyped,unused-ignore]
import onnxscript  # noqa: F401 - the exporter's, asked for before the work begins
import torch
from torch import nn

from dronepose._files import beside
from dronepose.model.metadata import WeightsError, encode
from dronepose.model.network import PoseNet
from dronepose.model.weights import full_metadata

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from torch import Tensor

__all__ = ["OnnxReport", "export_onnx"]

#: Largest difference of an output, absolute, that an export may have (metres, or of a matrix).
TOLERANCE = 1e-4
_BATCHES = (1, 3)


@dataclass(frozen=True, slots=True)
class OnnxReport:
    """What :func:`export_onnx` wrote.

    Attributes:
        path: The file.
        opset: Version of the operators.
        inputs: Names of the inputs.
        max_difference: Largest difference to torch, of all outputs, over the batches tried.
    """

    path: Path
    opset: int
    inputs: tuple[str, ...]
    max_difference: float


def export_onnx(
    model: PoseNet,
    path: str | os.PathLike[str],
    *,
    height: int,
    width: int,
    opset: int = 18,
    metadata: Mapping[str, Any] | None = None,
) -> OnnxReport:
    """Write a network as ONNX and compare it with torch in onnxruntime.

    Input ``image`` ``(B, 3, height, width)`` float32 RGB in ``[0, 1]``, and ``K`` ``(B, 3, 3)`` if
    the network is aware of the camera; outputs ``R`` ``(B, 3, 3)`` and ``t`` ``(B, 3)``, metres;
    ``B`` is free. Images are normalised inside.

    Args:
        model: The network; its weights and mode stay as they are.
        path: A name that ends in ``.onnx``; its folder exists. The file appears when it has been
            checked.
        height: Rows of the images, 32 or more.
        width: Columns of the images, 32 or more.
        opset: Version of the operators, 18 or more.
        metadata: As :func:`dronepose.model.save_weights` takes it, kept in ``metadata_props``.

    Returns:
        What was written, and the largest difference.

    Raises:
        TypeError: ``model`` is no :class:`PoseNet`.
        ValueError: An argument is out of its range, or (:class:`WeightsError`) the outputs differ
            by more than 1e-4.
        OSError: The file cannot be written.

    Example:
        >>> import tempfile
        >>> from dronepose.model import PoseNet, export_onnx
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     net = PoseNet("resnet18", hidden=(16,))
        ...     report = export_onnx(net, f"{folder}/m.onnx", height=32, width=32)
        ...     report.inputs, report.max_difference < 1e-4
        (('image',), True)
    """
    if not isinstance(model, PoseNet):
        raise TypeError(f"model: expected a PoseNet, got {type(model).__name__}")
    target = Path(path)
    if target.suffix.lower() != ".onnx":
        raise ValueError(f"path: expected a name that ends in .onnx, got {str(path)!r}")
    for name, value, least in (("height", height, 32), ("width", width, 32), ("opset", opset, 18)):
        if type(value) is not int or value < least:
            raise ValueError(f"{name}: expected a whole number of {least} or more, got {value!r}")
    given = {**full_metadata(model, metadata)}
    size = given.setdefault("image_size", (height, width))
    if tuple(size) != (height, width):
        raise ValueError(
            f"metadata['image_size']: is {tuple(size)}, but height and width are {(height, width)}"
        )
    texts = encode(given)
    was_training = model.training
    exported = _Tuple(model).eval()
    try:
        with beside(target) as part:
            _write(exported, part, height, width, opset)
            stored = onnx.load(part)
            onnx.helper.set_model_props(stored, texts)
            onnx.checker.check_model(stored)
            onnx.save(stored, part)
            difference = _compare(exported, part, height, width)
            if not difference <= TOLERANCE:
                raise WeightsError(
                    f"{target}: onnxruntime differs from torch by {difference:.3g}, "
                    f"expected at most {TOLERANCE:g}; not written"
                )
    finally:
        model.train(was_training)
    return OnnxReport(target, opset, exported.inputs, difference)


def onnx_texts(file: Path) -> dict[str, str]:
    """``metadata_props`` of an ONNX file."""
    try:
        model = onnx.load(file, load_external_data=False)
    except Exception as error:  # whatever protobuf raises
        raise WeightsError(f"{file}: not an ONNX file: {error}") from error
    return {prop.key: prop.value for prop in model.metadata_props}


class _Tuple(nn.Module):
    """The network with plain outputs and the inputs that it uses."""

    def __init__(self, model: PoseNet) -> None:
        super().__init__()
        self.model = model
        self.inputs = ("image",) if model.camera is None else ("image", "K")

    def forward(self, image: Tensor, K: Tensor | None = None) -> tuple[Tensor, Tensor]:
        R, t = self.model(image, K)
        return R, t

    def samples(self, batch: int, height: int, width: int) -> tuple[Tensor, ...]:
        """Images of noise, and cameras."""
        generator = torch.Generator().manual_seed(batch)
        like = next(self.model.parameters())
        image = torch.rand(batch, 3, height, width, generator=generator)
        f = 0.8 * width * (1.0 + 0.1 * torch.rand(batch, generator=generator))
        K = torch.zeros(batch, 3, 3)
        K[:, 0, 0] = K[:, 1, 1] = f
        K[:, 0, 2], K[:, 1, 2], K[:, 2, 2] = 0.5 * width, 0.5 * height, 1.0
        return tuple(v.to(like.device) for v in (image, K)[: len(self.inputs)])


def _write(exported: _Tuple, part: Path, height: int, width: int, opset: int) -> None:
    batch = torch.export.Dim("batch", min=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about its own parts
        torch.onnx.export(
            exported,
            exported.samples(2, height, width),
            part,
            input_names=list(exported.inputs),
            output_names=["R", "t"],
            opset_version=opset,
            dynamo=True,
            dynamic_shapes={name: {0: batch} for name in exported.inputs},
            external_data=False,
            verbose=False,
        )


def _compare(exported: _Tuple, part: Path, height: int, width: int) -> float:
    session = onnxruntime.InferenceSession(part, providers=["CPUExecutionProvider"])
    largest = 0.0
    for batch in _BATCHES:
        samples = exported.samples(batch, height, width)
        with torch.no_grad():
            expected = exported(*samples)
        feed = {n: v.cpu().numpy() for n, v in zip(exported.inputs, samples, strict=True)}
        for ours, theirs in zip(session.run(["R", "t"], feed), expected, strict=True):
            gap = (torch.from_numpy(ours) - theirs.cpu()).abs().max().item()
            largest = max(largest, gap) if gap == gap else float("inf")
    return largest
