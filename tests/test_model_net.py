"""The pose network: layers, rotation, camera."""

import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("torchvision")
roma = pytest.importorskip("roma")

from dronepose import geometry  # noqa: E402
from dronepose.model import PoseNet, backbone_names  # noqa: E402
from dronepose.model.network import from_image, smallest_rotation_to  # noqa: E402

K = torch.tensor([[60.0, 0.5, 31.0], [0.0, 55.0, 25.0], [0.0, 0.0, 1.0]])


def small(**options):
    torch.manual_seed(3)
    return PoseNet("resnet18", hidden=(24, 12), **options).eval()


def images(n=2, seed=0, height=48, width=64):
    return torch.rand(n, 3, height, width, generator=torch.Generator().manual_seed(seed))


def test_the_outputs_are_rotations_and_translations():
    with torch.no_grad():
        R, t = small()(images(3))
    assert R.shape == (3, 3, 3)
    assert t.shape == (3, 3)
    torch.testing.assert_close(R @ R.mT, torch.eye(3).expand(3, 3, 3), atol=1e-6, rtol=0)
    assert (torch.linalg.det(R) > 0.999).all()


def test_the_layers_are_those_of_the_authors():
    net = PoseNet()
    shapes = [tuple(layer.weight.shape) for layer in (net.embedding, *net.layers)]
    assert shapes == [(2048, 512), (1024, 2048), (512, 1024), (128, 512)]
    assert net.rotation.weight.shape == (6, 128)
    assert net.rotation.bias is None
    assert net.translation.bias.shape == (3,)


def test_the_forward_pass_step_by_step():
    net = small()
    x = images()
    with torch.no_grad():
        z = net.embedding(net.backbone(x))  # no activation here
        z = torch.nn.functional.elu(net.layers[0](z))
        six = (z @ net.rotation.weight.T).double().numpy()
        R, t = net(x)
    np.testing.assert_allclose(R.numpy(), geometry.matrix_from_6d(six), atol=2e-6)
    torch.testing.assert_close(t, net.translation(z))


def test_the_seed_decides_the_weights():
    for (name, a), b in zip(small().named_parameters(), small().parameters(), strict=True):
        assert torch.equal(a, b), name


def test_normalisation_is_that_of_imagenet():
    plain, normalised = small(), small(normalisation="imagenet")
    mean = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
    std = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    x = images()
    with torch.no_grad():
        torch.testing.assert_close(normalised(x).t, plain((x - mean) / std).t)
        assert (normalised(x).t - plain(x).t).abs().max() > 1e-4
    assert set(plain.state_dict()) == set(normalised.state_dict())


def test_gradients_reach_every_weight():
    net = small(camera="normalised").train()
    R, t = net(images(4), K)
    (R[:, 0, 1].sum() + R[:, 2, 0].sum() + t.square().sum()).backward()
    for name, parameter in net.named_parameters():
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_heads_are_float32_under_autocast():
    net = small()
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        R, t = net(images())
    assert R.dtype == t.dtype == torch.float32
    torch.testing.assert_close(R @ R.mT, torch.eye(3).expand(2, 3, 3), atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", ["vgg11", "densenet121", "mobilenet_v3_small", "squeezenet1_1"])
def test_other_backbones(name):
    net = PoseNet(name, hidden=(8,)).eval()
    with torch.no_grad():
        assert net(images(1, height=64)).t.shape == (1, 3)
    assert not [key for key in net.state_dict() if "classifier" in key]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backbone": "resnet35"}, r"^backbone: 'resnet35' is not one of .*did you mean 'resnet"),
        ({"backbone": "vit_b_16"}, r"^backbone: "),
        ({"hidden": ()}, r"^hidden: "),
        ({"hidden": (16, 0)}, r"^hidden: "),
        ({"normalisation": "minmax"}, r"^normalisation: "),
        ({"camera": "wide"}, r"^camera: "),
    ],
)
def test_wrong_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        PoseNet(**{"backbone": "resnet18", **options})


def test_wrong_inputs():
    net = small(camera="normalised")
    with pytest.raises(ValueError, match=r"^image: expected shape \(B, 3, H, W\), got \(3, 4, 4\)"):
        net(torch.rand(3, 4, 4), K)
    with pytest.raises(TypeError, match=r"^image: .*divide bytes by 255"):
        net(torch.zeros(1, 3, 32, 32, dtype=torch.uint8), K)
    with pytest.raises(TypeError, match=r"^image: expected a torch.Tensor"):
        net(np.zeros((1, 3, 32, 32)), K)
    with pytest.raises(ValueError, match=r"^K: this network is aware"):
        net(images())
    with pytest.raises(ValueError, match=r"^K: expected shape \(3, 3\) or \(2, 3, 3\)"):
        net(images(2), K.expand(3, 3, 3))


