"""G-buffer and optical flow, against golden images, rays, OpenCV and plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dronepose import Camera, Mesh
from dronepose._gbuffer import Flow, GBuffer, flow, gbuffer
from support import EXAMPLES, SHARED

CAMERA = Camera(60.0, 55.0, 33.0, 22.5, width=64, height=48, skew=0.8)
EYE = np.eye(3)
FLOATS = ("mask", "depth", "face", "object", "barycentrics", "normal")
seeds = st.integers(0, 2**32 - 1)


def square(half=1.0):
    return Mesh(
        [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]],
        [[0, 1, 2], [0, 2, 3]],
    )


def sphere(n=24):
    """A sphere of radius 1 that is closed, wound outwards."""
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n)[:-1])
    points = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(2 * n - 1))
    k = lambda i, j: (j % (2 * n - 1)) * n + i  # noqa: E731
    quads = [k(i, j), k(i + 1, j), k(i + 1, j + 1), k(i, j + 1)]
    faces = np.concatenate(
        [np.stack([quads[0], quads[1], quads[2]], -1), np.stack([quads[0], quads[2], quads[3]], -1)]
    ).reshape(-1, 3)
    return Mesh(points.reshape(-1, 3), faces)


def quadrotor():
    return Mesh.from_file(EXAMPLES / "quadrotor.obj")


def pose(rng, distance):
    return Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 0.1 + [0, 0, distance]


def centres(camera):
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return u, v


def unprojected(camera, depth):
    """Camera points ``(H, W, 3)``."""
    u, v = centres(camera)
    y = (v - camera.cy) / camera.fy
    x = (u - camera.cx - camera.skew * y) / camera.fx
    return np.stack([x * depth, y * depth, depth], -1)


def projected(camera, points):
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack(
        [(camera.fx * x + camera.skew * y) / z + camera.cx, camera.fy * y / z + camera.cy], -1
    )


def on_surface(mesh, seen):
    """Model points from barycentrics, where something is seen."""
    corners = mesh.vertices[mesh.faces[seen.face[seen.mask]]]
    return np.einsum("nc,nck->nk", seen.barycentrics[seen.mask], corners)


GOLDEN = SHARED / "golden"
NAMES = sorted(p.stem for p in GOLDEN.glob("*.npz")) if GOLDEN.exists() else []


@pytest.mark.skipif(not NAMES, reason="golden is not in ../shared (or DRONEPOSE_SHARED)")
@pytest.mark.parametrize("name", NAMES or ["none"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_golden(name, dtype):
    g = np.load(GOLDEN / f"{name}.npz")
    mesh = Mesh(g["V"], g["F"])
    camera = Camera.from_K(g["K"], int(g["W"]), int(g["H"]))
    near = None if np.isnan(g["z_near"]) else float(g["z_near"])
    seen = gbuffer(mesh, camera, g["R"], g["t"], channels=FLOATS, near=near, dtype=dtype)
    np.testing.assert_array_equal(seen.mask, g["hard"] > 0)
    np.testing.assert_array_equal(seen.face, g["face"])
    np.testing.assert_array_equal(seen.object, np.where(g["hard"] > 0, 0, -1))
    stored = g["depth"].dtype
    exact = stored == np.float64 and dtype == np.float64
    np.testing.assert_allclose(seen.depth, g["depth"], rtol=1e-9 if exact else 2e-7, atol=0)
    np.testing.assert_allclose(seen.normal, g["normal"], rtol=0, atol=1e-9 if exact else 2e-7)
    assert seen.depth.dtype == seen.normal.dtype == dtype


@given(seeds)
@settings(max_examples=20)
def test_barycentrics_depth_and_pixel_centres_agree(seed):
    rng = np.random.default_rng(seed)
    mesh = quadrotor()
    R, t = pose(rng, 0.6)
    seen = gbuffer(mesh, CAMERA, R, t, channels=FLOATS, dtype=np.float64)
    assert seen.mask.any()
    points = on_surface(mesh, seen) @ R.T + t
    np.testing.assert_allclose(points[:, 2], seen.depth[seen.mask], rtol=1e-9)
    expected = np.stack(centres(CAMERA), -1)[seen.mask]
    np.testing.assert_allclose(projected(CAMERA, points), expected, atol=1e-6)
    assert (seen.barycentrics >= 0).all()
    np.testing.assert_allclose(seen.barycentrics[seen.mask].sum(-1), 1, rtol=1e-12)


def test_memory_that_is_used_again_holds_nothing_old():
    mesh = quadrotor()
    channels = (*FLOATS, "coverage")
    camera = Camera(250, 250, 160, 120, width=320, height=240)
    R, t = pose(np.random.default_rng(3), 0.6)
    away = [0.0, 0.0, -5.0]
    first = gbuffer(mesh, camera, [R] * 4, [t] * 4, channels=channels)
    kept = {name: getattr(first, name).copy() for name in channels}
    others = [gbuffer(mesh, camera, [R] * 4, [away] * 4, channels=channels) for _ in range(2)]
    for name in channels:  # nothing is seen, and what is still referred to stays
        np.testing.assert_array_equal(getattr(first, name), kept[name])
        empty = -1 if name in ("face", "object") else 0
        assert all((getattr(other, name) == empty).all() for other in others)
    del first, others
    drawn = gbuffer(mesh, camera, [R] * 4, [t] * 4, channels=channels)
    for name in channels:
        np.testing.assert_array_equal(getattr(drawn, name), kept[name])


def test_vertices_are_where_opencv_projects_them():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(5)
    mesh = sphere(12)
    R, t = pose(rng, 3.5)
    camera = Camera(300, 310, 160, 120, width=320, height=240)
    # OpenCV's integers are pixel centres here: half a pixel less.
    K = camera.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    uv, _ = cv2.projectPoints(mesh.vertices, cv2.Rodrigues(R)[0], t, K, None)
    seen = gbuffer(mesh, camera, R, t, channels=("face", "barycentrics", "mask"), dtype=np.float64)
    points = on_surface(mesh, seen)
    back, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, None)
    i, j = np.nonzero(seen.mask)
    np.testing.assert_allclose(back[:, 0], np.stack([j, i], -1), atol=1e-6)
    # The mask fills the hull of the image points.
    hull = cv2.convexHull((uv * 16).astype(np.int32))
    filled = np.zeros((240, 320), np.uint8)
    cv2.fillConvexPoly(filled, hull, 1, shift=4)
    assert (filled.astype(bool) != seen.mask).mean() < 0.01


def test_rays_meet_the_same_faces():
    pytest.importorskip("embreex")
    trimesh = pytest.importorskip("trimesh")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    mesh = quadrotor()
    R, t = pose(np.random.default_rng(2), 0.5)
    camera = Camera(250, 250, 160, 120, width=320, height=240)
    seen = gbuffer(mesh, camera, R, t, channels=("face", "depth"))
    rays = unprojected(camera, np.ones((240, 320))).reshape(-1, 3) @ R
    origins = np.broadcast_to(-R.T @ t, rays.shape)
    model = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    face = RayMeshIntersector(model, scale_to_box=False).intersects_first(origins, rays)
    assert (face.reshape(240, 320) == seen.face).mean() > 0.998  # float32 rays
    assert ((face >= 0).reshape(240, 320) == (seen.depth > 0)).mean() > 0.998


def test_normals_of_the_depth_are_the_normals():
    camera = Camera(600, 600, 160, 120, width=320, height=240)
    mesh = sphere(64)
    for normals, least in (("flat", 0.995), ("smooth", 0.998), ("smooth-angle", 0.998)):
        seen = gbuffer(
            mesh,
            camera,
            EYE,
            [0, 0, 6.0],
            channels=("depth", "normal", "mask"),
            normals=normals,
            dtype=np.float64,
        )
        points = unprojected(camera, seen.depth)
        du = points[1:-1, 2:] - points[1:-1, :-2]
        dv = points[2:, 1:-1] - points[:-2, 1:-1]
        n = np.cross(dv, du)
        inner = seen.mask[1:-1, 1:-1].copy()
        for k in (slice(0, -2), slice(2, None)):
            inner &= seen.mask[k, 1:-1] & seen.mask[1:-1, k]
        inner &= points[1:-1, 1:-1, 2] < 5.6
        n = n[inner] / np.linalg.norm(n[inner], axis=-1, keepdims=True)
        cosine = (n * seen.normal[1:-1, 1:-1][inner]).sum(-1)
        assert inner.sum() > 1000
        assert cosine.mean() > least
        assert (seen.normal[seen.mask] * points[seen.mask]).sum(-1).max() < 0.1


def test_several_meshes_hide_each_other():
    meshes = [square(1.0), square(0.3), sphere(8)]
    t = np.array([[0, 0, 4.0], [0.1, 0, 3.0], [0, 0, -9.0]])
    seen = gbuffer(meshes, CAMERA, np.stack([EYE] * 3), t, channels=(*FLOATS, "coverage_each"))
    alone = [gbuffer(m, CAMERA, EYE, x, channels=FLOATS) for m, x in zip(meshes, t, strict=True)]
    depths = np.stack([np.where(a.mask, a.depth, np.inf) for a in alone])
    nearest = np.where(np.isfinite(depths).any(0), depths.argmin(0), -1)
    np.testing.assert_array_equal(seen.object, nearest)
    for k in (0, 1):
        np.testing.assert_array_equal(seen.face[nearest == k], alone[k].face[nearest == k])
        np.testing.assert_array_equal(seen.depth[nearest == k], alone[k].depth[nearest == k])
    assert seen.coverage.shape == (3, 48, 64)
    whole = gbuffer(meshes, CAMERA, np.stack([EYE] * 3), t, channels=["coverage"]).coverage
    np.testing.assert_allclose(seen.coverage.sum(0), whole, atol=1e-6)
    assert (whole[seen.mask] > 0).all()


def test_linear_attributes_and_uv_are_exact():
    mesh = sphere(16)
    R, t = pose(np.random.default_rng(0), 3.0)
    values = mesh.vertices @ np.array([[1.0, 2.0], [0.5, -1.0], [3.0, 0.0]]) + [0.0, 4.0]
    corners = mesh.vertices[mesh.faces][..., :2]
    seen = gbuffer(
        mesh,
        CAMERA,
        R,
        t,
        channels=("depth", "mask"),
        attributes=values,
        uv=corners,
        dtype=np.float64,
    )
    points = (unprojected(CAMERA, seen.depth)[seen.mask] - t) @ R
    expected = points @ np.array([[1.0, 2.0], [0.5, -1.0], [3.0, 0.0]]) + [0.0, 4.0]
    np.testing.assert_allclose(seen.attributes[seen.mask], expected, atol=1e-8)
    np.testing.assert_allclose(seen.uv[seen.mask], points[:, :2], atol=1e-8)
    assert (seen.attributes[~seen.mask] == 0).all()
    assert seen.face is None


def test_meshes_without_attributes_have_zeros():
    meshes, t = [square(0.5), square(0.5)], [[-0.6, 0, 3.0], [0.6, 0, 3.0]]
    seen = gbuffer(
        meshes,
        CAMERA,
        np.stack([EYE, EYE]),
        t,
        channels=["object"],
        attributes=[None, np.full((4, 1), 0.25)],
    )
    assert (seen.attributes[..., 0] == np.where(seen.object == 1, 0.25, 0)).all()


def test_coverage_tends_to_the_area():
    mesh = square(0.5)
    R = Rotation.from_rotvec([0.1, 0.2, 0.4]).as_matrix()
    coverage = gbuffer(mesh, CAMERA, R, [0, 0, 2], channels=["coverage"], samples=16).coverage
    outline = projected(CAMERA, mesh.vertices @ R.T + [0, 0, 2])
    u, v = outline.T
    area = 0.5 * abs(u @ np.roll(v, -1) - v @ np.roll(u, -1))
    assert abs(coverage.sum() - area) < 0.003 * area
    once = gbuffer(mesh, CAMERA, R, [0, 0, 2], channels=["coverage", "mask"], samples=1)
    np.testing.assert_array_equal(once.coverage, once.mask)


def test_batches_and_threads_change_nothing():
    rng = np.random.default_rng(8)
    mesh = quadrotor()
    poses = [pose(rng, 0.5) for _ in range(6)]
    R, t = (np.stack(x).reshape(2, 3, *x[0].shape) for x in zip(*poses, strict=True))
    draw = lambda n: gbuffer(mesh, CAMERA, R, t, channels=(*FLOATS, "coverage"), threads=n)  # noqa: E731
    one, two, seven = (draw(n) for n in (1, 2, 7))
    for name in (*FLOATS, "coverage"):
        plane = getattr(one, name)
        assert plane.shape[:4] == (2, 3, 48, 64)
        np.testing.assert_array_equal(plane, getattr(two, name))
        np.testing.assert_array_equal(plane, getattr(seven, name))
        alone = gbuffer(mesh, CAMERA, R[1, 2], t[1, 2], channels=[name])
        np.testing.assert_array_equal(plane[1, 2], getattr(alone, name))
    assert gbuffer(mesh, CAMERA, R[:, :0], t[:, :0]).depth.shape == (2, 0, 48, 64)


class TestFlow:
    def test_points_go_where_they_project(self):
        rng = np.random.default_rng(3)
        mesh = quadrotor()
        R0, t0 = pose(rng, 0.5)
        R1 = Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix() @ R0
        t1, other = t0 + np.array([0.02, 0.01, 0.05]), Camera(70, 60, 30, 25, width=64, height=48)
        moved = flow(mesh, CAMERA, R0, t0, R1, t1, camera1=other, dtype=np.float64)
        seen = gbuffer(mesh, CAMERA, R0, t0, channels=FLOATS, dtype=np.float64)
        np.testing.assert_array_equal(moved.valid, seen.mask)
        to = projected(other, on_surface(mesh, seen) @ R1.T + t1)
        start = np.stack(centres(CAMERA), -1)[seen.mask]
        np.testing.assert_allclose(moved.flow[seen.mask], to - start, atol=1e-6)
        assert (moved.flow[~seen.mask] == 0).all()

    def test_warping_back_gives_the_texture(self):
        # A texture that is a smooth function of the surface point, seen in both images.
        mesh = sphere(48)
        camera = Camera(300, 300, 128, 96, width=256, height=192)
        R1 = Rotation.from_rotvec([0.1, 0.3, -0.2]).as_matrix()
        t0, t1 = np.array([0, 0, 4.0]), np.array([0.1, -0.1, 3.7])
        texture = np.sin(3 * mesh.vertices) + 0.3 * mesh.vertices
        first, second = (
            gbuffer(mesh, camera, R, t, channels=["mask"], attributes=texture, dtype=np.float64)
            for R, t in ((EYE, t0), (R1, t1))
        )
        moved = flow(mesh, camera, EYE, t0, R1, t1, dtype=np.float64)
        i, j = np.nonzero(moved.visible)
        x = j + moved.flow[i, j, 0]
        y = i + moved.flow[i, j, 1]
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        inside = (x0 >= 0) & (y0 >= 0) & (x0 < 255) & (y0 < 191)
        i, j, x, y, x0, y0 = (a[inside] for a in (i, j, x, y, x0, y0))
        whole = np.all([second.mask[y0 + a, x0 + b] for a in (0, 1) for b in (0, 1)], axis=0)
        fx, fy = (x - x0)[:, None], (y - y0)[:, None]
        image = second.attributes
        warped = (1 - fy) * ((1 - fx) * image[y0, x0] + fx * image[y0, x0 + 1]) + fy * (
            (1 - fx) * image[y0 + 1, x0] + fx * image[y0 + 1, x0 + 1]
        )
        error = np.abs(warped - first.attributes[i, j])[whole]
        assert whole.sum() > 5000
        assert np.quantile(error, 0.99) < 0.01
        # On a convex body what turns away is occluded, and nothing else.
        normal = gbuffer(mesh, camera, EYE, t0, channels=["normal", "depth"], dtype=np.float64)
        points = (unprojected(camera, normal.depth) - t0) @ R1.T + t1
        facing = (points * (normal.normal @ R1.T)).sum(-1)
        clear = first.mask & (np.abs(facing) > 0.2)
        np.testing.assert_array_equal(moved.visible[clear], facing[clear] < 0)

    def test_each_object_moves_by_itself(self):
        meshes = [square(1.0), square(0.3)]
        R = np.stack([EYE, EYE])
        t0, t1 = np.array([[0, 0, 4.0], [0, 0, 2.0]]), np.array([[0, 0.5, 4.0], [0.25, 0, 2.0]])
        camera = Camera(64, 64, 32, 24, width=64, height=48)
        moved = flow(meshes, camera, R, t0, R, t1)
        objects = gbuffer(meshes, camera, R, t0, channels=["object"]).object
        np.testing.assert_allclose(
            moved.flow[objects == 0], [[0, 8]] * (objects == 0).sum(), atol=1e-5
        )
        np.testing.assert_allclose(
            moved.flow[objects == 1], [[8, 0]] * (objects == 1).sum(), atol=1e-5
        )
        assert moved.visible[objects == 1].all()
        # The near square hides u 30.4..49.6, v 14.4..33.6 of the second image.
        u, v = centres(camera)
        hidden = (objects == 0) & (np.abs(u - 40) < 9.6) & (np.abs(v + 8 - 24) < 9.6)
        np.testing.assert_array_equal(moved.occluded, hidden)

    def test_the_background_moves_with_the_camera(self):
        mesh, camera = square(0.2), Camera(64, 64, 32, 24, width=64, height=48)
        t = [0, 0, 2.0]
        turn = Rotation.from_rotvec([0.01, 0.02, 0.03]).as_matrix()
        far = flow(mesh, camera, EYE, t, EYE, t, camera_motion=(turn, [9, 9, 9]), dtype=np.float64)
        at = flow(
            mesh, camera, EYE, t, EYE, t, camera_motion=(EYE, [0.1, 0, 0]), background_depth=3.2
        )
        seen = gbuffer(mesh, camera, EYE, t, channels=["mask"]).mask
        to = projected(camera, unprojected(camera, np.ones((48, 64))) @ turn.T)
        expected = to - np.stack(centres(camera), -1)
        np.testing.assert_allclose(far.flow[~seen], expected[~seen], atol=1e-9)
        np.testing.assert_allclose(at.flow[~seen], [[2, 0]] * (~seen).sum(), atol=1e-5)
        assert at.occluded.sum() == 2 * 12  # two columns to the left of the square
        fates = [at.visible, at.occluded, at.outside, at.behind]
        np.testing.assert_array_equal(np.sum(fates, axis=0), 1)

    def test_batches_and_threads_change_nothing(self):
        rng = np.random.default_rng(8)
        mesh = quadrotor()
        (R0, t0), (R1, t1) = (
            tuple(np.stack(x) for x in zip(*[pose(rng, 0.5) for _ in range(3)], strict=True))
            for _ in range(2)
        )
        one = flow(mesh, CAMERA, R0, t0, R1, t1, threads=1)
        for threads in (2, 7):
            other = flow(mesh, CAMERA, R0, t0, R1, t1, threads=threads)
            for name in Flow.__slots__:
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        alone = flow(mesh, CAMERA, R0[1], t0[1], R1[1], t1[1])
        np.testing.assert_array_equal(one.flow[1], alone.flow)


class TestWrongArguments:
    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"R": np.zeros((3, 2))}, "R: expected shape"),
            ({"t": [0, 0]}, "t: expected shape"),
            ({"R": np.full((3, 3), np.nan)}, "R: expected finite"),
            ({"t": [0, 0, np.inf]}, "t: expected finite"),
            ({"R": np.zeros((2, 3, 3)), "t": np.zeros((3, 3))}, "R, t: batch shapes"),
            ({"mesh": []}, "mesh: expected at least one"),
            ({"mesh": Mesh([[0, 0, 0]], [])}, "mesh: a mesh without faces"),
            ({"mesh": [square(), square()]}, "R: expected shape"),
            ({"near": 0.0}, "near: expected"),
            ({"near": np.nan}, "near: expected"),
            ({"dtype": np.float16}, "dtype: expected"),
            ({"channels": ["colour"]}, "channels: expected"),
            ({"channels": ["attributes"]}, "attributes: the channel needs"),
            ({"channels": ["coverage", "coverage_each"]}, "channels: expected one"),
            ({"normals": "round"}, "normals: expected"),
            ({"samples": 0}, "samples: expected"),
            ({"attributes": np.zeros((3, 2))}, "attributes: expected shape"),
            ({"attributes": np.full((4, 2), np.nan)}, "attributes: expected finite"),
            ({"uv": np.zeros((4, 3, 2))}, "uv: expected shape"),
            ({"camera": Camera(9, 9, 9, 9, width=20_000, height=2)}, "camera: expected"),
            ({"threads": 5000}, "threads: "),
        ],
    )
    def test_are_named(self, change, text):
        arguments = {"mesh": square(), "camera": CAMERA, "R": EYE, "t": [0, 0, 2.0], **change}
        with pytest.raises(ValueError, match="^" + text):
            gbuffer(**arguments)

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"R1": np.zeros(3)}, "R1: expected shape"),
            ({"t0": [0, 0, np.nan]}, "t0: expected finite"),
            ({"tolerance": 1.0}, "tolerance: expected"),
            ({"camera_motion": (EYE, [0, np.nan, 0])}, r"camera_motion\[1\]: expected finite"),
            ({"camera_motion": (EYE, [0, 0, 0]), "background_depth": 0}, "background_depth: "),
            ({"camera_motion": (np.zeros((2, 3, 3)), [0, 0, 0])}, "camera_motion, background"),
        ],
    )
    def test_of_flow_are_named(self, change, text):
        arguments = {"R0": EYE, "t0": [0, 0, 2.0], "R1": EYE, "t1": [0, 0, 2.0], **change}
        with pytest.raises(ValueError, match="^" + text):
            flow(square(), CAMERA, **arguments)

    def test_something_else_is_no_mesh(self):
        with pytest.raises(TypeError, match=r"^mesh\[0\]: expected a Mesh"):
            gbuffer([3], CAMERA, EYE, [0, 0, 1])


def test_what_was_not_asked_for_is_none():
    seen = gbuffer(square(), CAMERA, EYE, [0, 0, 2.0])
    assert [n for n in GBuffer.__slots__ if getattr(seen, n) is not None] == ["depth", "face"]


@pytest.mark.slow
def test_eight_thousand_pixels():
    camera = Camera(8000, 8000, 4096, 4096, width=8192, height=8192)
    seen = gbuffer(square(0.2), camera, EYE, [0, 0, 1.0])
    assert (seen.depth > 0).sum() == 3200**2
    np.testing.assert_array_equal(seen.depth > 0, seen.face >= 0)
