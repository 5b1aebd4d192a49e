"""Predict the poses in a data set with trained weights."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from dronepose.commands._running import run

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = """example:
  dronepose predict --weights runs/smoke/best.safetensors --data data --out predictions.csv
  dronepose-eval predictions.csv data/test/poses.csv --mesh data/mesh.obj
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    found = argparse.ArgumentParser(
        prog="dronepose predict",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    found.add_argument("--weights", type=Path, required=True, help="weights, .safetensors")
    found.add_argument("--data", type=Path, required=True, help="folder of the data set")
    found.add_argument("--kind", default="folder", choices=["folder", "uava", "bop"])
    found.add_argument("--split", default="test", help="train, val or test (default: test)")
    found.add_argument("--out", type=Path, required=True, help="CSV to write")
    found.add_argument("--gt-out", type=Path, help="CSV to write with the true poses")
    found.add_argument("--batch-size", type=int, default=64)
    found.add_argument("--workers", type=int, default=0, help="processes that read images")
    found.add_argument("--device", default="cpu", help="where torch computes, such as cuda")
    found.add_argument("--json", action="store_true", help="say what was done as JSON")
    return found


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose predict``; 0 done, 1 refused, 2 the command line was not understood."""
    return run(parser(), argv, _work)


def _work(options: argparse.Namespace) -> int:
    from dronepose.train import predict

    found = predict.run(options)
    if options.json:
        print(json.dumps(found))
    else:
        print(f"{found['images']} poses in {found['out']}")
    return 0
