"""What other processes run: a module that they can import, whatever started them."""

import numpy as np

from dronepose import Camera, Mesh, Symmetries, evaluate, metrics
from support import EXAMPLES

CAMERA = Camera.from_fov(320, 240, horizontal_deg=64.69)
FILES = (EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv")


def errors(mesh: Mesh, symmetries: Symmetries, n: int = 2000) -> list[np.ndarray]:
    """Every metric of ``n`` poses, on all cores."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(-np.pi, np.pi, size=n)
    R = np.tile(np.eye(3), (n, 1, 1))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angle)
    R[:, 1, 0] = np.sin(angle)
    R[:, 0, 1] = -R[:, 1, 0]
    t = rng.normal(size=(n, 3)) * 0.2 + [0.0, 0.0, 3.0]
    poses = (R, t, R[::-1], t[::-1])
    return [
        metrics.cpe(*poses),
        metrics.symmetric_orientation_error(R, R[::-1], symmetries),
        metrics.add(mesh, *poses),
        metrics.adds(mesh, *poses),
        metrics.add_recall(mesh, *poses, [0.1, 0.5]),
        metrics.mssd(mesh, *poses, symmetries),
        metrics.mspd(mesh, *poses, CAMERA, symmetries),
    ]


def evaluation(mesh: Mesh) -> str:
    """The JSON of a whole evaluation, on all cores."""
    result = evaluate(*FILES, mesh=mesh, camera=CAMERA, by=["distance"], bootstrap=20)
    return result.to_json()


def both(mesh: Mesh, symmetries: Symmetries) -> tuple[list[np.ndarray], str]:
    """Errors and evaluation, in this order."""
    return errors(mesh, symmetries), evaluation(mesh)
