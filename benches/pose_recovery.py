"""Which silhouette and which loss find a pose again: gradient descent from random starts.

    python benches/pose_recovery.py [--starts N] [--steps N] [--mesh FILE] [--json FILE]

The truth is a hard mask of 320 x 240 pixels. A start is 10 degrees and 5 % of the distance off, in
random directions; every mode and loss begins with the same starts. Adam turns the drone about its
own origin (a tangent vector, radians) and shifts it (in units of the distance at the start), with
one schedule for all: the step falls from --rate to a hundredth of it along a cosine. The starts of
one distance are one batch; their losses are summed, so each descends by itself.

Modes: coverage with sigma 0 and 1 px; dibr over all faces and with Kaolin's cut-offs (delta 7000);
sigmoid over all faces (sigma 1e-4). Losses, for a truth a and a mask b:

    IoU       1 - <a, b> / sum(a + b - a b)
    Tanimoto  mean of 1 - <ga, gb> / (<ga, ga> + <gb, gb> - <ga, gb>), Gaussians g of 0, 2, 6, 18 px
    squared   sum (a - b)^2 / sum(a)
"""

import argparse
import datetime
import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

import dronepose
from dronepose import Mesh
from dronepose.torch import silhouette

HEIGHT, WIDTH, FOCAL = 240, 320, 252.72
DISTANCES = (0.7, 1.0, 1.4, 2.0, 2.8)
MODES: dict[str, dict[str, Any]] = {
    "coverage, sigma 0": {"mode": "coverage"},
    "coverage, sigma 1": {"mode": "coverage", "sigma": 1.0},
    "dibr": {"mode": "dibr"},
    "dibr, Kaolin's cut-offs": {"mode": "dibr", "kaolin_cutoff": (0.02, 30)},
    "sigmoid": {"mode": "sigmoid"},
}


def project_folder() -> Path:
    return Path(__file__).resolve().parents[1]


def default_mesh() -> Path:
    """The drone of the data folder, or the example."""
    beside = project_folder().parent / "shared"
    folder = Path(os.environ.get("DRONEPOSE_SHARED", beside))
    drone = folder / "data" / "drones" / "dji_mavic2" / "DJI.obj"
    return drone if drone.exists() else project_folder() / "examples" / "quadrotor.obj"


def inner(a: Tensor, b: Tensor) -> Tensor:
    """Of each pair of images."""
    return torch.bmm(a.reshape(len(a), 1, -1), b.reshape(len(b), -1, 1)).reshape(-1)


