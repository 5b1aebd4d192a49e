"""Compare the paper's losses on a small synthetic data set."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dronepose.commands._running import GOES_ON, run

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = """example:
  dronepose reproduce mini --out runs/mini --seeds 0 1 2

Finished runs are kept: the same command goes on where it was stopped. In the background:
  nohup dronepose reproduce mini --out runs/mini > mini.log 2>&1 &
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    found = argparse.ArgumentParser(
        prog="dronepose reproduce",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    found.add_argument("what", choices=["mini"], help="mini: Table 1 at a laptop's size")
    found.add_argument("--out", type=Path, required=True, help="folder of the runs")
    found.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    found.add_argument("--variants", nargs="+", help="some of the variants (default: five)")
    found.add_argument("--size", default="96x128", help="rows x columns (default: 96x128)")
    found.add_argument("--train", type=int, default=2500, help="images (default: 2500)")
    found.add_argument("--val", type=int, default=200)
    found.add_argument("--test", type=int, default=400)
    found.add_argument("--backbone", default="resnet18")
    found.add_argument("--epochs", type=int, default=10)
    found.add_argument("--batch-size", type=int, default=32)
    found.add_argument("--lr", type=float, default=1e-3)
    found.add_argument(
        "--precision",
        default="32-true",
        help="as of Lightning: bf16-mixed is twice as fast on CPUs with AMX (default: 32-true)",
    )
    found.add_argument("--workers", type=int, default=0)
    found.add_argument("--json", action="store_true", help="print the results as JSON")
    return found


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose reproduce``; 0 done, 1 refused, 2 the command line was not understood."""
    return run(parser(), argv, _mini, stopped=GOES_ON)


def _mini(options: argparse.Namespace) -> int:
    from dronepose._files import write_text
    from dronepose.data import ToySettings, write_toyset
    from dronepose.train.cli import quiet
    from dronepose.train.reproduce import VARIANTS, Plan, by_seed, mean_pose, run_one, table

    quiet()
    rows, _, columns = options.size.partition("x")
    if not (rows.isdigit() and columns.isdigit()):
        raise ValueError(f"--size: expected ROWSxCOLUMNS such as 96x128, got {options.size!r}")
    chosen = tuple(options.variants or Plan.variants)
    for name in chosen:
        if name not in VARIANTS:
            raise ValueError(f"--variants: {name!r}; expected some of {', '.join(VARIANTS)}")
    data = options.out / "data"
    counts = {"train": options.train, "val": options.val, "test": options.test}
    # Distances and places in the image are about those that the rules of the paper's set leave.
    settings = ToySettings(
        height=int(rows), width=int(columns), seed=0, distance=(0.8, 1.5), spread=0.5
    )
    write_toyset(data, counts=counts, settings=settings)
    plan = Plan(
        data=str(data),
        width=int(columns),
        backbone=options.backbone,
        epochs=options.epochs,
        batch_size=options.batch_size,
        lr=options.lr,
        precision=options.precision,
        workers=options.workers,
        seeds=tuple(options.seeds),
        variants=chosen,
    )
    results = []
    for seed in plan.seeds:  # seed by seed: a table of all variants as early as may be
        for variant in plan.variants:
            found = run_one(plan, variant, seed, options.out)
            results.append(found)
            print(
                f"{VARIANTS[variant].name}, seed {seed}: CPE {found['test']['cpe']:.4f}, "
                f"{found['seconds']:.0f} s, {found['peak_memory_mb']:.0f} MB",
                file=sys.stderr,
                flush=True,
            )
    text = f"{table(results, mean_pose(str(data)))}\n\n{by_seed(results)}"
    write_text(options.out / "results.json", json.dumps(results, indent=1))
    write_text(options.out / "results.md", text + "\n")
    print(json.dumps(results) if options.json else text)
    return 0
