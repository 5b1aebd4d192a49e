"""Losses of the pose: values, gradients at 0 and at pi, weights, errors."""

import math
import re

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from dronepose import losses  # noqa: E402


def turn(axis, angle, dtype=torch.float64):
    """Rodrigues."""
    axis = torch.tensor(axis, dtype=dtype)
    x, y, z = axis / axis.norm()
    k = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=dtype)
    return torch.eye(3, dtype=dtype) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def poses(seed, count=3):
    generator = torch.Generator().manual_seed(seed)
    axes = torch.randn(count, 3, dtype=torch.float64, generator=generator).tolist()
    R = torch.stack([turn(axis, 0.4 + k) for k, axis in enumerate(axes)])
    return R, torch.randn(count, 3, dtype=torch.float64, generator=generator)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.3, 1.5, 3.0, math.pi - 1e-6, math.pi])
def test_angles_keep_their_digits(angle):
    start = turn([0.2, -0.5, 0.7], 0.9)
    R = turn([1.0, 2.0, -0.5], angle) @ start
    assert abs(losses.rotation_loss(R[None], start[None]).item() - angle) < 1e-14 + 1e-9 * angle
    single = losses.rotation_loss(R[None].float(), start[None].float()).item()
    assert abs(single - angle) < 1e-6


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, math.pi - 1e-7, math.pi])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_the_gradient_is_finite_at_zero_and_at_a_half_turn(angle, dtype):
    for axis in ([1.0, 0, 0], [1.0, 2, 3]):
        R = turn(axis, angle).to(dtype)[None].requires_grad_()
        (slope,) = torch.autograd.grad(losses.rotation_loss(R, torch.eye(3)[None]), R)
        assert torch.isfinite(slope).all()
        assert slope.abs().max() < 10


