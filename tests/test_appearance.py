"""Colours of surfaces: textures, light, anti-aliasing."""

import numpy as np
import pytest

from dronepose import Camera, Mesh, render
from dronepose.render import (
    Environment,
    Light,
    Material,
    Texture,
    colour,
    srgb_bytes,
    srgb_linear,
)

CAMERA = Camera(40.0, 42.0, 24.0, 18.0, 48, 36)
SQUARE = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
UV = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])[np.array([[0, 1, 2], [0, 2, 3]])]
EYE = np.eye(3)


def linear(image):
    x = np.asarray(image) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def bilinear(image, uv):
    """Of a texture that repeats, `v` up; the slow way."""
    height, width = image.shape[:2]
    x, y = uv[..., 0] * width - 0.5, (1 - uv[..., 1]) * height - 0.5
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    a, b = (y - i)[..., None], (x - j)[..., None]

    def at(i, j):
        return linear(image[i % height, j % width])

    upper = at(i, j) * (1 - b) + at(i, j + 1) * b
    lower = at(i + 1, j) * (1 - b) + at(i + 1, j + 1) * b
    return upper * (1 - a) + lower * a


def turned(angle, axis=1):
    c, s = np.cos(angle), np.sin(angle)
    i, j = [k for k in range(3) if k != axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def test_a_magnified_texture_is_that_of_the_oracle():
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    R, t = turned(0.7) @ turned(0.3, 0), np.array([0.1, -0.1, 2.2])
    material = Material(Texture(image), lit=False)
    found = colour(SQUARE, CAMERA, R, t, materials=material, uv=UV, samples=8)
    n = 8  # the same points, each with its own colour
    fine = Camera(n * 40.0, n * 42.0, n * 24.0, n * 18.0, n * 48, n * 36)
    seen = render.gbuffer(SQUARE, fine, R, t, channels=("mask", "uv"), uv=UV, dtype=np.float64)
    each = bilinear(image, seen.uv) * seen.mask[..., None]
    expected = each.reshape(36, n, 48, n, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found.share, seen.mask.reshape(36, n, 48, n).mean(axis=(1, 3)))
    # One colour for each face in a pixel, at the mean of its points: exact where it is affine.
    assert np.abs(found.rgb - expected).mean() < 1e-3
    assert np.abs(found.rgb - expected).max() < 0.06


def test_a_fine_pattern_far_away_is_its_mean():
    image = np.zeros((256, 256, 3), np.uint8)
    image[::2, ::2] = image[1::2, 1::2] = 255
    far = colour(
        SQUARE, CAMERA, turned(0.9), [0, 0, 8.0], materials=Material(Texture(image), lit=False),
        uv=UV, samples=4,
    )  # fmt: skip
    inside = far.share > 0.99
    assert inside.any()
    np.testing.assert_allclose(far.rgb[inside], 0.5, atol=0.05)


def test_what_is_in_front_hides_what_is_behind():
    red, green = Material((1.0, 0, 0), lit=False), Material((0, 1.0, 0), lit=False)
    R = np.stack([EYE, turned(0.4)])
    t = np.array([[0.0, 0, 3], [0.8, 0.2, 2.6]])
    found = colour([SQUARE, SQUARE], CAMERA, R, t, materials=[[red], [green]], samples=5)
    shares = render.gbuffer(
        [SQUARE, SQUARE], CAMERA, R, t, channels=("coverage_each",), samples=5
    ).coverage
    np.testing.assert_allclose(found.shares, shares, atol=1e-6)
    np.testing.assert_allclose(found.rgb[..., 0], shares[0], atol=1e-6)
    np.testing.assert_allclose(found.rgb[..., 1], shares[1], atol=1e-6)
    np.testing.assert_allclose(found.share, shares.sum(axis=0), atol=1e-6)


def test_opacity_shows_the_mesh_behind():
    """A pane half in front of a wall, over the wall drawn by itself."""
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (4, 4, 4)).astype(np.uint8)
    image[..., 3] = 255 * (image[..., 3] > 127)
    pane, wall = Material(Texture(image), lit=False), Material((0.2, 0.9, 0.4), lit=False)
    t = np.array([[0.9, 0.0, 2.5], [0.0, 0.0, 3.0]])
    options = {"uv": [UV, None], "samples": 4}
    both = colour([SQUARE] * 2, CAMERA, [EYE] * 2, t, materials=[pane, wall], **options)
    alone = colour(SQUARE, CAMERA, EYE, t[1], materials=wall, samples=4)
    hiding = Material(Texture(np.ascontiguousarray(image[..., :3])), lit=False)
    front = colour([SQUARE] * 2, CAMERA, [EYE] * 2, t, materials=[hiding, wall], **options)
    assert front.veil.max() == 0
    np.testing.assert_array_equal(front.shares, both.shares)
    # Bytes 0 and 255 stand for 0 and 1 in colours too.
    grey = Material(Texture(np.repeat(image[..., 3:], 3, axis=2)), lit=False)
    opacity = colour(SQUARE, CAMERA, EYE, t[0], materials=grey, uv=UV, samples=4)
    seen = both.shares[0] > 0.999
    shown = 1 - both.veil[seen]
    assert shown.min() < 0.3 < 0.7 < shown.max()
    np.testing.assert_allclose(shown, opacity.rgb[seen][:, 0], atol=1e-6)
    over = both.rgb + both.veil[..., None] * alone.rgb
    rim = (both.shares[0] > 0) & (both.shares[1] > 0)
    expected = shown[:, None] * front.rgb[seen] + (1 - shown)[:, None] * alone.rgb[seen]
    assert np.abs(over[seen] - expected).max() < 1e-3  # a pixel of two faces: a product of means
    assert rim.any()
    assert over[rim].max() <= 1.0


