"""A device for torch whose memory the CPU cannot read, and what is done with tensors on it.

It stands in for an accelerator where there is none: torch takes ``elsewhere`` for a device of its
own, refuses ``.numpy()`` on it, and has no operation there but making, detaching and copying
tensors, so that whatever does not move its tensors first stops. Importing this registers the device
for good: do it in a process of its own.
"""

import numpy as np
import pytest
import torch
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

import scenes
from dronepose import Mesh
from dronepose.torch import SoftSilhouette, silhouette
from scenes import CAMERA

_setup_privateuseone_for_python_backend("elsewhere")

FACES = torch.tensor(scenes.TETRAHEDRON[1])


class Elsewhere(torch.Tensor):
    """A tensor of the device: torch sees no data, which are in ``array``."""

    @staticmethod
    def __new__(cls, array, dtype):
        tensor = torch._C._acc.create_empty_tensor(array.shape, dtype)
        tensor.__class__ = cls
        return tensor

    def __init__(self, array, dtype):
        self.array = array


def _of_device(name):
    return torch.library.impl(f"aten::{name}", "privateuseone")


@_of_device("empty.memory_format")
def _(size, dtype=None, layout=None, device=None, pin_memory=None, memory_format=None):
    return _empty(size, dtype)


@_of_device("empty_strided")
def _(size, stride, dtype=None, layout=None, device=None, pin_memory=None):
    return _empty(size, dtype)


@_of_device("detach")
def _(tensor):
    return Elsewhere(tensor.array, tensor.dtype)


@_of_device("_copy_from")
def _(source, target, non_blocking=False):
    if target.device.type == "cpu":
        target.copy_(torch.from_numpy(source.array))
    else:
        here = source.device.type == "cpu"
        target.array[...] = source.detach().numpy() if here else source.array
    return target


def _empty(size, dtype):
    dtype = dtype or torch.get_default_dtype()
    kind = torch.empty(0, dtype=dtype).numpy().dtype
    # What is not written shows.
    return Elsewhere(np.full(tuple(size), 77, kind), dtype)


# What follows is run there by the tests.


def refuses_numpy():
    """A tensor of the device that nobody moves cannot be read."""
    tensor = torch.ones(2).to("elsewhere")
    assert tensor.device.type == "elsewhere"
    assert not tensor.is_cpu
    with pytest.raises(TypeError) as refused:
        tensor.numpy()
    return str(refused.value)


def inputs(dtype):
    """Vertices, R, t and K."""
    R, t = scenes.poses(np.random.default_rng(3), 2, 2.5)
    arrays = (scenes.TETRAHEDRON[0], R, t, CAMERA.K)
    return [torch.tensor(a, dtype=dtype) for a in arrays]


def drawn(dtype, options, places, check_finite=False):
    """Masks and gradients of tensors in these places, the devices they are on."""
    faces, *given = [a.to(place) for a, place in zip((FACES, *inputs(dtype)), places, strict=True)]
    v, R, t, K = (a.requires_grad_() for a in given)
    size = (CAMERA.height, CAMERA.width)
    masks = silhouette(v, faces, R, t, K, *size, check_finite=check_finite, **options)
    made = [masks.detach()]
    if masks.requires_grad:
        upstream = torch.rand(2, *size, dtype=dtype, generator=torch.Generator().manual_seed(1))
        made += torch.autograd.grad(masks, (v, R, t, K), upstream.to(masks.device))
    return [a.cpu().numpy() for a in made], [a.device.type for a in made]


def module():
    """Masks of a module that was moved, and of one that was not."""
    mesh = Mesh(*scenes.TETRAHEDRON)
    size = (CAMERA.height, CAMERA.width)
    made = []
    for place in ("cpu", "elsewhere"):
        _, R, t, K = (a.to(place) for a in inputs(torch.float32))
        render = SoftSilhouette.from_mesh(mesh, *size, sigma=0.7).to(place)
        assert {a.device.type for a in render.state_dict().values()} == {place}
        masks = render(R, t, K)
        assert masks.device.type == place
        made.append(masks.cpu().numpy())
    return made


def refusal():
    """What is said of vertices that are not finite."""
    v, R, t, K = inputs(torch.float32)
    v[1, 2] = float("nan")
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        silhouette(v.to("elsewhere"), FACES, R, t, K, CAMERA.height, CAMERA.width)
    return str(refused.value)
