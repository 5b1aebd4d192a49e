"""Silhouettes in NumPy: closed forms, what must not matter, slow twins."""

import gc
import threading

import numpy as np
import pytest
from hypothesis import given, settings

import scenes
from dronepose import Camera, Mesh, render
from dronepose._buffers import BUFFERS
from oracles import silhouette as oracle
from scenes import ALL, CAMERA, CUTOFFS, SMOOTH, SQUARE, TETRAHEDRON
from support import EXAMPLES
from test_processes import Counter

EYE = np.eye(3)[None]
NEAR = {"near": 0.3}


@pytest.fixture(scope="module")
def drone():
    return Mesh.from_file(EXAMPLES / "quadrotor.obj")


def draw(mesh, R, t, camera=CAMERA, dtype=np.float64, **options):
    mesh = mesh if isinstance(mesh, Mesh) else Mesh(*mesh)
    return render.silhouette(mesh, camera, R, t, dtype=dtype, **options)


# ------------------------------------------------------------------------------- closed forms


def test_a_square_covers_its_pixels_and_parts_of_those_it_cuts():
    camera = Camera(5, 4, 2, 1, width=8, height=6)  # 2.5 x 2 pixels at 2 m, from (2, 1) on
    expected = np.zeros((6, 8))
    expected[1:3, 2:4] = 1
    expected[1:3, 4] = 0.5
    np.testing.assert_allclose(draw(SQUARE, EYE, [[0, 0, 2]], camera)[0], expected, atol=1e-12)


def test_a_blurred_edge_is_half_on_the_outline():
    camera = Camera(1000, 1000, 8, -500, width=16, height=9)
    mask = draw(SQUARE, EYE, [[0, 0, 1]], camera, sigma=1.5)[0]
    assert (np.diff(mask[4]) > 0).sum() >= 10  # an edge along x = 8 px, soft on both sides
    np.testing.assert_allclose(mask[4] + mask[4][::-1], 1.0, atol=1e-12)


def test_soft_masks_fall_off_as_their_formulas_say():
    camera = Camera(1000, 1000, 8, -500, width=16, height=8)
    # One side is at u = 8 px, the others far outside of the image.
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0.5, 0]])
    half = (vertices, np.array([[0, 1, 2]]))
    d = (8 - (np.arange(8) + 0.5)) * 2  # twice the distance in pixels
    dibr = draw(half, EYE, [[0, 0, 1]], camera, mode="dibr", delta=20.0)[0, 4]
    np.testing.assert_allclose(dibr[:8], np.exp(-20.0 * (d / 16) ** 2), rtol=1e-9)
    np.testing.assert_array_equal(dibr[8:], 1.0)
    sigmoid = draw(half, EYE, [[0, 0, 1]], camera, mode="sigmoid", sigma_ndc=0.3)[0, 4]
    expected = 1 / (1 + np.exp((d / 8) ** 2 / 0.3))
    np.testing.assert_allclose(sigmoid[:8], expected, rtol=1e-9)
    np.testing.assert_allclose(sigmoid[8:], 1 - expected[::-1], rtol=1e-9)


def test_the_gradient_of_an_area_is_the_length_of_its_outline():
    camera = Camera(4, 4, 2, 2, width=8, height=6)
    g = render.silhouette_gradients(Mesh(*SQUARE), camera, EYE, [[0, 0, 2]], np.ones((1, 6, 8)))
    # area = fx fy / z^2
    np.testing.assert_allclose(g.t, [[0, 0, -4]], atol=1e-12)
    np.testing.assert_allclose(g.K[0], [[1, 0, 0], [0, 1, 0], [0, 0, 0]], atol=1e-12)
    assert g.vertices.shape == (4, 3)


@pytest.mark.parametrize("options", ALL, ids=scenes.name)
def test_what_is_behind_the_camera_is_not_drawn(options):
    pose = (np.eye(3)[None], [[0.0, 0.0, -3.0]])
    assert not draw(TETRAHEDRON, *pose, **options).any()
    g = render.silhouette_gradients(
        Mesh(*TETRAHEDRON), CAMERA, *pose, np.ones((1, 12, 16)), **options
    )
    assert not any(array.any() for array in (g.R, g.t, g.K, g.vertices))


