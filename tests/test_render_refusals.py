"""Silhouettes in NumPy: what cannot be drawn is refused by name."""

import numpy as np
import pytest

from dronepose import Camera, Mesh, render
from scenes import CAMERA, SQUARE

EYE = np.eye(3)[None]


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"mesh": 3}, TypeError, "mesh: expected a dronepose.Mesh or a sequence, got int"),
        ({"mesh": [3]}, TypeError, "mesh: expected a dronepose.Mesh, got int"),
        ({"mesh": [Mesh(*SQUARE)] * 3}, ValueError, "mesh: expected one for each of 2 poses"),
        ({"mesh": Mesh(SQUARE[0], [])}, ValueError, "faces: a mesh without faces"),
        ({"camera": np.eye(3)}, TypeError, "camera: expected a dronepose.Camera, got ndarray"),
        (
            {"camera": Camera(1, 1, 0, 0, 70000, 4)},
            ValueError,
            "width: expected 1 to 65535 pixels, got 70000",
        ),
        ({"R": np.eye(3)}, ValueError, r"R: expected shape \(B, 3, 3\), got \(3, 3\)"),
        ({"R": np.full((2, 3, 3), np.nan)}, ValueError, r"R\[0\]: found NaN"),
        ({"R": [["a"]]}, TypeError, "R: expected real numbers"),
        ({"t": np.zeros((1, 3))}, ValueError, r"t: expected 2 translations"),
        ({"t": [[0, 0, 1], [0, np.inf, 1]]}, ValueError, r"t\[1\]: found inf"),
        ({"t": [[0, 0, 1], [0, 0, 1e13]]}, ValueError, "R, t: a vertex is further than"),
        ({"mode": "blurry"}, ValueError, "mode: expected 'coverage', 'hard', 'dibr' or"),
        ({"sigma": -1.0}, ValueError, "sigma: -1"),
        ({"sigma": float("nan")}, ValueError, "sigma: NaN"),
        ({"mode": "dibr", "delta": 0.0}, ValueError, "delta: 0"),
        ({"mode": "sigmoid", "sigma_ndc": -1e-4}, ValueError, "sigma_ndc: -0.0001"),
        ({"near": 0.0}, ValueError, "near: 0 m"),
        ({"near": -1.0}, ValueError, "near: -1 m"),
        ({"threads": -1}, ValueError, "threads: expected 0"),
        ({"threads": 10**6}, ValueError, "threads: found 1000000"),
        ({"kaolin_cutoff": (0.02, 30)}, ValueError, "kaolin_cutoff: belongs to mode 'dibr'"),
        ({"mode": "dibr", "kaolin_cutoff": (0.02, 0)}, ValueError, "kaolin_cutoff: expected"),
        ({"mode": "dibr", "kaolin_cutoff": (0.0, 30)}, ValueError, "boxlen: 0"),
        ({"mode": "dibr", "kaolin_cutoff": 3}, ValueError, "kaolin_cutoff: expected"),
        ({"mode": "dibr", "kaolin_cutoff": (0.02, np.inf)}, ValueError, "kaolin_cutoff: expected"),
        (
            {"mode": "sigmoid", "pytorch3d_cutoff": (0.02, None)},
            ValueError,
            "pytorch3d_cutoff: expected",
        ),
        ({"pytorch3d_cutoff": (1e-3, 5)}, ValueError, "pytorch3d_cutoff: belongs to mode"),
        ({"mode": "sigmoid", "pytorch3d_cutoff": (0.0, 5)}, ValueError, "blur_radius: 0"),
        ({"dtype": np.int32}, ValueError, "dtype: expected float32 or float64, got int32"),
        ({"out": np.zeros((1, 12, 16))}, ValueError, r"out: expected shape \(2, 12, 16\)"),
        ({"out": [1.0]}, TypeError, "out: expected an array, got list"),
        (
            {"out": np.zeros((2, 12, 16)), "dtype": np.float32},
            ValueError,
            "out: expected shape .* of float32, got .* of float64",
        ),
        ({"out": np.zeros((16, 12, 2)).T}, ValueError, "out: expected a C-contiguous array"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(change, error, text):
    arguments = {"mesh": Mesh(*SQUARE), "camera": CAMERA, "R": np.tile(np.eye(3), (2, 1, 1))}
    arguments |= {"t": np.array([[0.0, 0, 2], [0, 0, 3]]), **change}
    with pytest.raises(error, match=f"^{text}"):
        render.silhouette(**arguments)


def test_a_gradient_of_another_shape_is_refused():
    arguments = (Mesh(*SQUARE), CAMERA, EYE, [[0, 0, 2]])
    with pytest.raises(ValueError, match=r"^upstream: expected shape \(1, 12, 16\), got"):
        render.silhouette_gradients(*arguments, np.ones((1, 16, 12)))
    with pytest.raises(TypeError, match=r"^upstream: expected real numbers"):
        render.silhouette_gradients(*arguments, np.ones((1, 12, 16), dtype=complex))


def test_read_only_memory_is_not_written_to():
    out = np.zeros((1, 12, 16))
    out.flags.writeable = False
    with pytest.raises(ValueError, match="that can be written to"):
        render.silhouette(Mesh(*SQUARE), CAMERA, EYE, [[0, 0, 2]], out=out)
