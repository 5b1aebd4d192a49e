"""Weights in files: safetensors with metadata, and the checkpoints of others."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from dronepose._files import beside
from dronepose.model.checkpoints import own_state
from dronepose.model.metadata import WeightsError, decode, encode
from dronepose.model.network import PoseNet

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from torch import Tensor

__all__ = ["load_weights", "model_from_file", "read_metadata", "save_weights"]

_SHOWN = 4  # names in a message


def save_weights(
    model: PoseNet, path: str | os.PathLike[str], metadata: Mapping[str, Any] | None = None
) -> None:
    """Write a network as safetensors; the file appears when it is complete.

    Args:
        model: The network.
        path: A name that ends in ``.safetensors``; its folder exists.
        metadata: As :func:`dronepose.model.metadata.encode` takes it: ``mesh_sha256``,
            ``intrinsics``, ``image_size``, ``config``, ``metrics``, ``seed``, ... The
            architecture, the conventions and the versions are added.

    Returns:
        Nothing.

    Raises:
        TypeError: ``model`` is no :class:`PoseNet`, or a value of the metadata is of a wrong type.
        ValueError: The name or the metadata is wrong, or (:class:`WeightsError`) a weight is not
            finite.
        OSError: The file cannot be written.

    Example:
        >>> import tempfile, torch
        >>> from dronepose.model import PoseNet, read_metadata, save_weights
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = f"{folder}/w.safetensors"
        ...     save_weights(PoseNet("resnet18", hidden=(16,)), path, {"seed": 7})
        ...     read_metadata(path)["seed"]
        7
    """
    if not isinstance(model, PoseNet):
        raise TypeError(f"model: expected a PoseNet, got {type(model).__name__}")
    target = Path(path)
    if target.suffix.lower() != ".safetensors":
        raise ValueError(f"path: expected a name that ends in .safetensors, got {str(path)!r}")
    texts = encode(full_metadata(model, metadata))
    state = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    _check_finite(state, str(target))
    with beside(target) as part:
        save_file(state, part, texts)


def full_metadata(model: PoseNet, metadata: Mapping[str, Any] | None) -> dict[str, Any]:
    """Metadata with what the network and this machine add."""
    return {
        **(metadata or {}),
        "architecture": model.architecture,
        "torch_version": str(torch.__version__),
    }


def read_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a file of weights says about itself; its tensors are not read.

    Args:
        path: A ``.safetensors`` or ``.onnx`` file of this project.

    Returns:
        Values by key, as :func:`dronepose.model.metadata.decode` gives them.

    Raises:
        OSError: The file cannot be read.
        ImportError: It is an ONNX file and ``onnx`` is not installed.
        WeightsError: It is damaged, or holds no metadata of this project.

    Example:
        See :func:`save_weights`.

        >>> from dronepose.model import read_metadata
        >>> read_metadata("examples/quadrotor.obj")
        Traceback (most recent call last):
        ...
        dronepose.model.metadata.WeightsError: examples/quadrotor.obj: expected .safetensors or .onnx
    """  # noqa: E501 - a message on one line
    file = _existing(path)
    suffix = file.suffix.lower()
    if suffix == ".safetensors":
        return decode(_header(file), str(file))
    if suffix == ".onnx":
        from dronepose.model.onnx_export import onnx_texts

        return decode(onnx_texts(file), str(file))
    raise WeightsError(f"{file}: expected .safetensors or .onnx")


def load_weights(
    model: PoseNet | None, path: str | os.PathLike[str], *, strict: bool = True
) -> PoseNet:
    """Weights from a file into a network. Never runs code that a file holds.

    Understood are: files of :func:`save_weights`; the authors' published checkpoints (keys
    ``model.*`` and ``head.*``, with or without the ``module.`` of ``DataParallel``, alone or under
    ``model_state_dict`` or ``state_dict``); checkpoints of PyTorch Lightning that contain a
    :class:`PoseNet`; and weights of a backbone alone as torchvision publishes them, which replace
    the backbone's.

    The authors' network predicts in the OpenGL camera frame (y up, z backward), as the projection
    in their ``supervision/losses.py`` shows. Both heads are linear and Gram-Schmidt commutes with
    rotations, so the rows of y and z of the heads change sign here and the network loaded predicts
    in the OpenCV frame.

    Args:
        model: The network, changed in place; or ``None`` to build the one that the file describes
            (the authors': ``PoseNet()``).
        path: ``.safetensors``; or ``.pth``, ``.pt``, ``.ckpt``, read with ``weights_only=True``.
        strict: Refuse a file that lacks weights of the network, has others, or was saved for other
            arguments. If not, what fits by name is taken.

    Returns:
        The network.

    Raises:
        TypeError: ``model`` is no :class:`PoseNet`.
        OSError: The file cannot be read.
        WeightsError: The file is damaged, needs code to be read, belongs to another network, or
            holds a weight that is not finite.

    Example:
        >>> import tempfile, torch
        >>> from dronepose.model import PoseNet, load_weights, save_weights
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = f"{folder}/w.safetensors"
        ...     save_weights(PoseNet("resnet18", hidden=(16,)), path)
        ...     load_weights(None, path).architecture["backbone"]
        'resnet18'
    """
    if model is not None and not isinstance(model, PoseNet):
        raise TypeError(f"model: expected a PoseNet or None, got {type(model).__name__}")
    file = _existing(path)
    architecture: dict[str, Any] | None = None
    if file.suffix.lower() == ".safetensors":
        texts = _header(file)
        if "format" in texts:
            architecture = decode(texts, str(file)).get("architecture")
        try:
            found: Any = load_file(file)
        except SafetensorError as error:
            raise WeightsError(f"{file}: not a complete safetensors file: {error}") from error
    elif file.suffix.lower() in (".pth", ".pt", ".ckpt", ".tar"):
        found = _unpickled(file)
    else:
        raise WeightsError(f"{file}: expected .safetensors, .pth, .pt or .ckpt")
    kind, state = own_state(found, str(file))
    _check_finite(state, str(file))
    if model is None:
        model = _built(kind, architecture, file)
    elif strict and architecture is not None:
        _compare(architecture, model.architecture, file)
    target: torch.nn.Module = model.backbone if kind == "backbone" else model
    _fill(target, state, file, strict=strict)
    return model


