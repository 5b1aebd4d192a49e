"""Silhouette losses: values, gradients, torch's own rules, precision, modules, errors."""

import math
import re
import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from dronepose import losses  # noqa: E402
from dronepose.losses import _formulas, silhouette_loss  # noqa: E402
from dronepose.losses._ops import (  # noqa: E402
    mask_loss_op,
    scale_images_op,
    signed_distance_op,
)

H, W = 23, 31
NAMED = {
    "iou": {},
    "giou": {},
    "box": {"size": 9},
    "gaussian": {"size": 11},
    "tanimoto": {"sigmas": (0.0, 1.5, 4.0)},
    "blurred": {"sigma": 2.0},
    "outline": {},
}
IN_RUST = ("box", "gaussian", "tanimoto", "blurred")


def made(name, **more):
    return silhouette_loss(name, **NAMED[name], **more)


def noise(seed, shape=(2, H, W), dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(shape, dtype=torch.float64, generator=generator).to(dtype)


def disc(y, x, radius, shape=(H, W), dtype=torch.float64):
    i, j = torch.meshgrid(*(torch.arange(n, dtype=dtype) + 0.5 for n in shape), indexing="ij")
    return (radius + 0.5 - torch.hypot(i - y, j - x)).clamp(0, 1)[None]


def formula(name, pred, target):
    if name == "box":
        return _formulas.smooth(pred, target, lambda m: _formulas.box_mean(m, 9))
    if name == "gaussian":
        return _formulas.smooth(pred, target, lambda m: _formulas.gaussian_blur(m, 11 / 6, 5))
    if name == "tanimoto":
        return _formulas.tanimoto(pred, target, (0.0, 1.5, 4.0), 1e-7)
    return _formulas.blurred(pred, target, 2.0)


# ------------------------------------------------------------------------------ gradients


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
def test_gradcheck_in_both_masks_and_the_weights(name, reduction):
    loss = made(name, reduction=reduction)
    # Far from ties of the fullest pixels, where the box of GIoU has a kink.
    pred, target = noise(1, (2, 6, 7)), noise(2, (2, 6, 7))
    target = target if name == "outline" else target.requires_grad_()
    weight = torch.tensor([0.3, 1.7], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(loss, (pred.requires_grad_(), target, weight))


@pytest.mark.parametrize("name", IN_RUST)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["f64", "f32"])
@pytest.mark.parametrize("shape", [(2, H, W), (1, 1, 1), (1, 1, 40), (1, 90, 3), (3, 70, 130)])
def test_rust_and_torch_agree(name, dtype, shape):
    masks = [noise(k, shape, dtype).requires_grad_() for k in (3, 4)]
    factors = noise(5, shape[:1], dtype)
    found = made(name, reduction="none")(*masks)
    expected = formula(name, *masks)
    tolerance = {"atol": 1e-13, "rtol": 1e-12}
    if dtype == torch.float32:
        tolerance = {"atol": 2e-6, "rtol": 0}
    torch.testing.assert_close(found, expected, **tolerance)
    slopes = torch.autograd.grad((found * factors).sum(), masks)
    others = torch.autograd.grad((expected * factors).sum(), masks)
    for a, b in zip(slopes, others, strict=True):
        scale = b.abs().max().item()
        share = 1e-5 if dtype == torch.float32 else 1e-12
        torch.testing.assert_close(a, b, atol=share * scale + 1e-30, rtol=0)


@pytest.mark.parametrize("name", ["box", "gaussian", "outline"])
def test_some_losses_are_affine_in_the_prediction(name):
    loss, target = made(name), disc(11.0, 15.0, 6.0)
    a, b = (noise(k, (1, H, W)).requires_grad_() for k in (1, 2))
    torch.testing.assert_close(loss((a + b) / 2, target), (loss(a, target) + loss(b, target)) / 2)
    slopes = [torch.autograd.grad(loss(m, target), m)[0] for m in (a, b)]
    assert torch.equal(*slopes)


@pytest.mark.parametrize("kernel", ["box", "gaussian"])
def test_the_smooth_loss_is_smallest_where_the_blurred_target_is_above_a_quarter(kernel):
    target = torch.zeros(1, 120, 160, dtype=torch.float64)
    target[:, 40:80, 50:110] = 1
    target[:, 58:62, 110:150] = 1  # a rod, thinner than a quarter of the box
    pred = torch.zeros_like(target).requires_grad_()
    options = {"kernel": kernel, "size": 25} if kernel == "box" else {"kernel": kernel, "size": 69}
    (slope,) = torch.autograd.grad(losses.smooth_loss(pred, target, **options), pred)
    best = (slope < 0).double()
    blur = (
        _formulas.box_mean(target, 25)
        if kernel == "box"
        else _formulas.gaussian_blur(target, 11.5, 34)
    )
    # Where all windows are inside the image.
    inner = (slice(None), slice(35, -35), slice(35, -35))
    assert torch.equal(best[inner], (blur > 0.25).double()[inner])
    assert losses.smooth_loss(best, target, **options) < losses.smooth_loss(
        target, target, **options
    )
    if kernel == "box":
        grown = best[0, 60, :80].argmax().item()
        assert grown == 50 - 6  # a quarter of the box beyond a straight edge
        assert target[0, 60, 130] == 1
        assert best[0, 60, 130] == 0  # the rod is gone


@pytest.mark.parametrize("name", ["tanimoto", "blurred", "outline"])
def test_some_losses_are_least_at_equality(name):
    target = disc(11.2, 15.7, 6.3)
    loss = made(name)
    assert loss(target, target).item() == 0
    binary = (target > 0.5).double()
    for other in (disc(11.2, 15.7, 7.0), disc(10.4, 15.7, 6.3), noise(1, (1, H, W))):
        assert loss((other > 0.5).double(), binary) > 0
        if name != "outline":
            assert loss(other, target) > 0


def test_tanimoto_reaches_masks_that_do_not_touch_and_iou_does_not():
    target = disc(11.0, 5.0, 3.0)
    pred = disc(11.0, 25.0, 3.0).requires_grad_()
    for name, reaches in (("iou", False), ("tanimoto", True), ("giou", True), ("outline", True)):
        (slope,) = torch.autograd.grad(made(name)(pred, target), pred)
        row = slope[0, 11, 19:31]
        uneven = (row - row.mean()).abs().max() > 1e-9
        assert uneven == reaches, name


# ------------------------------------------------------------------------------ values


def test_iou_by_hand():
    pred, target = torch.zeros(2, 4, 4), torch.zeros(2, 4, 4)
    pred[0, :2], target[0, 1:3] = 1, 1
    pred[1, 0, 0] = target[1, 0, 0] = 1
    found = losses.iou_loss(pred, target, reduction="none")
    torch.testing.assert_close(found, torch.tensor([2 / 3, 0.0]), atol=1e-6, rtol=0)


def test_giou_by_hand():
    pred, target = torch.zeros(1, 9, 9), torch.zeros(1, 9, 9)
    pred[:, 1:3, 1:3], target[:, 5:8, 4:6] = 1, 1  # a box of 7 x 5 around 4 + 6 pixels
    for box in ("soft", "threshold"):
        assert abs(losses.giou_loss(pred, target, box=box).item() - (1 + 25 / 35)) < 1e-6
    empty = torch.zeros(1, 9, 9)
    for box in ("soft", "threshold"):
        assert losses.giou_loss(empty, empty, box=box).item() == 1
        assert torch.isfinite(losses.giou_loss(empty, target, box=box))


def test_the_box_of_giou_has_a_gradient():
    target = torch.zeros(1, 9, 12)
    target[:, 3:6, 1:4] = 1
    pred = torch.zeros(1, 9, 12)
    pred[:, 3:6, 6:9] = 1
    pred[:, 4, 9] = 0.4  # the box ends here
    pred.requires_grad_()
    (soft,) = torch.autograd.grad(losses.giou_loss(pred, target), pred)
    (hard,) = torch.autograd.grad(losses.giou_loss(pred, target, box="threshold"), pred)
    assert (soft[0, 4, 9] - soft[0, 3, 9]) > 0.01
    assert hard[0, 4, 9] == hard[0, 3, 9]


def test_distances_are_exact():
    mask = torch.zeros(1, 6, 9)
    mask[0, 2, 3] = 1
    found = signed_distance_op(mask, 0)[0]
    assert found[2, 3] == -0.5
    assert found[2, 8] == 4.5
    assert abs(found[5, 7].item() - 4.5) < 1e-6
    assert signed_distance_op(torch.ones(1, 3, 3), 0).abs().sum() == 0


def test_the_outline_loss_does_not_depend_on_scale():
    small = losses.outline_loss(disc(30, 33, 10, (60, 60)), disc(30, 30, 10, (60, 60)))
    large = losses.outline_loss(disc(90, 99, 30, (180, 180)), disc(90, 90, 30, (180, 180)))
    assert abs(small / large - 1) < 0.1


def test_a_target_without_outline_is_left_out():
    pred = noise(1).requires_grad_()
    loss = losses.outline_loss(pred, torch.zeros(2, H, W, dtype=torch.float64))
    assert loss.item() == 0
    assert torch.autograd.grad(loss, pred)[0].abs().sum() == 0


@pytest.mark.parametrize("name", NAMED)
def test_reductions_and_weights(name):
    pred, target = noise(1, (3, H, W)), noise(2, (3, H, W))
    each = made(name, reduction="none")(pred, target)
    assert each.shape == (3,)
    weight = torch.tensor([0.5, 0.0, 2.0], dtype=torch.float64)
    torch.testing.assert_close(made(name)(pred, target), each.mean())
    torch.testing.assert_close(made(name, reduction="sum")(pred, target), each.sum())
    torch.testing.assert_close(made(name)(pred, target, weight), (weight * each).sum() / 2.5)
    torch.testing.assert_close(made(name, reduction="none")(pred, target, weight), weight * each)
    assert made(name)(pred, target, 0 * weight).item() == 0
    alone = made(name, reduction="none")(pred[1:2], target[1:2])
    torch.testing.assert_close(alone, each[1:2])


def test_authors_sigma_is_the_same_for_every_size():
    pred, target = noise(1, (1, 90, 90)), noise(2, (1, 90, 90))
    values = [
        losses.smooth_loss(pred, target, kernel="gaussian", size=size, sigma="authors").item()
        for size in (35, 49, 59, 69)
    ]
    assert max(values) - min(values) < 1e-12
    other = losses.smooth_loss(pred, target, kernel="gaussian", size=69).item()
    given = losses.smooth_loss(pred, target, kernel="gaussian", size=69, sigma=11.5).item()
    assert other == given
    assert abs(other - values[0]) > 1e-6


# ------------------------------------------------------------------------------ torch


# opcheck itself looks at .grad of tensors that have none.
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf:UserWarning")
@pytest.mark.parametrize("name", IN_RUST)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["f64", "f32"])
def test_operators_keep_the_rules_of_torch(name, dtype):
    size, sigmas = NAMED[name].get("size", 1), [2.0]
    if name == "box":
        sigmas = []
    for wants in ((True, True), (True, False), (False, False)):
        masks = [
            noise(k, (2, 9, 12), dtype).requires_grad_(wanted) for k, wanted in enumerate(wants)
        ]
        torch.library.opcheck(mask_loss_op, (*masks, name, size, sigmas, 1e-7, *wants, 0))


