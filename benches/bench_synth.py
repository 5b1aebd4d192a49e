"""Samples a second of `dronepose synth render`, all modalities written, and its memory.

    python benches/bench_synth.py [--rows 40] [--scene FILE] [--workers N]
    python benches/bench_synth.py --shares
    python benches/bench_synth.py --memory [--rows 10000] [--size 160x120]

Without `--scene`: the placed house of the data folder if it is there (81,186 faces), else the hall
that the project makes. The drone is the project's quadrotor, the flight the example's; where there
are more rows than it has, they are repeated. `--memory` renders the hall and prints the resident
memory ten times on the way; images are removed as they come, so that it needs no disk. `--shares`
says, for one worker, what part of the time goes into colours, the G-buffer and flow.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from dronepose import render
from dronepose.camera import Camera
from dronepose.synth import Rules, make_plan, read_anchors, read_flight, read_plan, write_example
from dronepose.synth.dataset import write_dataset
from dronepose.synth.inputs import cameras_of, read_drone, read_panoramas, read_scene
from dronepose.synth.plan import PlanTable
from dronepose.synth.studio import Studio


def default_scene() -> str:
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("DRONEPOSE_SHARED", root.parent / "shared"))
    house = folder / "data" / "scenes" / "small_house" / "placements.csv"
    return str(house) if house.exists() else "example"


def resident_mb(field: str = "VmRSS") -> float:
    """Resident memory of this process as Linux counts it, now or (`VmHWM`) at most."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field)) / 1024


def example_plan(folder: Path, rows: int, rules: Rules) -> PlanTable:
    """Rows of the example's flight, evenly spread, repeated where there are not so many."""
    paths = write_example(folder)
    made = make_plan(read_flight(paths["flight"]), read_anchors(paths["anchors"]), rules)
    made.some(rows).write(folder / "plan.csv")
    table = read_plan(folder / "plan.csv")
    times = -(-rows // len(table))
    columns = {name: np.tile(values, times)[:rows] for name, values in table.columns.items()}
    ids, anchors = (list(part) * times for part in (table.ids, table.anchors))
    return PlanTable(ids[:rows], anchors[:rows], columns, table.manifest)


class Shares:
    """Times what the studio asks of the renderer."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("colour", "gbuffer", "flow"), 0.0)
        for name in self.seconds:
            setattr(render, name, self.timed(name, getattr(render, name)))

    def timed(self, name, work):
        def run(*args, **options):
            begin = time.perf_counter()
            found = work(*args, **options)
            self.seconds[name] += time.perf_counter() - begin
            return found

        return run


class Memory:
    """Prints the resident memory ten times, and removes images meanwhile."""

    def __init__(self, images: Path, rows: int) -> None:
        self.images, self.every = images, max(rows // 10, 1)
        self.points: list[tuple[int, float]] = []

    def __call__(self, done: int, total: int) -> None:
        if done % 100 == 0:
            for path in self.images.rglob("[0-9]*.png"):  # not what is being written
                path.unlink()
        if done % self.every == 0:
            self.points.append((done, resident_mb()))
            print(f"{done:6d} rows  {self.points[-1][1]:7.1f} MB", flush=True)

    def growth(self) -> float:
        """MB for 1,000 rows: slope of the line through all points but those of the first tenth."""
        rows, mb = np.array(self.points[2:]).T
        return float(1000 * np.polyfit(rows, mb, 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int)
    parser.add_argument("--scene")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--size", default="320x240", help="of the exocentric camera, WxH")
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--shares", action="store_true")
    args = parser.parse_args()
    shares = Shares() if args.shares else None
    args.workers = 1 if args.shares else args.workers
    rows = args.rows or (10_000 if args.memory else 40)
    name = args.scene or ("example" if args.memory else default_scene())
    scene, _ = read_scene(name)
    environments, _ = read_panoramas(None)
    studio = Studio(scene, [read_drone("example")[0]], samples=3, threads=1)
    width, height = map(int, args.size.split("x"))
    rules = Rules(
        exo=Camera.from_fov(width, height, horizontal_deg=64.69),
        ego=Camera.from_fov(width, height * 3 // 4, horizontal_deg=85.0),
    )
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        table = example_plan(folder, rows, rules)
        memory = Memory(folder / "set" / "drone", rows) if args.memory else None
        begin = time.perf_counter(), time.process_time()
        made = write_dataset(
            folder / "set", table, studio, cameras_of(table), building="bench",
            environments=environments, workers=args.workers, progress=memory,
        )  # fmt: skip
        wall, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
    print(f"scene {Path(name).name}, {len(scene.mesh.faces)} faces, {args.workers} workers, "
          f"images {args.size}")  # fmt: skip
    print(f"{made['kept']} of {made['rows']} rows kept")
    print(f"{made['rows'] / wall:.1f} rows a second, {1e3 * processor / made['rows']:.0f} ms of "
          "one core a row")  # fmt: skip
    if shares is not None:
        parts = {**shares.seconds, "rest": wall - sum(shares.seconds.values())}
        print(", ".join(f"{name} {100 * part / wall:.0f} %" for name, part in parts.items()))
    if memory is not None:
        print(f"after all {resident_mb():.1f} MB, at most {resident_mb('VmHWM'):.1f} MB; "
              f"growth {memory.growth():+.2f} MB for 1,000 rows")  # fmt: skip


if __name__ == "__main__":
    main()
