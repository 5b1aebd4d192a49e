"""The peers of `bench_render.py`: each draws its images, checks them, and is timed."""

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from render_scene import MODES, SIGMA_NDC, Array, Row, Scene, check, clock, load, scene_of

from dronepose import render


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