def test_light_comes_from_where_the_panorama_has_it():
    bright = np.zeros((32, 64, 3))
    bright[:16] = 1  # the upper half of the world
    world_from_camera = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # looks along x
    white = Material((1.0, 1.0, 1.0), roughness=1.0)
    light = Light(Environment(bright), 1.0, world_from_camera)
    values = {}
    for name, tilt in (("up", -0.9), ("level", 0.0), ("down", 0.9)):
        R = turned(tilt, 0)
        found = colour(SQUARE, CAMERA, R, [0, 0, 3.0], materials=white, lights=light)
        values[name] = found.rgb[18, 24, 0]
    normal = -turned(-0.9, 0)[:, 2]
    assert normal[1] < 0  # y is down: this one faces the sky
    assert values["up"] > values["level"] > values["down"]
    assert values["level"] == pytest.approx(0.5, abs=0.06)


def test_strength_and_colour_scale_what_is_seen():
    even = Environment(np.ones((8, 16, 3)))
    seen = {}
    for strength in (0.3, 0.6):
        for grey in (0.2, 0.4):
            material = Material((grey, grey, grey), roughness=0.8)
            found = colour(
                SQUARE, CAMERA, EYE, [0, 0, 2.0], materials=material,
                lights=Light(even, strength),
            )  # fmt: skip
            seen[strength, grey] = found.rgb[18, 24, 0]
    assert seen[0.6, 0.2] == pytest.approx(2 * seen[0.3, 0.2], rel=1e-5)
    assert seen[0.3, 0.4] - seen[0.3, 0.2] == pytest.approx(0.3 * 0.2 * 0.96, rel=0.1)


def test_threads_and_batches_give_the_same_bits():
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (16, 16, 3)).astype(np.uint8)
    R = np.stack([turned(a) for a in (0.1, 0.8, -0.5, 2.0)])
    t = np.array([[0.0, 0, 2], [0.3, 0, 3], [0, 0.5, 1.2], [0, 0, 0.9]])
    options = {"materials": Material(Texture(image), lit=False), "uv": UV}
    one = colour(SQUARE, CAMERA, R, t, threads=1, **options)
    for threads in (2, 7):
        more = colour(SQUARE, CAMERA, R, t, threads=threads, **options)
        assert one.rgb.tobytes() == more.rgb.tobytes()
    single = colour(SQUARE, CAMERA, R[2], t[2], **options)
    assert single.rgb.tobytes() == one.rgb[2].tobytes()


def test_srgb_bytes_are_the_standard():
    every = np.arange(256)
    np.testing.assert_array_equal(srgb_bytes(linear(every)), every)
    np.testing.assert_allclose(srgb_linear(every.astype(np.uint8)), linear(every), rtol=1e-6)
    assert srgb_bytes([[-1.0, np.nan], [2.0, 0.214]]).tolist() == [[0, 0], [255, 127]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"materials": []}, r"materials\[0\]: expected at least one"),
        ({"materials": Material((0.5, -1.0, 0.5), lit=False)}, "colour"),
        ({"materials": Material((0.5, 0.5, 0.5))}, "lights"),
        ({"materials": Material((0.5,) * 3, roughness=2.0)}, "roughness"),
        ({"material_of_face": [0, 1]}, "index 1 of 1"),
        ({"material_of_face": [0.0, 0.0]}, "material_of_face"),
        ({"materials": Material(Texture(np.zeros((1, 1, 3), np.uint8)), lit=False)}, "texture"),
        ({"samples": 9}, "samples"),
        ({"normals": "round"}, "normals"),
        ({"near": -1.0}, "near"),
    ],
)
def test_what_cannot_be_drawn_is_named(change, message):
    options = {"materials": Material((0.5, 0.5, 0.5), lit=False), **change}
    with pytest.raises(ValueError, match=message):
        colour(SQUARE, CAMERA, EYE, [0, 0, 2.0], **options)


def test_wrong_pictures_are_named():
    with pytest.raises(ValueError, match="image: expected uint8"):
        Texture(np.zeros((2, 2), np.uint8))
    with pytest.raises(ValueError, match="radiance: expected shape"):
        Environment(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="row 1, column 0"):
        Environment(np.array([[[1.0] * 3], [[np.inf] * 3]]))