def blur_matrix(size: int, sigma: float, stride: int) -> Tensor:
    """Rows: Gaussians of unit sum about every so-many-th pixel; nothing beyond the border."""
    centre = np.arange(size // stride)[:, None] * stride + 0.5 * (stride - 1)
    weight = np.exp(-0.5 * ((np.arange(size)[None] - centre) / sigma) ** 2)
    return torch.from_numpy((weight / (sigma * math.sqrt(2 * math.pi))).astype(np.float32))


class Tanimoto:
    """Multi-scale. Blurred images need few pixels: means of 2 x 2, then each scale from the last.

    The variances of the means and of the earlier blurs are subtracted. The strides (1, 2 and 4) are
    below half a sigma, so that the inner products are those of all pixels but for 1e-4.
    """

    def __init__(self, truth: Tensor) -> None:
        self.blurs = []
        height, width, pixel, before = HEIGHT // 2, WIDTH // 2, 2, 0.25
        for sigma, stride in ((2, 1), (6, 2), (18, 4)):
            step = math.sqrt(sigma**2 - before) / pixel
            rows, columns = (blur_matrix(size, step, stride) for size in (height, width))
            self.blurs.append((rows, columns.T.contiguous()))
            height, width, pixel, before = len(rows), len(columns), pixel * stride, sigma**2
        self.truth = self.scales(truth)
        self.squares = [inner(a, a) for a in self.truth]

    def scales(self, masks: Tensor) -> list[Tensor]:
        found = [masks]
        last = torch.nn.functional.avg_pool2d(masks, 2)
        for rows, columns in self.blurs:
            last = rows @ (last @ columns)
            found.append(last)
        return found

    def __call__(self, masks: Tensor) -> Tensor:
        total = torch.zeros(len(masks))
        for a, square, b in zip(self.truth, self.squares, self.scales(masks), strict=True):
            both = inner(a, b)
            total = total + 1 - (both + 1e-7) / (square + inner(b, b) - both + 1e-7)
        return total / len(self.truth)


class Iou:
    def __init__(self, truth: Tensor) -> None:
        self.truth, self.area = truth, truth.sum((1, 2))

    def __call__(self, masks: Tensor) -> Tensor:
        both = inner(self.truth, masks)
        return 1 - both / (self.area + masks.sum((1, 2)) - both + 1e-7)


class Squared:
    def __init__(self, truth: Tensor) -> None:
        self.truth, self.area = truth, truth.sum((1, 2))

    def __call__(self, masks: Tensor) -> Tensor:
        squares = inner(masks, masks) - 2 * inner(self.truth, masks)
        return squares / self.area + 1


LOSSES: dict[str, type[Iou] | type[Tanimoto] | type[Squared]] = {
    "IoU": Iou,
    "Tanimoto": Tanimoto,
    "squared": Squared,
}


class Problem:
    """The starts of one distance and what is to be found."""

    def __init__(self, distance: float, count: int, seed: int) -> None:
        rng = np.random.default_rng([seed, round(distance * 1000)])

        def directions() -> np.ndarray:
            v = rng.normal(size=(count, 3))
            return v / np.linalg.norm(v, axis=1, keepdims=True)

        self.R = Rotation.random(count, rng).as_matrix()
        sideways = rng.uniform(-0.15, 0.15, size=(count, 2)) * distance
        self.t = np.column_stack([sideways, np.full(count, distance)])
        self.R0 = Rotation.from_rotvec(directions() * math.radians(10)).as_matrix() @ self.R
        self.t0 = self.t + directions() * 0.05 * distance
        self.distance = distance


def errors(problem: Problem, R: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Degrees and millimetres; depth is positive where the estimate is too far away."""
    turn = Rotation.from_matrix(R @ problem.R.transpose(0, 2, 1)).magnitude()
    ray = problem.t / np.linalg.norm(problem.t, axis=1, keepdims=True)
    shift = (t - problem.t) * 1000
    depth = (shift * ray).sum(1)
    return {
        "rotation": np.degrees(turn),
        "depth": depth,
        "lateral": np.linalg.norm(shift - depth[:, None] * ray, axis=1),
        "translation": np.linalg.norm(shift, axis=1),
        "distance": np.full(len(t), problem.distance),
    }


def descend(
    problem: Problem,
    draw: Callable[[Tensor, Tensor], Tensor],
    loss: Callable[[Tensor], Tensor],
    steps: int,
    rate: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The last poses."""
    R0 = torch.from_numpy(problem.R0.astype(np.float32))
    t0 = torch.from_numpy(problem.t0.astype(np.float32))
    turn = torch.zeros(len(R0), 3, requires_grad=True)
    shift = torch.zeros(len(R0), 3, requires_grad=True)
    adam = torch.optim.Adam([turn, shift], lr=rate)
    zero = torch.zeros(len(R0))

    def pose() -> tuple[Tensor, Tensor]:
        x, y, z = turn.unbind(1)
        cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
        return torch.linalg.matrix_exp(cross) @ R0, t0 + shift * problem.distance

    for step in range(steps):
        falling = 0.5 + 0.5 * math.cos(math.pi * step / max(steps - 1, 1))
        adam.param_groups[0]["lr"] = rate * (0.01 + 0.99 * falling)
        adam.zero_grad()
        loss(draw(*pose())).sum().backward()
        adam.step()
    with torch.no_grad():
        R, t = pose()
    return R.double().numpy(), t.double().numpy()


def summary(found: dict[str, np.ndarray]) -> dict[str, Any]:
    """Medians and shares over all starts; the bias in depth for each distance, too."""
    share = found["translation"] / found["distance"] / 10  # mm of m: percent
    rotation = found["rotation"]
    return {
        "rotation_deg": float(np.median(rotation)),
        "lateral_mm": float(np.median(found["lateral"])),
        "depth_bias_mm": float(np.median(found["depth"])),
        "depth_mm": float(np.median(np.abs(found["depth"]))),
        "translation_mm": float(np.median(found["translation"])),
        "within_1deg_1percent": float(((rotation < 1) & (share < 1)).mean()),
        "within_2deg_2percent": float(((rotation < 2) & (share < 2)).mean()),
        "within_5deg_5percent": float(((rotation < 5) & (share < 5)).mean()),
        "depth_bias_percent": {
            f"{d:g}": float(np.median(found["depth"][found["distance"] == d]) / d / 10)
            for d in np.unique(found["distance"])
        },
    }


def tables(results: list[dict[str, Any]]) -> str:
    """Markdown."""
    lines = [
        "| mode | loss | rotation | lateral | depth, bias | depth | translation "
        "| 1°, 1 % | 2°, 2 % | 5°, 5 % |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r['mode']} | {r['loss']} | {r['rotation_deg']:.2f}° | {r['lateral_mm']:.2f} mm "
        f"| {r['depth_bias_mm']:+.1f} mm | {r['depth_mm']:.1f} mm | {r['translation_mm']:.1f} mm "
        f"| {100 * r['within_1deg_1percent']:.0f} % | {100 * r['within_2deg_2percent']:.0f} % "
        f"| {100 * r['within_5deg_5percent']:.0f} % |"
        for r in results
    ]
    distances = list(results[0]["depth_bias_percent"])
    lines += [
        "",
        "| mode | loss | " + " | ".join(f"{d} m" for d in distances) + " |",
        "|---|---|" + "--:|" * len(distances),
    ]
    for r in results:
        bias = " | ".join(f"{r['depth_bias_percent'][d]:+.2f} %" for d in distances)
        lines.append(f"| {r['mode']} | {r['loss']} | {bias} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", type=Path, default=default_mesh(), help="metres")
    parser.add_argument("--starts", type=int, default=200, help="over all distances")
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--rate", type=float, default=0.02, help="step of Adam at the start")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0, help="0 for all cores")
    parser.add_argument("--modes", nargs="*", choices=list(MODES), default=list(MODES))
    parser.add_argument("--losses", nargs="*", choices=list(LOSSES), default=list(LOSSES))
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    options = parser.parse_args()
    if options.threads:
        torch.set_num_threads(options.threads)
    torch.set_flush_denormal(True)  # the tails of the Gaussians
    mesh = Mesh.from_file(options.mesh)
    vertices = torch.from_numpy(mesh.vertices.astype(np.float32))
    faces = torch.from_numpy(mesh.faces.astype(np.int64))
    K = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])

    def drawn(R: Tensor, t: Tensor, **chosen: Any) -> Tensor:
        return silhouette(
            vertices, faces, R, t, K, HEIGHT, WIDTH, num_threads=options.threads, **chosen
        )

    each = max(options.starts // len(DISTANCES), 1)
    problems, truths = [], []
    for distance in DISTANCES:
        problem = Problem(distance, each, options.seed)
        problems.append(problem)
        pose = (torch.from_numpy(a.astype(np.float32)) for a in (problem.R, problem.t))
        truths.append(drawn(*pose, mode="hard"))
    start = [errors(p, p.R0, p.t0) for p in problems]
    pooled = {k: np.concatenate([s[k] for s in start]) for k in start[0]}
    results = []
    begun = time.perf_counter()
    for mode in options.modes:
        for loss in options.losses:
            clock = time.perf_counter()
            found = []
            for problem, truth in zip(problems, truths, strict=True):
                R, t = descend(
                    problem,
                    lambda R, t, m=mode: drawn(R, t, **MODES[m]),
                    LOSSES[loss](truth),
                    options.steps,
                    options.rate,
                )
                found.append(errors(problem, R, t))
            merged = {k: np.concatenate([f[k] for f in found]) for k in found[0]}
            taken = time.perf_counter() - clock
            results.append({"mode": mode, "loss": loss, **summary(merged), "seconds": taken})
            print(
                f"{mode} with {loss}: {taken:.0f} s, {time.perf_counter() - begun:.0f} s in all",
                file=sys.stderr,
            )
            print(tables(results[-1:]).splitlines()[2], file=sys.stderr, flush=True)
    versions = {
        "dronepose": dronepose.__version__,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    print(f"{options.mesh.name}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")
    print(
        f"{each} starts at each of {DISTANCES} m, {options.steps} steps, seed {options.seed}, "
        f"{torch.get_num_threads()} threads, {time.perf_counter() - begun:.0f} s, "
        f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}"
    )
    print(", ".join(f"{k} {v}" for k, v in versions.items()))
    print(f"starts: {json.dumps(summary(pooled))}\n")
    print(tables(results))
    if options.json is not None:
        document = {
            "mesh": options.mesh.name,
            "starts": each * len(DISTANCES),
            "steps": options.steps,
            "seed": options.seed,
            "versions": versions,
            "start": summary(pooled),
            "results": results,
        }
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
