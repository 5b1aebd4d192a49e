"""The operators ``dronepose::silhouette`` and its gradient.

Plain tensors and numbers in, plain tensors out, as torch asks for; torch reads the annotations, so
they are no strings in this module. The functions that users call are in ``dronepose.torch``.
"""

from typing import Any, Optional

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dronepose import _native
from dronepose._buffers import BUFFERS
from dronepose.torch import _traces
from dronepose.torch._models import models

_Batch = tuple[list[_native.Model], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]

# torch 2.4 does not know `float | None`.
_Float = Optional[float]  # noqa: UP045


@torch.library.custom_op("dronepose::silhouette", mutates_args=())
def silhouette_op(
    vertices: Tensor,
    faces: Tensor,
    R: Tensor,
    t: Tensor,
    K: Tensor,
    height: int,
    width: int,
    mode: str,
    softness: float,
    cutoff: _Float,
    cutoff_count: int,
    near: _Float,
    check_finite: bool,
    threads: int,
    traced: bool,
) -> Tensor:
    """Masks ``(B, H, W)`` of the dtype and on the device of ``R``.

    With ``traced``, their traces wait for the backward pass.
    """
    batch = _batch(vertices, faces, R, t, K)
    out = BUFFERS.empty((R.shape[0], height, width), _numpy_dtype(R))
    limit = None if cutoff is None else (cutoff, cutoff_count)
    traces = _native.silhouette(*batch, mode, softness, limit, near, threads, out, traced)
    if traces is not None:
        key = _traces.key_of(batch, (height, width), mode, softness, limit, near)
        _traces.keep(key, batch[0], traces)
    return torch.from_numpy(out).to(R.device)


@silhouette_op.register_fake
def _(
    vertices: Tensor,
    faces: Tensor,
    R: Tensor,
    t: Tensor,
    K: Tensor,
    height: int,
    width: int,
    *options: Any,
) -> Tensor:
    return R.new_empty(R.shape[0], height, width)


@torch.library.custom_op("dronepose::silhouette_backward", mutates_args=())
def _backward_op(
    upstream: Tensor,
    vertices: Tensor,
    faces: Tensor,
    R: Tensor,
    t: Tensor,
    K: Tensor,
    mode: str,
    softness: float,
    cutoff: _Float,
    cutoff_count: int,
    near: _Float,
    check_finite: bool,
    threads: int,
    traced: bool,
    of_vertices: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Gradients for vertices (empty unless asked for), ``R``, ``t`` and ``K``."""
    batch = _batch(vertices, faces, R, t, K)
    limit = None if cutoff is None else (cutoff, cutoff_count)
    given = _image(upstream)
    if check_finite:
        _all_finite("the gradient that comes in for the masks", given, ("image", "row", "column"))
    shape = (given.shape[1], given.shape[2])
    traces = None
    if traced:
        traces = _traces.take(_traces.key_of(batch, shape, mode, softness, limit, near))
    g_R, g_t, g_K, g_v = _native.silhouette_gradients(
        *batch, mode, softness, limit, near, threads, given, of_vertices, traces
    )
    if K.ndim == 2:
        g_K = g_K.sum(axis=0)
    vertex_rows = np.stack(g_v) if g_v else np.empty((0, 3))
    if check_finite:
        for k, each in enumerate(g_v):
            _vertices_finite(each, faces, k)
        _all_finite("the gradient for R", g_R, ("image", "row", "column"))
        _all_finite("the gradient for t", g_t, ("image", "row"))
        _all_finite("the gradient for K", g_K, ("image", "row", "column")[-g_K.ndim :])
    if of_vertices:
        vertex_rows = vertex_rows.reshape(vertices.shape)

    def like(array: NDArray[Any], tensor: Tensor) -> Tensor:
        return torch.from_numpy(array).to(tensor.device, tensor.dtype)

    return like(vertex_rows, vertices), like(g_R, R), like(g_t, t), like(g_K, K)


@_backward_op.register_fake
def _(
    upstream: Tensor,
    vertices: Tensor,
    faces: Tensor,
    R: Tensor,
    t: Tensor,
    K: Tensor,
    mode: str,
    softness: float,
    cutoff: _Float,
    cutoff_count: int,
    near: _Float,
    check_finite: bool,
    threads: int,
    traced: bool,
    of_vertices: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    shape = vertices.shape if of_vertices else (0, 3)
    return (
        vertices.new_empty(shape),
        R.new_empty(R.shape),
        t.new_empty(t.shape),
        K.new_empty(K.shape),
    )


def _setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    vertices, faces, R, t, K, _height, _width, *ctx.options = inputs
    ctx.save_for_backward(vertices, faces, R, t, K)


def _backward(ctx: Any, upstream: Tensor) -> tuple[Any, ...]:
    wanted = ctx.needs_input_grad
    g_v, g_R, g_t, g_K = _backward_op(upstream, *ctx.saved_tensors, *ctx.options, wanted[0])
    return (g_v if wanted[0] else None, None, g_R, g_t, g_K, *[None] * (2 + len(ctx.options)))


silhouette_op.register_autograd(_backward, setup_context=_setup_context)


def _nothing_to_keep(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    pass


def _second_derivative(ctx: Any, *upstream: Any) -> Any:
    raise RuntimeError(
        "dronepose.torch.silhouette has first derivatives only: the backward pass cannot be "
        "differentiated again (create_graph=True, gradient penalties, Hessians)"
    )


_backward_op.register_autograd(_second_derivative, setup_context=_nothing_to_keep)


def _batch(vertices: Tensor, faces: Tensor, R: Tensor, t: Tensor, K: Tensor) -> _Batch:
    """Models, rotations, translations and cameras for the extension."""
    prepared = models(_double(vertices), faces.detach().cpu().contiguous().numpy())
    return prepared, _double(R), _double(t), _double(K).reshape(-1, 3, 3)


def _double(tensor: Tensor) -> NDArray[np.float64]:
    return tensor.detach().to("cpu", torch.float64).contiguous().numpy()


def _numpy_dtype(tensor: Tensor) -> type[np.float32] | type[np.float64]:
    return np.float64 if tensor.dtype == torch.float64 else np.float32


def _image(upstream: Tensor) -> NDArray[Any]:
    """Contiguous and on the CPU; a copy (``sum()`` expands its gradient) into kept memory."""
    if upstream.is_cpu and upstream.is_contiguous():
        return upstream.detach().numpy()
    out = BUFFERS.empty(tuple(upstream.shape), _numpy_dtype(upstream))
    torch.from_numpy(out).copy_(upstream.detach())
    return out


def _all_finite(what: str, array: NDArray[Any], axes: tuple[str, ...]) -> None:
    good = np.isfinite(array)
    if good.all():
        return
    place = np.unravel_index(int(np.argmin(good)), array.shape)
    where = ", ".join(f"{axis} {k}" for axis, k in zip(axes, place, strict=True))
    raise RuntimeError(f"check_finite: {what} is {array[place]} at {where}")


def _vertices_finite(gradient: NDArray[Any], faces: Tensor, mesh: int) -> None:
    bad = ~np.isfinite(gradient).all(axis=1)
    if not bad.any():
        return
    vertex = int(np.argmax(bad))
    faces_of = (faces.detach().cpu().numpy() == vertex).any(axis=1)
    raise RuntimeError(
        f"check_finite: the gradient for vertices is {gradient[vertex].tolist()} at vertex "
        f"{vertex} of mesh {mesh}, in face {int(np.argmax(faces_of))}"
    )
