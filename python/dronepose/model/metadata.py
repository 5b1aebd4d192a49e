"""What a file of weights says about itself: network, mesh, camera, conventions, training.

The same keys are in the header of a ``.safetensors`` file and in the ``metadata_props`` of an ONNX
model; both formats hold texts only, so everything but a text is JSON. Needs neither torch nor
torchvision.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose._native import __version__
from dronepose.camera import Camera

if TYPE_CHECKING:
    import os

__all__ = ["CONVENTIONS", "FORMAT", "WeightsError", "decode", "encode", "file_sha256"]

FORMAT = "dronepose-weights/1"
CONVENTIONS = (
    "cam_from_model, p_cam = R p_model + t; OpenCV camera (x right, y down, z forward), metres; "
    "K in pixels of image_size, pixel centres at +0.5; images RGB in [0, 1]"
)

_TEXT = frozenset({"format", "conventions", "dronepose_version", "torch_version", "mesh_sha256"})
_JSON = frozenset(
    {"architecture", "config", "extra", "image_size", "intrinsics", "metrics", "seed"}
)


class WeightsError(ValueError):
    """A file of weights that cannot be used; the message names the file and what was expected."""


def file_sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, such as a mesh, in lower-case hexadecimal.

    Args:
        path: The file.

    Returns:
        64 digits.

    Raises:
        OSError: The file cannot be read.

    Example:
        >>> len(file_sha256("examples/quadrotor.obj"))
        64
    """
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def encode(metadata: Mapping[str, Any] | None = None) -> dict[str, str]:
    """Check metadata and turn every value into a text.

    Args:
        metadata: Any of ``architecture`` (the arguments of ``PoseNet``), ``mesh_sha256``,
            ``intrinsics`` (a :class:`dronepose.Camera`, which gives ``image_size`` too, or a
            ``(3, 3)`` matrix in pixels), ``image_size`` (``(height, width)`` of the network's
            input), ``conventions``, ``config``, ``metrics``, ``seed``, ``torch_version``, and
            ``extra`` for anything else. ``None`` values are left out.

    Returns:
        Texts by key, with ``format``, ``conventions`` and ``dronepose_version``.

    Raises:
        TypeError: A value is of a wrong type or cannot be written as JSON.
        ValueError: A key is unknown or a value is wrong; the message starts with
            ``metadata[KEY]``.

    Example:
        >>> encode({"image_size": (240, 320)})["image_size"]
        '[240, 320]'
    """
    given = {} if metadata is None else {k: v for k, v in metadata.items() if v is not None}
    unknown = sorted(set(given) - _TEXT - _JSON)
    if unknown:
        raise ValueError(
            f"metadata[{unknown[0]!r}]: expected one of {', '.join(sorted(_TEXT | _JSON))}"
        )
    camera = given.get("intrinsics")
    if isinstance(camera, Camera):
        given["intrinsics"] = camera.K
        given.setdefault("image_size", (camera.height, camera.width))
    given = {
        "conventions": CONVENTIONS,
        **given,
        "format": FORMAT,
        "dronepose_version": __version__,
    }
    return {key: _text(key, value) for key, value in sorted(given.items())}


def decode(texts: Mapping[str, str] | None, source: str) -> dict[str, Any]:
    """The opposite of :func:`encode`.

    Args:
        texts: As in the file; keys that this version does not know are left as they are.
        source: Name of the file, for messages.

    Returns:
        Values by key: ``intrinsics`` a ``(3, 3)`` float64 array, ``image_size`` a tuple.

    Raises:
        WeightsError: It is not the metadata of this project, or a value is damaged.

    Example:
        >>> decode(encode({"seed": 3}), "w.safetensors")["seed"]
        3
    """
    found = texts or {}
    form = found.get("format")
    if form != FORMAT:
        raise WeightsError(
            f"{source}: expected metadata of dronepose with format {FORMAT!r}, "
            f"found {'none' if form is None else repr(form)}"
        )
    values: dict[str, Any] = {}
    for key, text in found.items():
        if key not in _JSON:
            values[key] = text
            continue
        try:
            values[key] = json.loads(text)
            _text(key, values[key])
        except (TypeError, ValueError) as error:
            raise WeightsError(f"{source}: metadata {key!r} is damaged: {error}") from error
    if "intrinsics" in values:
        values["intrinsics"] = np.array(values["intrinsics"], dtype=np.float64)
    if "image_size" in values:
        height, width = values["image_size"]
        values["image_size"] = (height, width)
    return values


def _text(key: str, value: Any) -> str:
    """One value as text, checked."""
    if key in _TEXT:
        if not isinstance(value, str):
            raise TypeError(f"metadata[{key!r}]: expected a text, got {type(value).__name__}")
        if key == "mesh_sha256" and not re.fullmatch(r"[0-9a-f]{64}", value):
            raise ValueError(
                f"metadata['mesh_sha256']: expected 64 hexadecimal digits in lower case, "
                f"got {value!r}"
            )
        return value
    if key == "intrinsics":
        value = _intrinsics(value)
    elif key == "image_size":
        value = _image_size(value)
    elif key == "seed" and (isinstance(value, bool) or not isinstance(value, int)):
        raise TypeError(f"metadata['seed']: expected an integer, got {value!r}")
    elif key in ("architecture", "extra") and not isinstance(value, Mapping):
        raise TypeError(f"metadata[{key!r}]: expected a mapping, got {type(value).__name__}")
    try:
        return json.dumps(value, allow_nan=False, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise type(error)(f"metadata[{key!r}]: cannot be written as JSON: {error}") from error


def _intrinsics(value: Any) -> list[list[float]]:
    try:
        k = np.asarray(value, dtype=np.float64)
        if k.shape != (3, 3):
            raise ValueError(f"expected shape (3, 3), got {k.shape}")
        Camera.from_K(k, 1, 1)
    except (TypeError, ValueError) as error:
        raise ValueError(f"metadata['intrinsics']: {error}") from error
    rows: list[list[float]] = k.tolist()
    return rows


def _image_size(value: Any) -> list[int]:
    try:
        numbers = [float(v) for v in value]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 2 or not all(math.isfinite(v) and v == int(v) and v >= 1 for v in numbers):
        raise ValueError(
            f"metadata['image_size']: expected (height, width) in pixels, got {value!r}"
        )
    return [int(v) for v in numbers]
