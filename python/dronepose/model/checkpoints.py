"""Names of weights in the checkpoints of others, and ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import torch
from torch import Tensor

from dronepose.model.metadata import WeightsError

Kind = Literal["own", "authors", "backbone"]

# VCL3D/DronePose, models/__init__.py (Model, get_model) and models/continuous.py: what their
# modules are called, and what ours are.
_AUTHORS = {
    "model.fc.": "embedding.",
    "model.": "backbone.",
    "head.linear_1.": "layers.0.",
    "head.linear_2.": "layers.1.",
    "head.linear_3.": "layers.2.",
    "head.fc_position.": "translation.",
    "head.fc_rotation.": "rotation.",
}
_OWN = ("embedding.weight", "rotation.weight")


def own_state(found: Any, source: str) -> tuple[Kind, dict[str, Tensor]]:
    """The tensors of a checkpoint under our names.

    Args:
        found: What the file holds.
        source: Name of the file, for messages.

    Returns:
        Whose checkpoint it is, and its tensors by our names.

    Raises:
        WeightsError: It holds no weights.
    """
    state = _tensors(found, source)
    for prefix in _prefixes(state, _OWN):
        return "own", _below(state, prefix)
    for prefix in _prefixes(state, ("head.fc_position.weight", "head.fc_rotation.weight")):
        return "authors", _from_authors(_below(state, prefix), source)
    # A whole classifier: its last layers have no counterpart here.
    backbone = {
        name: value
        for name, value in state.items()
        if not name.startswith(("fc.", "classifier.", "AuxLogits."))
    }
    return "backbone", backbone


def _tensors(found: Any, source: str) -> dict[str, Tensor]:
    """The dictionary of tensors, out of what trainers wrap around it."""
    for key in ("model_state_dict", "state_dict"):
        if isinstance(found, Mapping) and isinstance(found.get(key), Mapping):
            found = found[key]
    if not isinstance(found, Mapping) or not found:
        raise WeightsError(
            f"{source}: expected a dictionary of tensors by name, or one under "
            f"'model_state_dict' or 'state_dict', found {type(found).__name__}"
        )
    odd = [key for key, v in found.items() if not isinstance(v, Tensor) or not isinstance(key, str)]
    if odd:
        raise WeightsError(
            f"{source}: expected a dictionary of tensors by name, or one under "
            f"'model_state_dict' or 'state_dict'; {odd[0]!r} is no tensor"
        )
    state = dict(found)
    while all(name.startswith("module.") for name in state):  # DataParallel
        state = {name.removeprefix("module."): value for name, value in state.items()}
    return state


def _prefixes(state: Mapping[str, Tensor], names: tuple[str, ...]) -> list[str]:
    """What stands before all of the names."""
    first = [key.removesuffix(names[0]) for key in state if key.endswith(names[0])]
    whole = [p for p in first if p == "" or p.endswith(".")]
    return [p for p in whole if all(p + name in state for name in names)]


def _below(state: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}


def _from_authors(state: Mapping[str, Tensor], source: str) -> dict[str, Tensor]:
    own: dict[str, Tensor] = {}
    for name, value in state.items():
        for theirs, ours in _AUTHORS.items():
            if name.startswith(theirs):
                own[ours + name.removeprefix(theirs)] = value
                break
        else:
            own[name] = value  # is refused by name
    # From the OpenGL camera frame to that of OpenCV: diag(1, -1, -1) from the left.
    for name in ("translation.weight", "translation.bias", "rotation.weight"):
        if name not in own or own[name].shape[0] % 3:
            raise WeightsError(f"{source}: expected a head of 3 or 6 numbers for {name}")
        value = own[name]
        signs = torch.tensor([1.0, -1.0, -1.0], dtype=value.dtype).repeat(value.shape[0] // 3)
        own[name] = value * signs.view(-1, *[1] * (value.ndim - 1))
    return own
