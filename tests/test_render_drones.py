"""Every drone of the data folder, seen from anywhere: open meshes, soups, 85,000 faces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import scenes
from dronepose import Camera, Mesh, render
from oracles import silhouette as oracle

CAMERA = Camera(120.0, 120.0, 48.0, 36.0, width=96, height=72)
DRONES = {
    "crazyflie2/cf2_assembly_with_props.dae": "m",
    "crazyflie2/cf2_assembly.stl": "m",
    "dji_mavic2/DJI.obj": "m",
    "firefly/firefly.ply": "m",
    "hector/quadrotor_base.dae": "m",
    "holybro_x500/hb_x500_fused.stl": "mm",
    "iris/iris.stl": "m",
    "omnicopter/omnicopter.stl": "mm",
    "skydio_x2/assets/X2_lowpoly.obj": "cm",
}
MODES = [
    {"mode": "coverage"},
    {"mode": "coverage", "sigma": 1.0},
    {"mode": "hard"},
    {"mode": "dibr"},
    {"mode": "sigmoid"},
]


def drone(shared, path):
    if path.endswith(".dae"):
        pytest.importorskip("collada", reason="pycollada is not installed")
    return Mesh.from_file(shared(f"data/drones/{path}"), DRONES[path])


def views(mesh, rng):
    """Whole in the image, partly outside, and cut by the near plane."""
    middle, size = mesh.bounds.mean(axis=0), mesh.bbox_diagonal
    R = Rotation.random(4, rng=rng).as_matrix()
    t = np.array([[0.02, 0.01, 1.6], [0.1, -0.05, 1.3], [0.7, 0.45, 1.5], [0.05, 0.0, 0.35]]) * size
    return R, t - R @ middle, 0.25 * size


@pytest.mark.slow
@pytest.mark.parametrize("path", DRONES, ids=lambda p: p.split("/")[-1])
def test_the_area_is_that_of_the_union(shared, path):
    mesh = drone(shared, path)
    rng = np.random.default_rng(len(path))
    R, t, near = views(mesh, rng)
    masks = render.silhouette(mesh, CAMERA, R, t, near=near, dtype=np.float64)
    few = range(4) if len(mesh.faces) < 30_000 else (1, 3)  # shapely takes seconds for the others
    for k in few:
        polygons = oracle.image_polygons(mesh.vertices, mesh.faces, CAMERA, R[k], t[k], near)
        assert masks[k].sum() == pytest.approx(oracle.area(polygons, CAMERA), rel=0, abs=1e-6)
    assert masks[[0, 1, 3]].any(axis=(1, 2)).all()


@pytest.mark.slow
@pytest.mark.parametrize("path", DRONES, ids=lambda p: p.split("/")[-1])
def test_masks_and_gradients_are_finite(shared, path):
    mesh = drone(shared, path)
    rng = np.random.default_rng(7)
    R, t, near = views(mesh, rng)
    upstream = rng.normal(size=(4, CAMERA.height, CAMERA.width))
    for options in MODES:
        masks = render.silhouette(mesh, CAMERA, R, t, near=near, **options)
        assert ((masks >= 0) & (masks <= 1)).all(), options
        g = render.silhouette_gradients(mesh, CAMERA, R, t, upstream, near=near, **options)
        for array in (g.R, g.t, g.K, g.vertices):
            assert np.isfinite(array).all(), options


@pytest.mark.slow
@pytest.mark.parametrize("options", [o for o in MODES if o["mode"] != "hard"], ids=scenes.name)
@pytest.mark.parametrize("path", DRONES, ids=lambda p: p.split("/")[-1])
def test_gradients_are_difference_quotients(shared, path, options):
    mesh = drone(shared, path)
    rng = np.random.default_rng(11)
    R, t, near = views(mesh, rng)
    upstream = rng.normal(size=(4, CAMERA.height, CAMERA.width))
    options = {**options, "near": near}
    g = render.silhouette_gradients(mesh, CAMERA, R, t, upstream, vertices=False, **options)
    turn, shift = rng.normal(size=(2, 4, 3))
    ours = (render.tangent(g.R, R) * turn + g.t * shift * mesh.bbox_diagonal).sum(axis=1)

    def values(h):
        turned = Rotation.from_rotvec(h * turn).as_matrix() @ R
        moved = t + h * shift * mesh.bbox_diagonal
        masks = render.silhouette(mesh, CAMERA, turned, moved, dtype=np.float64, **options)
        return (masks * upstream).sum(axis=(1, 2))

    h = 1e-7
    slope = (values(h) - values(-h)) / (2 * h)
    np.testing.assert_allclose(ours, slope, rtol=2e-3, atol=2e-3 * np.abs(slope).max())
