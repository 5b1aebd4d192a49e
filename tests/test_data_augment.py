"""Augmentation: the pose and the camera explain the augmented mask."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("torchvision", reason="torchvision is not installed")
pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose import Camera, Mesh, render  # noqa: E402
from dronepose.data import (  # noqa: E402
    GeometricAugmentation,
    PhotometricAugmentation,
    Raw,
    ToySettings,
    render_toy_sample,
)
from dronepose.data.augment import rotated  # noqa: E402
from dronepose.data.sample import resized  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402

SIZE = (480, 640)
MESH = Mesh.from_file(EXAMPLE_MESH)
SETTINGS = ToySettings(height=SIZE[0], width=SIZE[1], distance=(0.7, 1.0), seed=4)


def toy(number):
    """A sample whose image is white, so that its border shows where the mask is known."""
    _, mask, R, t = render_toy_sample(SETTINGS, "train", number)
    K = SETTINGS.camera.K.copy()
    return Raw(np.full((*SIZE, 3), 255, np.uint8), mask, K, R, t, str(number))


def overlap(raw):
    """Intersection over union of the mask and the mesh drawn with the sample's K, R, t."""
    camera = Camera.from_K(raw.K, raw.size[1], raw.size[0])
    drawn = render.silhouette(MESH, camera, raw.R[None], raw.t[None])[0] > 0.5
    known = raw.image[..., 0] == 255
    given = raw.mask > 127
    return (known & drawn & given).sum() / (known & (drawn | given)).sum()


KINDS = {
    "rotation": {"rotation_deg": 180.0},
    "scale": {"scale": (0.7, 1.6)},
    "shift": {"shift": 0.3},
    "all": {"rotation_deg": 30.0, "scale": (0.8, 1.4), "shift": 0.15},
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_mesh_lands_on_the_augmented_mask(kind):
    augment = GeometricAugmentation(**KINDS[kind])
    for k in range(6):
        raw = toy(k)
        changed = augment(raw, np.random.default_rng(k))
        assert changed is not raw
        assert overlap(changed) > 0.98
        if kind == "rotation":
            np.testing.assert_array_equal(changed.K, raw.K)
            assert overlap(replace(changed, R=raw.R)) < 0.8
        else:
            assert overlap(replace(changed, K=raw.K)) < 0.8
        np.testing.assert_allclose(changed.R @ changed.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(changed.R) > 0


def test_half_a_pixel_would_be_seen():
    changed = GeometricAugmentation(**KINDS["all"])(toy(0), np.random.default_rng(0))
    off = changed.K.copy()
    off[:2, 2] += 0.5
    assert overlap(replace(changed, K=off)) < overlap(changed) - 0.01


def test_a_turn_is_exact_for_any_camera():
    """With fx unlike fy and the principal point off the middle, which a plain turn would miss."""
    camera = Camera(700, 500, 290, 260, width=640, height=480)
    _, _, R, t = render_toy_sample(SETTINGS, "train", 2)
    t = np.array([0.05, -0.02, 0.8])
    mask = render.silhouette(MESH, camera, R[None], t[None])[0]
    image = np.full((*SIZE, 3), 255, np.uint8)
    raw = Raw(image, np.round(mask * 255).astype(np.uint8), camera.K, R, t, "a")
    turned = rotated(raw, 0.7)
    assert overlap(turned) > 0.98
    np.testing.assert_allclose(turned.t[2], t[2])
    np.testing.assert_allclose(np.linalg.norm(turned.t), np.linalg.norm(t))
    back = rotated(turned, -0.7, pixels=False)
    np.testing.assert_allclose(back.R, R, atol=1e-12)


def test_resizing_keeps_the_mesh_on_the_mask():
    raw = toy(1)
    for height, width in ((960, 960), (400, 700)):
        assert overlap(resized(raw, height, width)) > 0.97


def test_the_drone_stays_in_the_image():
    augment = GeometricAugmentation(shift=1.0, keep=0.9)
    changed = kept = 0
    for k in range(20):
        raw = toy(k % 4)
        out = augment(raw, np.random.default_rng(k))
        changed += out is not raw
        kept += out.mask.sum(dtype=float) >= 0.88 * raw.mask.sum(dtype=float)
    assert kept == 20
    assert changed > 5
    without = GeometricAugmentation(shift=1.0)
    for k in range(20):
        out = without(replace(toy(0), mask=None), np.random.default_rng(k))
        u, v = (out.K @ (out.t / out.t[2]))[:2]
        assert 0 <= u < 640
        assert 0 <= v < 480


def test_the_same_generator_gives_the_same_sample():
    augment = GeometricAugmentation(**KINDS["all"])
    one, two = (augment(toy(0), np.random.default_rng(9)) for _ in range(2))
    np.testing.assert_array_equal(one.image, two.image)
    np.testing.assert_array_equal(one.K, two.K)
    assert GeometricAugmentation(probability=0)(raw := toy(0), np.random.default_rng(0)) is raw


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rotation_deg": 181.0}, "rotation_deg: expected 0 to 180"),
        ({"scale": (0.0, 1.0)}, "scale: expected"),
        ({"scale": (2.0, 1.0)}, "scale: expected"),
        ({"shift": -0.1}, "shift: "),
        ({"border": "mirror"}, "border: expected one of reflect, black"),
    ],
)
def test_what_is_out_of_range_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        GeometricAugmentation(**options)
    with pytest.raises(ValueError, match=r"hue: expected 0 to 0\.5, got 0\.6"):
        PhotometricAugmentation(hue=0.6)


def test_colours_change_and_places_do_not():
    image = torch.from_numpy(render_toy_sample(ToySettings(), "train", 0)[0]).permute(2, 0, 1) / 255
    augment = PhotometricAugmentation(blur=0, noise=0)
    state = torch.random.get_rng_state()
    one = augment(image, np.random.default_rng(1))
    assert torch.equal(one, augment(image, np.random.default_rng(1)))
    assert torch.equal(torch.random.get_rng_state(), state)
    assert one.shape == image.shape
    assert 0 <= one.min() <= one.max() <= 1
    assert not torch.allclose(one, image, atol=0.02)
    grey, changed = image.mean(dim=0).flatten(), one.mean(dim=0).flatten()
    assert torch.corrcoef(torch.stack([grey, changed]))[0, 1] > 0.9


def test_noise_blur_and_erasing():
    flat = torch.full((3, 60, 80), 0.5)
    none = {"brightness": 0, "contrast": 0, "saturation": 0, "hue": 0}
    noisy = PhotometricAugmentation(**none, blur=0, noise=0.05)(flat, np.random.default_rng(0))
    assert 0.001 < noisy.std() < 0.05
    erased = PhotometricAugmentation(**none, blur=0, noise=0, erase=1)
    share = (erased(flat, np.random.default_rng(0)) != 0.5).float().mean()
    assert 0.01 < share < 0.12
    edge = flat.clone()
    edge[..., 40:] = 1
    blur = PhotometricAugmentation(**none, blur=3, noise=0)
    widths = []
    for seed in range(10):
        soft = blur(edge, np.random.default_rng(seed))
        widths.append(int(((soft > 0.51) & (soft < 0.99))[0, 30].sum()))
    assert max(widths) > 4
    assert len(set(widths)) > 2
