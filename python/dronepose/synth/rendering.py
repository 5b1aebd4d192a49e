"""What ``dronepose synth render`` does with its arguments."""

from __future__ import annotations

import os
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.dataset import RenderSettings, SynthError, write_dataset
from dronepose.synth.inputs import (
    cameras_of,
    read_drone,
    read_more_drones,
    read_panoramas,
    read_scene,
)
from dronepose.synth.licences import input_licences, render_inputs, unlicensed
from dronepose.synth.plan import read_plan
from dronepose.synth.studio import Studio

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
        apart_m=args.apart,
    )
    if not 1 <= args.samples <= 8:
        raise SynthError(f"--samples: expected 1 to 8, got {args.samples}")
    stage("reading the plan")
    plan = read_plan(args.plan)
    cameras = cameras_of(plan)
    licences = input_licences(render_inputs(args, plan), args.licence)
    if lacking := unlicensed({"licences": licences}):
        print(f"no licence is known of {', '.join(lacking)}; --licence NAME=ID states one",
              file=sys.stderr)  # fmt: skip
    stage("reading the scene")
    scene, scene_facts = read_scene(args.scene, metres_per_unit=args.scene_unit)
    stage("reading the drone")
    drone, drone_facts = read_drone(
        args.drone,
        metres_per_unit=args.drone_unit,
        texture=args.drone_texture,
        roughness=args.roughness,
        metallic=args.metallic,
    )
    further, further_facts = read_more_drones(
        args.more_drones,
        model_axes=plan.manifest.get("rules", {}).get("model_axes", "flu"),
        axes=args.more_axes,
        metres_per_unit=args.more_units,
        textures=args.more_textures,
        roughness=args.roughness,
        metallic=args.metallic,
    )
    stage("preparing the light")
    environments, light_facts = read_panoramas(args.panoramas)
    workers = args.workers or _cores()
    studio = Studio(scene, [drone, *further], samples=args.samples, threads=1 if workers > 1 else 0)
    building = args.building or plan.manifest.get("scene") or _name(args.scene)
    stage("rendering")
    begin, last, before = time.monotonic(), 0.0, -1

    def progress(done: int, total: int) -> None:
        nonlocal last, before
        now = time.monotonic()
        before = done - 1 if before < 0 else before  # of an earlier run
        if now - begin > 2 and (now - last > 1 or done == total):
            rate = (done - before) / (now - begin)
            text = f"{done}/{total} rows, {rate:.1f} a second, {(total - done) / rate:.0f} s left"
            end = "\r" if sys.stderr.isatty() else "\n"
            if sys.stderr.isatty() or now - last > 10 or done == total:
                print(text, end=end, file=sys.stderr, flush=True)
                last = now

    return write_dataset(
        args.out,
        plan,
        studio,
        cameras,
        building=building,
        drone=args.drone_name or _name(args.drone),
        split=args.split or plan.manifest.get("split") or "train",
        date=args.date,
        environments=environments,
        settings=settings,
        inputs={"scene": scene_facts, "drone": drone_facts, "panoramas": light_facts,
                "samples": args.samples, "licences": licences,
                **({"more_drones": further_facts} if further else {})},
        shard=(int(match[1]), int(match[2])),
        workers=workers,
        progress=progress,
    )  # fmt: skip


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _name(file: str) -> str:
    """Of a file, without what names must not have."""
    return re.sub(r"[_/\\\s]+", "-", Path(file).stem) or "scene"
