"""Operators of the losses that are computed in Rust: ``dronepose::mask_loss`` and what it needs.

Plain tensors and numbers in, plain tensors out, as torch asks for; torch reads the annotations, so
they are no strings in this module.
"""

from typing import Any, Sequence  # noqa: UP035 (torch 2.4 knows only this one)

import torch
from numpy.typing import NDArray
from torch import Tensor

from dronepose import _native
from dronepose._buffers import BUFFERS


@torch.library.custom_op("dronepose::mask_loss", mutates_args=())
def mask_loss_op(
    pred: Tensor,
    target: Tensor,
    name: str,
    size: int,
    sigmas: Sequence[float],
    eps: float,
    of_pred: bool,
    of_target: bool,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Losses ``(B,)`` and their gradients for the masks, empty unless asked for.

    All of these losses are symmetric, so the gradient for the target is that of the swapped call.
    """
    s, y = _array(pred), _array(target)

    def call(first: NDArray[Any], second: NDArray[Any], slope: NDArray[Any] | None) -> Any:
        return _native.mask_loss(name, size, list(sigmas), eps, first, second, slope, threads)

    slopes = [
        BUFFERS.empty(s.shape, s.dtype) if wanted else None for wanted in (of_pred, of_target)
    ]
    values = call(y, s, slopes[1]) if of_target else None
    if of_pred or values is None:
        values = call(s, y, slopes[0])
    found = torch.from_numpy(values).to(pred.dtype)
    first, second = (
        pred.new_empty((0,)) if each is None else torch.from_numpy(each) for each in slopes
    )
    return found, first, second


@mask_loss_op.register_fake
def _(
    pred: Tensor,
    target: Tensor,
    name: str,
    size: int,
    sigmas: Sequence[float],
    eps: float,
    of_pred: bool,
    of_target: bool,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor]:
    return (
        pred.new_empty((pred.shape[0],)),
        pred.new_empty(pred.shape if of_pred else (0,)),
        pred.new_empty(pred.shape if of_target else (0,)),
    )


@torch.library.custom_op("dronepose::scale_images", mutates_args=())
def scale_images_op(images: Tensor, factors: Tensor, threads: int) -> Tensor:
    """Each image of ``(B, H, W)`` times its number of ``(B,)``, in memory that is kept."""
    source = _array(images)
    out = BUFFERS.empty(source.shape, source.dtype)
    wide = factors.detach().to(torch.float64).contiguous().numpy()
    _native.scale_images(source, wide, out, threads)
    return torch.from_numpy(out)


@scale_images_op.register_fake
def _(images: Tensor, factors: Tensor, threads: int) -> Tensor:
    return images.new_empty(images.shape)


@torch.library.custom_op("dronepose::signed_distance", mutates_args=())
def signed_distance_op(target: Tensor, threads: int) -> Tensor:
    """Pixels to the outline of ``target > 1/2``, negative inside; on the device of ``target``."""
    source = _array(target.cpu())
    out = BUFFERS.empty(source.shape, source.dtype)
    _native.signed_distance(source, out, threads)
    return torch.from_numpy(out).to(target.device)


@signed_distance_op.register_fake
def _(target: Tensor, threads: int) -> Tensor:
    return target.new_empty(target.shape)


def _array(tensor: Tensor) -> NDArray[Any]:
    return tensor.detach().contiguous().numpy()


def _setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    ctx.threads = inputs[-1]
    ctx.set_materialize_grads(False)  # zeros for the gradients that are outputs, as large as they
    ctx.mark_non_differentiable(output[1], output[2])
    ctx.save_for_backward(output[1], output[2])


def _backward(ctx: Any, upstream: Tensor | None, *_: Any) -> tuple[Any, ...]:
    gradients = [
        scale_images_op(each, upstream, ctx.threads) if wanted and upstream is not None else None
        for each, wanted in zip(ctx.saved_tensors, ctx.needs_input_grad[:2], strict=True)
    ]
    return (*gradients, *[None] * 7)


mask_loss_op.register_autograd(_backward, setup_context=_setup_context)


def _nothing_to_keep(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    pass


def _second_derivative(ctx: Any, *upstream: Any) -> Any:
    raise RuntimeError(
        "the silhouette losses have first derivatives only on the CPU: the backward pass cannot be "
        "differentiated again (create_graph=True, gradient penalties, Hessians)"
    )


scale_images_op.register_autograd(_second_derivative, setup_context=_nothing_to_keep)


def mask_loss(
    pred: Tensor,
    target: Tensor,
    name: str,
    *,
    size: int = 1,
    sigmas: Sequence[float] = (),
    eps: float = 1.0,
    threads: int = 0,
) -> Tensor:
    """The losses ``(B,)`` of masks on the CPU."""
    learns = torch.is_grad_enabled()
    found = mask_loss_op(
        pred,
        target,
        name,
        size,
        list(sigmas),
        eps,
        learns and pred.requires_grad,
        learns and target.requires_grad,
        threads,
    )
    values: Tensor = found[0]
    return values
