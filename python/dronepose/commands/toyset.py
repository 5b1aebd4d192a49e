"""Make a small synthetic data set of the drone, for trying out training.

Each sample depends on the seed and its number alone: a run that was stopped goes on where it was
when the command is given again.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from contextlib import closing
from typing import TYPE_CHECKING

from dronepose._progress import Progress
from dronepose.commands._running import GOES_ON, run

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = """\
examples:
  dronepose toyset toy
  dronepose toyset toy --train 2000 --val 200 --test 200 --size 120x160 --seed 1
  dronepose-eval toy/test/poses.csv toy/test/poses.csv --mesh toy/mesh.obj

The folder holds dataset.json, camera.json, mesh.obj, and for each split images/, masks/ and
poses.csv, the ground truth for dronepose-eval.
"""


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose toyset``.

    Args:
        argv: The arguments after the subcommand.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> main(["toy", "--train", "80"])  # doctest: +SKIP
        0
    """
    return run(_parser(), argv, _work, stopped=GOES_ON)


def _work(args: argparse.Namespace) -> int:
    from dronepose.data import ToySettings, write_toyset

    begin = time.monotonic()
    settings = ToySettings(
        height=args.size[0],
        width=args.size[1],
        seed=args.seed,
        distance=tuple(args.distance),
        spread=args.spread,
        max_tilt_deg=args.max_tilt,
        max_pitch_deg=args.max_pitch,
        up=args.up,
        backgrounds=args.backgrounds,
    )
    with closing(Progress("samples")) as progress:
        made = write_toyset(
            args.out,
            counts={"train": args.train, "val": args.val, "test": args.test},
            mesh=args.mesh,
            settings=settings,
            shard=args.shard,
            progress=progress,
        )
    seconds = time.monotonic() - begin
    if args.json:
        print(json.dumps({**made, "seconds": round(seconds, 3)}, indent=2))
    else:
        counts = ", ".join(f"{n} {split}" for split, n in made["splits"].items())
        state = "" if made["complete"] else "; other shards are missing"
        print(f"{args.out}: {counts}; {made['written']} made in {seconds:.1f} s{state}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dronepose toyset",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("out", metavar="OUT", help="folder to write to, or to go on with")
    add("--train", type=int, default=800, metavar="N", help="training samples [800]")
    add("--val", type=int, default=100, metavar="N", help="validation samples [100]")
    add("--test", type=int, default=100, metavar="N", help="test samples [100]")
    add("--seed", type=int, default=0, metavar="S", help="seed of everything [0]")
    add("--size", type=_size, default=(120, 160), metavar="HxW", help="rows x columns [120x160]")
    add(
        "--distance",
        type=float,
        nargs=2,
        default=(0.8, 3.0),
        metavar=("NEAR", "FAR"),
        help="of the drone, metres [0.8 3.0]",
    )
    add(
        "--spread",
        type=float,
        default=0.84,
        metavar="SHARE",
        help="of the image, about its middle, in which the drone's origin is [0.84]",
    )
    add("--max-tilt", type=float, default=25.0, metavar="DEG", help="from upright [25]")
    add("--max-pitch", type=float, default=20.0, metavar="DEG", help="camera up, down [20]")
    add("--mesh", metavar="FILE", help="the drone, metres [the project's quadrotor]")
    add("--up", choices=("y", "z"), default="z", help="axis of the mesh that points up [z]")
    add(
        "--backgrounds",
        default="procedural",
        metavar="FOLDER",
        help="images, and panoramas twice as wide as high (also .hdr) [drawn]",
    )
    add(
        "--shard",
        type=_shard,
        default=(0, 1),
        metavar="K/N",
        help="make every N-th sample from the K-th on, K from 0; run all N [0/1]",
    )
    add("--json", action="store_true", help="say what was made as JSON")
    return parser


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected HxW, such as 120x160, got {text!r}")
    return int(match[1]), int(match[2])


def _shard(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected K/N, such as 0/4, got {text!r}")
    return int(match[1]), int(match[2])
