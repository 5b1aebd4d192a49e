"""Small meshes, cameras and poses for the renderer's tests, made from a seed."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dronepose import Camera

CAMERA = Camera(22.0, 20.0, 8.3, 5.6, width=16, height=12, skew=0.4)
TETRAHEDRON = (
    np.array([[0.5, 0.1, -0.3], [-0.4, 0.6, 0.2], [0.2, -0.7, 0.4], [0.1, 0.2, -1.0]]),
    np.array([[0, 1, 2], [0, 2, 3], [1, 3, 2], [0, 3, 1]]),
)
SQUARE = (
    np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
ALL = [
    {"mode": "coverage"},
    {"mode": "coverage", "sigma": 0.8},
    {"mode": "dibr", "delta": 30.0},
    {"mode": "sigmoid", "sigma_ndc": 0.02},
    {"mode": "hard"},
]
SMOOTH = [options for options in ALL if options["mode"] != "hard"]
CUTOFFS = [
    {"mode": "dibr", "delta": 30.0, "kaolin_cutoff": (0.3, 5)},
    {"mode": "dibr", "delta": 30.0, "kaolin_cutoff": (0.3, None)},
    {"mode": "sigmoid", "sigma_ndc": 0.02, "pytorch3d_cutoff": (0.2, 5)},
]

seeds = st.integers(0, 2**32 - 1)


def name(options):
    return "-".join(str(v) for v in options.values())


def soup(rng, faces=6, size=0.8):
    """Triangles that share some vertices and cross each other."""
    vertices = rng.uniform(-size, size, size=(max(4, faces), 3))
    triangles = [rng.permutation(len(vertices))[:3] for _ in range(faces)]
    return vertices, np.array(triangles)


def poses(rng, n, distance=2.5, spread=0.3):
    R = Rotation.random(n, rng=rng).as_matrix()
    return R, rng.normal(size=(n, 3)) * spread + [0.0, 0.0, distance]


def split(vertices, faces):
    """Every face in four, through the middles of its sides."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    corners = [a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2]
    all_vertices = np.stack(corners, axis=1).reshape(-1, 3)
    pattern = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    start = 6 * np.arange(len(faces))[:, None, None]
    return all_vertices, (pattern + start).reshape(-1, 3)
