"""The smooth silhouette losses, forward and backward, against torch's forms of them, in one run.

    python benches/bench_losses.py [--quick] [--json FILE]

64 pairs of masks of 240 x 320 pixels, one thread, float32: the box of 49 and the Gaussian of 69
pixels (``sigma = 69 / 6``, and the authors' 1.5). Two kinds of masks: noise, where no pixel is 0,
and renders of the example drone. Peers:

* the authors' forms: ``AvgPool2d(49, 1, 24, count_include_pad=False)`` and a dense ``conv2d`` of
  69 x 69, each applied four times as in their loss, at a small batch and scaled to 64;
* the best torch forms that we know, with two blurs instead of four: cumulative sums and a pooling
  of each axis for the box, FFT and a ``conv2d`` of each axis for the Gaussian.

Values and gradients are compared before anything is timed. Times are the least of several
repetitions, on the wall clock and of the processor (which stands still while other programs have
the core); the losses are also timed alone, without their gradient.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy and torch are loaded

import numpy as np  # noqa: E402
import torch  # noqa: E402
import torch.nn.functional as F  # noqa: E402
from torch import Tensor  # noqa: E402

import dronepose  # noqa: E402
from dronepose import losses, render  # noqa: E402
from dronepose.losses import _formulas  # noqa: E402

BATCH, HEIGHT, WIDTH = 64, 240, 320
BOX, GAUSS = 49, 69
ROOT = Path(__file__).resolve().parent.parent

Blur = Callable[[Tensor], Tensor]
Loss = Callable[[Tensor, Tensor], Tensor]


# ------------------------------------------------------------------------------ peers


def authors_form(blur: Blur) -> Loss:
    """Four blurs, as in the paper's equation."""

    def loss(s: Tensor, y: Tensor) -> Tensor:
        return (y * (blur(1 - s) - blur(s)) + s * (blur(1 - y) - blur(y))).mean()

    return loss


def two_blurs(blur: Blur) -> Loss:
    """With ``g*(1-m) = g*1 - g*m``, the first of which is always the same."""
    ones: dict[torch.Size, Tensor] = {}

    def loss(s: Tensor, y: Tensor) -> Tensor:
        b = ones.setdefault(s.shape[1:], blur(torch.ones_like(s[:1]).detach()))
        return (y * (b - 2 * blur(s)) + s * (b - 2 * blur(y))).mean()

    return loss