def test_the_names_are_sorted_and_known():
    names = backbone_names()
    assert names == sorted(names)
    assert {"resnet18", "resnet34", "resnet50", "vgg16"} <= set(names)


class TestCamera:
    def test_the_offset_is_where_the_origin_is_seen(self):
        abc = torch.tensor([[0.1, -0.2, 0.7], [-0.3, 0.25, -0.4]])
        t = from_image(abc, K, 48, 64)
        seen = t @ K.T
        uv = seen[:, :2] / seen[:, 2:]
        torch.testing.assert_close(uv[:, 0], 64 * (0.5 + abc[:, 0]))
        torch.testing.assert_close(uv[:, 1], 48 * (0.5 + abc[:, 1]))
        depth = np.exp(0.7 / (1 + 0.7 / 8))
        assert t[0, 2].item() == pytest.approx((60 * 55 / (48 * 64)) ** 0.5 * depth, rel=1e-6)

    def test_a_depth_far_off_finds_its_way_back(self):
        """The depth is bounded, and yet its gradient does not vanish."""
        abc = torch.tensor([[0.0, 0.0, -50.0], [0.0, 0.0, 50.0]], requires_grad=True)
        z = from_image(abc, K, 48, 64)[:, 2]
        assert 3e-4 < z[0] < z[1] < 3100
        (slope,) = torch.autograd.grad(z.log().sum(), abc)
        assert (slope[:, 2] > 0.01).all()

    def test_a_scaled_image_has_the_same_pose(self):
        """Twice the pixels in each direction, K in those pixels: one camera."""
        abc = torch.tensor([[0.1, -0.2, 0.7]])
        scaled = K * torch.tensor([2.0, 3.0, 1.0])[:, None]
        torch.testing.assert_close(
            from_image(abc, K, 48, 64), from_image(abc, scaled, 144, 128), rtol=1e-5, atol=1e-6
        )

    def test_a_crop_elsewhere_turns_and_shifts_the_pose_with_it(self):
        """The same picture cut out further right: the drone is seen the same along its ray."""
        net, x = small(camera="normalised"), images(1)
        shifted = K.clone()
        shifted[0, 2] -= 20.0  # the crop begins 20 px further right
        with torch.no_grad():
            (R1, t1), (R2, t2) = net(x, K), net(x, shifted)
        torch.testing.assert_close(t1[:, 2], t2[:, 2])
        assert (60 * (t2[0, 0] - t1[0, 0]) / t1[0, 2]).item() == pytest.approx(20.0, abs=1e-3)
        seen1, seen2 = smallest_rotation_to(t1).mT @ R1, smallest_rotation_to(t2).mT @ R2
        torch.testing.assert_close(seen1, seen2, atol=1e-6, rtol=0)
        assert (R1 - R2).abs().max() > 1e-3

    def test_the_smallest_rotation(self):
        t = torch.tensor([[0.0, 0.0, 2.0], [0.3, -0.4, 1.0], [3.0, 1.0, 0.01]])
        Q = smallest_rotation_to(t)
        torch.testing.assert_close(Q @ Q.mT, torch.eye(3).expand(3, 3, 3), atol=1e-6, rtol=0)
        d = t / t.norm(dim=1, keepdim=True)
        torch.testing.assert_close(Q[:, :, 2], d, atol=1e-6, rtol=0)
        torch.testing.assert_close(roma.rotmat_geodesic_distance(Q, torch.eye(3).expand(3, 3, 3)),
                                   torch.acos(d[:, 2]), atol=1e-3, rtol=0)  # fmt: skip

    def test_depth_stays_finite(self):
        t = from_image(torch.tensor([[0.0, 0.0, 1e4], [0.0, 0.0, -1e4]]), K, 48, 64)
        assert torch.isfinite(t).all()
        assert (t[:, 2] > 0).all()


def test_one_image_and_cameras_of_their_own():
    net = small(camera="normalised")
    both = torch.stack([K, 2 * K])
    both[:, 2, 2] = 1
    x = images(2)
    with torch.no_grad():
        together = net(x, both)
        alone = net(x[1:], both[1])
    torch.testing.assert_close(together.t[1:], alone.t, atol=1e-5, rtol=1e-5)


def test_importing_the_package_needs_no_torch():
    code = (
        "import sys\nsys.modules['torch'] = None\nimport dronepose.model\n"
        "from dronepose.model.metadata import encode\nencode({})\n"
        "try:\n    dronepose.model.PoseNet\nexcept ImportError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "dronepose[train]"' in done.stdout
