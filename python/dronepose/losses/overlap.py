"""Losses of overlap: intersection over union, and with the box around both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch

from dronepose.losses._batch import masks, precise, reduced

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

    from dronepose.losses._batch import Reduction

_EPS = 1e-7


def iou_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    eps: float = _EPS,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
) -> Tensor:
    """``1 - I / (A + B - I + eps)`` with ``I = sum(y s)``, ``A = sum(y)``, ``B = sum(s)``.

    A ratio of sums, as the authors' code has it (the paper's equation divides within each pixel).
    Without overlap its gradient is zero but for ``eps``. Of a mask with itself it is 0 only if the
    mask is binary.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``; gets a gradient too if it asks for one.
        eps: Added to the union; Kaolin's ``mask_iou`` has ``1e-10``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.

    Returns:
        In ``[0, 1]``; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import iou_loss
        >>> pred = torch.tensor([[[1.0, 1, 0, 0]]])
        >>> target = torch.tensor([[[0.0, 1, 1, 0]]])
        >>> round(iou_loss(pred, target).item(), 4)
        0.6667
    """
    pred, target = masks(pred, target)
    _above_zero("eps", eps)
    with precise(pred):
        common, union = _sums(pred, target)
        values = 1 - common / (union + eps)
    return reduced(values, reduction, weight)


def giou_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    box: Literal["soft", "threshold"] = "soft",
    threshold: float = 0.5,
    eps: float = _EPS,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
) -> Tensor:
    """``1 - (I / U - (C - U) / C)``: IoU and how empty the box around both masks is.

    ``I`` and ``U = A + B - I`` are those of :func:`iou_loss`, ``C`` is the area of the smallest
    upright box around both masks (Rezatofighi et al., "Generalized Intersection over Union", 2019,
    with masks for boxes). Without overlap the loss falls as the masks come nearer.

    The box of soft masks: its sides are those of the box around the pixels where
    ``m = s + y - s y`` is above a threshold, averaged over all thresholds from 0 to 1. Of binary
    masks this is the box. In between it grows by the part of the outermost row or column that is
    covered, so that ``C`` has a gradient, which goes to the pixels that touch the box, and a faint
    tail counts little instead of all or nothing. (As a sum: a column is as full as its fullest
    pixel, or as the emptier of the fullest columns to its left and right if that is more.)

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``; gets a gradient too if it asks for one.
        box: ``"soft"`` as above, or ``"threshold"``: the box around pixels above ``threshold``, a
            constant for the gradient, which then flows through ``I`` and ``U`` only.
        threshold: For box ``"threshold"``.
        eps: Added to what is divided by.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.

    Returns:
        In ``[0, 2]``; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import giou_loss
        >>> pred = torch.tensor([[[1.0, 0, 0, 0.5]]], requires_grad=True)
        >>> target = torch.tensor([[[1.0, 0, 0, 0]]])
        >>> loss = giou_loss(pred, target)  # U = 1.5, C = (4 + 1) / 2
        >>> round(loss.item(), 4)
        0.7333
    """
    pred, target = masks(pred, target)
    _above_zero("eps", eps)
    if box not in ("soft", "threshold"):
        raise ValueError(f"box: expected 'soft' or 'threshold', got {box!r}")
    if not 0 <= threshold < 1:
        raise ValueError(f"threshold: expected 0 to below 1, got {threshold}")
    with precise(pred):
        common, union = _sums(pred, target)
        if box == "soft":
            both = pred + target - pred * target
            area = _soft_length(both.amax(dim=2)) * _soft_length(both.amax(dim=1))
            # A faint pixel alone covers more than the square of itself.
            area = torch.maximum(area, union)
            empty = (area - union) / (area + eps)
        else:
            above = torch.maximum(pred, target).detach() > threshold
            rows, columns = _extent(above.any(dim=2)), _extent(above.any(dim=1))
            area = ((rows[1] - rows[0] + 1) * (columns[1] - columns[0] + 1)).to(pred.dtype)
            # Without such pixels there is no box, and no term for it.
            none = ~above.any(dim=2).any(dim=1)
            empty = torch.where(none, torch.zeros_like(union), (area - union) / area)
        values = 1 - (common / (union + eps) - empty)
    return reduced(values, reduction, weight)


@torch.no_grad()
def giou_authors(pred: Float[Tensor, "B H W"], target: Float[Tensor, "B H W"]) -> Tensor:
    """What the code of DronePose's authors evaluates as GIoU: a value to compare with, not a loss.

    Its union is ``A + B - 2 I``, the symmetric difference; its box is doubled, lacks the last row
    and column and looks at pixels that are exactly 1; masks that nearly agree give minus hundreds,
    and those that agree are patched to 0. All of it is detached there: the gradient is zero.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``.
        target: ``(B, H, W)`` in ``[0, 1]``.

    Returns:
        ``(B,)``, without gradient.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import giou_authors
        >>> a, b = torch.zeros(1, 8, 8), torch.zeros(1, 8, 8)
        >>> a[:, 1:7, 1:7] = 1
        >>> b[:, 1:7, 1:6] = 1
        >>> giou_authors(a, a).tolist(), giou_authors(a, b).tolist()
        ([0.0], [-3.119999885559082])
    """
    pred, target = masks(pred, target)
    with precise(pred):
        height, width = pred.shape[1:]
        boxes = []
        for mask in (target, pred):
            ones = mask == 1
            found = ones.any(dim=2).any(dim=1)
            for axis, length in ((2, height), (1, width)):
                first, last = _extent(ones.any(dim=axis))
                boxes.append(torch.where(found, first, torch.zeros_like(first)))
                boxes.append(torch.where(found, last, torch.full_like(last, length)))
        sides = [
            (torch.maximum(boxes[k + 1], boxes[k + 5]) - torch.minimum(boxes[k], boxes[k + 4]))
            for k in (0, 2)
        ]
        area = 2.0 * (sides[0].clamp(min=0) * sides[1].clamp(min=0)).to(pred.dtype)
        common = (pred * target).sum(dim=(1, 2))
        union = (pred + target).sum(dim=(1, 2)) - 2 * common
        zero, one = torch.zeros_like(union), torch.ones_like(union)
        iou = torch.where(union != 0, common / torch.where(union != 0, union, one), zero)
        rest = torch.where(area != 0, (area - union) / torch.where(area != 0, area, one), zero)
        rest = torch.where(rest == 1, -one, rest)
        return 1 - (iou - rest)


def _sums(pred: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Intersection and union."""
    common = (pred * target).sum(dim=(1, 2))
    return common, (pred + target).sum(dim=(1, 2)) - common


def _soft_length(fullest: Tensor) -> Tensor:
    """The sum of how full the places of ``(B, N)`` are, with gaps filled."""
    left = fullest.cummax(dim=1).values
    right = fullest.flip(1).cummax(dim=1).values.flip(1)
    return torch.minimum(left, right).sum(dim=1)


def _extent(used: Tensor) -> tuple[Tensor, Tensor]:
    """First and last place in use of ``(B, N)``; the ends if none is."""
    marks = used.to(torch.int32)
    return marks.argmax(dim=1), used.shape[1] - 1 - marks.flip(1).argmax(dim=1)


def _above_zero(name: str, value: float) -> None:
    if not 0 < value < float("inf"):
        raise ValueError(f"{name}: expected a finite number above 0, got {value}")