def test_further_operators_keep_the_rules_of_torch():
    utilities = ("test_schema", "test_faketensor")
    images, factors = noise(1, (2, 9, 12)), noise(2, (2,))
    torch.library.opcheck(scale_images_op, (images, factors, 0), test_utils=utilities)
    torch.library.opcheck(signed_distance_op, (images, 0), test_utils=utilities)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_compiled_without_a_graph_break(name):
    torch._dynamo.reset()
    loss = made(name)
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    target = disc(11.0, 14.0, 5.0, dtype=torch.float32)
    slopes = []
    for function in (loss, compiled):
        pred = noise(1, (1, H, W), torch.float32).requires_grad_()
        value = function(pred, target)
        slopes.append((value.detach(), *torch.autograd.grad(value, pred)))
    for a, b in zip(*slopes, strict=True):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_and_autocast_are_computed_in_single(name, half):
    pred, target = noise(1, dtype=half), disc(11.0, 15.0, 6.0).expand(2, -1, -1).to(half)
    expected = made(name)(pred.float(), target.float())
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = made(name)(pred.requires_grad_(), target)
    assert found.dtype == torch.float32
    assert found == expected
    found.backward()
    assert pred.grad.dtype == half
    assert torch.isfinite(pred.grad).all()


@pytest.mark.parametrize("name", IN_RUST)
def test_formulas_for_other_devices_ignore_autocast(name):
    pred, target = noise(1, dtype=torch.float32), noise(2, dtype=torch.float32)
    expected = formula(name, pred, target)
    from dronepose.losses._batch import precise

    with torch.autocast("cpu", dtype=torch.bfloat16), precise(pred):
        assert torch.equal(formula(name, pred, target), expected)


