"""Poses of all images of a data set, by a network from a file."""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.utils.data import DataLoader

from dronepose._files import write_text
from dronepose._progress import Progress
from dronepose.data import PoseDataModule
from dronepose.data._poses import poses_csv
from dronepose.data.module import one_thread
from dronepose.model import WeightsError, model_from_file, read_metadata

if TYPE_CHECKING:
    import argparse
    import os
    from pathlib import Path

    from numpy.typing import NDArray

    from dronepose.data import PoseDataset

    Array = NDArray[np.float64]


def predict(
    weights: str | os.PathLike[str],
    dataset: PoseDataset,
    *,
    batch_size: int = 64,
    workers: int = 0,
    device: str = "cpu",
) -> tuple[list[str], Array, Array]:
    """Predict the pose in every image.

    Args:
        weights: A file written by training, or by :func:`dronepose.model.save_weights`.
        dataset: The images.
        batch_size: Images at a time.
        workers: Processes that read images; 0 reads in this one.
        device: Where torch computes.

    Returns:
        Names, ``R`` ``(N, 3, 3)`` and ``t`` ``(N, 3)`` metres, ``cam_from_model``, in the order of
        the data set.

    Raises:
        OSError: A file cannot be read.
        ValueError: The weights or a sample were refused, or a predicted pose is not finite.
    """
    model = model_from_file(weights).to(device).eval()
    loader = DataLoader(
        dataset, batch_size=batch_size, num_workers=workers, worker_init_fn=one_thread
    )
    names: list[str] = []
    rotations, translations = [], []
    with torch.inference_mode(), closing(Progress("images")) as progress:
        progress(0, len(dataset))
        for batch in loader:
            R, t = model(batch["image"].to(device), batch["K"].to(device))
            finite = R.isfinite().all(dim=(1, 2)) & t.isfinite().all(dim=1)
            if not finite.all():
                first = batch["name"][int(finite.int().argmin())]
                raise ValueError(
                    f"{weights}: the pose predicted for sample {first!r} is not finite"
                )
            names += batch["name"]
            rotations.append(R.double().cpu().numpy())
            translations.append(t.double().cpu().numpy())
            progress(len(names), len(dataset))
    if not names:
        return names, np.zeros((0, 3, 3)), np.zeros((0, 3))
    return names, np.concatenate(rotations), np.concatenate(translations)


def true_poses_csv(dataset: PoseDataset) -> str:
    """The poses that a data set states, as CSV for ``dronepose-eval``; no image is read."""
    poses = [dataset.pose(k) for k in range(len(dataset))]
    R = np.array([R for R, _ in poses]).reshape(-1, 3, 3)
    t = np.array([t for _, t in poses]).reshape(-1, 3)
    return poses_csv(dataset.names, R, t)


def image_size(weights: Path) -> tuple[int | None, int | None]:
    """Height and width of the images that weights were trained on; ``None`` if they do not say."""
    try:
        height, width = read_metadata(weights).get("image_size", (None, None))
    except WeightsError:  # a checkpoint of others
        return None, None
    return height, width


def run(options: argparse.Namespace) -> dict[str, object]:
    """What ``dronepose predict`` does.

    Images are brought to the size that the weights were trained on.

    Args:
        options: The arguments of the command, parsed.

    Returns:
        What was written, as for JSON.

    Raises:
        OSError: A file cannot be read or written.
        ValueError: The weights, the data or an argument were refused.
    """
    if not options.weights.is_file():
        raise FileNotFoundError(f"{options.weights}: there is no such file of weights")
    height, width = image_size(options.weights)
    data = PoseDataModule(
        kind=options.kind,
        root=str(options.data),
        batch_size=options.batch_size,
        height=height,
        width=width,
    )
    dataset = data.dataset(options.split)
    begin = time.monotonic()
    names, R, t = predict(
        options.weights,
        dataset,
        batch_size=options.batch_size,
        workers=options.workers,
        device=options.device,
    )
    seconds = time.monotonic() - begin
    write_text(options.out, poses_csv(names, R, t))
    if options.gt_out is not None:
        write_text(options.gt_out, true_poses_csv(dataset))
    return {"out": str(options.out), "images": len(names), "seconds": round(seconds, 3)}
