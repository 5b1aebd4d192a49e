"""Samples a second of `dronepose synth render`, all modalities written, and where the time goes.

    python benches/bench_synth.py [--rows 40] [--scene FILE] [--workers N]

Without `--scene`: the placed house of the data folder if it is there (81,186 faces), else the hall
that the project makes. The drone is the project's quadrotor, the flight the example's.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from dronepose.synth import make_plan, read_anchors, read_flight, read_plan, write_example
from dronepose.synth.dataset import write_dataset
from dronepose.synth.inputs import cameras_of, read_drone, read_panoramas, read_scene
from dronepose.synth.studio import Studio


def default_scene() -> str:
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("DRONEPOSE_SHARED", root.parent / "shared"))
    house = folder / "data" / "scenes" / "small_house" / "placements.csv"
    return str(house) if house.exists() else "example"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=40)
    parser.add_argument("--scene", default=default_scene())
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    scene, _ = read_scene(args.scene)
    environments, _ = read_panoramas(None)
    studio = Studio(scene, [read_drone("example")[0]], samples=3, threads=1)
    with tempfile.TemporaryDirectory() as name:
        paths = write_example(name)
        plan = make_plan(read_flight(paths["flight"]), read_anchors(paths["anchors"]))
        keep = np.zeros(len(plan), bool)
        keep[np.linspace(0, len(plan) - 1, args.rows).astype(int)] = True
        plan.keep(keep, "some", "as many as are timed").write(Path(name) / "plan.csv")
        table = read_plan(Path(name) / "plan.csv")
        begin = time.perf_counter(), time.process_time()
        made = write_dataset(
            Path(name) / "set", table, studio, cameras_of(table), building="bench",
            environments=environments, workers=args.workers,
        )  # fmt: skip
        wall, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
    print(f"scene {Path(args.scene).name}, {len(scene.mesh.faces)} faces, {args.workers} workers")
    print(f"{made['kept']} of {made['rows']} rows kept")
    print(f"{made['rows'] / wall:.1f} rows a second, {1e3 * processor / made['rows']:.0f} ms of "
          "one core a row")  # fmt: skip


if __name__ == "__main__":
    main()
