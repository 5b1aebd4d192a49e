"""What ``dronepose synth render`` does with its arguments."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose._progress import Progress
from dronepose.synth.cluster import Cluster
from dronepose.synth.dataset import SynthError, write_dataset
from dronepose.synth.licences import unlicensed
from dronepose.synth.sample import RenderSettings
from dronepose.synth.sources import Sources

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable


def render_plan(args: argparse.Namespace, stage: Callable[[str], None]) -> dict[str, Any]:
    """Render a plan from the command line's arguments; the manifest.

    Args:
        args: As from :func:`dronepose.synth.options.add_render_options`.
        stage: Is told what goes on.

    Raises:
        ValueError: An argument or a file was refused.
        OSError: A file cannot be read or written.
        ImportError: A package is missing.
    """
    match = re.fullmatch(r"(\d+)/(\d+)", args.shard)
    if match is None:
        raise SynthError(f"--shard: expected K/N, such as 0/4, got {args.shard!r}")
    settings = RenderSettings(
        seed=args.seed,
        strength=tuple(args.strength),
        least_seen=args.seen,
        most_hole=args.hole,
        least_depth_m=args.least_depth,
        apart_m=args.apart,
    )
    if not 1 <= args.samples <= 8:
        raise SynthError(f"--samples: expected 1 to 8, got {args.samples}")
    if args.dask is not None and args.workers:
        raise SynthError("--dask, --workers: expected one of the two")
    workers = args.workers or _cores()
    given = {part.name: getattr(args, part.name) for part in fields(Sources)}
    lists = {name: tuple(of) for name, of in given.items() if isinstance(of, list)}
    sources = Sources(**{**given, **lists, "plan": str(args.plan)})
    loaded = sources.load(threads=1 if workers > 1 else 0, stage=stage)
    if lacking := unlicensed(loaded.facts):
        print(f"no licence is known of {', '.join(lacking)}; --licence NAME=ID states one",
              file=sys.stderr)  # fmt: skip
    building = args.building or loaded.plan.manifest.get("scene") or _name(args.scene)
    stage("rendering")
    progress = Progress("rows")
    try:
        return write_dataset(
            args.out,
            loaded.plan,
            loaded.studio,
            loaded.cameras,
            building=building,
            drone=args.drone_name or _name(args.drone),
            split=args.split or loaded.plan.manifest.get("split") or "train",
            date=args.date,
            environments=loaded.environments,
            settings=settings,
            inputs=loaded.facts,
            shard=(int(match[1]), int(match[2])),
            workers=workers,
            cluster=None if args.dask is None else Cluster(args.dask, sources, say=stage),
            progress=progress,
        )
    finally:
        progress.close()


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _name(file: str) -> str:
    """Of a file, without what names must not have."""
    return re.sub(r"[_/\\\s]+", "-", Path(file).stem) or "scene"
