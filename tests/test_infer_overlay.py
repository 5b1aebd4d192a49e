"""Poses drawn on frames."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose import Camera, Mesh
from dronepose.infer import Style, color, draw
from support import EXAMPLES

MESH = EXAMPLES / "quadrotor.obj"


class TestOverlay:
    CAMERA = Camera.from_fov(160, 120, vertical_deg=50)

    def drawn(self, t=(0, 0, 1), **style):
        parts = {"fill": None, "contour": None, "box": None, "axes": False, **style}
        frame = np.full((120, 160, 3), 100, dtype=np.uint8)
        mesh = Mesh.from_file(MESH)
        return draw(frame, self.CAMERA, np.eye(3), t, mesh=mesh, style=Style(**parts))

    def test_nothing_asked_for_draws_nothing(self):
        assert (self.drawn() == 100).all()

    def test_the_fill_is_the_silhouette(self):
        from dronepose.render import silhouette

        out = self.drawn(fill=(255, 0, 0), alpha=1.0)
        mask = silhouette(Mesh.from_file(MESH), self.CAMERA, np.eye(3)[None], [[0, 0, 1]])[0]
        expected = 100 + mask * 155
        np.testing.assert_allclose(out[..., 0], expected, atol=0.51)

    def test_axes_end_where_they_project(self):
        out = self.drawn(axes=True, t=(0.05, -0.03, 1.2)).astype(int)
        length = 0.5 * np.linalg.norm(np.ptp(Mesh.from_file(MESH).bounds, axis=0))
        for axis, channel in ((0, 0), (1, 1)):
            seen = self.CAMERA.K @ (np.array([0.05, -0.03, 1.2]) + length * np.eye(3)[axis])
            u, v = seen[:2] / seen[2]
            others = [c for c in range(3) if c != channel]
            colored = (out[..., channel] - out[..., others].max(axis=2)) > 60
            points = np.argwhere(colored)[:, ::-1] + 0.5
            assert np.linalg.norm(points - [u, v], axis=1).min() < 2.0
            assert points[:, axis].max() == pytest.approx((u, v)[axis], abs=2.5)

    def test_the_box_holds_the_silhouette(self):
        box = self.drawn(box=(0, 255, 0))[..., 1] > 180
        fill = self.drawn(fill=(255, 0, 0), alpha=1.0)[..., 0] > 180
        for axis in (0, 1):
            of_box, of_fill = (np.flatnonzero(m.any(axis=axis)) for m in (box, fill))
            assert of_box[0] <= of_fill[0] + 1
            assert of_box[-1] >= of_fill[-1] - 1

    @pytest.mark.parametrize("t", [(0, 0, -1), (0, 0, 0), (5, 0, 0.001), (1e6, 0, 1), (0, 0, 1e9)])
    def test_any_pose_can_be_drawn(self, t):
        parts = {"fill": (1, 2, 3), "contour": (9, 9, 9), "box": (7, 7, 7), "axes": True}
        assert self.drawn(t=t, **parts).shape == (120, 160, 3)

    def test_the_frame_is_left_alone(self):
        frame = np.zeros((120, 160, 3), dtype=np.uint8)
        draw(frame, self.CAMERA, np.eye(3), [0, 0, 1])
        assert not frame.any()

    def test_wrong_arguments(self):
        frame = np.zeros((12, 16, 3), dtype=np.uint8)
        with pytest.raises(ValueError, match=r"^frame: "):
            draw(frame, self.CAMERA, np.eye(3), [0, 0, 1])
        with pytest.raises(ValueError, match=r"^R, t: expected finite"):
            draw(np.zeros((120, 160, 3), np.uint8), self.CAMERA, np.eye(3), [0, 0, np.nan])
        with pytest.raises(ValueError, match=r"^alpha: "):
            Style(alpha=2.0)

    def test_colours(self):
        assert color("#0a0B0c") == (10, 11, 12)
        assert color("none") is None
