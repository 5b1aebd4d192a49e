"""The functions on arrays, against plain NumPy, and what they say about wrong arguments."""

import json
import multiprocessing
import pickle
import re
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import dronepose
from dronepose import Camera, Mesh, MeshError, Symmetries, evaluate, geometry, metrics
from oracles import metrics as oracle
from support import EXAMPLES, rows

CAMERA = Camera.from_fov(320, 240, horizontal_deg=64.69)
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def random_poses(rng, n, distance=3.0):
    R = Rotation.random(n, rng=rng).as_matrix()
    return R, rng.normal(size=(n, 3)) * 0.3 + [0.0, 0.0, distance]


def near(rng, R, t, degrees=5.0, metres=0.03):
    turn = Rotation.from_rotvec(np.radians(degrees) * rng.normal(size=(len(R), 3))).as_matrix()
    return turn @ R, t + metres * rng.normal(size=t.shape)


def random_mesh(rng, n=40):
    return Mesh(rng.uniform(-0.3, 0.3, size=(n, 3)), [[0, 1, 2]])


def each(function, *arrays):
    return np.array([function(*row) for row in zip(*arrays, strict=True)])


seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 12)
scales = st.sampled_from([1e-9, 1e-3, 1.0, 20.0])


class TestAgainstTheOracle:
    @given(seeds, sizes, scales)
    def test_translation_error_and_npe(self, seed, n, scale):
        rng = np.random.default_rng(seed)
        _, t_gt = random_poses(rng, n)
        t_est = t_gt + scale * rng.normal(size=t_gt.shape)
        expected = each(oracle.translation_error, t_est, t_gt)
        np.testing.assert_allclose(metrics.translation_error(t_est, t_gt), expected, rtol=1e-13)
        np.testing.assert_allclose(
            metrics.npe(t_est, t_gt), each(oracle.npe, t_est, t_gt), rtol=1e-13
        )

    @given(seeds, sizes, scales)
    def test_orientation_error(self, seed, n, scale):
        rng = np.random.default_rng(seed)
        R_gt, t = random_poses(rng, n)
        R_est, _ = near(rng, R_gt, t, degrees=scale)
        expected = each(oracle.orientation_error, R_est, R_gt)
        ours = metrics.orientation_error(R_est, R_gt)
        np.testing.assert_allclose(ours, expected, rtol=0, atol=2e-15)
        assert ((ours >= 0) & (ours <= np.pi)).all()

    @given(seeds, sizes)
    def test_cpe_and_acc(self, seed, n):
        rng = np.random.default_rng(seed)
        gt = random_poses(rng, n)
        est = near(rng, *gt)
        angle = each(oracle.orientation_error, est[0], gt[0])
        ratio = each(oracle.npe, est[1], gt[1])
        np.testing.assert_allclose(metrics.cpe(*est, *gt), ratio + angle, rtol=1e-12)
        distance = each(oracle.translation_error, est[1], gt[1])
        expected = (np.degrees(angle) < 5) & (distance * 100 < 5)
        np.testing.assert_array_equal(metrics.acc(*est, *gt, x=5), expected)

    @given(seeds, sizes, scales)
    def test_add_and_adds(self, seed, n, scale):
        rng = np.random.default_rng(seed)
        mesh, gt = random_mesh(rng), random_poses(rng, n)
        est = near(rng, *gt, degrees=scale, metres=0.01 * scale)
        for ours, theirs in ((metrics.add, oracle.add), (metrics.adds, oracle.adds)):
            expected = np.array([theirs(mesh.vertices, *p) for p in zip(*est, *gt, strict=True)])
            np.testing.assert_allclose(ours(mesh, *est, *gt), expected, rtol=1e-9, atol=1e-14)

    @given(seeds, sizes)
    def test_mssd_and_mspd_take_the_best_symmetry(self, seed, n):
        rng = np.random.default_rng(seed)
        mesh, gt = random_mesh(rng), random_poses(rng, n)
        est = near(rng, gt[0] @ HALF_TURN[:3, :3], gt[1])
        symmetries = Symmetries(HALF_TURN[None])
        transforms = symmetries.transforms
        poses = list(zip(*est, *gt, strict=True))
        expected = np.array([oracle.mssd(mesh.vertices, *p, transforms) for p in poses])
        np.testing.assert_allclose(metrics.mssd(mesh, *est, *gt, symmetries), expected, rtol=1e-9)
        expected = np.array([oracle.mspd(mesh.vertices, *p, CAMERA.K, transforms) for p in poses])
        np.testing.assert_allclose(
            metrics.mspd(mesh, *est, *gt, CAMERA, symmetries), expected, rtol=1e-9
        )
        expected = np.array([oracle.projection_error(mesh.vertices, *p, CAMERA.K) for p in poses])
        np.testing.assert_allclose(
            metrics.projection_error(mesh, *est, *gt, CAMERA), expected, rtol=1e-9
        )
        expected = np.array(
            [
                oracle.symmetric_orientation_error(R_est, R_gt, transforms)
                for R_est, _, R_gt, _ in poses
            ]
        )
        np.testing.assert_allclose(
            metrics.symmetric_orientation_error(est[0], gt[0], symmetries), expected, atol=2e-15
        )

    @given(
        st.lists(st.one_of(st.floats(0, 0.2), st.just(float("inf"))), max_size=30),
        st.integers(0, 5),
    )
    def test_auc(self, errors, missing):
        n = len(errors) + missing
        e = np.array(errors, dtype=np.float64)
        if n == 0:
            with pytest.raises(ValueError, match="n_total"):
                metrics.auc(e, n_total=n)
            return
        exact, ycb = (metrics.auc(e, n_total=n, method=m) for m in ("exact", "ycb"))
        assert exact == pytest.approx(oracle.auc_exact(e, 0.1, n), abs=1e-12)
        assert ycb == pytest.approx(oracle.auc_ycb(e, 0.1, n), abs=1e-12)
        assert 0 <= exact <= ycb <= 1 + 1e-12

    @given(seeds, sizes)
    def test_add_recall_is_the_share_of_add_below(self, seed, n):
        rng = np.random.default_rng(seed)
        mesh, gt = random_mesh(rng), random_poses(rng, n)
        est = near(rng, *gt)
        errors = metrics.add(mesh, *est, *gt)
        # Also the errors themselves: the comparison is strict.
        thresholds = np.concatenate([[0.0, 0.02, 0.05, 1.0], errors * (1 - 1e-9)])
        expected = (errors[None] < thresholds[:, None]).mean(axis=1)
        np.testing.assert_array_equal(metrics.add_recall(mesh, *est, *gt, thresholds), expected)
        assert metrics.add_recall(mesh, *est, *gt, 0.05).shape == ()


