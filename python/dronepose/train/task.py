"""What is trained: a pose network, its objective and how it is judged.

The objective is that of DronePose (Albanis et al., ECCV Workshops 2020), section 4:

    L_pose = lambda_pose L_t + (1 - lambda_pose) L_r
    L      = (1 - lambda_exo) L_pose + lambda_exo L_exo

``L_t`` is the squared distance of the translations in square metres, ``L_r`` the geodesic distance
of the rotations in radians, ``L_exo`` compares the silhouette drawn under the predicted pose with
the mask of the image. ``lambda_exo`` may change from epoch to epoch.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any, Literal

import lightning
import torch
from torch import Tensor, nn

from dronepose import losses
from dronepose.mesh import Mesh
from dronepose.model import PoseNet
from dronepose.torch import silhouette
from dronepose.train.report import Judge
from dronepose.train.source import mesh_file

Mode = Literal["coverage", "dibr", "sigmoid"]
Compat = Literal["paper", "authors"]


class Exo(nn.Module):
    """The silhouette objective: masks of a mesh under predicted poses, and a loss for them.

    Args:
        mesh: The model, metres.
        loss: Its name, as :func:`dronepose.losses.silhouette_loss` takes it.
        options: Its options.
        mode: As in :class:`PoseTask`, and so are the following.
        sigma: As in :class:`PoseTask`.
        delta: As in :class:`PoseTask`.
        sigma_ndc: Width of mode ``"sigmoid"``, squared NDC, as SoftRas has it.

    Attributes:
        seconds: Time spent in forward and backward passes of masks and loss since they were last
            set to zero.
        drawing_seconds: The part of it that went into masks and their gradients.
    """

    def __init__(
        self,
        mesh: Mesh,
        loss: str,
        options: dict[str, Any] | None = None,
        *,
        mode: Mode = "dibr",
        sigma: float = 0.0,
        delta: float = 7000.0,
        sigma_ndc: float = 1e-4,
    ) -> None:
        super().__init__()
        self.register_buffer("vertices", torch.tensor(mesh.vertices).float(), persistent=False)
        self.register_buffer("faces", torch.tensor(mesh.faces).long(), persistent=False)
        self.loss = losses.silhouette_loss(loss, **(options or {}))
        self.drawing = {"mode": mode, "sigma": sigma, "delta": delta, "sigma_ndc": sigma_ndc}
        self.reset_times()

    def reset_times(self) -> None:
        """Count from zero."""
        self.seconds = self.drawing_seconds = 0.0

    def draw(self, R: Tensor, t: Tensor, K: Tensor, height: int, width: int) -> Tensor:
        """Masks ``(B, H, W)`` float32 under ``R`` ``(B, 3, 3)``, ``t`` ``(B, 3)`` metres."""
        vertices, faces = self.vertices, self.faces
        assert isinstance(vertices, Tensor)
        assert isinstance(faces, Tensor)
        with torch.autocast(R.device.type, enabled=False):
            return silhouette(
                vertices,
                faces,
                R.float(),
                t.float(),
                K.float(),
                height,
                width,
                **self.drawing,  # type: ignore[arg-type]
            )

    def forward(self, R: Tensor, t: Tensor, K: Tensor, target: Tensor) -> Tensor:
        """The loss, a number, against masks ``target`` ``(B, H, W)``."""
        begin = time.perf_counter()
        R, t = R.clone(), t.clone()
        masks = self.draw(R, t, K, target.shape[-2], target.shape[-1])
        drawn = time.perf_counter()
        value: Tensor = self.loss(masks, target)
        self.seconds += time.perf_counter() - begin
        self.drawing_seconds += drawn - begin
        if value.requires_grad and not torch.compiler.is_compiling():
            self._time_backward(value, masks, (R, t))
        return value

    def _time_backward(self, value: Tensor, masks: Tensor, poses: tuple[Tensor, ...]) -> None:
        """From the gradient for the loss to that for the masks, and on to those for the poses."""
        last: list[float] = []

        def start(_: Tensor) -> None:
            last.append(time.perf_counter())

        def count(*, drawing: bool) -> None:
            if last:
                now = time.perf_counter()
                self.seconds += now - last[-1]
                self.drawing_seconds += now - last[-1] if drawing else 0.0
                last[-1] = now

        def of_masks(_: Tensor) -> None:
            count(drawing=False)

        def of_pose(_: Tensor) -> None:
            count(drawing=True)

        value.register_hook(start)  # type: ignore[no-untyped-call]
        masks.register_hook(of_masks)  # type: ignore[no-untyped-call]
        for pose in poses:
            if pose.requires_grad:
                pose.register_hook(of_pose)  # type: ignore[no-untyped-call]


class PoseTask(lightning.LightningModule):
    """A pose network, trained on poses and silhouettes, judged as ``dronepose-eval`` does.

    Args:
        mesh: The model, for silhouettes and ADD; by default that of the data set.
        backbone: A torchvision network by name, see :func:`dronepose.model.backbone_names`.
        weights: A file with weights to begin from; none is ever downloaded.
        normalisation: ``"none"`` or ``"imagenet"``.
        camera: ``None``, or ``"normalised"`` for a network that knows the camera.
        hidden: Widths of the fully connected layers behind the backbone; by default the paper's.
        silhouette: A loss by name (:func:`dronepose.losses.silhouette_loss`), or ``"none"``.
        silhouette_options: Options of the loss, such as ``size`` and ``sigma``.
        mode: How silhouettes are drawn: ``"dibr"`` as in the paper, ``"coverage"``, ``"sigmoid"``.
        sigma: Blur of mode ``"coverage"``, pixels.
        delta: Inverse squared width of mode ``"dibr"``, NDC.
        lambda_pose: Share of the translation in ``L_pose``, 0 to 1.
        lambda_exo: Share of ``L_exo``: one number, or by the epoch from which it holds.
        lr: Learning rate of Adam.
        lr_schedule: ``"constant"``, as in the paper, or ``"cosine"``: up to ``lr`` along a line
            during the first twentieth of the steps, then down to zero along half a cosine.
        freeze_norm: Keep the statistics of batch normalisation as they are.
        compat: ``"paper"``, or ``"authors"``: the mean over the three coordinates in ``L_t``, and
            errors in validation and test as means of the means of batches of 8, as their script
            has them. ``dronepose train`` then uses the data as their script does, too:
            :func:`dronepose.train.cli.as_authors`.

    Raises:
        ValueError: A share is outside of 0 to 1, a schedule does not begin at epoch 0, or a name is
            unknown.
    """

    def __init__(
        self,
        mesh: str | None = None,
        backbone: str = "resnet34",
        weights: str | None = None,
        normalisation: Literal["none", "imagenet"] = "none",
        camera: Literal["normalised"] | None = None,
        hidden: list[int] | None = None,
        silhouette: str = "none",
        silhouette_options: dict[str, Any] | None = None,
        mode: Mode = "dibr",
        sigma: float = 0.0,
        delta: float = 7000.0,
        lambda_pose: float = 0.95,
        lambda_exo: float | dict[int, float] = 0.1,
        lr: float = 1e-4,
        lr_schedule: Literal["constant", "cosine"] = "constant",
        freeze_norm: bool = False,
        compat: Compat = "paper",
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.schedule = _schedule(lambda_exo if silhouette != "none" else 0.0)
        if not 0 <= lambda_pose <= 1:
            raise ValueError(f"lambda_pose: {lambda_pose}; expected 0 to 1")
        if compat not in ("paper", "authors"):
            raise ValueError(f"compat: {compat!r}; expected 'paper' or 'authors'")
        if lr_schedule not in ("constant", "cosine"):
            raise ValueError(f"lr_schedule: {lr_schedule!r}; expected 'constant' or 'cosine'")
        self.lambda_pose, self.lr, self.lr_schedule = lambda_pose, lr, lr_schedule
        self.freeze_norm, self.compat = freeze_norm, compat
        widths: dict[str, Any] = {} if hidden is None else {"hidden": hidden}
        net = PoseNet(
            backbone, weights=weights, normalisation=normalisation, camera=camera, **widths
        )
        self.model = net.to(memory_format=torch.channels_last)
        self.mesh = mesh
        self._exo_options = (silhouette, dict(silhouette_options or {}), mode, sigma, delta)
        self.exo: Exo | None = None
        self.judge = Judge(None, preset=compat)
        self.epoch_report: dict[str, float] = {}

    def configure_model(self) -> None:
        """Load the mesh: of the arguments, or of the data set."""
        if self.exo is not None or self.judge.mesh is not None:
            return
        path = mesh_file(self.mesh, self.trainer.datamodule)  # type: ignore[attr-defined]
        name, options, mode, sigma, delta = self._exo_options
        if path is None:
            if name != "none":
                raise ValueError("mesh: a silhouette loss needs one, and the data set names none")
            return
        mesh = Mesh.from_file(path)
        self.judge = Judge(mesh, preset=self.compat)
        if name != "none":
            self.exo = Exo(mesh, name, options, mode=mode, sigma=sigma, delta=delta)

    def configure_optimizers(self) -> Any:
        """Adam with its default moments, and the schedule of the learning rate, step by step."""
        optimizer = torch.optim.Adam(self.model.parameters(), lr=self.lr, fused=True)
        if self.lr_schedule == "constant":
            return optimizer
        steps = int(self.trainer.estimated_stepping_batches)
        scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, partial(cosine, steps=steps))
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def lambda_exo(self, epoch: int) -> float:
        """The share of the silhouette in an epoch, counted from 0."""
        return [value for first, value in self.schedule if first <= epoch][-1]

    def on_train_epoch_start(self) -> None:
        """Keep statistics as they are, where asked for."""
        if self.freeze_norm:
            for module in self.model.modules():
                if isinstance(module, nn.modules.batchnorm._BatchNorm):
                    module.eval()

    def objective(self, batch: dict[str, Any]) -> dict[str, Tensor]:
        """The loss and its parts.

        Args:
            batch: Samples as :class:`dronepose.data.Sample` has them, collated.

        Returns:
            ``loss``, ``translation`` (square metres), ``rotation`` (radians), and ``silhouette`` if
            it has a share; numbers.

        Raises:
            ValueError: A silhouette loss was asked for, and the samples have no masks.
        """
        R, t = self.model(batch["image"], batch["K"])
        parts = {
            "translation": losses.translation_loss(t.float(), batch["t"], form=self.compat),
            "rotation": losses.rotation_loss(R.float(), batch["R"]),
        }
        share = self.lambda_exo(self.current_epoch)
        weight = self.lambda_pose
        pose = weight * parts["translation"] + (1 - weight) * parts["rotation"]
        if self.exo is None or share == 0:
            return {"loss": pose, **parts}
        if batch["mask"].numel() == 0:
            raise ValueError(f"silhouette: sample {batch['name'][0]!r} has no mask to compare with")
        parts["silhouette"] = self.exo(R, t, batch["K"], batch["mask"])
        return {"loss": losses.total_loss(pose, parts["silhouette"], lambda_exo=share), **parts}

    def training_step(self, batch: dict[str, Any], batch_idx: int) -> Tensor:
        """One step; the loss and its parts are logged."""
        found = self.objective(batch)
        if not torch.isfinite(found["loss"]):
            names = ", ".join(str(name) for name in batch["name"][:8])
            raise FloatingPointError(f"the loss is {found['loss'].item()} for samples {names}")
        logged = {f"train/{name}": value.detach() for name, value in found.items()}
        shared = self.trainer.world_size > 1
        self.log_dict(logged, batch_size=len(batch["name"]), prog_bar=False, sync_dist=shared)
        self.log("loss", found["loss"].detach(), prog_bar=True, logger=False)
        return found["loss"]

    def validation_step(self, batch: dict[str, Any], batch_idx: int) -> None:
        """Predict and remember."""
        self._remember(batch)

    def test_step(self, batch: dict[str, Any], batch_idx: int) -> None:
        """Predict and remember."""
        self._remember(batch)

    def on_validation_epoch_end(self) -> None:
        """Judge the predictions of the epoch."""
        self._report("val")

    def on_test_epoch_end(self) -> None:
        """Judge the predictions of the epoch."""
        self._report("test")

    def predict_step(self, batch: dict[str, Any], batch_idx: int) -> dict[str, Any]:
        """Poses with the names of their samples."""
        R, t = self.model(batch["image"], batch["K"])
        return {"name": batch["name"], "R": R.float(), "t": t.float()}

    def _remember(self, batch: dict[str, Any]) -> None:
        R, t = self.model(batch["image"], batch["K"])
        self.judge.add(batch["name"], (R.float(), t.float()), (batch["R"], batch["t"]))

    def _report(self, split: str) -> None:
        found = self.judge.finish(self.trainer.world_size)
        if found is None:
            return
        self.epoch_report = found
        self.log_dict({f"{split}/{k}": v for k, v in found.items()}, sync_dist=False)
        for name in ("cpe", "npe", "oe_deg"):
            self.log(name, found[name], prog_bar=True, logger=False)


def cosine(step: int, steps: int) -> float:
    """The share of the learning rate in a step, counted from 0, of ``steps``."""
    rise = max(1, steps // 20)
    if step < rise:
        return (step + 1) / rise
    return 0.5 * (1 + math.cos(math.pi * min(1.0, (step - rise) / max(1, steps - rise))))


def _schedule(value: float | dict[int, float]) -> list[tuple[int, float]]:
    """Shares by the epoch from which they hold, in order."""
    steps = sorted(value.items()) if isinstance(value, dict) else [(0, value)]
    if not steps or steps[0][0] != 0:
        raise ValueError(f"lambda_exo: {value}; expected a share from epoch 0 on")
    for _, share in steps:
        if not 0 <= share <= 1:
            raise ValueError(f"lambda_exo: {share}; expected 0 to 1")
    return [(int(epoch), float(share)) for epoch, share in steps]