@pytest.mark.parametrize("name", [*IN_RUST, "outline"])
def test_threads_change_no_bit(name):
    pred, target = noise(1, (9, H, W), torch.float32), noise(2, (9, H, W), torch.float32)
    results = []
    for threads in (1, 2, 7):
        mask = pred.clone().requires_grad_()
        values = made(name, reduction="none", num_threads=threads)(mask, target)
        (slope,) = torch.autograd.grad(values.sum(), mask)
        results.append((values.detach(), slope))
    for values, slope in results[1:]:
        assert torch.equal(values, results[0][0])
        assert torch.equal(slope, results[0][1])


def test_memory_of_gradients_is_not_shared():
    target = noise(2, (2, 300, 300), torch.float32)
    kept = []
    for k in range(3):
        pred = noise(k, (2, 300, 300), torch.float32).requires_grad_()
        value = losses.tanimoto_loss(pred, target, sigmas=[1.0])
        (slope,) = torch.autograd.grad(value, pred, retain_graph=True)
        (again,) = torch.autograd.grad(value, pred)
        assert torch.equal(slope, again)
        kept.append((slope, slope.clone()))
    for slope, copy in kept:
        assert torch.equal(slope, copy)


def test_second_derivatives_are_refused():
    pred = noise(1).requires_grad_()
    value = losses.tanimoto_loss(pred, noise(2))
    (slope,) = torch.autograd.grad(value, pred, create_graph=True)
    if slope.requires_grad:
        with pytest.raises(RuntimeError, match="first derivatives only"):
            torch.autograd.grad(slope.sum(), pred)


