"""The metrics of arrays, against plain NumPy, and what they say about wrong arguments."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronepose import Mesh, Symmetries, metrics
from oracles import metrics as oracle
from poses import CAMERA, HALF_TURN, each, near, random_mesh, random_poses, scales, seeds, sizes


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

    def test_a_copy_has_the_same_transforms(self):
        symmetries = Symmetries(HALF_TURN[None], [([0, 0, 1], [0.1, 0, 0])], max_step=0.1)
        again = pickle.loads(pickle.dumps(symmetries))
        np.testing.assert_array_equal(again.transforms, symmetries.transforms)

    def test_an_axis_of_no_direction(self):
        with pytest.raises(ValueError, match="axis"):
            Symmetries(continuous=[([0, 0, 0], [0, 0, 0])])
