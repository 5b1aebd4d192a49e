"""What all losses do with their arguments and with the numbers of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

Reduction = Literal["mean", "sum", "none"]


def precise(tensor: Tensor) -> AbstractContextManager[None]:
    """No autocast on the device of a tensor: its rounding would be most of a small loss."""
    return torch.autocast(tensor.device.type, enabled=False)


def named(**tensors: object) -> None:
    """Refuse what is no tensor of floating point numbers."""
    for name, value in tensors.items():
        if not isinstance(value, Tensor):
            raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
        if not value.is_floating_point():
            raise TypeError(f"{name}: expected floating point numbers, got {value.dtype}")


def same_dtype(*tensors: Tensor) -> tuple[Tensor, ...]:
    """Float64 if one of them is, float32 otherwise."""
    wide = any(each.dtype == torch.float64 for each in tensors)
    return tuple(each.to(torch.float64 if wide else torch.float32) for each in tensors)


def masks(pred: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Two batches of masks of one shape, device and dtype."""
    named(pred=pred)
    if getattr(target, "dtype", None) == torch.bool:
        target = target.to(torch.float32)
    named(target=target)
    if pred.ndim != 3 or 0 in pred.shape:
        raise ValueError(f"pred: expected shape (B, H, W) with pixels, got {tuple(pred.shape)}")
    if target.shape != pred.shape:
        raise ValueError(
            f"target: expected shape {tuple(pred.shape)} as pred has it, got {tuple(target.shape)}"
        )
    if target.device != pred.device:
        raise ValueError(f"target: expected it on {pred.device} as pred is, got {target.device}")
    pred, target = same_dtype(pred, target)
    return pred, target


def reduced(values: Tensor, reduction: Reduction, weight: Tensor | None) -> Tensor:
    """The losses ``(B,)`` of a batch as asked for; weights that are all 0 give 0."""
    if reduction not in ("mean", "sum", "none"):
        raise ValueError(f"reduction: expected 'mean', 'sum' or 'none', got {reduction!r}")
    if weight is None:
        if reduction == "mean":
            return values.mean()
        return values.sum() if reduction == "sum" else values
    named(weight=weight)
    if weight.shape != values.shape:
        raise ValueError(
            f"weight: expected shape ({values.shape[0]},), a number for each sample, "
            f"got {tuple(weight.shape)}"
        )
    weight = weight.to(values.dtype)
    values = weight * values
    if reduction == "none":
        return values
    if reduction == "sum":
        return values.sum()
    total = weight.sum()
    return values.sum() / torch.where(total == 0, torch.ones_like(total), total)
