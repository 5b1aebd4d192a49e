"""A portable build against one for this very processor, by the least times of benches/minima.rs.

    python benches/bench_builds.py [--mesh FILE] [--repetitions N] [--rounds N]

Both are built by Cargo, each in a folder of its own below target/, and run in turns, so that a busy
spell of the machine meets both. The portable build is what is published: it looks for AVX2 and
AVX-512 as it runs. Microseconds an image of 320 x 240 pixels, one thread, least over all rounds.
"""

import argparse
import json
import os
import subprocess
from pathlib import Path

from render_scene import default_mesh

ROOT = Path(__file__).resolve().parents[1]
FLAGS = {"portable": "", "native": "-C target-cpu=native"}


def build(name: str) -> Path:
    """The program."""
    command = ["cargo", "build", "--release", "--bench", "minima", "--message-format", "json"]
    folder = ROOT / "target" / "builds" / name
    environment = {**os.environ, "RUSTFLAGS": FLAGS[name], "CARGO_TARGET_DIR": str(folder)}
    done = subprocess.run(
        command, cwd=ROOT / "crates" / "raster", env=environment, stdout=subprocess.PIPE, check=True
    )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    return next(
        Path(m["executable"])
        for m in found
        if m.get("executable") and m["target"]["name"] == "minima"
    )


def times(program: Path, mesh: Path, repetitions: int) -> dict[str, float]:
    """By what is drawn."""
    environment = {**os.environ, "DRONEPOSE_BENCH_MESH": str(mesh)}
    command = [program, str(repetitions)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    pairs = (line.split(" ", 1) for line in done.stdout.splitlines())
    return {name: float(time) for time, name in pairs}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", type=Path, default=default_mesh(), help="metres")
    parser.add_argument("--repetitions", type=int, default=20, help="of each image in a round")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    programs = {name: build(name) for name in FLAGS}
    best: dict[str, dict[str, float]] = {name: {} for name in FLAGS}
    for _ in range(options.rounds):
        for name, program in programs.items():
            for what, time in times(program, options.mesh.resolve(), options.repetitions).items():
                best[name][what] = min(time, best[name].get(what, time))
    print("| | portable | native | portable / native |\n|---|--:|--:|--:|")
    for what, portable in best["portable"].items():
        native = best["native"][what]
        print(f"| {what} | {portable:.1f} µs | {native:.1f} µs | {portable / native:.2f} |")


if __name__ == "__main__":
    main()