class TestInvariance:
    @given(seeds)
    def test_equal_poses_have_no_error(self, seed):
        rng = np.random.default_rng(seed)
        mesh, (R, t) = random_mesh(rng), random_poses(rng, 5)
        for f in (metrics.add, metrics.adds, metrics.mssd):
            np.testing.assert_allclose(f(mesh, R, t, R, t), 0.0, atol=2e-15)
        np.testing.assert_array_equal(metrics.cpe(R, t, R, t), 0.0)
        assert metrics.acc(R, t, R, t, x=1e-9).all()

    @given(seeds)
    def test_add_bounds_adds_and_mssd_bounds_add(self, seed):
        rng = np.random.default_rng(seed)
        mesh, gt = random_mesh(rng), random_poses(rng, 8)
        est = near(rng, *gt, degrees=30.0)
        add = metrics.add(mesh, *est, *gt)
        assert (metrics.adds(mesh, *est, *gt) <= add * (1 + 1e-12)).all()
        assert (add <= metrics.mssd(mesh, *est, *gt) * (1 + 1e-12)).all()

    @given(seeds)
    def test_moving_the_camera_changes_no_distance(self, seed):
        rng = np.random.default_rng(seed)
        mesh, gt = random_mesh(rng), random_poses(rng, 6)
        est = near(rng, *gt)
        Q, s = random_poses(rng, 1)

        def moved(pose):
            return Q[0] @ pose[0], pose[1] @ Q[0].T + s[0]

        for f in (metrics.add, metrics.adds, metrics.mssd):
            np.testing.assert_allclose(
                f(mesh, *moved(est), *moved(gt)), f(mesh, *est, *gt), rtol=1e-9, atol=1e-13
            )

    def test_the_number_of_threads_changes_no_bit(self):
        rng = np.random.default_rng(1)
        mesh, gt = random_mesh(rng), random_poses(rng, 1000)
        est = near(rng, *gt)
        for f in (metrics.add, metrics.adds, metrics.mssd):
            np.testing.assert_array_equal(
                f(mesh, *est, *gt, threads=1), f(mesh, *est, *gt, threads=2)
            )


