"""Rotations, meshes and cameras."""

import copy
import json
import pickle
import sys

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from dronepose import Camera, Mesh, MeshError, geometry, metrics
from poses import CAMERA, seeds
from support import EXAMPLES


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


class TestMesh:
    def test_arrays_are_kept_and_cannot_be_written(self):
        v = np.random.default_rng(0).normal(size=(5, 3))
        mesh = Mesh(v, [[0, 1, 2], [2, 3, 4]])
        np.testing.assert_array_equal(mesh.vertices, v)
        np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [2, 3, 4]])
        assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.int32)
        with pytest.raises(ValueError, match="read-only"):
            mesh.vertices[0] = 0

    def test_a_copy_has_the_same_arrays_and_needs_no_file(self):
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        for again in (pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh)):
            np.testing.assert_array_equal(again.vertices, mesh.vertices)
            np.testing.assert_array_equal(again.faces, mesh.faces)
            assert again.diameter == mesh.diameter

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