def test_strided_masks_and_targets_of_booleans():
    pred, target = noise(1), noise(2) > 0.5
    expected = losses.smooth_loss(pred, target.double())
    turned = pred.transpose(1, 2).contiguous().transpose(1, 2)
    assert losses.smooth_loss(turned, target) == expected


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", NAMED)
def test_a_cuda_device_agrees_with_the_cpu(name):
    slopes = []
    for device in ("cpu", "cuda"):
        pred = noise(1, (2, 60, 80), torch.float32).to(device).requires_grad_()
        target = disc(30.0, 40.0, 15.0, (60, 80), torch.float32).expand(2, -1, -1).to(device)
        value = made(name)(pred, target)
        (slope,) = torch.autograd.grad(value, pred)
        slopes.append((value.detach().cpu(), slope.cpu()))
    torch.testing.assert_close(slopes[0][0], slopes[1][0], atol=2e-6, rtol=1e-5)
    scale = slopes[0][1].abs().max().item()
    torch.testing.assert_close(slopes[0][1], slopes[1][1], atol=1e-5 * scale, rtol=0)


# ------------------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda s, y: losses.iou_loss(s[0], y), "pred: expected shape (B, H, W)"),
        (lambda s, y: losses.iou_loss(s[:0], y), "pred: expected shape (B, H, W)"),
        (lambda s, y: losses.iou_loss(s, y[:, 1:]), "target: expected shape (2, 23, 31)"),
        (lambda s, y: losses.iou_loss(s, y, eps=0), "eps: expected a finite number above 0"),
        (lambda s, y: losses.iou_loss(s, y, reduction="avg"), "reduction: expected 'mean', 'sum'"),
        (lambda s, y: losses.iou_loss(s, y, weight=y), "weight: expected shape (2,)"),
        (lambda s, y: losses.giou_loss(s, y, box="x"), "box: expected 'soft' or 'threshold'"),
        (lambda s, y: losses.giou_loss(s, y, threshold=1), "threshold: expected 0 to below 1"),
        (lambda s, y: losses.smooth_loss(s, y, kernel="x"), "kernel: expected 'box' or 'gaussian'"),
        (lambda s, y: losses.smooth_loss(s, y, size=48), "size: expected an odd number"),
        (lambda s, y: losses.smooth_loss(s, y, sigma=1), "sigma: belongs to kernel 'gaussian'"),
        (lambda s, y: losses.smooth_loss(s, y, kernel="gaussian", sigma=0), "sigma: expected more"),
        (
            lambda s, y: losses.smooth_loss(s, y, kernel="gaussian", sigma="x"),
            "sigma: expected",
        ),
        (lambda s, y: losses.smooth_loss(s, y, num_threads=-1), "num_threads: expected 0"),
        (lambda s, y: losses.tanimoto_loss(s, y, sigmas=[]), "sigmas: expected at least one"),
        (lambda s, y: losses.tanimoto_loss(s, y, sigmas=[-1]), "sigmas: expected 0 to 1000"),
        (lambda s, y: losses.tanimoto_loss(s, y, eps=math.nan), "eps: expected a finite number"),
        (lambda s, y: losses.blurred_loss(s, y, sigma=math.inf), "sigma: expected 0 to 1000"),
    ],
)
def test_what_is_wrong_is_named(function, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        function(noise(1), noise(2))


def test_what_is_no_tensor_is_named():
    for bad in (np.zeros((1, 2, 2)), None, torch.zeros(1, 2, 2, dtype=torch.uint8)):
        with pytest.raises(TypeError, match=r"^pred: "):
            losses.iou_loss(bad, noise(1))
        with pytest.raises(TypeError, match=r"^target: "):
            losses.iou_loss(noise(1), bad)


def test_unknown_names_and_options_are_refused_with_the_list():
    with pytest.raises(ValueError, match="iou, giou, box, gaussian, tanimoto, blurred, outline"):
        silhouette_loss("dice")
    with pytest.raises(TypeError, match=r"^sigmaa: expected one of the options sigmas, eps"):
        silhouette_loss("tanimoto", sigmaa=1)
    with pytest.raises(TypeError, match="sigma"):
        silhouette_loss("blurred")
    with pytest.raises(ValueError, match=r"^size: "):
        silhouette_loss("box", size=10)


def test_modules_are_the_functions():
    pred, target = noise(1), noise(2)
    expected = losses.smooth_loss(pred, target, kernel="gaussian", size=11)
    assert made("gaussian")(pred, target) == expected
    assert repr(made("blurred")) == "BlurredLoss(sigma=2.0)"
    assert not list(made("box").parameters())
    assert not made("box").state_dict()


def test_the_package_says_what_to_install():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import dronepose\n"
        "try:\n    import dronepose.losses\n"
        "except ImportError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "dronepose[torch]"' in done.stdout