class TestShapesAndTypes:
    def setup_method(self):
        rng = np.random.default_rng(7)
        self.mesh = random_mesh(rng)
        self.gt = random_poses(rng, 6)
        self.est = near(rng, *self.gt)

    def test_single_poses_give_a_single_number(self):
        one = metrics.add(self.mesh, self.est[0][0], self.est[1][0], self.gt[0][0], self.gt[1][0])
        assert one.shape == ()
        assert one.dtype == np.float64
        assert float(one) == metrics.add(self.mesh, *self.est, *self.gt)[0]

    def test_a_single_pose_is_compared_with_all(self):
        ours = metrics.add(self.mesh, *self.est, self.gt[0][2], self.gt[1][2])
        R, t = np.repeat(self.gt[0][2:3], 6, axis=0), np.repeat(self.gt[1][2:3], 6, axis=0)
        np.testing.assert_array_equal(ours, metrics.add(self.mesh, *self.est, R, t))

    def test_leading_axes_are_kept(self):
        R, t = self.est[0].reshape(2, 3, 3, 3), self.est[1].reshape(2, 3, 3)
        ours = metrics.cpe(R, t, self.gt[0].reshape(2, 3, 3, 3), self.gt[1].reshape(2, 3, 3))
        assert ours.shape == (2, 3)
        np.testing.assert_array_equal(ours.ravel(), metrics.cpe(*self.est, *self.gt))

    def test_nothing_in_nothing_out(self):
        R, t = np.empty((0, 3, 3)), np.empty((0, 3))
        assert metrics.add(self.mesh, R, t, R, t).shape == (0,)
        with pytest.raises(ValueError, match="at least one pose"):
            metrics.add_recall(self.mesh, R, t, R, t, [0.1])

    def test_single_precision_is_computed_in_double(self):
        est32 = [a.astype(np.float32) for a in self.est]
        ours = metrics.add(self.mesh, *est32, *self.gt)
        assert ours.dtype == np.float64
        exact = metrics.add(self.mesh, *self.est, *self.gt)
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-6)

    def test_strided_and_fortran_arrays(self):
        R = np.asfortranarray(self.est[0])
        t = np.concatenate([self.est[1], self.est[1]], axis=1)[:, ::-1][:, 2::-1][:, ::-1][:, ::-1]
        t = np.ascontiguousarray(t)[:, ::-1]
        expected = metrics.add(self.mesh, self.est[0], np.array(t), *self.gt)
        np.testing.assert_array_equal(metrics.add(self.mesh, R, t, *self.gt), expected)

    def test_lists_will_do(self):
        assert metrics.npe([0, 0, 3], [0, 0, 2]) == 0.5


