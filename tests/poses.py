"""Poses and meshes for tests, made from a seed."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dronepose import Camera, Mesh, geometry
from support import EXAMPLES, rows

CAMERA = Camera.from_fov(320, 240, horizontal_deg=64.69)
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 12)
scales = st.sampled_from([1e-9, 1e-3, 1.0, 20.0])


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


def example_arrays(name):
    table = rows(EXAMPLES / name)
    q = np.array([[float(r[k]) for k in ("qw", "qx", "qy", "qz")] for r in table])
    t = np.array([[float(r[k]) for k in ("tx", "ty", "tz")] for r in table])
    return geometry.matrix_from_quat_wxyz(q), t, [r["id"] for r in table]
