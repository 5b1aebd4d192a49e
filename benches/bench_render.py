"""Silhouettes, their gradients and depth against what is installed, in one run, on one model.

    python benches/bench_render.py [--quick] [--mesh FILE] [--json FILE]

64 random rotations 0.8 to 1.5 m away in images of 320 x 240 pixels; peers draw some of the same
images. Milliseconds an image, on the wall clock (least and median of several repetitions) and of
the processor, all threads together (least; it stands still while other programs have the core). A
ratio is that to the row of ours that draws the like with one thread, by least wall clock and by
processor. Projecting the vertices counts for everyone, building the mesh for none. Every picture
is compared before it is timed: "area" is the sum of the mask over the exact area of the silhouette.

Peers, each optional and skipped with the reason: torch (naive: SoftRas's formula for all faces, in
chunks, by autograd; few rows of one image, scaled), opencv-python-headless (fillPoly,
fillConvexPoly), deodr, moderngl on llvmpipe (EGL), embreex.
"""

import argparse
import json
import os
import platform
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy and torch are loaded; processes inherit it
os.environ.setdefault("LP_NUM_THREADS", "0")  # llvmpipe draws in the calling thread

import numpy as np  # noqa: E402
from render_peers import deodr, embree, llvmpipe_apart, naive_torch, opencv  # noqa: E402
from render_scene import (  # noqa: E402
    BOXES,
    KAOLIN,
    MODES,
    PYTORCH3D,
    Array,
    Row,
    Scene,
    camera,
    check,
    clock,
    default_mesh,
    load,
    noisy_sphere,
    poses,
    scene_of,
)

import dronepose  # noqa: E402
from dronepose import render  # noqa: E402


def work_of(scene: Scene, name: str, backward: bool, threads: int) -> Callable[[], Any]:
    arguments = (scene.mesh, scene.camera, scene.R, scene.t)
    if name == "depth, face":
        return lambda: render.gbuffer(*arguments, threads=threads)
    out = np.empty_like(scene.hard)

    def forward() -> Array:
        return render.silhouette(*arguments, **MODES[name], out=out, threads=threads)

    def both() -> Any:
        _masks, pull_back = render.silhouette_vjp(*arguments, **MODES[name], threads=threads)
        return pull_back(scene.upstream, vertices=False)

    return both if backward else forward


def ours(scene: Scene, seconds: float, threads: tuple[int, ...]) -> list[Row]:
    found = []
    truth, count = float(scene.exact.sum()), len(scene.R)
    for name in (*MODES, "depth, face"):
        for backward in (False, True) if name not in ("hard", "depth, face") else (False,):
            like = name + (" + gradient" if backward else "")
            if name == "depth, face":
                seen = render.gbuffer(scene.mesh, scene.camera, scene.R, scene.t).face
                area = float((seen >= 0).sum()) / truth
            else:
                drawn = render.silhouette(scene.mesh, scene.camera, scene.R, scene.t, **MODES[name])
                area = float(drawn.sum(dtype=np.float64)) / truth
            low, high = (1.0, 2.5) if name.startswith(("dibr", "sigmoid")) else (0.99, 1.01)
            check(like, area, low, high)
            # With cut-offs, the gradient leaves out what they do.
            if backward and name not in (KAOLIN, BOXES, PYTORCH3D):
                check_gradient(scene, name)
            for n in threads:
                ms = clock(work_of(scene, name, backward, n), count, seconds)
                plural = "thread" if n == 1 else "threads"
                found.append(Row(f"dronepose {like}, {n} {plural}", like, area, ms, count))
    return found


def check_gradient(scene: Scene, name: str) -> None:
    """Against a central difference along z in the first image, smooth upstream."""
    v, u = np.mgrid[0 : scene.camera.height, 0 : scene.camera.width]
    upstream = np.sin(u / 17.0) * np.cos(v / 13.0)
    some = (scene.R[:1], scene.t[:1])
    g = render.silhouette_gradients(
        scene.mesh, scene.camera, *some, upstream[None], **MODES[name], vertices=False
    )
    step = np.array([0, 0, 1e-5])
    high, low = (
        render.silhouette(
            scene.mesh, scene.camera, some[0], some[1] + s, **MODES[name], dtype=np.float64
        )
        for s in (step, -step)
    )
    expected = float(((high - low) * upstream).sum() / 2e-5)
    if abs(g.t[0, 2] - expected) > 0.02 * abs(expected) + 1:
        raise AssertionError(f"{name}: gradient {g.t[0, 2]}, central difference {expected}")