class TestRefusals:
    def setup_method(self):
        self.R = np.tile(np.eye(3), (4, 1, 1))
        self.t = np.tile([0.0, 0.0, 1.0], (4, 1))
        self.mesh = Mesh(np.eye(3), [[0, 1, 2]])

    @pytest.mark.parametrize("name", ["R_est", "t_est", "R_gt", "t_gt"])
    def test_a_wrong_shape_names_the_argument(self, name):
        poses = {"R_est": self.R, "t_est": self.t, "R_gt": self.R, "t_gt": self.t}
        poses[name] = poses[name][..., :2]
        with pytest.raises(ValueError, match=rf"^{name}: expected shape .*got \(4, "):
            metrics.add(self.mesh, **poses)

    @pytest.mark.parametrize("name", ["R_est", "t_est", "R_gt", "t_gt"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_a_value_that_is_not_finite_names_argument_and_row(self, name, value):
        poses = {
            k: v.copy()
            for k, v in zip(("R_est", "t_est", "R_gt", "t_gt"), (self.R, self.t) * 2, strict=True)
        }
        poses[name][2].flat[0] = value
        with pytest.raises(ValueError, match=rf"^{name}\[2\]: "):
            metrics.add(self.mesh, **poses)

    @pytest.mark.parametrize(
        ("matrix", "word"),
        [
            (1.1 * np.eye(3), "orthonormal"),
            (np.diag([1.0, 1.0, -1.0]), "reflection"),
            (np.zeros((3, 3)), "orthonormal"),
        ],
    )
    def test_what_is_no_rotation_is_refused_with_its_row(self, matrix, word):
        self.R[3] = matrix
        with pytest.raises(ValueError, match=rf"^R_gt\[3\]: .*{word}"):
            metrics.orientation_error(np.eye(3), self.R)

    def test_a_rotation_that_is_nearly_one_is_projected_with_a_warning(self):
        self.R[1] *= 1.001
        with pytest.warns(UserWarning, match=r"^R_est: 1 of 4 matrices .*row 1"):
            angle = metrics.orientation_error(self.R, np.eye(3))
        np.testing.assert_allclose(angle, 0.0, atol=1e-15)

    def test_batches_that_do_not_fit(self):
        with pytest.raises(ValueError, match=r"R_est \(4, 3, 3\), R_gt \(3, 3, 3\)"):
            metrics.orientation_error(self.R, self.R[:3])

    def test_npe_of_a_model_at_the_camera(self):
        self.t[2] = 0.0
        with pytest.raises(ValueError, match=r"^t_gt\[2\]: "):
            metrics.npe(np.ones(3), self.t)

    def test_words_are_no_numbers(self):
        with pytest.raises(TypeError, match=r"^t_est: expected real numbers"):
            metrics.npe(["a", "b", "c"], [0, 0, 1])

    def test_x_of_acc_is_above_zero(self):
        with pytest.raises(ValueError, match=r"^x: "):
            metrics.acc(self.R, self.t, self.R, self.t, x=0)

    @pytest.mark.parametrize(
        ("arguments", "name"),
        [
            ({"errors": [-1.0]}, r"errors\[0\]"),
            ({"errors": [0.0, np.nan]}, r"errors\[1\]"),
            ({"errors": []}, "n_total"),
            ({"errors": [0.0, 0.0], "n_total": 1}, "n_total"),
            ({"errors": [0.0], "max_error": 0.0}, "max_error"),
            ({"errors": [0.0], "method": "area"}, "method"),
        ],
    )
    def test_auc_refuses(self, arguments, name):
        with pytest.raises(ValueError, match=f"^{name}: "):
            metrics.auc(**arguments)

    def test_a_point_behind_the_camera_has_no_projection(self):
        t = np.array([0.0, 0.0, 0.5])
        ours = metrics.mspd(self.mesh, np.eye(3), -t, np.eye(3), t, CAMERA)
        assert ours == np.inf


class TestGeometry:
    @given(seeds)
    def test_every_form_gives_the_same_matrix(self, seed):
        rotation = Rotation.random(6, rng=np.random.default_rng(seed))
        R = rotation.as_matrix()
        xyzw = rotation.as_quat() * 3.7
        close = {"rtol": 0, "atol": 1e-14}
        np.testing.assert_allclose(geometry.matrix_from_quat_xyzw(xyzw), R, **close)
        wxyz = -xyzw[:, [3, 0, 1, 2]]
        np.testing.assert_allclose(geometry.matrix_from_quat_wxyz(wxyz), R, **close)
        turned = geometry.matrix_from_axis_angle(rotation.as_rotvec())
        np.testing.assert_allclose(turned, R, **close)
        columns = np.concatenate([2 * R[:, :, 0], R[:, :, 1] + R[:, :, 0]], axis=1)
        np.testing.assert_allclose(geometry.matrix_from_6d(columns), R, **close)
        two_rows = R[:, :2].reshape(-1, 6)
        np.testing.assert_allclose(geometry.matrix_from_6d(two_rows, layout="rows"), R, **close)
        back = geometry.quat_wxyz_from_matrix(R)
        assert (back[:, 0] >= 0).all()
        np.testing.assert_allclose(geometry.matrix_from_quat_wxyz(back), R, **close)

    def test_shapes(self):
        assert geometry.matrix_from_quat_wxyz([1, 0, 0, 0]).shape == (3, 3)
        assert geometry.matrix_from_axis_angle(np.zeros((2, 5, 3))).shape == (2, 5, 3, 3)
        assert geometry.quat_wxyz_from_matrix(np.eye(3)).shape == (4,)

    @pytest.mark.parametrize(
        ("function", "argument", "value"),
        [
            (geometry.matrix_from_quat_wxyz, "quat_wxyz", [[1, 0, 0, 0], [0, 0, 0, 0]]),
            (geometry.matrix_from_quat_xyzw, "quat_xyzw", [[1, 0, 0, 0], [np.nan, 0, 0, 0]]),
            (geometry.matrix_from_axis_angle, "axis_angle", [[0, 0, 0], [np.inf, 0, 0]]),
            (geometry.matrix_from_6d, "rotation_6d", [[1, 0, 0, 0, 1, 0], [1, 0, 0, 2, 0, 0]]),
        ],
    )
    def test_what_is_no_rotation_names_argument_and_row(self, function, argument, value):
        with pytest.raises(ValueError, match=rf"^{argument}\[1\]: "):
            function(value)
        with pytest.raises(ValueError, match=rf"^{argument}: expected shape"):
            function(np.zeros((2, 2)))

    def test_an_unknown_layout(self):
        with pytest.raises(ValueError, match=r"^layout: "):
            geometry.matrix_from_6d([1, 0, 0, 0, 1, 0], layout="diagonal")


class TestSymmetries:
    def test_the_identity_comes_first_and_once(self):
        for discrete in (None, HALF_TURN[None], np.stack([np.eye(4), HALF_TURN])):
            transforms = Symmetries(discrete).transforms
            np.testing.assert_array_equal(transforms[0], np.eye(4))
            assert len(transforms) == (1 if discrete is None else 2)

    def test_a_continuous_axis_through_an_offset(self):
        symmetries = Symmetries(continuous=[([0, 0, 2], [0.1, 0, 0])])
        assert len(symmetries) == 315
        fixed = np.array([0.1, 0.0, 0.7, 1.0])
        np.testing.assert_allclose(symmetries.transforms @ fixed, [fixed] * 315, atol=1e-15)

    def test_bop_translations_are_millimetres(self):
        m = HALF_TURN.copy()
        m[0, 3] = 200.0
        symmetries = Symmetries.from_bop({"symmetries_discrete": [m.ravel().tolist()]})
        assert symmetries.transforms[1, 0, 3] == pytest.approx(0.2)

    @pytest.mark.parametrize(
        "discrete", [np.ones((1, 2, 2)), 2 * HALF_TURN[None], np.ones((1, 4, 4))]
    )
    def test_refusals(self, discrete):
        with pytest.raises(ValueError, match=r"^discrete"):
            Symmetries(discrete)

    def test_an_axis_of_no_direction(self):
        with pytest.raises(ValueError, match="axis"):
            Symmetries(continuous=[([0, 0, 0], [0, 0, 0])])


class TestMesh:
    def test_arrays_are_kept_and_cannot_be_written(self):
        v = np.random.default_rng(0).normal(size=(5, 3))
        mesh = Mesh(v, [[0, 1, 2], [2, 3, 4]])
        np.testing.assert_array_equal(mesh.vertices, v)
        np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [2, 3, 4]])
        assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.int32)
        with pytest.raises(ValueError, match="read-only"):
            mesh.vertices[0] = 0

    def test_lengths_of_a_box(self):
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 2)])
        mesh = Mesh(corners, [[0, 1, 2]])
        assert mesh.bbox_diagonal == mesh.diameter == 3.0
        np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 2, 2]])

    @given(seeds)
    def test_the_diameter_is_the_largest_distance(self, seed):
        v = np.random.default_rng(seed).normal(size=(30, 3))
        distances = np.linalg.norm(v[:, None] - v[None], axis=2)
        assert Mesh(v, []).diameter == pytest.approx(distances.max(), rel=1e-14)

    @pytest.mark.parametrize(
        ("vertices", "faces", "error", "text"),
        [
            ([[0, 0]], [], ValueError, r"^vertices: expected shape \(V, 3\)"),
            ([[0, 0, 0]], [[0, 0]], ValueError, r"^faces: expected shape \(F, 3\)"),
            ([[0, 0, 0]], [[0.0, 0.0, 0.0]], TypeError, "^faces: expected integers"),
            ([[0, 0, 0]], [[0, 0, 1]], MeshError, "face 0 refers to vertex 1"),
            ([[0, 0, 0]], [[0, 0, -1]], MeshError, "^faces: .*-1"),
            ([[0, 0, 0], [0, np.nan, 0]], [], MeshError, "vertex 1 is not finite"),
            (np.empty((0, 3)), [], MeshError, "at least one"),
        ],
    )
    def test_refusals(self, vertices, faces, error, text):
        with pytest.raises(error, match=text):
            Mesh(vertices, faces)

    def test_units_scale_to_metres(self):
        path = EXAMPLES / "quadrotor.obj"
        metres, millimetres = Mesh.from_file(path), Mesh.from_file(path, unit="mm")
        np.testing.assert_allclose(millimetres.vertices * 1000, metres.vertices, rtol=1e-14)
        with pytest.raises(ValueError, match=r"^unit: "):
            Mesh.from_file(path, unit="inch")

    @pytest.mark.parametrize("suffix", ["ply", "stl", "off", "glb"])
    def test_other_formats_hold_the_same_surface(self, suffix, tmp_path):
        trimesh = pytest.importorskip("trimesh")
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        path = tmp_path / f"quadrotor.{suffix}"
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
        again = Mesh.from_file(path)
        assert again.diameter == pytest.approx(mesh.diameter, rel=1e-6)
        corners, same = again.vertices[again.faces], mesh.vertices[mesh.faces]
        np.testing.assert_allclose(corners, same, rtol=0, atol=1e-6)

    def test_a_format_that_needs_trimesh_says_so(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "trimesh", None)
        path = tmp_path / "drone.glb"
        path.write_bytes(b"glTF")
        with pytest.raises(ImportError, match="pip install trimesh"):
            Mesh.from_file(path)

    @pytest.mark.parametrize("name", ["none.obj", "none.glb"])
    def test_a_missing_file(self, name, tmp_path):
        with pytest.raises(FileNotFoundError, match=name):
            Mesh.from_file(tmp_path / name)

    def test_from_trimesh(self):
        trimesh = pytest.importorskip("trimesh")
        box = trimesh.creation.box((300, 400, 1200))
        assert Mesh.from_trimesh(box, unit="mm").diameter == pytest.approx(1.3)
        with pytest.raises(TypeError, match=r"^mesh: "):
            Mesh.from_trimesh("box")

    def test_check_finds_what_is_wrong(self):
        good = Mesh.from_file(EXAMPLES / "quadrotor.obj").check()
        assert good["closed"] is True
        v = np.zeros((4, 3))
        v[1, 0] = v[2, 1] = 1.0  # vertex 3 doubles vertex 0
        bad = Mesh(v, [[0, 1, 2]]).check()
        assert bad["closed"] is False
        assert bad["duplicate_vertices"] == 1
        assert str(good) != str(bad)
        assert json.loads(json.dumps(bad)) == bad


