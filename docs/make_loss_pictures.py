"""Draws the pictures of losses.md and prints its tables.

    python docs/make_loss_pictures.py            # into docs/pictures
    python docs/make_loss_pictures.py --folder F # elsewhere

Needs the package, torch and Matplotlib.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import torch
from numpy.typing import NDArray

from dronepose import Camera, Mesh, render
from dronepose.losses import silhouette_loss

ROOT = Path(__file__).resolve().parent.parent
MESH = Mesh.from_file(ROOT / "examples" / "quadrotor.obj")
CAMERA = Camera(252.7, 252.7, 160, 120, 320, 240)
DISTANCES = (0.7, 1.2, 2.0)
SMOOTH: dict[str, tuple[str, dict[str, Any]]] = {
    "box 25": ("box", {"size": 25}),
    "box 49": ("box", {}),
    "box 79": ("box", {"size": 79}),
    "Gaussian 69, sigma 11.5": ("gaussian", {}),
    "Gaussian 69, sigma 1.5 (authors)": ("gaussian", {"sigma": "authors"}),
}
LOSSES: dict[str, tuple[str, dict[str, Any]]] = {
    "IoU": ("iou", {}),
    "GIoU": ("giou", {}),
    **SMOOTH,
    "Tanimoto 0, 2, 6, 18": ("tanimoto", {}),
    "blurred 8": ("blurred", {"sigma": 8.0}),
    "outline": ("outline", {}),
}

Array = NDArray[np.float64]


def rotation() -> Array:
    """The drone turned by 30 degrees and seen from 20 degrees above."""
    yaw, tilt = np.radians(30), np.radians(20)
    turn = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    # From x forward, y left, z up to x right, y down, z forward.
    axes = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    nod = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    return np.array(nod) @ np.array(axes) @ np.array(turn)


def masks(t: Array, mode: str) -> Array:
    """Masks ``(B, H, W)`` at translations ``(B, 3)``, metres."""
    R = np.tile(rotation(), (len(t), 1, 1))
    return render.silhouette(MESH, CAMERA, R, t, mode=mode, dtype=np.float64)


def ray(distance: float, factors: Array) -> Array:
    """Places along the ray to a drone a little off the middle of the image."""
    place = distance * np.array([0.1, 0.05, 1.0])
    return factors[:, None] * place


def values(name: str, options: dict[str, Any], pred: Array, target: Array) -> Array:
    """The loss of each mask against one target."""
    loss = silhouette_loss(name, reduction="none", **options)
    same = torch.from_numpy(target).expand(len(pred), -1, -1)
    return np.asarray(loss(torch.from_numpy(pred), same).numpy())


def slope(name: str, options: dict[str, Any], pred: Array, target: Array) -> Array:
    """The gradient for one mask."""
    mask = torch.tensor(pred[None], requires_grad=True)
    silhouette_loss(name, **options)(mask, torch.from_numpy(target[None])).backward()
    assert mask.grad is not None
    return mask.grad[0].numpy()


def best(name: str, options: dict[str, Any], target: Array) -> Array:
    """The mask in ``[0, 1]`` that an affine loss is smallest for: 1 where its gradient is < 0."""
    return (slope(name, options, np.zeros_like(target), target) < 0).astype(float)


def iou(a: Array, b: Array) -> float:
    """Of binary masks."""
    return float((a * b).sum() / np.maximum(a, b).sum())


def minimisers(folder: Path) -> None:
    """Targets, the masks that the smooth loss is smallest for, and that the loss is a plane."""
    print("IoU of the minimising mask with the target, and its area over the target's")
    figure, axes = plt.subplots(3, 4, figsize=(13, 8.2), layout="constrained")
    shown = ["box 49", "Gaussian 69, sigma 11.5", "Gaussian 69, sigma 1.5 (authors)"]
    for row, distance in enumerate(DISTANCES):
        target = masks(ray(distance, np.ones(1)), "hard")[0]
        used = np.argwhere(target)
        (top, left), (bottom, right) = used.min(axis=0) - 28, used.max(axis=0) + 28
        window = (slice(max(top, 0), bottom), slice(max(left, 0), right))
        axes[row, 0].imshow(target[window], cmap="gray")
        axes[row, 0].set_title(f"target at {distance} m, {int(target.sum())} px", fontsize=10)
        for name, choice in {**SMOOTH, "outline": ("outline", {})}.items():
            mask = best(*choice, target)
            area = mask.sum() / target.sum()
            print(f"  {distance} m  {name:34s} IoU {iou(mask, target):.2f}  area {area:.2f}")
            if name not in shown:
                continue
            picture = np.zeros((*target.shape, 3))
            picture[..., 0] = mask
            picture[..., 1] = target * mask * 0.8 + target * (1 - mask) * 0.55
            picture[..., 2] = target
            place = axes[row, 1 + shown.index(name)]
            place.imshow(picture[window])
            place.set_title(f"{name}: IoU {iou(mask, target):.2f}", fontsize=10)
    for place in axes.flat:
        place.set_axis_off()
    figure.suptitle(
        "The mask for which the smooth loss is smallest. White-pink: in both; red: only in that "
        "mask; blue: only in the target",
        fontsize=11,
    )
    figure.savefig(folder / "loss_minimisers.png", dpi=80)
    plt.close(figure)


def affine(folder: Path) -> None:
    """The loss along the straight line between masks, and the gradient along a row."""
    target = masks(ray(1.2, np.ones(1)), "coverage")[0]
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.0), layout="constrained")
    steps = np.linspace(0, 2, 81)
    grown = best("box", {}, target)
    empty = np.zeros_like(target)
    # From the empty mask to the target at 1, and on to the grown mask at 2.
    path = [
        (1 - a) * empty + a * target if a <= 1 else (2 - a) * target + (a - 1) * grown
        for a in steps
    ]
    for name in ("box 49", "Gaussian 69, sigma 11.5", "Tanimoto 0, 2, 6, 18", "IoU"):
        found = values(*LOSSES[name], np.array(path), target)
        span = found.max() - found.min()
        left.plot(steps, (found - found.min()) / span, label=name)
    left.set_xticks([0, 1, 2], ["empty", "target", "grown target\n[g*y > 1/4]"])
    left.set_ylabel("loss, lowest 0 and highest 1")
    left.set_title("Along straight lines between masks", fontsize=10)
    left.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    row = int(np.argmax(target.sum(axis=1)))
    for name in ("box 49", "Gaussian 69, sigma 11.5", "Gaussian 69, sigma 1.5 (authors)"):
        line = slope(*LOSSES[name], target, target)[row] * target.size
        right.plot(line, label=name)
    right.fill_between(np.arange(320), -3, 1, where=target[row] > 0.5, color="0.9", label="target")
    right.axhline(0, color="k", lw=0.5)
    right.set_xlim(70, 310)
    right.set_ylim(-3.1, 1.1)
    right.set_xlabel(f"column, in row {row}")
    right.set_title("Gradient N dL/ds of the smooth loss: the same for every s", fontsize=10)
    right.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    figure.savefig(folder / "loss_smooth.png", dpi=80)
    plt.close(figure)


def along_the_ray(folder: Path) -> None:
    """Where each loss is smallest in depth."""
    factors = np.arange(0.6, 1.6001, 0.01)
    figure, axes = plt.subplots(1, 3, figsize=(13, 5.0), layout="constrained", sharey=True)
    drawn = [
        "IoU", "GIoU", "box 49", "Gaussian 69, sigma 11.5",
        "Gaussian 69, sigma 1.5 (authors)", "Tanimoto 0, 2, 6, 18", "outline",
    ]  # fmt: skip
    print("\nDepth at which each loss is smallest, in true depths (0.60 to 1.60 by 0.01)")
    table: dict[str, list[str]] = {name: [] for name in LOSSES}
    for place, distance in zip(axes, DISTANCES, strict=True):
        for kind in ("hard", "coverage"):
            target = masks(ray(distance, np.ones(1)), kind)[0]
            pred = masks(ray(distance, factors), "coverage")
            for name, choice in LOSSES.items():
                found = values(*choice, pred, target)
                table[name].append(f"{factors[found.argmin()]:.2f}")
                if kind == "hard" and name in drawn:
                    span = found.max() - found.min()
                    place.plot(factors, (found - found.min()) / span, label=name, lw=1.3)
        place.axvline(1, color="k", lw=0.5)
        place.set_title(f"drone at {distance} m", fontsize=10)
        place.set_xlabel("depth / true depth")
    axes[0].set_ylabel("loss, lowest 0 and highest 1")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(folder / "loss_depth.png", dpi=80)
    plt.close(figure)
    head = "  ".join(f"{d} m hard, coverage" for d in DISTANCES)
    print(f"  {'':34s} {head}")
    for name, cells in table.items():
        print(f"  {name:34s} " + "  ".join(f"{cell:>8s}" for cell in cells))


def main() -> None:
    """Everything."""
    parser = argparse.ArgumentParser(description="draw the pictures of losses.md")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "pictures")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    minimisers(folder)
    affine(folder)
    along_the_ray(folder)


if __name__ == "__main__":
    main()
