"""What happens beside training: pictures, the renderer's share, the best weights as a file."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.utilities import rank_zero_only

from dronepose.model import file_sha256, save_weights
from dronepose.train.source import camera_of, mesh_file
from dronepose.train.task import PoseTask

if TYPE_CHECKING:
    from lightning import LightningModule, Trainer
    from torch import Tensor

    from dronepose.data import PoseDataModule


class RendererShare(Callback):
    """Times steps and the silhouette objective in them, and says what share that has.

    ``renderer/share`` is logged for every epoch: forward and backward of the masks over the whole
    step, data loading excluded; ``renderer/objective_share`` has the loss with it. Backward is
    timed by hooks on the masks and the predicted poses.

    Args:
        tell: Whether to print a line for each epoch, on the error stream.
    """

    def __init__(self, *, tell: bool = True) -> None:
        self.tell = tell
        self._begin = 0.0
        self._steps = 0.0
        self._count = 0
        self._loss = 0.0
        self.share: float | None = None
        """Of drawing, in the last epoch; ``None`` without a silhouette."""
        self.objective_share: float | None = None
        """Of drawing and loss."""

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Begin again."""
        self._steps, self._count, self._loss = 0.0, 0, 0.0
        if isinstance(pl_module, PoseTask) and pl_module.exo is not None:
            pl_module.exo.reset_times()

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """A step begins."""
        self._begin = time.perf_counter()

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """A step ends."""
        self._steps += time.perf_counter() - self._begin
        self._count += len(batch["name"])
        loss = outputs["loss"] if isinstance(outputs, dict) else outputs
        self._loss += float(loss) * len(batch["name"])

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Say what the epoch took, and came to."""
        exo = getattr(pl_module, "exo", None)
        if not self._count or self._steps == 0.0:
            return
        told = [f"epoch {trainer.current_epoch}", f"loss {self._loss / self._count:.4f}"]
        for name, key in (("CPE", "val/cpe"), ("NPE", "val/npe")):
            if key in trainer.callback_metrics:
                told.append(f"{name} {float(trainer.callback_metrics[key]):.4f}")
        if "val/oe_deg" in trainer.callback_metrics:
            told.append(f"OE {float(trainer.callback_metrics['val/oe_deg']):.2f} deg")
        told.append(f"{1e3 * self._steps / self._count:.2f} ms an image and step")
        if exo is not None and exo.seconds > 0.0:
            self.share = exo.drawing_seconds / self._steps
            self.objective_share = exo.seconds / self._steps
            pl_module.log("renderer/share", self.share)
            pl_module.log("renderer/objective_share", self.objective_share)
            for name, seconds in (("drawing", exo.drawing_seconds), ("with its loss", exo.seconds)):
                each, share = 1e3 * seconds / self._count, 100 * seconds / self._steps
                told.append(f"{name} {each:.3f} ms, {share:.2f} %")
        if trainer.is_global_zero and self.tell:
            print(", ".join(told), file=sys.stderr, flush=True)


class Overlays(Callback):
    """Silhouettes of predictions over some images of the validation set, for TensorBoard.

    Args:
        count: How many images of the first batch.
    """

    def __init__(self, count: int = 8) -> None:
        self.count = count

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Draw, after the first batch."""
        logger = trainer.logger
        if not isinstance(pl_module, PoseTask):
            return
        exo = pl_module.exo
        if batch_idx or exo is None or trainer.sanity_checking or not trainer.is_global_zero:
            return
        if not isinstance(logger, lightning.pytorch.loggers.TensorBoardLogger):
            return
        some = {key: value[: self.count] for key, value in batch.items()}
        with torch.no_grad():
            R, t = pl_module.model(some["image"], some["K"])
            height, width = some["image"].shape[-2:]
            masks = exo.draw(R, t, some["K"], height, width)
        pictures = overlay(some["image"], masks, some["mask"])
        logger.experiment.add_images("val/overlay", pictures, trainer.global_step)


def overlay(image: Tensor, predicted: Tensor, truth: Tensor) -> Tensor:
    """Images ``(B, 3, H, W)`` with the predicted mask in red and the true one in green.

    Masks are ``(B, H, W)`` in ``[0, 1]``; where both are, it is yellow.
    """
    colours = torch.stack([predicted, truth, torch.zeros_like(truth)], dim=1)
    weight = 0.5 * torch.maximum(predicted, truth)[:, None]
    return (image * (1 - weight) + colours * weight).clamp(0, 1)


class BestWeights(Callback):
    """Writes ``best.safetensors`` whenever the best checkpoint changes.

    Args:
        folder: Where.
        config: The configuration of the run, as text, for the metadata.
        seed: That of the run, for the metadata.
    """

    def __init__(self, folder: str | Path, config: str = "", seed: int | None = None) -> None:
        self.folder, self.config, self.seed = Path(folder), config, seed
        self._written = ""

    @rank_zero_only
    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write them if this epoch is the best so far."""
        saver = trainer.checkpoint_callback  # the first one
        if not isinstance(saver, ModelCheckpoint) or trainer.sanity_checking:
            return
        if not isinstance(pl_module, PoseTask):
            return
        score = trainer.callback_metrics.get(saver.monitor or "")
        best = saver.best_model_score
        if score is None or (best is not None and float(score) > float(best)):
            return
        key = f"{trainer.current_epoch}:{trainer.global_step}"
        if key == self._written:
            return
        self._written = key
        self.folder.mkdir(parents=True, exist_ok=True)
        metadata = run_metadata(trainer, pl_module, self.config, self.seed)
        save_weights(pl_module.model, self.folder / "best.safetensors", metadata)


def run_metadata(trainer: Trainer, task: PoseTask, config: str, seed: int | None) -> dict[str, Any]:
    """What a file with weights says about where they come from."""
    data: PoseDataModule = trainer.datamodule  # type: ignore[attr-defined]
    mesh = mesh_file(task.mesh, data)
    return {
        "torch_version": str(torch.__version__),
        "seed": seed,
        "metrics": task.epoch_report,
        "mesh_sha256": None if mesh is None else file_sha256(mesh),
        "intrinsics": camera_of(data),
        "image_size": None if data.height is None else (data.height, data.width),
        "config": config,
        "extra": {
            "epoch": trainer.current_epoch,
            "step": trainer.global_step,
            "compat": task.compat,
            "chosen_on": data.splits[1],
            "drop_last": data.drop_last,
            "lightning_version": lightning.__version__,
        },
    }
