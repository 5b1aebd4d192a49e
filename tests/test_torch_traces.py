"""Traces that wait between the forward and the backward pass of the torch operator."""

import numpy as np
import pytest

import scenes
from scenes import CAMERA, TETRAHEDRON

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from dronepose.torch import _traces, silhouette  # noqa: E402


def inputs():
    """Vertices, R, t, K of two poses."""
    R, t = scenes.poses(np.random.default_rng(0), 2)
    return [torch.tensor(a, requires_grad=True) for a in (TETRAHEDRON[0], R, t, CAMERA.K)]


def draw(vertices, R, t, K, **options):
    faces = torch.tensor(TETRAHEDRON[1])
    return silhouette(vertices, faces, R, t, K, CAMERA.height, CAMERA.width, **options)


@pytest.mark.parametrize(
    "options",
    [{"sigma": 0.6}, {"mode": "dibr"}, {"mode": "sigmoid"}],
    ids=["coverage", "dibr", "sigmoid"],
)
def test_traces_wait_for_backward_and_change_no_bit(monkeypatch, options):
    taken = []
    plain = _traces.take
    monkeypatch.setattr(_traces, "take", lambda key: taken.append(plain(key)) or taken[-1])
    arguments = inputs()
    mask = draw(*arguments, **options)
    generator = torch.Generator().manual_seed(1)
    loss = (mask * torch.randn(mask.shape, dtype=mask.dtype, generator=generator)).sum()
    kept = torch.autograd.grad(loss, arguments, retain_graph=True)
    again = torch.autograd.grad(loss, arguments)
    assert taken[0].nbytes > 0
    assert taken[1] is None  # taken before: made again
    for a, b in zip(kept, again, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    before = _traces._kept
    with torch.no_grad():
        draw(*arguments, **options)
    assert _traces._kept is before


def test_traces_of_forgotten_masks_do_not_pile_up(monkeypatch):
    v, R, t, K = inputs()
    for k in range(20):
        draw(v, R, t + 0.01 * k, K)
    assert 0 < len(_traces._kept) <= _traces._ENTRIES
    monkeypatch.setattr(_traces, "_BYTES", 1)
    draw(v, R, t, K)
    assert len(_traces._kept) == 1


def test_masks_with_pytorch3d_cutoffs_leave_no_traces_and_take_none():
    arguments = inputs()
    exact = draw(*arguments, mode="sigmoid")  # its traces wait under the same numbers
    cut = draw(*arguments, mode="sigmoid", pytorch3d_cutoff=(1e-3, 30))
    before = _traces._kept
    torch.autograd.grad(cut.sum(), arguments)
    assert _traces._kept is before
    torch.autograd.grad(exact.sum(), arguments)
    assert _traces._kept is not before


def test_masks_with_kaolin_cutoffs_have_traces_of_their_own():
    arguments = inputs()
    exact = draw(*arguments, mode="dibr")
    cuts = [draw(*arguments, mode="dibr", kaolin_cutoff=(0.02, knum)) for knum in (2, None)]
    assert len(_traces._kept) >= 3
    for mask in (*cuts, exact):
        before = _traces._kept
        first = torch.autograd.grad(mask.sum(), arguments, retain_graph=True)
        assert len(_traces._kept) == len(before) - 1
        again = torch.autograd.grad(mask.sum(), arguments)  # made again
        for a, b in zip(first, again, strict=True):
            torch.testing.assert_close(a, b, rtol=0, atol=0)