def test_a_small_error_pulls_as_hard_as_a_large_one():
    for angle in (1e-6, 1e-2, 1.0, 3.0):
        w = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
        k = torch.tensor([[0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=torch.float64)
        R = torch.eye(3, dtype=torch.float64) + w.sin() * k + (1 - w.cos()) * k @ k
        (slope,) = torch.autograd.grad(losses.rotation_loss(R[None], torch.eye(3)[None]), w)
        assert abs(slope.item() - 1) < 1e-8


def test_roma_agrees():
    roma = pytest.importorskip("roma", reason="roma is not installed")
    (R, _), (R_gt, _) = poses(1), poses(2)
    expected = roma.rotmat_geodesic_distance(R, R_gt)
    torch.testing.assert_close(losses.rotation_loss(R, R_gt, reduction="none"), expected)


def test_a_matrix_of_zeros_is_no_nan():
    R = torch.zeros(1, 3, 3, requires_grad=True)
    loss = losses.rotation_loss(R, torch.eye(3)[None])
    assert torch.isfinite(loss)
    assert torch.isfinite(torch.autograd.grad(loss, R)[0]).all()


def test_translations_by_hand():
    t, t_gt = torch.tensor([[1.0, 2, 3]]), torch.tensor([[0.0, 0, 1]])
    assert losses.translation_loss(t, t_gt).item() == 9
    assert losses.translation_loss(t, t_gt, form="authors").item() == 3


def test_the_weights_are_those_of_the_paper():
    (R, t), (R_gt, t_gt) = poses(1), poses(2)
    apart = ((t - t_gt) ** 2).sum(1)
    angle = losses.rotation_loss(R, R_gt, reduction="none")
    found = losses.pose_loss(R, t, R_gt, t_gt, lambda_pose=0.7, reduction="none")
    torch.testing.assert_close(found, 0.7 * apart + 0.3 * angle)
    exo = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    torch.testing.assert_close(
        losses.total_loss(found, exo, lambda_exo=0.4), 0.6 * found + 0.4 * exo
    )


def test_the_authors_objective():
    (R, t), (R_gt, t_gt) = poses(1), poses(2)
    exo = torch.tensor(0.3, dtype=torch.float64)
    pose = losses.pose_loss(R, t, R_gt, t_gt, form="authors")
    rotation, position = losses.rotation_loss(R, R_gt), torch.nn.functional.mse_loss(t, t_gt)
    expected = 0.9 * (0.05 * rotation + 0.95 * position) + 0.1 * exo
    torch.testing.assert_close(losses.total_loss(pose, exo), expected)


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
def test_gradcheck(reduction):
    (R, t), (R_gt, t_gt) = poses(1), poses(2)
    weight = torch.tensor([0.2, 1.0, 3.0], dtype=torch.float64)
    arguments = [each.requires_grad_() for each in (R, t, R_gt, t_gt, weight)]

    def loss(R, t, R_gt, t_gt, weight):
        return losses.pose_loss(R, t, R_gt, t_gt, reduction=reduction, weight=weight)

    assert torch.autograd.gradcheck(loss, arguments)


def test_autocast_changes_nothing():
    (R, t), (R_gt, t_gt) = ([each.float() for each in poses(k)] for k in (1, 2))
    expected = losses.PoseLoss()(R, t, R_gt, t_gt)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(losses.PoseLoss()(R, t, R_gt, t_gt), expected)


@pytest.mark.slow
def test_compiled_without_a_graph_break():
    torch._dynamo.reset()
    (R, t), (R_gt, t_gt) = poses(1), poses(2)
    loss = losses.PoseLoss(lambda_pose=0.6)
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    R.requires_grad_()
    slopes = [torch.autograd.grad(f(R, t, R_gt, t_gt), R)[0] for f in (loss, compiled)]
    torch.testing.assert_close(*slopes)


def test_modules_are_the_functions():
    (R, t), (R_gt, t_gt) = poses(1), poses(2)
    weight = torch.tensor([0.2, 1.0, 3.0])
    assert losses.TranslationLoss(form="authors")(t, t_gt) == losses.translation_loss(
        t, t_gt, form="authors"
    )
    assert losses.RotationLoss()(R, R_gt, weight) == losses.rotation_loss(R, R_gt, weight=weight)
    assert repr(losses.TotalLoss(lambda_exo=0.2)) == "TotalLoss(lambda_exo=0.2)"


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda R, t: losses.rotation_loss(R[0], R), "R: expected shape (B, 3, 3)"),
        (lambda R, t: losses.rotation_loss(R, R[:1]), "R_gt: expected shape (3, 3, 3)"),
        (lambda R, t: losses.translation_loss(R, t), "t: expected shape (B, 3)"),
        (lambda R, t: losses.translation_loss(t[:0], t), "t: expected shape (B, 3) with B > 0"),
        (lambda R, t: losses.translation_loss(t, t[:1]), "t_gt: expected shape (3, 3)"),
        (lambda R, t: losses.translation_loss(t, t, form="x"), "form: expected 'paper'"),
        (lambda R, t: losses.pose_loss(R, t[:2], R, t[:2]), "t: expected shape (3, 3)"),
        (lambda R, t: losses.pose_loss(R, t, R, t, lambda_pose=2), "lambda_pose: expected a share"),
        (lambda R, t: losses.total_loss(t, t, lambda_exo=-1), "lambda_exo: expected a share"),
        (lambda R, t: losses.total_loss(t, t[0]), "exo: expected shape (3, 3)"),
        (lambda R, t: losses.PoseLoss(lambda_pose=math.nan), "lambda_pose: expected a share"),
    ],
)
def test_what_is_wrong_is_named(function, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        function(*poses(1))


def test_what_is_no_tensor_is_named():
    with pytest.raises(TypeError, match=r"^t_gt: expected a torch.Tensor, got list"):
        losses.translation_loss(torch.zeros(1, 3), [[0, 0, 0]])
    with pytest.raises(TypeError, match=r"^R: expected floating point numbers"):
        losses.rotation_loss(torch.zeros(1, 3, 3, dtype=torch.int64), torch.zeros(1, 3, 3))