class TestCamera:
    def test_fields_of_view(self):
        by_height = Camera.from_fov(320, 240, vertical_deg=50.8)
        assert by_height.fy == pytest.approx(252.72, abs=5e-3)
        assert (CAMERA.cx, CAMERA.cy) == (160.0, 120.0)
        assert 2 * np.degrees(np.arctan(160 / CAMERA.fx)) == pytest.approx(64.69)
        for angles in ({}, {"horizontal_deg": 60, "vertical_deg": 50}):
            with pytest.raises(ValueError, match="exactly one"):
                Camera.from_fov(320, 240, **angles)

    def test_matrix_and_back(self):
        camera = Camera(500, 510, 320.5, 240, 640, 480, skew=0.25)
        assert Camera.from_K(camera.K, 640, 480) == camera
        assert pickle.loads(pickle.dumps(camera)) == camera

    @pytest.mark.parametrize(
        ("field", "value"),
        [("fx", 0), ("fy", -1), ("cx", np.nan), ("width", 0), ("height", 1.5), ("skew", np.inf)],
    )
    def test_refusals_name_the_field(self, field, value):
        good = {"fx": 1, "fy": 1, "cx": 0, "cy": 0, "width": 2, "height": 2}
        with pytest.raises(ValueError, match=f"^{field}: "):
            Camera(**{**good, field: value})

    @pytest.mark.parametrize("K", [np.eye(2), np.ones((3, 3)), np.diag([1.0, 1.0, 2.0])])
    def test_what_is_no_camera_matrix(self, K):
        with pytest.raises(ValueError, match=r"^K: "):
            Camera.from_K(K, 10, 10)

    def test_a_skew_shears_the_projection(self):
        # A point moves by 0.1 m along y at 5 m: by 10 px along v, and by 1 px along u.
        camera = Camera(500, 500, 320, 240, 640, 480, skew=50.0)
        mesh, R = Mesh(np.zeros((1, 3)), []), np.eye(3)
        error = metrics.mspd(mesh, R, [0, 0.1, 5], R, [0, 0, 5], camera)
        np.testing.assert_allclose(error, np.hypot(10, 1), rtol=1e-12)