def test_an_empty_batch_is_an_empty_array():
    assert draw(SQUARE, np.empty((0, 3, 3)), np.empty((0, 3))).shape == (0, 12, 16)
    g = render.silhouette_gradients(
        Mesh(*SQUARE), CAMERA, np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 12, 16))
    )
    assert g.R.shape == (0, 3, 3)
    assert not g.vertices.any()


# -------------------------------------------------------------------------------- slow twins


@pytest.mark.parametrize("near", [None, 0.8])
@given(seed=scenes.seeds)
@settings(max_examples=25)
def test_masks_are_what_their_definitions_say(near, seed):
    rng = np.random.default_rng(seed)
    mesh = scenes.soup(rng)
    R, t = scenes.poses(rng, 1, distance=1.2)
    polygons = oracle.image_polygons(
        *mesh, CAMERA, R[0], t[0], oracle.DEFAULT_NEAR if near is None else near
    )
    if near is None and any(np.abs(p).max() > 1e5 for p in polygons):
        return  # shapely has no digits left there
    twins = {
        "coverage": ({}, lambda: oracle.coverage(polygons, CAMERA)),
        "blurred": ({"sigma": 0.8}, lambda: oracle.coverage(polygons, CAMERA, 0.8)),
        "hard": ({"mode": "hard"}, lambda: oracle.hard(polygons, CAMERA)),
        "dibr": (
            {"mode": "dibr", "delta": 30.0},
            lambda: oracle.dibr(polygons, CAMERA, 30.0),
        ),
        "sigmoid": (
            {"mode": "sigmoid", "sigma_ndc": 0.02},
            lambda: oracle.sigmoid(polygons, CAMERA, 0.02),
        ),
    }
    for key, (options, twin) in twins.items():
        found = draw(mesh, R, t, near=near, **options)[0]
        np.testing.assert_allclose(found, twin(), rtol=0, atol=1e-6, err_msg=key)
        assert (found >= 0).all()
        assert (found <= 1 + 1e-12).all()


def test_image_points_agree_with_opencv(drone):
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(4)
    camera = Camera(250.0, 260.0, 155.0, 118.0, width=320, height=240)
    R, t = scenes.poses(rng, 4, distance=1.0, spread=0.05)
    for r, p in zip(R, t, strict=True):
        points, _ = cv2.projectPoints(drone.vertices, cv2.Rodrigues(r)[0], p, camera.K, None)
        polygons = oracle.image_polygons(drone.vertices, drone.faces, camera, r, p)
        ours = np.concatenate(polygons)
        np.testing.assert_allclose(ours, points[:, 0][drone.faces].reshape(-1, 2), atol=1e-4)
        # And the mask ends where the points do.
        rows, columns = np.nonzero(draw(drone, [r], [p], camera)[0])
        low, high = points[:, 0].min(axis=0), points[:, 0].max(axis=0)
        assert (columns.min(), rows.min()) == tuple(np.floor(low))
        assert (columns.max(), rows.max()) == tuple(np.ceil(high) - 1)


# ----------------------------------------------------------------------- what must not matter


def invariant(a, b, options):
    """Coverage is a set's area; the products over faces round differently in another order."""
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9, err_msg=scenes.name(options))


@pytest.mark.parametrize("options", ALL, ids=scenes.name)
@given(seed=scenes.seeds)
@settings(max_examples=20)
def test_the_order_and_winding_of_faces_do_not_matter(options, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = scenes.soup(rng)
    pose = scenes.poses(rng, 2)
    expected = draw((vertices, faces), *pose, **options)
    shuffled = rng.permutation(faces)
    rolled = np.array([np.roll(f, rng.integers(3)) for f in faces])
    invariant(draw((vertices, shuffled), *pose, **options), expected, options)
    invariant(draw((vertices, rolled), *pose, **options), expected, options)
    some = np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1])
    invariant(draw((vertices, some), *pose, **options), expected, options)