ONE = (
    ("hard", False),
    ("coverage", False),
    ("coverage", True),
    ("coverage, sigma 1", False),
    ("coverage, sigma 1", True),
    ("dibr", False),
    ("dibr", True),
    ("sigmoid", True),
)
KINDS = (("hard", False), ("coverage", False), ("coverage", True), ("dibr", False), ("dibr", True))


def growth(title: str, scenes: list[tuple[str, Scene]], seconds: float) -> list[dict[str, Any]]:
    """Milliseconds of the processor an image, in the quickest run, of some modes, one thread."""
    heads = [name + (" + gradient" if backward else "") for name, backward in KINDS]
    print(f"\n{title}, one thread, processor ms an image, the quickest of three or more\n")
    print("| | " + " | ".join(heads) + " |\n|--:|" + "--:|" * len(heads))
    found = []
    for label, scene in scenes:
        ms = [
            clock(work_of(scene, name, backward, 1), len(scene.R), seconds, warm=False)[2]
            for name, backward in KINDS
        ]
        print(f"| {label} | " + " | ".join(f"{x:.3f}" for x in ms) + " |", flush=True)
        found.append({"of": label, **dict(zip(heads, ms, strict=True))})
    return found


def alone(scenes: list[tuple[str, Scene]], seconds: float) -> list[dict[str, Any]]:
    """Milliseconds of one image in a call, by one thread, two, and as many as are taken unasked."""
    print("\nOne image in a call, least ms by one thread, by two, and where that is left open\n")
    print("| | | 1 thread | 2 threads | faster | left open |\n|---|---|--:|--:|--:|--:|")
    found = []
    for label, scene in scenes:
        for name, backward in ONE:
            one, two, free = (
                clock(work_of(scene, name, backward, n), 1, seconds)[0] for n in (1, 2, 0)
            )
            kind = name + (" + gradient" if backward else "")
            ms = f"{one:.3f} | {two:.3f} | {one / two:.2f} | {free:.3f}"
            print(f"| {label} | {kind} | {ms} |", flush=True)
            found.append({"of": label, "mode": kind, "one": one, "two": two, "open": free})
    return found