def dense_box(m: Tensor) -> Tensor:
    return F.avg_pool2d(m[:, None], BOX, 1, BOX // 2, count_include_pad=False)[:, 0]


def taps_of(sigma: float) -> Tensor:
    x = torch.arange(GAUSS, dtype=torch.float64) - GAUSS // 2
    taps = torch.exp(-x * x / (2 * sigma * sigma))
    return (taps / taps.sum()).float()


def dense_gauss(sigma: float) -> Blur:
    kernel = torch.outer(taps_of(sigma), taps_of(sigma))[None, None]
    return lambda m: F.conv2d(m[:, None], kernel, padding=GAUSS // 2)[:, 0]


def cumulative_box(m: Tensor) -> Tensor:
    """Differences of cumulative sums."""
    r = BOX // 2
    total = F.pad(m.cumsum(1).cumsum(2), (1, 0, 1, 0))
    i0, i1, j0, j1 = (
        (torch.arange(n) + d).clamp(0, n)
        for n, d in ((HEIGHT, -r), (HEIGHT, r + 1), (WIDTH, -r), (WIDTH, r + 1))
    )
    below, above = total[:, i1], total[:, i0]
    sums = below[:, :, j1] - above[:, :, j1] - below[:, :, j0] + above[:, :, j0]
    return sums / ((i1 - i0)[:, None] * (j1 - j0))


def fft_gauss(sigma: float) -> Blur:
    size = (HEIGHT + GAUSS - 1, WIDTH + GAUSS - 1)
    r = GAUSS // 2
    kernel = torch.fft.rfft2(torch.outer(taps_of(sigma), taps_of(sigma)), size)

    def blur(m: Tensor) -> Tensor:
        product = torch.fft.rfft2(m, size) * kernel
        return torch.fft.irfft2(product, size)[:, r : r + HEIGHT, r : r + WIDTH]

    return blur


# ------------------------------------------------------------------------------ timing


def noise() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    s, y = torch.rand(2, BATCH, HEIGHT, WIDTH, generator=generator)
    return s, y


def drones() -> tuple[Tensor, Tensor]:
    mesh = dronepose.Mesh.from_file(ROOT / "examples" / "quadrotor.obj")
    camera = dronepose.Camera.from_fov(WIDTH, HEIGHT, vertical_deg=50.8)
    generator = np.random.default_rng(2)
    t = generator.uniform([-0.3, -0.2, 0.8], [0.3, 0.2, 2.0], (BATCH, 3))
    axis = generator.normal(size=(BATCH, 4))
    R = dronepose.geometry.matrix_from_quat_wxyz(axis / np.linalg.norm(axis, axis=1)[:, None])
    pair = [render.silhouette(mesh, camera, R, t + d, dtype=np.float32) for d in (0.0, 0.03)]
    return torch.from_numpy(pair[1].copy()), torch.from_numpy(pair[0].copy())


def least(work: Callable[[], Any], seconds: float) -> tuple[float, float]:
    """Least wall-clock and processor seconds of some repetitions, after one to warm up.

    One that takes long is not repeated.
    """
    found = []
    while len(found) < 4 or sum(wall for wall, _ in found) < seconds:
        start = time.perf_counter(), time.process_time()
        work()
        found.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        if found[0][0] > 4 * seconds:
            return found[0]
    return min(wall for wall, _ in found[1:]), min(used for _, used in found[1:])


def row(loss: Loss, s: Tensor, y: Tensor, seconds: float, scale: float = 1.0) -> list[float]:
    """Milliseconds: wall clock forward, wall clock and processor forward and backward."""
    alone, together = least(forward(loss, s, y), seconds), least(both_ways(loss, s, y), seconds)
    return [1e3 * scale * t for t in (alone[0], *together)]


def both_ways(loss: Loss, s: Tensor, y: Tensor) -> Callable[[], tuple[float, Tensor]]:
    def work() -> tuple[float, Tensor]:
        pred = s.detach().requires_grad_()
        value = loss(pred, y)
        (slope,) = torch.autograd.grad(value, pred)
        return value.item(), slope

    return work


def forward(loss: Loss, s: Tensor, y: Tensor) -> Callable[[], float]:
    def work() -> float:
        with torch.no_grad():
            return loss(s, y).item()

    return work


def ours(kernel: Any, sigma: Any = None) -> Loss:
    return lambda s, y: losses.smooth_loss(s, y, kernel=kernel, sigma=sigma, num_threads=1)


def agree(name: str, ours: Loss, peer: Loss, s: Tensor, y: Tensor) -> None:
    (a, slope), (b, other) = (both_ways(f, s, y)() for f in (ours, peer))
    gap = (slope - other).abs().max().item() / slope.abs().max().item()
    if abs(a - b) > 1e-5 or gap > 1e-4:
        raise SystemExit(f"{name}: {a} and {b}, gradients {gap:.1e} apart: not the same loss")


def main() -> None:
    parser = argparse.ArgumentParser(description="the smooth silhouette losses against torch's")
    parser.add_argument("--quick", action="store_true", help="shorter repetitions, batches of 1")
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    seconds, few = (0.3, 1) if options.quick else (1.5, 2)
    dense, real = noise(), drones()
    wide, narrow = GAUSS / 6, 1.5
    groups = [
        (f"box {BOX}", ours("box"), dense_box, [
            ("cumulative sums", two_blurs(cumulative_box)),
            ("pooling of each axis", two_blurs(lambda m: _formulas.box_mean(m, BOX))),
        ]),
        (f"Gaussian {GAUSS}, sigma {wide:g}", ours("gaussian"), dense_gauss(wide), [
            ("FFT", two_blurs(fft_gauss(wide))),
            ("conv2d of each axis", two_blurs(
                lambda m: _formulas.gaussian_blur(m, wide, GAUSS // 2))),
        ]),
        (f"Gaussian {GAUSS}, sigma {narrow:g}", ours("gaussian", "authors"), None, [
            ("FFT", two_blurs(fft_gauss(narrow))),
        ]),
    ]  # fmt: skip
    print(f"{platform.processor() or platform.machine()}, torch {torch.__version__}, one thread")
    print(f"{BATCH} x {HEIGHT} x {WIDTH}, milliseconds and ratios to ours of noise: forward,")
    print("forward + backward, and the latter by processor time")
    found: dict[str, dict[str, list[float]]] = {}
    for name, loss, blur, peers in groups:
        rows: dict[str, list[float]] = {}
        found[name] = rows
        for kind, (s, y) in (("noise", dense), ("drones", real)):
            rows[f"ours, {kind}"] = row(loss, s, y, seconds)
        s, y = dense
        for peer, form in peers:
            agree(peer, loss, form, s[:few], y[:few])
            rows[peer] = row(form, s, y, seconds)
        if blur is not None:
            form = authors_form(blur)
            s, y = s[:few], y[:few]
            agree("authors' form", loss, form, s, y)
            rows[f"authors' form, from a batch of {few}"] = row(form, s, y, seconds, BATCH / few)
        print(f"\n{name}")
        for label, times in rows.items():
            cells = "".join(f"{t:12.1f}" for t in times)
            ratios = zip(times, rows["ours, noise"], strict=True)
            cells += "".join(f"{a / b:10.1f} x" for a, b in ratios)
            print(f"  {label:34s}{cells}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
