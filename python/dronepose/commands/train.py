"""Train a pose network with a silhouette loss."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

HELP = """Train a pose network with a silhouette loss.

Usage: dronepose train --config CONFIG [--data.root FOLDER] [--out FOLDER] [--OPTION VALUE ...]

CONFIG is a file, or the name of a configuration that comes with the package:
  {names}

Example:
  dronepose toyset data --train 1500 --size 96x128 --distance 0.8 1.5
  dronepose train --config configs/smoke.yaml --data.root data --out runs/smoke
  dronepose train --config configs/smoke.yaml --data.root data --out runs/smoke --resume true
  dronepose predict --weights runs/smoke/best.safetensors --data data --out predictions.csv
  dronepose-eval predictions.csv data/test/poses.csv --mesh data/mesh.obj

In OUT: best.safetensors (of the epoch with the least CPE on the validation split; with
--model.compat authors on the test split, as their script does), checkpoints/, tensorboard/ (with
config.yaml), csv/. On several processes:
  torchrun --nproc-per-node 2 -m dronepose train ... --trainer.strategy ddp --trainer.devices 2

Options, with --help-all: every option of the model, the data and the trainer.
"""


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose train``; 0 done, 1 refused, 2 the command line was not understood."""
    arguments = list(argv)
    try:
        from lightning.fabric.utilities.exceptions import MisconfigurationException

        from dronepose.train.cli import run, shipped_configs
    except ImportError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if not arguments or arguments in (["--help"], ["-h"]):
        print(HELP.format(names=", ".join(sorted(shipped_configs()))))
        return 0 if arguments else 2
    if arguments == ["--help-all"]:
        arguments = ["--help"]
    try:
        run(arguments)
    except KeyboardInterrupt:
        print("stopped; --resume true goes on", file=sys.stderr)
        return 130
    except (ValueError, OSError, FloatingPointError, MisconfigurationException) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0
