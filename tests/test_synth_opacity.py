"""Drones with faces that one can see through."""

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")
pytest.importorskip("trimesh")
pytest.importorskip("PIL")

from dronepose import Camera, Mesh  # noqa: E402
from dronepose.render import Material, Texture, srgb_linear  # noqa: E402
from dronepose.synth.asset import Asset, load_asset, merged  # noqa: E402
from dronepose.synth.opacity import opaque_part, see_through  # noqa: E402
from dronepose.synth.studio import DRONE, SCENE, Studio  # noqa: E402

CAMERA = Camera(60.0, 60.0, 32.0, 24.0, 64, 48)
AHEAD = (np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))
"""A level camera at the origin that looks along the world's y."""
HERE = (np.eye(3), np.zeros(3))
UV = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[np.array([[0, 1, 2], [0, 2, 3]])]


def pane(away, side, material):
    """A square that faces the camera."""
    corners = [[-side, away, -side], [side, away, -side], [side, away, side], [-side, away, side]]
    mesh = Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    return Asset(mesh, (material,), np.zeros(2, np.uint32), UV)


def glass(opacity):
    image = np.full((4, 4, 4), 255, np.uint8)
    image[..., 1:3] = 0  # red
    image[..., 3] = opacity
    return Material(Texture(image), lit=False)


WALL = pane(6.0, 9.0, Material((0.0, 0.5, 0.0), lit=False))


def middle(drone, row=24, column=32):
    """Linear colour of a pixel, and the frame."""
    frame = Studio(WALL, [drone], samples=2, threads=1).frame(CAMERA, AHEAD, [HERE])
    return srgb_linear(frame.colour)[row, column], frame


@pytest.mark.parametrize("opacity", [0, 51, 200, 255])
def test_a_pane_shows_the_wall_behind_by_its_opacity(opacity):
    colour, frame = middle(pane(2.0, 0.5, glass(opacity)))
    share = opacity / 255
    np.testing.assert_allclose(colour, [share, 0.5 * (1 - share), 0.0], atol=0.01)
    # All but colours take it for solid.
    assert frame.depth[24, 32] == pytest.approx(2.0)
    assert frame.instance[24, 32] == DRONE
    assert frame.instance[2, 2] == SCENE
    assert frame.matte.sum() == pytest.approx(frame.silhouette.sum(), rel=0.02)
    assert frame.seen > 0.98


def test_what_is_opaque_of_the_drone_is_seen_through_it():
    body = pane(3.0, 0.5, Material((0.0, 0.0, 1.0), lit=False))
    colour, _ = middle(merged([pane(2.0, 0.5, glass(102)), body]))
    np.testing.assert_allclose(colour, [0.4, 0.0, 0.6], atol=0.01)


def test_faces_are_told_by_their_texture():
    image = np.full((8, 8, 4), 255, np.uint8)
    image[:, 4:, 3] = 100  # the right half
    corners = np.array([[0.05, 0.1], [0.4, 0.1], [0.4, 0.9]])
    uv = np.stack([corners + np.array([right, 0]) for right in (0.0, 0.55, 0.2)])
    mesh = Mesh(np.random.default_rng(0).normal(size=(9, 3)), np.arange(9).reshape(3, 3))
    asset = Asset(mesh, (Material(Texture(image)),), np.zeros(3, np.uint32), uv)
    assert see_through(asset).tolist() == [False, True, True]
    left = opaque_part(asset)
    assert (len(left.mesh.faces), len(left.uv), len(left.material_of_face)) == (1, 1, 1)
    assert opaque_part(left) is left
    assert opaque_part(pane(1.0, 1.0, glass(7))) is None


def test_opacity_is_read_where_it_is_asked_for(tmp_path):
    image = np.full((4, 4, 4), 200, np.uint8)
    image[0, 0, 3] = 10
    cv2.imwrite(str(tmp_path / "skin.png"), image)
    (tmp_path / "pane.mtl").write_text("newmtl m\nmap_Kd skin.png\n")
    (tmp_path / "pane.obj").write_text(
        "mtllib pane.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
        "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    for texture in (None, tmp_path / "skin.png"):
        path = tmp_path / "pane.obj"
        assert load_asset(path, texture=texture).materials[0].colour.opacity is None
        found = load_asset(path, texture=texture, opacity=True).materials[0].colour
        assert found.opacity[0, 0] == 10
        assert found.opacity.shape == (4, 4)
    # Opaque all over, or but for a texel that no face shows.
    for corner in (255, 10):
        image[..., 3] = 255
        image[0, 3, 3] = corner
        cv2.imwrite(str(tmp_path / "skin.png"), image)
        opaque = load_asset(tmp_path / "pane.obj", opacity=True)
        assert opaque.materials[0].colour.opacity is None
