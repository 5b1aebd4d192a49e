"""Losses that look beyond the pixel: smoothed, blurred, and by distance to the outline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch

from dronepose._softness import thread_count
from dronepose.losses import _formulas
from dronepose.losses._batch import masks, precise, reduced
from dronepose.losses._ops import mask_loss, signed_distance_op

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Float
    from torch import Tensor

    from dronepose.losses._batch import Reduction

_SIZES = {"box": 49, "gaussian": 69}
_AUTHORS_SIGMA = 1.5
_LARGEST_SIGMA = 1000.0
_LARGEST_SIZE = 8191


def smooth_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    kernel: Literal["box", "gaussian"] = "box",
    size: int | None = None,
    sigma: float | Literal["authors"] | None = None,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
    num_threads: int = 0,
) -> Tensor:
    """The smooth silhouette loss of DronePose, ``mean(y S(s) + s S(y))``, ``S(m) = g*(1-m) - g*m``.

    The mean is over pixels. The box is the mean over the part of its window that is inside the
    image (``AvgPool2d(k, 1, k // 2, count_include_pad=False)``); the Gaussian is normalised over
    its whole window and sees 0 outside the image, in ``m`` and in ``1 - m``.

    **Affine in the prediction**: the gradient is ``(b - 2 g*y - 2 g^T*y) / N`` with ``b = g*1``,
    whatever ``s`` is, so that this loss is smallest for the mask ``[g*y > 1/4]``: the target grown,
    by 12 px for a box of 49, less all parts that are thinner than a quarter of the kernel; for a
    target that is thin everywhere it is the empty mask. See ``docs/losses.md``.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``; gets a gradient too if it asks for one.
        kernel: ``"box"`` or ``"gaussian"``.
        size: Pixels a side of the window, odd; ``None`` is 49 for the box and 69 for the Gaussian.
        sigma: Standard deviation of the Gaussian in pixels; ``None`` is ``size / 6``, ``"authors"``
            is 1.5, which the authors' code has for every size. The box has none.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.
        num_threads: 0 for all cores; changes no bit. On the CPU.

    Returns:
        In ``[-2, 2]``, below 0 where masks overlap well; ``()``, or ``(B,)`` for reduction
        ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.
        RuntimeError: A second derivative is asked for on the CPU.

    Example:
        >>> import torch
        >>> from dronepose.losses import smooth_loss
        >>> mask = torch.zeros(1, 9, 9)
        >>> mask[:, 3:6, 3:6] = 1
        >>> round(smooth_loss(mask, mask, kernel="box", size=3).item(), 5)
        -0.04664
    """
    pred, target = masks(pred, target)
    if kernel not in _SIZES:
        raise ValueError(f"kernel: expected 'box' or 'gaussian', got {kernel!r}")
    size = _SIZES[kernel] if size is None else size
    if not 1 <= size <= _LARGEST_SIZE or size % 2 == 0:
        raise ValueError(
            f"size: expected an odd number of pixels, 1 to {_LARGEST_SIZE}, got {size}"
        )
    threads = thread_count("num_threads", num_threads)
    if kernel == "box":
        if sigma is not None:
            raise ValueError(f"sigma: belongs to kernel 'gaussian', got {sigma!r} for 'box'")
        width = 0.0
    else:
        width = _sigma_of(sigma, size)
    if pred.is_cpu:
        sigmas = [] if kernel == "box" else [width]
        values = mask_loss(pred, target, kernel, size=size, sigmas=sigmas, threads=threads)
        return reduced(values, reduction, weight)

    def blur(images: Tensor) -> Tensor:
        if kernel == "box":
            return _formulas.box_mean(images, size)
        return _formulas.gaussian_blur(images, width, size // 2)

    with precise(pred):
        values = _formulas.smooth(pred, target, blur)
    return reduced(values, reduction, weight)


def tanimoto_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    sigmas: Sequence[float] = (0.0, 2.0, 6.0, 18.0),
    eps: float = 1e-7,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
    num_threads: int = 0,
) -> Tensor:
    """``1 - (<a,b> + eps) / (<a,a> + <b,b> - <a,b> + eps)``, mean over blurs of several widths.

    ``a = g*y`` and ``b = g*s``, ``g`` a Gaussian of ``2 ceil(4 sigma) + 1`` taps that sees 0
    outside the image. Zero exactly where the masks agree, also if they are not binary, and above it
    everywhere else; a share, whatever the size of the masks; and the wide blurs reach masks that do
    not touch. What is divided is the Tanimoto coefficient (Tanimoto 1958) of the blurred masks.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``; gets a gradient too if it asks for one.
        sigmas: Standard deviations in pixels, 0 to 1000; 0 is no blur.
        eps: Above zero; two empty masks have loss 0.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.
        num_threads: 0 for all cores; changes no bit. On the CPU.

    Returns:
        In ``[0, 1]``; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.
        RuntimeError: A second derivative is asked for on the CPU.

    Example:
        >>> import torch
        >>> from dronepose.losses import tanimoto_loss
        >>> pred, target = torch.zeros(2, 20, 20), torch.zeros(2, 20, 20)
        >>> target[:, 5:9, 5:9] = 1
        >>> pred[0, 5:9, 5:9] = 1
        >>> pred[1, 5:9, 14:18] = 1
        >>> tanimoto_loss(pred, target, sigmas=[0, 8], reduction="none")
        tensor([0.0000, 0.6552])
    """
    pred, target = masks(pred, target)
    widths = [_checked("sigmas", sigma) for sigma in sigmas]
    if not widths:
        raise ValueError("sigmas: expected at least one, got none")
    if not 0 < eps < float("inf"):
        raise ValueError(f"eps: expected a finite number above 0, got {eps}")
    threads = thread_count("num_threads", num_threads)
    if pred.is_cpu:
        values = mask_loss(pred, target, "tanimoto", sigmas=widths, eps=eps, threads=threads)
    else:
        with precise(pred):
            values = _formulas.tanimoto(pred, target, widths, eps)
    return reduced(values, reduction, weight)


def blurred_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    sigma: float,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
    num_threads: int = 0,
) -> Tensor:
    """``mean((g*s - g*y)^2)`` over pixels, ``g`` a Gaussian of ``2 ceil(4 sigma) + 1`` taps.

    ``g`` sees 0 outside the image. Zero exactly where the masks agree. It is small for small
    masks, and its gradient with it.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``; gets a gradient too if it asks for one.
        sigma: Standard deviation in pixels, 0 to 1000; 0 is no blur.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.
        num_threads: 0 for all cores; changes no bit. On the CPU.

    Returns:
        In ``[0, 1]``; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.
        RuntimeError: A second derivative is asked for on the CPU.

    Example:
        >>> import torch
        >>> from dronepose.losses import blurred_loss
        >>> pred, target = torch.zeros(1, 9, 9), torch.zeros(1, 9, 9)
        >>> pred[:, 4, 4] = 1
        >>> round(blurred_loss(pred, target, sigma=0.0).item() * 81, 6)
        1.0
    """
    pred, target = masks(pred, target)
    width = _checked("sigma", sigma)
    threads = thread_count("num_threads", num_threads)
    if pred.is_cpu:
        values = mask_loss(pred, target, "blurred", sigmas=[width], threads=threads)
    else:
        with precise(pred):
            values = _formulas.blurred(pred, target, width)
    return reduced(values, reduction, weight)


def outline_loss(
    pred: Float[Tensor, "B H W"],
    target: Float[Tensor, "B H W"],
    *,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
    num_threads: int = 0,
) -> Tensor:
    """``sum(d (s - y)) / A^1.5``, with ``d`` the signed distance to the target's outline.

    ``d`` is in pixels, negative inside, and ``A = sum(y)``. For a binary target the sum is
    ``sum(|d| |s - y|)``: what is between the two outlines, each pixel as bad as it is far from the
    target's; for outlines that are ``e`` apart, half the integral of ``e^2`` along the outline. So
    it is a squared Chamfer distance of outlines (as in Kervadec et al., "Boundary loss for highly
    unbalanced segmentation", 2019). Dividing by ``A^1.5`` makes it a number that does not depend on
    scale.

    Affine in the prediction, as the smooth loss is, but smallest for the target itself (up to the
    pixels of its edge): all pixels inside have ``d < 0`` and all outside ``d > 0``. Its gradient
    grows with the distance, so it reaches all over the image, and it is not bounded.

    The target is a constant here, on every device: its outline is that of ``y > 1/2``, found on the
    CPU by the exact distance transform of Felzenszwalb & Huttenlocher (2012); it gets no gradient.
    A target without outline (no pixel above one half, or all) has loss 0.

    Args:
        pred: ``(B, H, W)`` in ``[0, 1]``, ``s``.
        target: ``(B, H, W)`` in ``[0, 1]``, ``y``, without gradient.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.
        num_threads: 0 for all cores; changes no bit.

    Returns:
        0 or more for binary masks; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option out of range; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import outline_loss
        >>> target = torch.zeros(1, 8, 8)
        >>> target[:, 2:6, 2:6] = 1
        >>> wider = target.clone()
        >>> wider[:, 2:6, 6:8] = 1  # four pixels at a distance of 0.5, four at 1.5
        >>> outline_loss(target, target).item(), outline_loss(wider, target).item()
        (0.0, 0.125)
    """
    pred, target = masks(pred, target)
    target = target.detach()
    distance = signed_distance_op(target, thread_count("num_threads", num_threads))
    with precise(pred):
        area = target.sum(dim=(1, 2))
        # Where nothing is inside, the distances are 0.
        scale = torch.where(area > 0, area, torch.ones_like(area)) ** 1.5
        values = (distance * (pred - target)).sum(dim=(1, 2)) / scale
    return reduced(values, reduction, weight)


def _sigma_of(sigma: float | Literal["authors"] | None, size: int) -> float:
    if sigma is None:
        return size / 6
    if isinstance(sigma, str):
        if sigma != "authors":
            raise ValueError(f"sigma: expected a number, 'authors' or None, got {sigma!r}")
        return _AUTHORS_SIGMA
    if sigma == 0:
        raise ValueError("sigma: expected more than 0 pixels, got 0")
    return _checked("sigma", sigma)


def _checked(name: str, sigma: float) -> float:
    if not 0 <= sigma <= _LARGEST_SIGMA:
        raise ValueError(f"{name}: expected 0 to {_LARGEST_SIGMA:g} pixels, got {sigma}")
    return float(sigma)
