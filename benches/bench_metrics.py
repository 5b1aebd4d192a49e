"""ADD and ADD-S: dronepose against NumPy and SciPy, in one run, on one model.

    python benches/bench_metrics.py [--mesh FILE.obj] [--poses N] [--json FILE]

The NumPy forms of ADD take chunks of poses: one matrix product with the difference of the two
poses, squares, root, mean. The best of them in float64 is the baseline (float32 is shown too, but
keeps only six digits). The baseline of ADD-S is SciPy's cKDTree, rebuilt for each pose, on as many
poses as take a moment. All on one thread; the least time of several repetitions counts, on the wall
clock and in processor time (which stands still while other programs have the core).
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402  (after the thread counts)
from scipy.spatial import cKDTree  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from dronepose import Mesh, metrics  # noqa: E402

CHUNKS = (16, 32, 64, 128)
Array = np.ndarray


def vertices(path: Path | None) -> Array:
    """All `v` lines of an OBJ file, or a made-up drone of 3,010 vertices."""
    if path is not None:
        with path.open(encoding="utf-8", errors="replace") as lines:
            rows = [line.split()[1:4] for line in lines if line.startswith("v ")]
        return np.array(rows, dtype=np.float64)
    rng = np.random.default_rng(7)
    body = rng.normal(size=(1000, 3)) * (0.08, 0.04, 0.03)
    side = 0.15 * rng.choice((-1.0, 1.0), size=(1612, 2))
    rotors = np.column_stack([side, np.full(1612, 0.02)]) + rng.normal(size=(1612, 3)) * (
        0.04,
        0.04,
        0.002,
    )
    distinct = np.concatenate([body, rotors])
    return np.concatenate([distinct, distinct[:398]])


def poses(count: int, degrees: float, metres: float) -> tuple[Array, Array, Array, Array]:
    """`R_est, t_est, R_gt, t_gt` with errors of so many degrees and metres."""
    rng = np.random.default_rng(0)

    def directions() -> Array:
        v = rng.normal(size=(count, 3))
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    true = Rotation.random(count, rng).as_matrix()
    t_gt = rng.normal(size=(count, 3)) * 0.2 + (0.0, 0.0, 1.5)
    turn = Rotation.from_rotvec(directions() * np.radians(degrees)).as_matrix()
    return true @ turn, t_gt + directions() * metres, true, t_gt


def add_matmul(points: Array, pairs: tuple[Array, ...], chunk: int, dtype: type) -> Array:
    """One product per pose of a chunk."""
    r_est, t_est, r_gt, t_gt = pairs
    turn, shift = (r_est - r_gt).astype(dtype), (t_est - t_gt).astype(dtype)
    columns = np.ascontiguousarray(points.T.astype(dtype))
    out = np.empty(len(shift))
    for i in range(0, len(shift), chunk):
        d = turn[i : i + chunk] @ columns + shift[i : i + chunk, :, None]
        np.multiply(d, d, out=d)
        q = d[:, 0] + d[:, 1]
        q += d[:, 2]
        np.sqrt(q, out=q)
        out[i : i + chunk] = q.mean(axis=1)
    return out


def add_one_product(points: Array, pairs: tuple[Array, ...], chunk: int, dtype: type) -> Array:
    """One product per chunk, homogeneous, coordinate by coordinate."""
    r_est, t_est, r_gt, t_gt = pairs
    rows = np.concatenate([r_est - r_gt, (t_est - t_gt)[:, :, None]], axis=2).astype(dtype)
    columns = np.vstack([points.T, np.ones(len(points))]).astype(dtype)
    out = np.empty(len(rows))
    for i in range(0, len(rows), chunk):
        part = rows[i : i + chunk].transpose(1, 0, 2).reshape(-1, 4)
        d = (part @ columns).reshape(3, -1, len(points))
        np.multiply(d, d, out=d)
        q = d[0]
        q += d[1]
        q += d[2]
        np.sqrt(q, out=q)
        out[i : i + chunk] = q.mean(axis=1)
    return out


def adds_tree(points: Array, pairs: tuple[Array, ...]) -> Array:
    """cKDTree of the points in the estimated pose, asked for those in the true pose."""
    out = []
    for r_est, t_est, r_gt, t_gt in zip(*pairs, strict=True):
        tree = cKDTree(points @ r_est.T + t_est)
        out.append(tree.query(points @ r_gt.T + t_gt, k=1)[0].mean())
    return np.array(out)


def microseconds(work: Callable[[], Array], count: int, repetitions: int) -> tuple[Array, Array]:
    """Least wall-clock and processor time per pose, and the result."""
    best, result = np.full(2, np.inf), np.empty(0)
    for _ in range(repetitions):
        start = time.perf_counter(), time.process_time()
        result = work()
        best = np.minimum(best, (time.perf_counter() - start[0], time.process_time() - start[1]))
    return best / count * 1e6, result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", type=Path, help="OBJ file (metres); a made-up drone without it")
    parser.add_argument("--poses", type=int, default=10000)
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    options = parser.parse_args()
    points = vertices(options.mesh)
    # The faces do not matter here.
    mesh = Mesh(points, np.arange(len(points) // 3 * 3).reshape(-1, 3))
    near, few = poses(options.poses, 5.0, 0.02), 50
    some = tuple(a[:few] for a in near)
    rows: dict[str, Array] = {}

    ours, exact = microseconds(
        lambda: np.asarray(metrics.add(mesh, *near, threads=1)), options.poses, 7
    )
    rows["ADD, dronepose"] = ours
    for dtype in (np.float64, np.float32):
        best = np.full(2, np.inf)
        for form in (add_matmul, add_one_product):
            for chunk in CHUNKS:
                taken, value = microseconds(
                    lambda f=form, c=chunk, d=dtype: f(points, near, c, d), options.poses, 3
                )
                np.testing.assert_allclose(
                    value, exact, rtol=1e-12 if dtype is np.float64 else 1e-4
                )
                best = np.minimum(best, taken)
        rows[f"ADD, NumPy {np.dtype(dtype).name}"] = best
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    thresholds = [0.02 * diagonal, 0.05 * diagonal, 0.1 * diagonal]
    taken, recall = microseconds(
        lambda: np.asarray(metrics.add_recall(mesh, *near, thresholds, threads=1)), options.poses, 7
    )
    np.testing.assert_allclose(recall, [(exact < t).mean() for t in thresholds])
    rows["ADD recall at 2, 5, 10 %, dronepose"] = taken
    metrics.adds(mesh, *(a[:1] for a in near), threads=1)
    taken, value = microseconds(
        lambda: np.asarray(metrics.adds(mesh, *near, threads=1)), options.poses, 3
    )
    rows["ADD-S, dronepose"] = taken
    taken, tree = microseconds(lambda: adds_tree(points, some), few, 3)
    np.testing.assert_allclose(value[:few], tree, rtol=1e-12, atol=1e-14)
    rows["ADD-S, cKDTree per pose"] = taken

    ratios = {
        "ADD": rows["ADD, NumPy float64"] / rows["ADD, dronepose"],
        "ADD-S": rows["ADD-S, cKDTree per pose"] / rows["ADD-S, dronepose"],
        "ADD recall, against exact ADD": rows["ADD, dronepose"]
        / rows["ADD recall at 2, 5, 10 %, dronepose"],
    }
    print(f"{len(points)} vertices, {options.poses} poses, one thread, numpy {np.__version__}")
    print(f"{'':40} {'wall clock':>13} {'processor':>13}")
    for name, value_us in rows.items():
        print(f"{name:40} {value_us[0]:10.3f} us {value_us[1]:10.3f} us a pose")
    for name, ratio in ratios.items():
        print(f"{name:40} {ratio[0]:11.1f} x {ratio[1]:11.1f} x faster")
    if options.json is not None:
        result = {
            "vertices": len(points),
            "poses": options.poses,
            "columns": ["wall clock", "processor"],
            "us": {name: list(value) for name, value in rows.items()},
            "ratios": {name: list(value) for name, value in ratios.items()},
        }
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
