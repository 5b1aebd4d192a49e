"""Silhouette losses against files that a slow reference wrote (``golden`` in ../shared)."""

import numpy as np
import pytest

from support import SHARED

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from dronepose import losses  # noqa: E402
from dronepose.losses import _formulas  # noqa: E402

FILES = sorted((SHARED / "golden").glob("*.npz"))
pytestmark = pytest.mark.skipif(not FILES, reason="no golden files in ../shared")

SIGMAS = (0.0, 2.0, 6.0, 18.0)
KINDS = {
    "iou": lambda s, y: losses.iou_loss(s, y),
    "giou": lambda s, y: losses.giou_loss(s, y, box="threshold"),
    "box49": lambda s, y: losses.smooth_loss(s, y, kernel="box", size=49),
    "gauss69": lambda s, y: losses.smooth_loss(s, y, kernel="gaussian", size=69, sigma="authors"),
    "tanimoto_ms": lambda s, y: losses.tanimoto_loss(s, y),
}
ELSEWHERE = {
    "box49": lambda s, y: _formulas.smooth(s, y, lambda m: _formulas.box_mean(m, 49)).mean(),
    "gauss69": lambda s, y: _formulas.smooth(
        s, y, lambda m: _formulas.gaussian_blur(m, 1.5, 34)
    ).mean(),
    "tanimoto_ms": lambda s, y: _formulas.tanimoto(s, y, SIGMAS, 1e-7).mean(),
}


def compare(name, kind, renderer, function, dtype):
    data = np.load(SHARED / "golden" / f"{name}.npz")
    stored = data[f"{renderer}.S"]
    pred = torch.tensor(stored[None], dtype=dtype, requires_grad=True)
    target = torch.tensor(data["gt"][None], dtype=dtype)
    value = function(pred, target)
    (slope,) = torch.autograd.grad(value, pred)
    # Masks are stored in single precision there.
    double = dtype == torch.float64 and stored.dtype == np.float64
    expected = float(data[f"{kind}.{renderer}.value"])
    assert abs(value.item() - expected) < (1e-9 if double else 5e-6)
    key = f"{kind}.{renderer}.dS"
    expected = data[key if key in data else f"{kind}.coverage.dS"]
    scale = np.abs(expected).max()
    tolerance = 1e-7 if double else 1e-3
    np.testing.assert_allclose(slope[0].numpy(), expected, rtol=0, atol=tolerance * scale)


CASES = [
    (path.stem, kind, renderer)
    for path in FILES
    for kind in KINDS
    for renderer in ("dibr", "coverage")
    if f"{kind}.{renderer}.value" in np.load(path)
]


@pytest.mark.parametrize(("name", "kind", "renderer"), CASES)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["f64", "f32"])
def test_losses_and_their_gradients_are_those_of_the_reference(name, kind, renderer, dtype):
    compare(name, kind, renderer, KINDS[kind], dtype)


@pytest.mark.parametrize(
    ("name", "kind", "renderer"), [case for case in CASES if case[1] in ELSEWHERE]
)
def test_so_are_the_formulas_for_other_devices(name, kind, renderer):
    compare(name, kind, renderer, ELSEWHERE[kind], torch.float64)


@pytest.mark.parametrize("name", [path.stem for path in FILES])
@pytest.mark.parametrize("renderer", ["dibr", "coverage"])
def test_the_authors_value_is_that_of_the_reference(name, renderer):
    data = np.load(SHARED / "golden" / f"{name}.npz")
    key = f"giou_authors.{renderer}.value"
    if key not in data:
        pytest.skip("the file has no such value")
    stored = data[f"{renderer}.S"]
    found = losses.giou_authors(
        torch.tensor(stored[None], dtype=torch.float64),
        torch.tensor(data["gt"][None].astype(float)),
    )
    expected = float(data[key])
    # A mask in single precision has more pixels that are exactly 1, and so another box.
    tolerance = 1e-9 if stored.dtype == np.float64 else 1e-2
    assert abs(found.item() - expected) <= tolerance * max(1.0, abs(expected))


def test_binary_masks_have_the_same_box_either_way():
    for path in FILES:
        data = np.load(path)
        s, y = (torch.tensor(data[k][None].astype(float)) for k in ("hard", "gt"))
        soft, hard = (losses.giou_loss(s, y, box=box).item() for box in ("soft", "threshold"))
        assert abs(soft - hard) < 1e-8
