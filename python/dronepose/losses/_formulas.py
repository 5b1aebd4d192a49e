"""The losses of :mod:`dronepose.losses.reach` in torch's own operators, for any device.

The same sums as in Rust, in another order. Gradients, second ones too, are those of autograd.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from torch import Tensor


def box_mean(images: Tensor, size: int) -> Tensor:
    """The mean over the part of a square window that is inside the image, of ``(B, H, W)``."""
    radius = size // 2
    down = F.avg_pool2d(
        images[:, None], (size, 1), stride=1, padding=(radius, 0), count_include_pad=False
    )
    across = F.avg_pool2d(down, (1, size), stride=1, padding=(0, radius), count_include_pad=False)
    return across[:, 0]


def gaussian_blur(images: Tensor, sigma: float, radius: int) -> Tensor:
    """A Gaussian of ``2 radius + 1`` taps that sees 0 outside the image, of ``(B, H, W)``."""
    if radius == 0:
        return images
    weights = [math.exp(-x * x / (2 * sigma * sigma)) for x in range(-radius, radius + 1)]
    total = sum(weights)
    taps = torch.tensor([w / total for w in weights], dtype=images.dtype, device=images.device)
    down = F.conv2d(images[:, None], taps[None, None, :, None], padding=(radius, 0))
    return F.conv2d(down, taps[None, None, None, :], padding=(0, radius))[:, 0]


def smooth(pred: Tensor, target: Tensor, blur: Callable[[Tensor], Tensor]) -> Tensor:
    """``mean(y (g*1 - 2 g*s) + s (g*1 - 2 g*y))`` of each image."""
    ones = blur(torch.ones_like(pred[:1]))
    terms = target * (ones - 2 * blur(pred)) + pred * (ones - 2 * blur(target))
    return terms.mean(dim=(1, 2))


def tanimoto(pred: Tensor, target: Tensor, sigmas: Sequence[float], eps: float) -> Tensor:
    """The mean over widths of ``|a-b|^2 / (|a-b|^2 + <a,b> + eps)``, of each image."""
    losses = []
    for sigma in sigmas:
        radius = math.ceil(4 * sigma)
        a, b = (gaussian_blur(m, sigma, radius) for m in (target, pred))
        gap, overlap = (a - b).square().sum(dim=(1, 2)), (a * b).sum(dim=(1, 2))
        losses.append(gap / (gap + overlap + eps))
    return torch.stack(losses).mean(dim=0)


def blurred(pred: Tensor, target: Tensor, sigma: float) -> Tensor:
    """``mean((g*s - g*y)^2)`` of each image."""
    return gaussian_blur(pred - target, sigma, math.ceil(4 * sigma)).square().mean(dim=(1, 2))
