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
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
os.environ.setdefault("LP_NUM_THREADS", "0")  # llvmpipe draws in the calling thread

import numpy as np  # noqa: E402  (after the thread counts)

import dronepose  # noqa: E402
from dronepose import Camera, Mesh, render  # noqa: E402

Array = np.ndarray
FOV_FOCAL = 252.72 / 240.0
SIGMA_NDC = 1e-4


def default_mesh() -> Path:
    """The drone of the data folder, or the example."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("DRONEPOSE_SHARED", root.parent / "shared"))
    drone = folder / "data" / "drones" / "dji_mavic2" / "DJI.obj"
    return drone if drone.exists() else root / "examples" / "quadrotor.obj"


def load(path: Path) -> Mesh:
    """In metres, equal vertices merged: deodr finds edges by the indices of vertices."""
    mesh = Mesh.from_file(path)
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(vertices, faces[distinct])


def noisy_sphere(faces: int) -> Mesh:
    """About so many faces in bands, radius 20 cm with 5 % of noise."""
    bands = max(3, round((faces / 4) ** 0.5))
    around = 2 * bands
    theta = np.linspace(0, np.pi, bands + 1)[1:-1, None]
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    ring = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1
    ).reshape(-1, 3)
    points = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]])
    points = points * (0.2 + 0.01 * np.random.default_rng(0).uniform(-1, 1, (len(points), 1)))
    i, j = (a.reshape(-1) for a in np.mgrid[0 : bands - 2, 0:around])
    k = (j + 1) % around
    a, b, c, d = i * around + j, i * around + k, (i + 1) * around + j, (i + 1) * around + k
    j = np.arange(around)
    k, last, top = (j + 1) % around, (bands - 2) * around, len(ring)
    caps = [
        np.stack([np.full(around, top), j, k], 1),
        np.stack([np.full(around, top + 1), last + k, last + j], 1),
    ]
    return Mesh(points, np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1), *caps]))


def camera(height: int, width: int) -> Camera:
    focal = FOV_FOCAL * height
    return Camera(focal, focal, width / 2, height / 2, width=width, height=height)


def poses(count: int) -> tuple[Array, Array]:
    """Rotations of every kind, the drone within the image."""
    rng = np.random.default_rng(1)
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    R = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        1,
    )
    depth = rng.uniform(0.8, 1.5, count)
    t = np.stack([rng.uniform(-0.3, 0.3, count), rng.uniform(-0.2, 0.2, count), np.ones(count)], -1)
    return R, t * depth[:, None]


def clock(
    work: Callable[[], Any], images: float, seconds: float, least: int = 3, warm: bool = True
) -> list[float]:
    """Milliseconds an image: least and median on the wall clock, least of the processor."""
    if warm:
        work()
    taken: list[tuple[float, float]] = []
    end = time.perf_counter() + seconds
    while len(taken) < least or (time.perf_counter() < end and len(taken) < 200):
        start = time.perf_counter(), time.process_time()
        work()
        taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    wall, processor = np.array(taken).T * 1e3 / images
    return [float(wall.min()), float(np.median(wall)), float(processor.min())]


@dataclass
class Scene:
    """What every peer draws, and what is right."""

    mesh: Mesh
    camera: Camera
    R: Array
    t: Array
    exact: Array
    hard: Array
    upstream: Array

    def pixels(self, k: int) -> tuple[Array, Array]:
        """Vertices of image `k`: pixels `(V, 2)` and depths `(V,)`."""
        p = self.mesh.vertices @ self.R[k].T + self.t[k]
        f, c = self.camera.fx, (self.camera.cx, self.camera.cy)
        return f * p[:, :2] / p[:, 2:] + c, p[:, 2]


@dataclass
class Row:
    """`like` names the row of ours that draws the like; `area` is over the exact area."""

    name: str
    like: str
    area: float
    ms: list[float]
    images: float


def check(name: str, area: float, low: float, high: float) -> None:
    if not low <= area <= high:
        raise AssertionError(f"{name}: {area:.3f} of the area, expected {low} to {high}")


def scene_of(mesh: Mesh, height: int, width: int, count: int) -> Scene:
    R, t = poses(count)
    view = camera(height, width)
    exact = render.silhouette(mesh, view, R, t)
    hard = render.silhouette(mesh, view, R, t, mode="hard")
    upstream = np.random.default_rng(2).normal(size=hard.shape).astype(np.float32)
    return Scene(mesh, view, R, t, exact, hard, upstream)


MODES: dict[str, dict[str, Any]] = {
    "hard": {"mode": "hard"},
    "coverage": {"mode": "coverage"},
    "coverage, sigma 1": {"mode": "coverage", "sigma": 1.0},
    "dibr": {"mode": "dibr"},
    "sigmoid": {"mode": "sigmoid", "sigma_ndc": SIGMA_NDC},
}


def work_of(scene: Scene, name: str, backward: bool, threads: int) -> Callable[[], Any]:
    arguments = (scene.mesh, scene.camera, scene.R, scene.t)
    if name == "depth, face":
        return lambda: render.gbuffer(*arguments, threads=threads)
    out = np.empty_like(scene.hard)

    def forward() -> Array:
        return render.silhouette(*arguments, **MODES[name], out=out, threads=threads)

    def both() -> Any:
        forward()
        return render.silhouette_gradients(
            *arguments, scene.upstream, **MODES[name], vertices=False, threads=threads
        )

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
            low, high = (0.99, 1.01) if name not in ("dibr", "sigmoid") else (1.0, 2.5)
            check(like, area, low, high)
            if backward:
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


def opencv(scene: Scene, seconds: float) -> list[Row]:
    import cv2

    cv2.setNumThreads(1)
    height, width = scene.hard.shape[1:]
    image = np.empty((height, width), np.uint8)
    count = min(8, len(scene.R))

    def corners(k: int) -> Array:
        # OpenCV's integers are centres of pixels; four bits behind the point.
        uv, _ = scene.pixels(k)
        return np.round((uv - 0.5) * 16).astype(np.int32)[scene.mesh.faces]

    def polygons(k: int) -> Array:
        image.fill(0)
        cv2.fillPoly(image, corners(k), 1, shift=4)
        return image

    def convex(k: int) -> Array:
        image.fill(0)
        for triangle in corners(k):
            cv2.fillConvexPoly(image, triangle, 1, shift=4)
        return image

    found = []
    # It fills the outline's pixels too. fillPoly is even-odd over all polygons given at once,
    # and leaves holes where triangles overlap.
    for name, draw, low in (("fillPoly at once", polygons, 0.3), ("fillConvexPoly", convex, 1.0)):
        masks = np.stack([draw(k).copy() for k in range(count)])
        area = float(masks.sum() / scene.exact[:count].sum())
        check(name, area, low, 2.0)
        if draw is convex and ((scene.hard[:count] > 0) & (masks == 0)).mean() > 1e-4:
            raise AssertionError("fillConvexPoly lacks pixels")
        ms = clock(lambda d=draw: [d(k) for k in range(count)], count, seconds)
        found.append(Row(f"OpenCV {name}", "hard", area, ms, count))
    return found


def deodr(scene: Scene, seconds: float) -> list[Row]:
    from deodr import differentiable_renderer as d

    mesh, view = scene.mesh, scene.camera
    faces = mesh.faces.astype(np.uint32)
    v, f = len(mesh.vertices), len(faces)
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1, 3)
    size = (view.height, view.width)
    count = min(8, len(scene.R))

    def draw(k: int, backward: bool, culling: bool = True) -> Any:
        uv, depth = scene.pixels(k)
        a, b, c = uv[faces].transpose(1, 0, 2)
        # Clockwise on the screen, as the file winds its faces seen from outside.
        cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        visible = cross < 0
        flags = np.bincount(edges.reshape(-1), np.repeat(visible, 3), edges.max() + 1)[edges] == 1
        drawn = d.Scene2D(
            faces=faces, faces_uv=faces, ij=uv, depths=depth, textured=np.zeros(f, bool),
            uv=np.zeros((v, 2)), shade=np.zeros(v), colors=np.ones((v, 1)),
            shaded=np.zeros(f, bool), edgeflags=flags, height=size[0], width=size[1], nb_colors=1,
            texture=np.zeros((0, 0)), background_color=np.zeros(1), clockwise=False,
            backface_culling=culling, integer_pixel_centers=False,
        )  # fmt: skip
        image, z = np.empty((*size, 1)), np.empty(size)
        d.renderScene(drawn, 1.0, image, z)
        if not backward:
            return image
        drawn.clear_gradients()
        # It overwrites what it is given.
        upstream = scene.upstream[k, :, :, None].astype(np.float64)
        d.renderSceneB(drawn, 1.0, image.copy(), z, upstream)
        p = drawn.ij_b * view.fx / depth[:, None]
        last = -(p * (uv - (view.cx, view.cy))).sum(1) / view.fx
        grad = np.column_stack([p, last])
        return grad.T @ mesh.vertices, grad.sum(0)

    found = []
    for backward in (False, True):
        images = np.stack([draw(k, False)[:, :, 0] for k in range(count)])
        area = float(images.sum() / scene.exact[:count].sum())
        check("deodr", area, 0.85, 1.25)
        if backward:
            gradient = draw(0, True)
            if not (np.isfinite(gradient[0]).all() and np.abs(gradient[1]).min() > 0):
                raise AssertionError("deodr: no gradient")
        ms = clock(lambda w=backward: [draw(k, w) for k in range(count)], count, seconds)
        like = "coverage + gradient" if backward else "coverage"
        found.append(Row("deodr" + (" + gradient" if backward else ""), like, area, ms, count))
    return found


def llvmpipe(scene: Scene, seconds: float) -> list[Row]:
    import moderngl

    gl = moderngl.create_context(standalone=True, backend="egl", require=330)
    view, name = scene.camera, str(gl.info["GL_RENDERER"])
    if "llvmpipe" not in name:
        raise RuntimeError(f"the context is {name}, not llvmpipe")
    program = gl.program(
        vertex_shader="""
            #version 330
            uniform mat4 m;
            in vec3 p;
            void main() { gl_Position = m * vec4(p, 1.0); }
        """,
        fragment_shader="#version 330\nout float c;\nvoid main() { c = 1.0; }",
    )
    points = gl.buffer(scene.mesh.vertices.astype("f4").tobytes())
    index = gl.buffer(scene.mesh.faces.astype("i4").tobytes())
    array = gl.vertex_array(program, [(points, "3f", "p")], index)
    target = gl.framebuffer([gl.renderbuffer((view.width, view.height), 1)])
    target.use()
    near, far = 0.01, 100.0
    # The row at the bottom is read first: v up in GL's frame is v down in the picture.
    projection = np.array(
        [
            [2 * view.fx / view.width, 0, 2 * view.cx / view.width - 1, 0],
            [0, 2 * view.fy / view.height, 2 * view.cy / view.height - 1, 0],
            [0, 0, (far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, 1, 0],
        ]
    )
    out = np.empty((len(scene.R), view.height, view.width), np.uint8)

    def draw() -> Array:
        for k in range(len(scene.R)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = scene.R[k], scene.t[k]
            program["m"].write((projection @ pose).T.astype("f4").tobytes())
            target.clear()
            array.render()
            target.read_into(out[k], components=1, alignment=1)
        return out

    masks = draw() > 0
    area = float(masks.sum() / scene.exact.sum())
    check("llvmpipe", area, 0.99, 1.01)
    if (masks != (scene.hard > 0)).mean() > 1e-3:
        raise AssertionError("llvmpipe: other pixels")
    threads = os.environ["LP_NUM_THREADS"]
    label = f"moderngl on {name.split(' (')[0]}, LP_NUM_THREADS={threads}"
    return [Row(label, "hard", area, clock(draw, len(scene.R), seconds), len(scene.R))]


def llvmpipe_apart(path: Path, seconds: float) -> list[Row]:
    """In a process of its own: Mesa's LLVM and that of torch do not bear each other."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(llvmpipe_task, path, seconds).result()


