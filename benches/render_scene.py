"""What `bench_render.py` draws, how it is checked, and the clock."""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dronepose import Camera, Mesh, render

Array = np.ndarray
FOV_FOCAL = 252.72 / 240.0
SIGMA_NDC = 1e-4
KAOLIN = "dibr, Kaolin's cut-offs"
BOXES = "dibr, Kaolin's boxes alone"
PYTORCH3D = "sigmoid, PyTorch3D's cut-offs"


def default_mesh() -> Path:
    """The drone of the data folder, or the example."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("DRONEPOSE_SHARED", root.parent / "shared"))
    drone = folder / "data" / "drones" / "dji_mavic2" / "DJI.obj"
    return drone if drone.exists() else root / "examples" / "quadrotor.obj"


def load(path: Path) -> Mesh:
    """In metres, equal vertices merged: deodr finds edges by the indices of vertices."""
    mesh = Mesh.from_file(path)
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(vertices, faces[distinct])


def noisy_sphere(faces: int) -> Mesh:
    """About so many faces in bands, radius 20 cm with 5 % of noise."""
    bands = max(3, round((faces / 4) ** 0.5))
    around = 2 * bands
    theta = np.linspace(0, np.pi, bands + 1)[1:-1, None]
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    ring = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1
    ).reshape(-1, 3)
    points = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]])
    points = points * (0.2 + 0.01 * np.random.default_rng(0).uniform(-1, 1, (len(points), 1)))
    i, j = (a.reshape(-1) for a in np.mgrid[0 : bands - 2, 0:around])
    k = (j + 1) % around
    a, b, c, d = i * around + j, i * around + k, (i + 1) * around + j, (i + 1) * around + k
    j = np.arange(around)
    k, last, top = (j + 1) % around, (bands - 2) * around, len(ring)
    caps = [
        np.stack([np.full(around, top), j, k], 1),
        np.stack([np.full(around, top + 1), last + k, last + j], 1),
    ]
    return Mesh(points, np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1), *caps]))


def camera(height: int, width: int) -> Camera:
    focal = FOV_FOCAL * height
    return Camera(focal, focal, width / 2, height / 2, width=width, height=height)


def poses(count: int) -> tuple[Array, Array]:
    """Rotations of every kind, the drone within the image."""
    rng = np.random.default_rng(1)
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    R = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        1,
    )
    depth = rng.uniform(0.8, 1.5, count)
    t = np.stack([rng.uniform(-0.3, 0.3, count), rng.uniform(-0.2, 0.2, count), np.ones(count)], -1)
    return R, t * depth[:, None]


def clock(
    work: Callable[[], Any], images: float, seconds: float, least: int = 3, warm: bool = True
) -> list[float]:
    """Milliseconds an image: least and median on the wall clock, the processor's at the least."""
    if warm:
        work()
    taken: list[tuple[float, float]] = []
    end = time.perf_counter() + seconds
    while len(taken) < least or (time.perf_counter() < end and len(taken) < 200):
        start = time.perf_counter(), time.process_time()
        work()
        taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    wall, processor = np.array(taken).T * 1e3 / images
    return [float(wall.min()), float(np.median(wall)), float(processor[wall.argmin()])]


@dataclass
class Scene:
    """What every peer draws, and what is right."""

    mesh: Mesh
    camera: Camera
    R: Array
    t: Array
    exact: Array
    hard: Array
    upstream: Array

    def pixels(self, k: int) -> tuple[Array, Array]:
        """Vertices of image `k`: pixels `(V, 2)` and depths `(V,)`."""
        p = self.mesh.vertices @ self.R[k].T + self.t[k]
        f, c = self.camera.fx, (self.camera.cx, self.camera.cy)
        return f * p[:, :2] / p[:, 2:] + c, p[:, 2]


@dataclass
class Row:
    """`like` names the row of ours that draws the like; `area` is over the exact area."""

    name: str
    like: str
    area: float
    ms: list[float]
    images: float


def check(name: str, area: float, low: float, high: float) -> None:
    if not low <= area <= high:
        raise AssertionError(f"{name}: {area:.3f} of the area, expected {low} to {high}")


def scene_of(mesh: Mesh, height: int, width: int, count: int) -> Scene:
    R, t = poses(count)
    view = camera(height, width)
    exact = render.silhouette(mesh, view, R, t)
    hard = render.silhouette(mesh, view, R, t, mode="hard")
    upstream = np.random.default_rng(2).normal(size=hard.shape).astype(np.float32)
    return Scene(mesh, view, R, t, exact, hard, upstream)


MODES: dict[str, dict[str, Any]] = {
    "hard": {"mode": "hard"},
    "coverage": {"mode": "coverage"},
    "coverage, sigma 1": {"mode": "coverage", "sigma": 1.0},
    "dibr": {"mode": "dibr"},
    KAOLIN: {"mode": "dibr", "kaolin_cutoff": (0.02, 30)},
    BOXES: {"mode": "dibr", "kaolin_cutoff": (0.02, None)},
    "sigmoid": {"mode": "sigmoid", "sigma_ndc": SIGMA_NDC},
    PYTORCH3D: {
        "mode": "sigmoid",
        "sigma_ndc": SIGMA_NDC,
        "pytorch3d_cutoff": (math.log(1 / 1e-4 - 1) * SIGMA_NDC, 50),
    },
}