def example_arrays(name):
    table = rows(EXAMPLES / name)
    q = np.array([[float(r[k]) for k in ("qw", "qx", "qy", "qz")] for r in table])
    t = np.array([[float(r[k]) for k in ("tx", "ty", "tz")] for r in table])
    return geometry.matrix_from_quat_wxyz(q), t, [r["id"] for r in table]


class TestEvaluate:
    def test_arrays_and_files_give_the_same_numbers(self):
        names = ("predictions.csv", "gt.csv")
        from_files = evaluate(*(EXAMPLES / n for n in names), mesh=EXAMPLES / "quadrotor.obj")
        arrays = [example_arrays(n) for n in names]
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        from_tuples = evaluate(*arrays, mesh=mesh)
        from_mappings = evaluate(
            *({"R": R, "t": t, "ids": ids} for R, t, ids in arrays),
            mesh=Mesh(mesh.vertices, mesh.faces),
        )
        assert from_files.n_matched == from_tuples.n_matched == from_mappings.n_matched
        for other in (from_tuples, from_mappings):
            for key in ("npe", "oe_rad", "te_m", "cpe", "add_m", "adds_m"):
                ours, theirs = getattr(other.metrics, key), getattr(from_files.metrics, key)
                assert ours.mean == pytest.approx(theirs.mean, rel=0, abs=1e-12)
            for x, recall in from_files.metrics.acc.items():
                assert other.metrics.acc[x].count == recall.count

    def test_functions_and_evaluation_agree(self):
        est, gt = example_arrays("predictions.csv"), example_arrays("gt.csv")
        index = {name: k for k, name in enumerate(gt[2])}
        chosen = [index[name] for name in est[2]]
        pair = (*est[:2], gt[0][chosen], gt[1][chosen])
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        result = evaluate(est, gt, mesh=mesh, camera=CAMERA)
        m = result.metrics
        for errors, summary in (
            (metrics.cpe(*pair), m.cpe),
            (metrics.add(mesh, *pair), m.add_m),
            (metrics.adds(mesh, *pair), m.adds_m),
            (metrics.mssd(mesh, *pair), m.mssd_m),
            (metrics.mspd(mesh, *pair, CAMERA), m.mspd_px),
            (metrics.projection_error(mesh, *pair, CAMERA), m.proj_px),
        ):
            assert summary.mean == pytest.approx(errors.mean(), rel=1e-12)
            assert summary.p95 == pytest.approx(np.percentile(errors, 95), rel=1e-12)
            assert summary.std == pytest.approx(errors.std(), rel=1e-9)
        assert m.acc["5"].count == metrics.acc(*pair, x=5).sum()
        recall = metrics.add_recall(mesh, *pair, 0.05 * mesh.bbox_diagonal)
        assert m.add_recall.at["5"].percent_of_matched == pytest.approx(100 * recall)
        errors = metrics.add(mesh, *pair)
        for method in ("exact", "ycb"):
            ours = metrics.auc(errors, n_total=len(gt[2]), method=method)
            assert getattr(m.add_auc, method) == pytest.approx(ours, rel=1e-12)

    def test_dataclasses_mirror_the_json(self):
        result = evaluate(
            EXAMPLES / "predictions.csv",
            EXAMPLES / "gt.csv",
            mesh=EXAMPLES / "quadrotor.obj",
            by=["scene", "distance"],
            bootstrap=50,
            compare=[EXAMPLES / "predictions_baseline.csv"],
            add_reference=0.354,
            acc=[5, 2.5],
        )
        data = result.to_dict()
        assert data == json.loads(result.to_json())
        assert data["schema"] == result.schema == "dronepose-eval/1"
        assert list(result.metrics.acc) == sorted(data["metrics"]["acc"])
        assert set(result.metrics.acc) == {"5", "2.5"}
        assert result.metrics.add_recall.reference_m == 0.354
        assert set(result.metrics.add_recall.at) == {"2", "5", "10"}
        assert [b.column for b in result.by] == ["scene", "distance"]
        assert result.by[1].groups[0].from_ == data["by"][1]["groups"][0]["from"]
        assert result.ci95.mean["npe"] == tuple(data["ci95"]["npe"])
        assert result.compare[0].difference["npe"].mean > 0
        assert result.table()
        assert str(result) == result.table()
        assert "npe" in result.table().lower()
        data["n_gt"] = 0
        assert result.to_dict()["n_gt"] == 2000

    def test_row_numbers_are_ids_where_none_are_given(self):
        R, t = np.tile(np.eye(3), (3, 1, 1)), np.tile([0.0, 0.0, 2.0], (3, 1))
        result = evaluate((R[:2], t[:2]), (R, t))
        assert (result.n_gt, result.n_matched, result.n_predictions) == (3, 2, 2)
        assert result.metrics.cpe.max == 0.0

    @pytest.mark.parametrize(
        ("poses", "error", "text"),
        [
            ((np.eye(3), np.zeros(3)), ValueError, r"predictions R: expected shape \(N, 3, 3\)"),
            ((np.eye(3)[None], np.ones((2, 3))), ValueError, "as many R, t and ids"),
            ((np.eye(3)[None], np.ones((1, 3)), ["a", "b"]), ValueError, "as many R, t and ids"),
            ({"R": np.eye(3)[None]}, ValueError, "keys"),
            (7, TypeError, "predictions: expected a path"),
        ],
    )
    def test_refusals_name_the_input(self, poses, error, text):
        with pytest.raises(error, match=text):
            evaluate(poses, (np.eye(3)[None], np.ones((1, 3))))

    def test_errors_in_files_come_with_their_place(self, tmp_path):
        bad = tmp_path / "bad.csv"
        bad.write_text("id,qw,qx,qy,qz,tx,ty,tz\na,1,0,0,0,0,zero,1\n")
        with pytest.raises(ValueError, match=re.escape("bad.csv:2:ty: ")):
            evaluate(bad, EXAMPLES / "gt.csv")
        with pytest.raises(FileNotFoundError, match=r"none\.csv"):
            evaluate(tmp_path / "none.csv", EXAMPLES / "gt.csv")

    def test_an_unknown_choice_is_an_error(self):
        with pytest.raises(ValueError, match="preset"):
            evaluate(EXAMPLES / "gt.csv", EXAMPLES / "gt.csv", preset="kind")


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_process_computes_too():
    R, t = np.tile(np.eye(3), (2000, 1, 1)), np.tile([0.0, 0.0, 2.0], (2000, 1))
    metrics.cpe(R, t, R, t)  # the parent's pool exists before the fork
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(_worst, (R, t)).get(timeout=60) == 0.0


def _worst(R, t):
    return float(metrics.cpe(R, t, R, t).max())


def test_public_names_are_documented():
    for name in dronepose.__all__:
        if name != "__version__":
            assert getattr(dronepose, name).__doc__, name
    for name in metrics.__all__ + geometry.__all__:
        module = metrics if name in metrics.__all__ else geometry
        assert getattr(module, name).__doc__