def llvmpipe_task(path: Path, seconds: float) -> list[Row]:
    return llvmpipe(scene_of(load(path), 240, 320, 64), seconds)


def embree(scene: Scene, seconds: float) -> list[Row]:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    world = rtcore_scene.EmbreeScene()
    corners = scene.mesh.vertices[scene.mesh.faces].astype(np.float32)
    keep = TriangleMesh(world, corners)
    view, count = scene.camera, min(8, len(scene.R))
    v, u = np.mgrid[0 : view.height, 0 : view.width] + 0.5
    rays = np.stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, np.ones_like(u)], -1)
    rays = rays.reshape(-1, 3)

    def draw(k: int) -> Array:
        directions = (rays @ scene.R[k]).astype(np.float32)
        origin = (-scene.R[k].T @ scene.t[k]).astype(np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(origin, directions.shape))
        return world.run(origins, directions).reshape(view.height, view.width)

    masks = np.stack([draw(k) >= 0 for k in range(count)])
    area = float(masks.sum() / scene.exact[:count].sum())
    check("embree", area, 0.98, 1.02)
    ms = clock(lambda: [draw(k) for k in range(count)], count, seconds)
    del keep
    return [Row("embreex, nearest face by rays", "depth, face", area, ms, count)]


def naive_torch(scene: Scene, stride: int, threads: int) -> list[Row]:
    """SoftRas's mask of every so-many-th row, all faces in chunks; each chunk drawn again."""
    import torch
    from torch.utils.checkpoint import checkpoint

    torch.set_num_threads(threads)
    view = scene.camera
    vertices = torch.from_numpy(scene.mesh.vertices.astype("f4"))
    faces = torch.from_numpy(scene.mesh.faces.astype("i8"))
    R = torch.from_numpy(scene.R[0].astype("f4"))
    t = torch.from_numpy(scene.t[0].astype("f4")).requires_grad_()
    rows = torch.arange(stride // 2, view.height, stride)
    v, u = torch.meshgrid(rows + 0.5, torch.arange(view.width) + 0.5, indexing="ij")
    px, py = u.reshape(-1, 1), v.reshape(-1, 1)
    unit = min(view.height, view.width) / 2

    def outside(triangles: torch.Tensor) -> torch.Tensor:
        """Sum over faces of `log(1 - p)`."""
        d2, signs = None, []
        for k in range(3):
            (ax, ay), (bx, by) = triangles[:, k].T, triangles[:, (k + 1) % 3].T
            ex, ey = bx - ax, by - ay
            x, y = px - ax, py - ay
            s = ((x * ex + y * ey) / (ex * ex + ey * ey).clamp_min(1e-12)).clamp(0, 1)
            near = (x - s * ex).square() + (y - s * ey).square()
            d2 = near if d2 is None else torch.minimum(d2, near)
            signs.append(ex * y - ey * x > 0)
        d2 = d2 / unit**2
        inside = (signs[0] == signs[1]) & (signs[1] == signs[2])
        x = torch.where(inside, d2, -d2) / SIGMA_NDC
        return -torch.nn.functional.softplus(x).sum(1)

    def forward() -> torch.Tensor:
        p = vertices @ R.T + t
        uv = view.fx * p[:, :2] / p[:, 2:] + torch.tensor([view.cx, view.cy])
        total = torch.zeros(len(px))
        for part in uv[faces].split(64):
            total = total + checkpoint(outside, part, use_reentrant=False)
        return 1 - torch.exp(total)

    def both() -> None:
        t.grad = None
        forward().sum().backward()

    with torch.no_grad():
        mask = forward().reshape(len(rows), -1).numpy()
    wanted = render.silhouette(scene.mesh, view, scene.R[:1], scene.t[:1], **MODES["sigmoid"])[0]
    if np.abs(mask - wanted[rows.numpy()]).max() > 2e-3:
        raise AssertionError("torch: another mask than that of mode sigmoid")
    area = float(mask.sum() / scene.exact[0, rows.numpy()].sum())
    found = []
    plural = "thread" if threads == 1 else "threads"
    for like, work in (("sigmoid", forward), ("sigmoid + gradient", both)):
        if like == "sigmoid":
            with torch.no_grad():
                ms = clock(work, 1 / stride, 0, 2, False)
        else:
            ms = clock(work, 1 / stride, 0, 2, False)
        label = f"naive torch {like}, {threads} {plural}"
        found.append(Row(label, like, area, ms, 1 / stride))
    return found


KINDS = (("hard", False), ("coverage", False), ("coverage", True), ("dibr", False), ("dibr", True))


def growth(title: str, scenes: list[tuple[str, Scene]], seconds: float) -> list[dict[str, Any]]:
    """Least milliseconds an image of some modes, one thread, of the processor."""
    heads = [name + (" + gradient" if backward else "") for name, backward in KINDS]
    print(f"\n{title}, one thread, processor ms an image, least of three or more\n")
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
        if Path("/proc/self/clear_refs").exists():
            document["memory"] = memory(options.mesh, options.quick)
        else:
            print("\nskipped: peak memory: needs Linux")
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