def model_from_file(path: str | os.PathLike[str]) -> PoseNet:
    """The network that a file of weights describes, with its weights, in evaluation mode.

    Args:
        path: A file of :func:`save_weights`, or a checkpoint of the authors.

    Returns:
        The network.

    Raises:
        OSError: The file cannot be read.
        WeightsError: As :func:`load_weights`.

    Example:
        >>> import tempfile
        >>> from dronepose.model import PoseNet, model_from_file, save_weights
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = f"{folder}/w.safetensors"
        ...     save_weights(PoseNet("resnet18", hidden=(16,)), path)
        ...     model_from_file(path).training
        False
    """
    return load_weights(None, path).eval()


def _existing(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    if not file.is_file():
        what = "is a folder" if file.is_dir() else "no such file"
        raise FileNotFoundError(f"cannot read {file}: {what}")
    return file


def _header(file: Path) -> dict[str, str]:
    try:
        with safe_open(file, framework="np") as opened:
            return dict(opened.metadata() or {})
    except SafetensorError as error:
        raise WeightsError(f"{file}: not a complete safetensors file: {error}") from error


def _unpickled(file: Path) -> Any:
    try:
        return torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise WeightsError(
            f"{file}: holds Python objects besides tensors (such as a whole module), and reading "
            "them would run code from the file (weights_only=True refuses it); expected a "
            "dictionary of tensors. Where the file is trusted and its code installed, convert it: "
            'torch.save({"model_state_dict": torch.load(OLD, weights_only=False).state_dict()}, '
            f"NEW). It said: {str(error).splitlines()[0]}"
        ) from error
    except (RuntimeError, EOFError, ValueError) as error:
        raise WeightsError(f"{file}: not a checkpoint of torch: {error}") from error


def _built(kind: str, architecture: dict[str, Any] | None, file: Path) -> PoseNet:
    """The network that a file describes."""
    if kind == "authors":
        return PoseNet()
    if architecture is None or kind == "backbone":
        raise WeightsError(
            f"{file}: does not say which network it belongs to; expected metadata with "
            "'architecture', or build the PoseNet first and pass it as model"
        )
    try:
        return PoseNet(**architecture)
    except (TypeError, ValueError) as error:
        raise WeightsError(f"{file}: metadata 'architecture': {error}") from error


def _compare(saved: Mapping[str, Any], wanted: Mapping[str, Any], file: Path) -> None:
    for key, value in wanted.items():
        if saved.get(key, value) != value:
            raise WeightsError(
                f"{file}: was saved for {key}={saved[key]!r}, but this network has {key}={value!r}"
            )


def _fill(target: torch.nn.Module, state: dict[str, Tensor], file: Path, *, strict: bool) -> None:
    own = target.state_dict()
    # Checkpoints of old versions of torch do not count batches.
    missing = [n for n in own if n not in state and not n.endswith("num_batches_tracked")]
    others = [name for name in state if name not in own]
    shared = {name: value for name, value in state.items() if name in own}
    if (strict and (missing or others)) or not shared:
        parts = [
            f"{what} {len(names)} ({', '.join(names[:_SHOWN])}{', ...' * (len(names) > _SHOWN)})"
            for what, names in (("lacks", missing), ("has besides", others))
            if names
        ]
        raise WeightsError(
            f"{file}: belongs to another network: of {len(own)} expected tensors it "
            + "; ".join(parts)
        )
    for name, value in shared.items():
        if value.shape != own[name].shape:
            raise WeightsError(
                f"{file}: belongs to another network: {name} has shape {tuple(value.shape)}, "
                f"expected {tuple(own[name].shape)}"
            )
    target.load_state_dict(shared, strict=False)


def _check_finite(state: Mapping[str, Tensor], source: str) -> None:
    for name, value in state.items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise WeightsError(f"{source}: {name} holds numbers that are not finite")
