"""Does a silhouette loss help? Table 1 of the paper, on data and networks of a laptop's size.

Each variant is trained with several seeds on the same synthetic data set, the epoch with the least
combined pose error on the validation split is tested, and the columns of the paper's Table 1 are
given with 95 % intervals over the seeds (Student's t). A run that is finished is not run again.
"""

from __future__ import annotations

import hashlib
import json
import math
import resource
import statistics
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint

import dronepose
from dronepose._files import write_text
from dronepose.data import FolderDataset, PoseDataModule
from dronepose.evaluation import evaluate
from dronepose.mesh import Mesh
from dronepose.train.callbacks import RendererShare
from dronepose.train.report import table_one
from dronepose.train.task import PoseTask

if TYPE_CHECKING:
    from collections.abc import Sequence

COLUMNS = ("npe", "oe_rad", "cpe", "acc5", "acc10", "add5", "add10")
HEADS = ("NPE", "OE", "CPE", "Acc5", "Acc10", "6D Pose-5", "6D Pose-10")

# Quantiles 0.975 of Student's t with n - 1 degrees of freedom, for n = 2, 3, ...
_STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)


@dataclass(frozen=True)
class Variant:
    """A row of the table; lengths are in pixels of an image 320 wide and follow the width."""

    name: str
    silhouette: str = "none"
    size: int | None = None
    sigma: float | None = None
    mode: str = "dibr"
    lambda_exo: float = 0.1

    def model(self, width: int) -> dict[str, Any]:
        """Arguments of :class:`PoseTask` for images ``width`` pixels wide."""
        scale = width / 320
        options: dict[str, Any] = {}
        if self.size is not None:
            options["size"] = 2 * max(1, round(scale * (self.size - 1) / 2)) + 1
        if self.sigma is not None:
            options["sigma"] = scale * self.sigma
        if self.silhouette == "tanimoto":
            options["sigmas"] = [scale * s for s in (0.0, 2.0, 6.0, 18.0)]
        return {
            "silhouette": self.silhouette,
            "silhouette_options": options,
            "mode": self.mode,
            "lambda_exo": self.lambda_exo,
        }


VARIANTS = {
    "direct": Variant("Direct"),
    "i01": Variant("I0.1", "iou"),
    "s01": Variant("S0.1", "box", size=49),
    "gauss01": Variant("Gauss0.1", "gaussian", size=69, sigma=1.5),
    "tanimoto01": Variant("T0.1, coverage", "tanimoto", mode="coverage"),
    "iou_coverage01": Variant("I0.1, coverage", "iou", mode="coverage"),
}


@dataclass(frozen=True)
class Plan:
    """What all runs have in common."""

    data: str
    width: int
    backbone: str = "resnet18"
    hidden: tuple[int, ...] = (256,)
    epochs: int = 10
    batch_size: int = 32
    lr: float = 1e-3
    precision: str = "32-true"
    workers: int = 0
    seeds: tuple[int, ...] = (0, 1, 2)
    variants: tuple[str, ...] = ("direct", "i01", "s01", "gauss01", "tanimoto01")
    versions: dict[str, str] = field(
        default_factory=lambda: {
            "dronepose": dronepose.__version__,
            "torch": str(torch.__version__),
            "lightning": lightning.__version__,
        }
    )

    def key(self, variant: str, seed: int) -> str:
        """What a finished run must agree with to count."""
        common = {
            k: v for k, v in asdict(self).items() if k not in ("seeds", "variants", "workers")
        }
        told = json.dumps([common, asdict(VARIANTS[variant]), seed], sort_keys=True)
        manifest = (Path(self.data) / "dataset.json").read_bytes()
        return hashlib.sha256(told.encode() + manifest).hexdigest()


