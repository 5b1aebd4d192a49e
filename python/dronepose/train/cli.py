"""``dronepose train``: LightningCLI over :class:`~dronepose.train.task.PoseTask`."""

from __future__ import annotations

import logging
import sys
import warnings
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from dronepose.data import PoseDataModule
from dronepose.train.callbacks import BestWeights, Overlays, RendererShare
from dronepose.train.task import PoseTask

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jsonargparse import Namespace
    from lightning import Trainer
    from lightning.pytorch.cli import LightningArgumentParser

MONITOR = "val/cpe"
"""What the best checkpoint is chosen by: the combined pose error on the validation split, and with
``--model.compat authors`` on what takes its place."""


class Cli(LightningCLI):
    """Adds the folder of a run, resuming and the callbacks that every run has."""

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Options of a run as a whole."""
        parser.add_argument("--out", type=str, default="runs/dronepose", help="folder of the run")
        parser.add_argument(
            "--resume", type=bool, default=False, help="go on from OUT/checkpoints/last.ckpt"
        )
        parser.add_argument(
            "--checkpoint_every",
            type=int,
            default=0,
            help="steps between checkpoints within an epoch; 0 is one at the end of each",
        )
        parser.set_defaults(
            {
                "trainer.max_epochs": 20,
                "trainer.accelerator": "auto",
                "trainer.log_every_n_steps": 10,
                "trainer.num_sanity_val_steps": 0,
                "trainer.enable_model_summary": False,
                "seed_everything": 0,
            }
        )

    def before_instantiate_classes(self) -> None:
        """Loggers, checkpoints and pictures go to the folder of the run."""
        config = self.config[self.subcommand] if self.subcommand else self.config
        if config.model.compat == "authors":
            as_authors(config.data)
        out = Path(config.out)
        saver = ModelCheckpoint(
            dirpath=out / "checkpoints",
            filename="epoch-{epoch:03d}",
            auto_insert_metric_name=False,
            monitor=MONITOR,
            mode="min",
        )
        last = ModelCheckpoint(
            dirpath=out / "checkpoints", filename="last", enable_version_counter=False
        )
        text = self.parser.dump(self.config, skip_none=False)
        seed = config.get("seed_everything")
        chosen = [
            saver,
            last,
            RendererShare(),
            Overlays(),
            BestWeights(out, text, None if seed is True else seed),
        ]
        if config.checkpoint_every:
            within = ModelCheckpoint(
                dirpath=out / "checkpoints",
                filename="step",
                every_n_train_steps=config.checkpoint_every,
                save_top_k=1,
                enable_version_counter=False,
            )
            chosen.append(within)
        self.trainer_defaults["callbacks"] = chosen
        self.loggers = [
            TensorBoardLogger(out, name="tensorboard", version=""),
            CSVLogger(out, name="csv", version=""),
        ]
        newest_of_run = newest(out / "checkpoints")
        if config.resume and self.subcommand == "fit":
            if newest_of_run is None:
                print(f"nothing to resume in {out}: starting anew", file=sys.stderr)
            else:
                config.ckpt_path = str(newest_of_run)
        elif self.subcommand == "fit" and newest_of_run is not None and not config.ckpt_path:
            raise FileExistsError(
                f"{out} holds a run already: --resume true goes on with it, --out takes another one"
            )

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        """With the loggers of the run; a progress bar only where somebody may look at it."""
        if not sys.stderr.isatty():
            kwargs["enable_progress_bar"] = False
        return super().instantiate_trainer(**kwargs, logger=self.loggers)


def as_authors(data: Namespace) -> None:
    """Let data be used as the authors' training script does, and say so on the error stream.

    Their script leaves out batches smaller than the batch size, never reads the validation split,
    and chooses the best epoch by the error on the test split. The last is a flaw: what is chosen on
    a split scores too well on it. It is reproduced for comparison with their numbers.

    Args:
        data: The arguments of :class:`PoseDataModule`; ``splits`` and ``drop_last`` are changed.
    """
    train, _, test = data.splits
    data.splits, data.drop_last = (train, test, test), True
    rank_zero_only(print)(
        f"--model.compat authors: the best epoch is chosen on the test split {test!r}, as in the "
        "authors' code, so that its errors there are too small to compare with others; no "
        f"validation split is read; batches smaller than {data.batch_size} are left out",
        file=sys.stderr,
    )


def newest(folder: Path) -> Path | None:
    """The checkpoint that was written last: at the end of an epoch, or within it."""
    found = [path for path in (folder / "last.ckpt", folder / "step.ckpt") if path.exists()]
    return max(found, key=lambda path: path.stat().st_mtime) if found else None


def config_path(given: str) -> str:
    """A configuration: a file, or one of those that come with the package, by file or bare name."""
    if Path(given).exists():
        return given
    shipped = resources.files("dronepose.train") / "configs" / f"{Path(given).stem}.yaml"
    if shipped.is_file():
        return str(shipped)
    names = ", ".join(sorted(shipped_configs()))
    raise FileNotFoundError(f"{given}: no such configuration; expected a file, or one of {names}")


def shipped_configs() -> list[str]:
    """Names of the configurations that come with the package."""
    folder = resources.files("dronepose.train") / "configs"
    return [entry.name.removesuffix(".yaml") for entry in folder.iterdir()]


def run(argv: Sequence[str]) -> Cli:
    """Train, with the arguments of ``dronepose train``."""
    arguments = list(argv)
    for k, word in enumerate(arguments):
        if word in ("--config", "-c") and k + 1 < len(arguments):
            arguments[k + 1] = config_path(arguments[k + 1])
        elif word.startswith("--config="):
            arguments[k] = f"--config={config_path(word.partition('=')[2])}"
    quiet()
    return Cli(
        PoseTask,
        PoseDataModule,
        args=["fit", *arguments],
        save_config_kwargs={"overwrite": True},
        auto_configure_optimizers=False,
        parser_kwargs={"prog": "dronepose train"},
    )


def quiet() -> None:
    """Keep hints that a user cannot act upon to themselves."""
    for text in (
        ".*does not have many workers.*",
        ".*number of training batches.*",
        ".*Checkpoint directory .* exists.*",
        ".*isinstance\\(treespec, LeafSpec\\).*",
        ".*LightningCLI's args parameter.*",
        ".*Experiment logs directory .* exists.*",
        ".*sync_dist=True.*",  # all processes log the same number
    ):
        warnings.filterwarnings("ignore", message=text)
    for name in ("lightning.pytorch", "lightning.fabric"):
        for logger in (name, f"{name}.utilities.rank_zero", f"{name}.utilities.seed"):
            logging.getLogger(logger).setLevel(logging.WARNING)