@pytest.mark.parametrize(
    "options", [o for o in ALL if o["mode"] in ("coverage", "hard")], ids=scenes.name
)
@given(seed=scenes.seeds)
@settings(max_examples=20)
def test_a_union_forgets_duplicates_and_subdivision(options, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = scenes.soup(rng)
    pose = scenes.poses(rng, 2)
    expected = draw((vertices, faces), *pose, **options)
    twice = np.concatenate([faces, faces[:3], faces[:2, ::-1]])
    invariant(draw((vertices, twice), *pose, **options), expected, options)
    again = np.concatenate([vertices, vertices]), np.concatenate([faces, faces + len(vertices)])
    invariant(draw(again, *pose, **options), expected, options)
    if options["mode"] == "coverage":  # a centre on a new edge is no one's
        finer = scenes.split(vertices, faces)
        np.testing.assert_allclose(draw(finer, *pose, **options), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", ALL, ids=scenes.name)
def test_moving_the_principal_point_by_whole_pixels_moves_the_mask(options):
    rng = np.random.default_rng(8)
    mesh, pose = scenes.soup(rng), scenes.poses(rng, 3)
    c = CAMERA
    moved = Camera(c.fx, c.fy, c.cx + 3, c.cy - 2, c.width, c.height, skew=c.skew)
    a, b = draw(mesh, *pose, **options), draw(mesh, *pose, moved, **options)
    np.testing.assert_allclose(b[:, :-2, 3:], a[:, 2:, :-3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", [*ALL, *CUTOFFS], ids=scenes.name)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_number_of_threads_changes_no_bit(options, dtype, drone):
    rng = np.random.default_rng(2)
    pose = scenes.poses(rng, 11, distance=0.6, spread=0.1)
    upstream = rng.normal(size=(11, 12, 16)).astype(dtype)
    found = []
    for threads in (1, 2, 7):
        mask = render.silhouette(drone, CAMERA, *pose, dtype=dtype, threads=threads, **options)
        g = render.silhouette_gradients(drone, CAMERA, *pose, upstream, threads=threads, **options)
        found.append([a.tobytes() for a in (mask, g.R, g.t, g.K, g.vertices)])
    assert found[0] == found[1] == found[2]


# ---------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("options", SMOOTH, ids=scenes.name)
@pytest.mark.parametrize("near", [None, 2.2], ids=["whole", "cut"])
def test_gradients_are_difference_quotients_across_the_near_plane_too(options, near):
    rng = np.random.default_rng(6)
    vertices, faces = TETRAHEDRON
    R, t = scenes.poses(rng, 2, distance=2.4, spread=0.1)
    K = CAMERA.K
    U = rng.normal(size=(2, 12, 16))
    options = {**options, "near": near}
    depth = vertices @ R[0].T + t[0]
    assert near is None or (depth[:, 2] < near).any() != (depth[:, 2] < near).all()
    g = render.silhouette_gradients(Mesh(vertices, faces), CAMERA, R, t, U, **options)

    def value(v=vertices, r=R, p=t, k=K):
        camera = Camera.from_K(k, CAMERA.width, CAMERA.height)
        return float((draw((v, faces), r, p, camera, **options) * U).sum())

    def slope(argument, array, place, h=1e-6):
        step = np.zeros_like(array)
        step[place] = h
        plus, minus = value(**{argument: array + step}), value(**{argument: array - step})
        return (plus - minus) / (2 * h)

    pairs = [(g.vertices[p], slope("v", vertices, p)) for p in np.ndindex(4, 3)]
    pairs += [(g.R[p], slope("r", R, p)) for p in np.ndindex(2, 3, 3)]
    pairs += [(g.t[p], slope("p", t, p)) for p in np.ndindex(2, 3)]
    pairs += [
        (g.K[:, i, j].sum(), slope("k", K, (i, j)))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2))
    ]
    ours, numeric = np.array(pairs).T
    np.testing.assert_allclose(ours, numeric, rtol=0, atol=2e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("near", [None, 2.2], ids=["whole", "cut"])
@given(seed=scenes.seeds)
@settings(max_examples=40)
def test_copies_of_a_vertex_named_or_not_leave_the_gradient_of_coverage(near, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = TETRAHEDRON
    R, t = scenes.poses(rng, 2, distance=2.4, spread=0.1)
    pose = (CAMERA, R, t, rng.normal(size=(2, 12, 16)))
    once = render.silhouette_gradients(Mesh(vertices, faces), *pose, near=near)
    # Each vertex up to four times, in any order, and corners that name any of these.
    copies = rng.permutation(np.repeat(np.arange(4), rng.integers(1, 5, size=4)))
    named = np.array([[rng.choice(np.flatnonzero(copies == v)) for v in face] for face in faces])
    found = render.silhouette_gradients(Mesh(vertices[copies], named), *pose, near=near)
    sums = np.zeros_like(vertices)
    np.add.at(sums, copies, found.vertices)
    for ours, expected in (
        (found.R, once.R),
        (found.t, once.t),
        (found.K, once.K),
        (sums, once.vertices),
    ):
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("options", [*ALL, *CUTOFFS], ids=scenes.name)
@given(seed=scenes.seeds)
@settings(max_examples=40)
def test_nothing_odd_makes_a_number_that_is_none(options, seed):
    """Edge-on and doubled faces, corners that meet, at the camera, on the near plane, far away."""
    rng = np.random.default_rng(seed)
    values = np.array([0.0, 0.0, 1.0, -1.0, 0.5, 1e-9, -1e-12, 1e-3, 1e3, -1e6])
    vertices = rng.choice(values[: rng.integers(3, 11)], size=(6, 3))
    faces = rng.integers(6, size=(8, 3))
    R = rng.choice([np.eye(3), np.zeros((3, 3)), scenes.poses(rng, 1)[0][0], np.eye(3)[::-1]])
    t = rng.choice(values, size=3) * [1, 1, 0] + [0, 0, rng.choice([0.0, 1e-3, 1.0, 2.0])]
    pose = (R[None], t[None])
    mask = draw((vertices, faces), *pose, **options)
    assert ((mask >= 0) & (mask <= 1)).all()
    g = render.silhouette_gradients(
        Mesh(vertices, faces), CAMERA, *pose, rng.normal(size=(1, 12, 16)), **options
    )
    for array in (g.R, g.t, g.K, g.vertices):
        assert np.isfinite(array).all()


def test_a_turn_of_the_camera_frame_is_the_tangent():
    rng = np.random.default_rng(3)
    mesh, (R, t) = Mesh(*TETRAHEDRON), scenes.poses(rng, 1)
    U = rng.normal(size=(1, 12, 16))
    g = render.silhouette_gradients(mesh, CAMERA, R, t, U)
    w = render.tangent(g.R, R)[0]
    h = 1e-6
    for axis in range(3):
        omega = np.zeros(3)
        omega[axis] = h
        turned = [
            (draw(mesh, scenes.Rotation.from_rotvec(s * omega).as_matrix() @ R, t) * U).sum()
            for s in (1, -1)
        ]
        assert w[axis] == pytest.approx((turned[0] - turned[1]) / (2 * h), rel=1e-5, abs=1e-5)


def test_a_sequence_of_meshes_has_one_for_each_pose():
    rng = np.random.default_rng(9)
    meshes = [Mesh(*scenes.soup(rng, faces)) for faces in (4, 9, 5)]
    R, t = scenes.poses(rng, 3)
    U = rng.normal(size=(3, 12, 16))
    masks = render.silhouette(meshes, CAMERA, R, t)
    g = render.silhouette_gradients(meshes, CAMERA, R, t, U)
    for k, mesh in enumerate(meshes):
        pose = (R[k : k + 1], t[k : k + 1])
        np.testing.assert_array_equal(masks[k], render.silhouette(mesh, CAMERA, *pose)[0])
        one = render.silhouette_gradients(mesh, CAMERA, *pose, U[k : k + 1])
        np.testing.assert_array_equal(g.vertices[k], one.vertices)
        np.testing.assert_array_equal(g.t[k], one.t[0])
    without = render.silhouette_gradients(meshes, CAMERA, R, t, U, vertices=False)
    assert without.vertices is None
    np.testing.assert_array_equal(without.R, g.R)


# --------------------------------------------------------------------------------- arguments


def test_dtype_and_out():
    pose = (EYE, [[0.0, 0, 2]])
    single = render.silhouette(Mesh(*SQUARE), CAMERA, *pose)
    double = draw(SQUARE, *pose)
    assert (single.dtype, double.dtype) == (np.float32, np.float64)
    np.testing.assert_allclose(single, double, atol=1e-6)
    out = np.full((1, 12, 16), 7.0)
    assert render.silhouette(Mesh(*SQUARE), CAMERA, *pose, out=out) is out
    np.testing.assert_array_equal(out, double)


# ----------------------------------------------------------------------------------- settings


def test_settings_of_kaolin_and_pytorch3d():
    assert render.from_kaolin(7000) == {"mode": "dibr", "delta": 7000.0}
    full = render.from_kaolin(70, boxlen=0.1, knum=5, height=240, width=320)
    assert full["kaolin_cutoff"] == (0.1, 5)
    assert render.from_kaolin(70, boxlen=0.1, knum=np.inf)["kaolin_cutoff"] == (0.1, None)
    # exp(-70 d^2) is a Gaussian of sqrt(1 / 140); one unit is 160 px along u, 120 along v
    assert full["sigma"] == pytest.approx(np.sqrt(160 * 120 / 140))
    assert render.from_pytorch3d(1e-4) == {"mode": "sigmoid", "sigma_ndc": 1e-4}
    theirs = render.from_pytorch3d(1e-4, 9e-4, 10, height=240, width=320)
    assert theirs["pytorch3d_cutoff"] == (9e-4, 10)
    d = theirs["sigma"] / 120
    assert 1 / (1 + np.exp(d * d / 1e-4)) == pytest.approx(0.15865525)
    for options in (render.from_kaolin(7000, boxlen=0.02), render.from_pytorch3d(1e-4, 9e-4)):
        assert draw(TETRAHEDRON, EYE, [[0, 0, 3]], **options).any()
    with pytest.raises(ValueError, match=r"^sigmainv: expected a finite number above zero"):
        render.from_kaolin(-1)
    with pytest.raises(ValueError, match=r"^blur_radius: "):
        render.from_pytorch3d(1e-4, float("nan"))
    with pytest.raises(ValueError, match=r"^height, width: expected both or neither"):
        render.from_kaolin(7000, height=240)


# ------------------------------------------------------------------------------------- memory


def test_results_stay_what_they_were(drone):
    camera = Camera.from_fov(320, 240, horizontal_deg=64.69)
    R, t = scenes.poses(np.random.default_rng(1), 4, distance=0.7, spread=0.02)
    first = render.silhouette(drone, camera, R, t)
    copy = first.copy()
    for _ in range(5):
        render.silhouette(drone, camera, R, -t)
    np.testing.assert_array_equal(first, copy)
    address = first.ctypes.data
    del first
    gc.collect()
    second = render.silhouette(drone, camera, R, t)
    np.testing.assert_array_equal(second, copy)
    assert BUFFERS.kept() <= 1 << 28
    assert address in (second.ctypes.data, render.silhouette(drone, camera, R, t).ctypes.data)


@pytest.mark.parametrize("options", ALL, ids=scenes.name)
def test_masks_with_their_gradient_are_both_to_the_bit(drone, options):
    R, t = scenes.poses(np.random.default_rng(8), 3, 1.0)
    U = np.random.default_rng(9).normal(size=(3, CAMERA.height, CAMERA.width))
    masks, pull_back = render.silhouette_vjp(drone, CAMERA, R, t, **options)
    np.testing.assert_array_equal(masks, render.silhouette(drone, CAMERA, R, t, **options))
    expected = render.silhouette_gradients(drone, CAMERA, R, t, U, **options)
    R[:], t[:] = 0, 9  # the poses belong to the caller
    for _ in range(2):
        found = pull_back(U)
        for name in ("R", "t", "K", "vertices"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert pull_back(U, vertices=False).vertices is None
    with pytest.raises(ValueError, match=r"upstream: expected shape \(3, 12, 16\)"):
        pull_back(U[:1])


@pytest.mark.parametrize("function", ["silhouette", "silhouette_gradients"])
def test_python_goes_on_while_the_extension_draws(function, drone):
    camera = Camera.from_fov(320, 240, horizontal_deg=64.69)
    pose = scenes.poses(np.random.default_rng(1), 16, distance=0.7, spread=0.02)
    upstream = (np.ones((16, 240, 320), np.float32),) if function != "silhouette" else ()
    with Counter() as counter:
        for _ in range(200):  # the first call is enough, unless the machine looks away
            before = counter.count
            getattr(render, function)(drone, camera, *pose, *upstream)
            if counter.count > before:
                return
    pytest.fail("no other thread ran during 200 calls")


def test_calls_from_many_threads_agree(drone):
    R, t = scenes.poses(np.random.default_rng(1), 6, distance=0.7)
    expected = draw(drone, R, t)
    wrong = []

    def work():
        wrong.extend(k for k in range(20) if not np.array_equal(draw(drone, R, t), expected))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