def run_one(plan: Plan, variant: str, seed: int, out: Path) -> dict[str, Any]:
    """Train and test one variant with one seed, unless that is done; its result.

    Args:
        plan: What all runs have in common.
        variant: A key of :data:`VARIANTS`.
        seed: Of weights, order and augmentation.
        out: Folder of all runs.

    Returns:
        The metrics of the test split, seconds, the share of masks and loss in a step, memory.

    Raises:
        OSError: The data set cannot be read.
        ValueError: A sample was refused.
    """
    folder, key = out / f"{variant}-{seed}", plan.key(variant, seed)
    result = folder / "result.json"
    if result.exists():
        found: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        if found["key"] == key:
            return found
    begin = time.monotonic()
    lightning.seed_everything(seed, workers=True, verbose=False)
    task = PoseTask(
        backbone=plan.backbone,
        hidden=list(plan.hidden),
        camera="normalised",
        normalisation="imagenet",
        lr=plan.lr,
        lr_schedule="cosine",
        **VARIANTS[variant].model(plan.width),
    )
    data = PoseDataModule(
        root=plan.data, batch_size=plan.batch_size, workers=plan.workers, seed=seed
    )
    saver = ModelCheckpoint(
        dirpath=folder, filename="best", monitor="val/cpe", mode="min", enable_version_counter=False
    )
    latest = ModelCheckpoint(dirpath=folder, filename="last", enable_version_counter=False)
    share = RendererShare(tell=False)
    trainer = lightning.Trainer(
        max_epochs=plan.epochs,
        precision=plan.precision,  # type: ignore[arg-type]
        callbacks=[saver, latest, share],
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        default_root_dir=str(folder),
    )
    last, mark = folder / "last.ckpt", folder / "key"
    resumed = last.exists() and mark.exists() and mark.read_text(encoding="utf-8") == key
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text(key, encoding="utf-8")
    trainer.fit(task, datamodule=data, ckpt_path=str(last) if resumed else None, weights_only=False)
    trainer.test(
        task,
        datamodule=data,
        ckpt_path=saver.best_model_path,
        verbose=False,
        weights_only=False,
    )
    found = {
        "key": key,
        "variant": variant,
        "seed": seed,
        "test": task.epoch_report,
        "seconds": time.monotonic() - begin,
        "resumed": resumed,
        "renderer_share": share.objective_share,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    write_text(result, json.dumps(found, indent=1))
    for path in (last, folder / "best.ckpt"):
        path.unlink(missing_ok=True)
    return found


def interval(values: Sequence[float]) -> float | None:
    """Half the 95 % interval of the mean (Student's t); ``None`` for a single value."""
    n = len(values)
    if n < 2:
        return None
    quantile = _STUDENT[n - 2] if n - 2 < len(_STUDENT) else 1.96
    return quantile * statistics.stdev(values) / math.sqrt(n)


def mean_pose(root: str) -> dict[str, float]:
    """The test split scored for a network that has seen nothing: always the mean training pose.

    Args:
        root: Folder of the data set.

    Returns:
        The metrics, as :func:`dronepose.train.report.table_one`. The mean rotation is the one
        nearest to the mean of the matrices.

    Raises:
        OSError: The data set cannot be read.
    """
    train, test = FolderDataset(root, "train"), FolderDataset(root, "test")
    known = [train.pose(k) for k in range(len(train))]
    u, _, v = np.linalg.svd(np.mean([R for R, _ in known], axis=0))
    R = u @ np.diag([1.0, 1.0, float(np.linalg.det(u @ v))]) @ v
    t = np.mean([t for _, t in known], axis=0)
    truth = [test.pose(k) for k in range(len(test))]
    names = [str(k) for k in range(len(truth))]
    predicted = (np.tile(R, (len(truth), 1, 1)), np.tile(t, (len(truth), 1)), names)
    expected = (np.stack([R for R, _ in truth]), np.stack([t for _, t in truth]), names)
    mesh = Mesh.from_file(Path(root) / "mesh.obj")
    return table_one(evaluate(predicted, expected, mesh=mesh, metrics=["add"], bootstrap=0))


def table(results: Sequence[dict[str, Any]], baseline: dict[str, float] | None = None) -> str:
    """The results as Markdown: mean over the seeds and half of the 95 % interval.

    The last but one column is the mean of the differences to ``direct`` with the same seed.

    Args:
        results: Of :func:`run_one`.
        baseline: Metrics of :func:`mean_pose`, for a row of their own.
    """
    lines = [
        "| | seeds | " + " | ".join(HEADS) + " | CPE - Direct | renderer |",
        "|---|--:|" + "--:|" * 9,
    ]
    direct = {r["seed"]: r["test"]["cpe"] for r in results if r["variant"] == "direct"}
    if baseline is not None:
        cells = [f"{baseline[c]:.{1 if c.startswith('a') else 4}f}" for c in COLUMNS]
        lines.append("| Mean pose | | " + " | ".join(cells) + " | | |")
    for key, variant in VARIANTS.items():
        runs = [r for r in results if r["variant"] == key]
        if not runs:
            continue
        cells = [
            _cell([run["test"][column] for run in runs], 1 if column.startswith("a") else 4)
            for column in COLUMNS
        ]
        # The same seed gives the same order of the same images.
        pairs = [r["test"]["cpe"] - direct[r["seed"]] for r in runs if r["seed"] in direct]
        cells.append(_cell(pairs, 4) if pairs and key != "direct" else "")
        shares = [r["renderer_share"] for r in runs if r["renderer_share"] is not None]
        share = f"{100 * statistics.mean(shares):.2f} %" if shares else ""
        lines.append(f"| {variant.name} | {len(runs)} | " + " | ".join(cells) + f" | {share} |")
    return "\n".join(lines)


def by_seed(results: Sequence[dict[str, Any]]) -> str:
    """CPE of every run as Markdown, a column for each seed."""
    seeds = sorted({run["seed"] for run in results})
    lines = [
        "| CPE | " + " | ".join(f"seed {seed}" for seed in seeds) + " |",
        "|---|" + "--:|" * len(seeds),
    ]
    found = {(run["variant"], run["seed"]): f"{run['test']['cpe']:.3f}" for run in results}
    for key, variant in VARIANTS.items():
        if any((key, seed) in found for seed in seeds):
            cells = [found.get((key, seed), "") for seed in seeds]
            lines.append(f"| {variant.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(values: Sequence[float], digits: int) -> str:
    """Mean and half of the 95 % interval."""
    half = interval(values)
    plus = "" if half is None else f" ± {half:.{digits}f}"
    return f"{statistics.mean(values):.{digits}f}{plus}"