def status(name: str) -> float:
    """MiB of this process (Linux)."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(name)) / 1024


def peak(task: tuple[str, str | int, int, int, int, bool]) -> tuple[float, float]:
    """MiB that the process grew by at its peak, and of the images; in a fresh process."""
    mode, source, height, width, count, backward = task
    mesh = noisy_sphere(source) if isinstance(source, int) else load(Path(source))
    R, t = poses(count)
    upstream = np.ones((count, height, width), np.float32) if backward else None
    work = (mesh, camera(height, width), R, t)
    render.silhouette(mesh, camera(8, 8), R[:1], t[:1], mode="hard", threads=1)
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak so far is forgotten
    before = status("VmRSS")
    if upstream is None:
        render.silhouette(*work, **MODES[mode], threads=1)
    else:
        render.silhouette_gradients(*work, upstream, **MODES[mode], vertices=False, threads=1)
    return status("VmHWM") - before, count * height * width * 4 / 2**20


def memory(path: Path, quick: bool) -> list[dict[str, Any]]:
    print("\nPeak memory: growth of a fresh process by one call, one thread\n")
    print("| mode | mesh | images | growth | the images themselves |\n|---|---|---|--:|--:|")
    tasks: list[tuple[str, str | int, int, int, int, bool]] = []
    for mode, backward in KINDS:
        tasks += [(mode, str(path), 240, 320, 64, backward)]
        if not quick:
            tasks += [(mode, str(path), 2160, 3840, 1, backward)]
            tasks += [(mode, 500_000, 240, 320, 4, backward)]
    found = []
    context = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        for task, (grown, images) in zip(tasks, pool.map(peak, tasks), strict=True):
            mode, source, height, width, count, backward = task
            name = mode + (" gradient" if backward else "")
            mesh = f"{source} faces" if isinstance(source, int) else Path(source).name
            size = f"{count} x {width} x {height}"
            of = "none kept" if backward else f"{images:.0f} MiB"
            print(f"| {name} | {mesh} | {size} | {grown:.0f} MiB | {of} |", flush=True)
            found.append({"mode": name, "mesh": mesh, "images": size, "growth_mib": grown})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", type=Path, default=default_mesh(), help="metres")
    parser.add_argument("--quick", action="store_true", help="under a minute")
    parser.add_argument("--no-peers", action="store_true", help="only ours, and growth")
    parser.add_argument("--no-growth", action="store_true", help="only the first table")
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    options = parser.parse_args()
    seconds = 0.2 if options.quick else 0.8
    mesh = load(options.mesh)
    scene = scene_of(mesh, 240, 320, 64)
    print(
        f"{options.mesh.name}: {len(mesh.vertices)} distinct vertices, {len(mesh.faces)} faces; "
        f"dronepose {dronepose.__version__}, Python {platform.python_version()}, "
        f"numpy {np.__version__}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n"
    )
    rows = ours(scene, seconds, (1, 2))
    skipped = {}
    peers: dict[str, Callable[[], list[Row]]] = {
        "OpenCV": lambda: opencv(scene, seconds),
        "deodr": lambda: deodr(scene, seconds),
        "llvmpipe": lambda: llvmpipe_apart(options.mesh, seconds),
        "embreex": lambda: embree(scene, seconds),
        "torch, one thread": lambda: naive_torch(scene, 48, 1),
    }
    for name, peer in ({} if options.no_peers else peers).items():
        try:
            rows += peer()
        except ImportError as error:
            skipped[name] = f"not installed ({error})"
        except Exception as error:
            # A driver that is missing says so in many ways; a wrong picture is no skip.
            if isinstance(error, AssertionError):
                raise
            skipped[name] = f"{type(error).__name__}: {error}"
    one = ", 1 thread"
    base = {r.like: r.ms for r in rows if r.name.startswith("dronepose") and r.name.endswith(one)}
    print("| | least ms | median ms | processor ms | area | ratio | by processor | to |")
    print("|---|--:|--:|--:|--:|--:|--:|---|")
    for r in rows:
        ratios = [r.ms[k] / base[r.like][k] for k in (0, 2)]
        against = " | ".join(f"{x:.2f}" if x < 10 else f"{x:,.0f}" for x in ratios)
        times = " | ".join(f"{x:.3f}" if x < 100 else f"{x:,.0f}" for x in r.ms)
        print(f"| {r.name} | {times} | {r.area:.3f} | {against} | {r.like} |", flush=True)
    for name, reason in skipped.items():
        print(f"\nskipped: {name}: {reason}")
    document: dict[str, Any] = {
        "mesh": options.mesh.name,
        "faces": len(mesh.faces),
        "skipped": skipped,
        "rows": [{**vars(r), "ratio": r.ms[0] / base[r.like][0]} for r in rows],
    }
    if not options.no_growth:
        few_s = seconds / 4
        sizes = [(240, 320), (480, 640), (720, 1280), (1080, 1920), (2160, 3840)]
        counts = [1, 8, 64, 512]
        numbers = [500, 5_000, 50_000, 500_000]
        if options.quick:
            sizes, counts, numbers = sizes[:3], counts[:3], numbers[:3]
        spheres = [noisy_sphere(n) for n in numbers]
        document["faces growth"] = growth(
            "Faces of a noisy sphere, 4 images of 320 x 240",
            [(f"{len(s.faces):,}", scene_of(s, 240, 320, 4)) for s in spheres],
            few_s,
        )
        document["size growth"] = growth(
            "Size of the image, 4 images",
            [(f"{w} x {h}", scene_of(mesh, h, w, 4)) for h, w in sizes],
            few_s,
        )
        document["batch growth"] = growth(
            "Images in one call, 320 x 240",
            [(str(n), scene_of(mesh, 240, 320, n)) for n in counts],
            few_s,
        )
        document["one image"] = alone(
            [(f"{w} x {h}", scene_of(mesh, h, w, 1)) for h, w in (sizes[0], *sizes[2:])], few_s
        )
        if Path("/proc/self/clear_refs").exists():
            document["memory"] = memory(options.mesh, options.quick)
        else:
            print("\nskipped: peak memory: needs Linux")
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
