#!/usr/bin/env python3
"""Make the files of this folder: a quadrotor, 2,000 true poses of it and two sets of predictions.

Everything is computed from a seed with NumPy alone, so nothing here was measured, scanned or
copied. ``--check`` makes the files anew in memory and compares them with those on disk.

The poses follow the exocentric views of UAVA (Albanis et al., "DronePose", ECCV Workshops 2020,
section 3 and supplement): a person with a head-worn camera (320 x 240 pixels, 64.69 degrees) looks
roughly at a drone that flies 0.8 to 1.5 m away, now and then up to 5 m.

The errors follow what a network makes of such images: mostly along the viewing ray and growing
with the distance, rotations off by a degree or two with a heavy tail, now and then a drone taken
for one that flies the other way, and some drones not found at all.

Usage:
    python examples/make_examples.py [--check] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]
    Faces = NDArray[np.int64]
    Part = tuple[Array, Faces]

SEED = 2020
N_POSES = 2000
WIDTH, HEIGHT, HORIZONTAL_FOV_DEG = 320, 240, 64.69
SCENES = ("atrium", "bungalow", "library", "loft", "townhouse", "villa")


# ------------------------------------------------------------------------------------- the mesh


def loft(rings: ArrayLike) -> Part:
    """A closed surface over ``(S, N, 3)`` rings of points; the ends are fans about their centres.

    The rings turn counter-clockwise seen from the last one, so that the faces look outwards.
    """
    p = np.asarray(rings, dtype=np.float64)
    s, n = p.shape[:2]
    vertices = np.concatenate([p.reshape(-1, 3), [p[0].mean(axis=0)], [p[-1].mean(axis=0)]])
    first, last = s * n, s * n + 1
    i = np.arange(n)
    j = (i + 1) % n
    faces = [np.stack([np.full(n, first), j, i], axis=1)]
    for k in range(s - 1):
        a, b = k * n, (k + 1) * n
        faces.append(np.stack([a + i, a + j, b + j], axis=1))
        faces.append(np.stack([a + i, b + j, b + i], axis=1))
    faces.append(np.stack([np.full(n, last), (s - 1) * n + i, (s - 1) * n + j], axis=1))
    return vertices, np.concatenate(faces)


def _power(x: Array, e: float) -> Array:
    return np.sign(x) * np.abs(x) ** e


def pebble(
    centre: ArrayLike, half: ArrayLike, *, n: int, rings: int, e_plan: float, e_side: float
) -> Part:
    """A superellipsoid: exponents of 1 make an ellipsoid, towards 0 a box with round edges."""
    u = 2 * np.pi * (np.arange(n) + 0.5) / n
    v = np.pi * (np.arange(1, rings + 1) / (rings + 1) - 0.5)
    x = _power(np.cos(v), e_side)[:, None] * _power(np.cos(u), e_plan)
    y = _power(np.cos(v), e_side)[:, None] * _power(np.sin(u), e_plan)
    z = np.broadcast_to(_power(np.sin(v), e_side)[:, None], x.shape)
    vertices, faces = loft(np.stack([x, y, z], axis=-1))
    vertices[-2, 2], vertices[-1, 2] = -1.0, 1.0  # the poles
    return vertices * np.asarray(half) + np.asarray(centre), faces


def lathe(centre: ArrayLike, profile: Sequence[tuple[float, float]], n: int) -> Part:
    """A surface of revolution about z: ``profile`` holds (radius, height), from bottom to top."""
    u = 2 * np.pi * np.arange(n) / n
    rings = [np.stack([r * np.cos(u), r * np.sin(u), np.full(n, h)], axis=1) for r, h in profile]
    vertices, faces = loft(rings)
    return vertices + np.asarray(centre), faces


def tube(
    path: ArrayLike, radii: ArrayLike, n: int, *, flatten: float = 1.0, up: ArrayLike = (0, 0, 1)
) -> Part:
    """A tube along points ``(S, 3)``, its height along ``up`` scaled by ``flatten``."""
    p = np.asarray(path, dtype=np.float64)
    r = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(p))
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, np.asarray(up, dtype=np.float64))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    above = np.cross(side, tangent)
    u = -2 * np.pi * (np.arange(n) + 0.5) / n
    offsets = (
        np.cos(u)[None, :, None] * side[:, None]
        + flatten * np.sin(u)[None, :, None] * above[:, None]
    )
    return loft(p[:, None] + r[:, None, None] * offsets)


def ring(centre: ArrayLike, radius: float, half: tuple[float, float], n: int, sides: int) -> Part:
    """A torus about z with an elliptic section, ``half`` its half width and half height."""
    u = 2 * np.pi * np.arange(n) / n
    w = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    rho = radius + half[0] * np.cos(w)
    x, y = np.cos(u)[:, None] * rho, np.sin(u)[:, None] * rho
    z = np.broadcast_to(half[1] * np.sin(w), x.shape)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) + np.asarray(centre)
    i, k = np.meshgrid(np.arange(n), np.arange(sides), indexing="ij")
    a, b = i * sides + k, i * sides + (k + 1) % sides
    c, d = ((i + 1) % n) * sides + k, ((i + 1) % n) * sides + (k + 1) % sides
    faces = np.concatenate(
        [np.stack([a, c, d], axis=-1).reshape(-1, 3), np.stack([a, d, b], axis=-1).reshape(-1, 3)]
    )
    return vertices, faces


def blade(hub: Array, angle: float, length: float, spin: int) -> Part:
    """One blade of a propeller: a flat, twisted, tapered section from the hub to the tip."""
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), np.cos(angle), 0.0]) * spin
    station = np.array([0.06, 0.2, 0.5, 0.85, 1.0])
    chord = np.array([0.004, 0.0075, 0.0085, 0.0058, 0.0025])
    twist = np.radians([30.0, 26.0, 17.0, 10.0, 8.0])
    section = np.array(
        [[1.0, 0.0], [0.3, 0.16], [-0.6, 0.12], [-1.0, 0.0], [-0.6, -0.06], [0.3, -0.06]]
    )
    if spin < 0:
        section = section[::-1]
    rings = []
    for s, c, a in zip(station, chord, twist, strict=True):
        x = c * (section[:, 0] * np.cos(a) - section[:, 1] * np.sin(a))
        z = c * (section[:, 0] * np.sin(a) + section[:, 1] * np.cos(a))
        rings.append(
            hub + s * length * along + x[:, None] * across + z[:, None] * np.array([0.0, 0.0, 1.0])
        )
    vertices, faces = loft(rings)
    return vertices, faces


def quadrotor() -> Part:
    """The drone, metres, FLU: x forward, y left, z up; 0.35 m from motor to motor, diagonally."""
    parts: list[Part] = [
        # Hull, canopy and battery hatch, nose.
        pebble((0.0, 0.0, 0.0), (0.108, 0.05, 0.027), n=26, rings=9, e_plan=0.6, e_side=0.65),
        pebble((-0.018, 0.0, 0.026), (0.066, 0.033, 0.014), n=18, rings=5, e_plan=0.5, e_side=0.6),
        # Gimbal: damper plate, fork and camera ahead of the hull, looking forward.
        pebble((0.098, 0.0, -0.018), (0.022, 0.02, 0.004), n=12, rings=2, e_plan=0.5, e_side=0.4),
        tube(
            [[0.104, 0.0, -0.018], [0.106, 0.021, -0.026], [0.112, 0.023, -0.045]],
            0.0038,
            6,
            up=(1, 0, 0),
        ),
        pebble(
            (0.114, 0.002, -0.045), (0.017, 0.0185, 0.017), n=12, rings=6, e_plan=0.55, e_side=0.55
        ),
        tube(
            [[0.126, 0.002, -0.045], [0.135, 0.002, -0.045], [0.137, 0.002, -0.045]],
            [0.0105, 0.0105, 0.0085],
            12,
        ),
        # Receiver mast at the back: front and back differ also from above.
        tube([[-0.085, 0.0, 0.015], [-0.104, 0.0, 0.058]], [0.004, 0.003], 6, up=(1, 0, 0)),
        pebble((-0.105, 0.0, 0.062), (0.009, 0.009, 0.006), n=10, rings=3, e_plan=1.0, e_side=0.7),
    ]
    for x, y, spin in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        # On the diagonal, 0.175 m from the centre; the front pair sits a little lower.
        motor = np.array([x * 0.175 * 0.70, y * 0.175 * np.sqrt(1 - 0.49), 0.016 - 0.004 * x])
        root = np.array([x * 0.062, y * 0.03, 0.0])
        elbow = 0.45 * root + 0.55 * motor + [0.0, 0.0, 0.004]
        path = [root, 0.5 * (root + elbow), elbow, 0.5 * (elbow + motor) + [0, 0, 0.001], motor]
        parts.append(tube(path, [0.0145, 0.013, 0.0115, 0.0105, 0.0115], 10, flatten=0.7))
        parts.append(
            lathe(
                motor,
                [
                    (0.0125, -0.014),
                    (0.0145, -0.011),
                    (0.0145, 0.006),
                    (0.0135, 0.0075),
                    (0.0135, 0.019),
                    (0.0095, 0.022),
                    (0.004, 0.023),
                    (0.004, 0.031),
                ],
                12,
            )
        )
        hub = motor + np.array([0.0, 0.0, 0.0285])
        turn = 0.5 + 0.9 * x + 0.4 * y
        parts += [blade(hub, turn + k * np.pi, 0.062, spin) for k in (0, 1)]
        # Guard around the propeller, held by the arm's extension and one strut to the side.
        parts.append(ring(hub, 0.0695, (0.0022, 0.0045), n=24, sides=4))
        outward = np.arctan2(motor[1], motor[0])
        for side in (-1, 1):
            angle = outward + 0.85 * side
            end = hub + 0.0693 * np.array([np.cos(angle), np.sin(angle), 0.0])
            parts.append(
                tube(
                    [
                        motor - [0, 0, 0.006 + 0.0005 * side],
                        0.5 * (motor + end) - [0, 0, 0.007],
                        end,
                    ],
                    0.0028,
                    5,
                )
            )
    for y in (1, -1):
        # Landing gear: a skid on two legs.
        skid = np.array([[-0.082, 0, 6e-3], [-0.07, 0, 0], [0.05, 0, 0], [0.062, 0, 6e-3]])
        parts.append(tube(skid + np.array([0.0, y * 0.062, -0.088]), 0.0042, 7))
        for forward in (0.035, -0.055):
            top, foot = [0.8 * forward, y * 0.03, -0.016], [forward, y * 0.062, -0.088]
            parts.append(tube([top, foot], [0.0055, 0.0042], 7, up=(1, 0, 0)))
    vertices, faces, n = [], [], 0
    for v, f in parts:
        vertices.append(v)
        faces.append(f + n)
        n += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def obj_text(vertices: Array, faces: Faces) -> str:
    """The mesh as OBJ, micrometres."""
    lines = ["# A quadrotor in metres: x forward, y left, z up. Made by make_examples.py."]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices + 0.0]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------------------------ the poses


@dataclass(frozen=True)
class Poses:
    """Poses ``cam_from_model`` as quaternions ``(N, 4)`` wxyz and translations ``(N, 3)`` in m."""

    q: Array
    t: Array


def multiply(a: Array, b: Array) -> Array:
    """Products of Hamilton quaternions, scalar first: first turn by ``b``, then by ``a``."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def turn(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Quaternions of turns by ``angle`` radians about unit ``axis``."""
    half = 0.5 * np.asarray(angle, dtype=np.float64)[..., None]
    return np.concatenate(
        [np.cos(half), np.sin(half) * np.asarray(axis, dtype=np.float64)], axis=-1
    )


X, Y, Z = np.eye(3)
#: From a level camera's world (x right, y forward, z up) to OpenCV's (y down, z forward).
OPENCV_FROM_LEVEL = turn(X, np.radians(90.0))


def true_poses(rng: np.random.Generator) -> Poses:
    """Drones in flight before a camera that looks roughly at them; all inside the image."""
    f = 0.5 * WIDTH / np.tan(np.radians(0.5 * HORIZONTAL_FOV_DEG))
    q, t = np.empty((N_POSES, 4)), np.empty((N_POSES, 3))
    done = 0
    while done < N_POSES:
        near = rng.random() < 0.95
        u = rng.random()
        distance = 0.8 + 0.7 * u if near else 1.5 * (5.0 / 1.5) ** u
        # Where the camera points, beside the drone: the "look at" cube of the paper.
        right, up = np.radians(rng.standard_normal(2) * [9.0, 6.5])
        direction = np.array([np.sin(right), -np.sin(up), np.cos(right) * np.cos(up)])
        p = distance * direction / np.linalg.norm(direction)
        uv = f * p[:2] / p[2] + [0.5 * WIDTH, 0.5 * HEIGHT]
        if not (0.08 * WIDTH < uv[0] < 0.92 * WIDTH and 0.08 * HEIGHT < uv[1] < 0.92 * HEIGHT):
            continue
        yaw = 2 * np.pi * rng.random()
        pitch, roll = np.radians(rng.standard_normal(2) * [7.0, 6.0])
        camera_pitch = np.radians(8.0 + 12.0 * rng.standard_normal())  # people look up at drones
        camera_roll = np.radians(1.5 * rng.standard_normal())
        attitude = multiply(multiply(turn(Z, yaw), turn(Y, pitch)), turn(X, roll))
        camera = multiply(turn(Z, camera_roll), multiply(turn(X, -camera_pitch), OPENCV_FROM_LEVEL))
        q[done], t[done] = multiply(camera, attitude), p
        done += 1
    return Poses(q, t)


def predicted(
    gt: Poses, rng: np.random.Generator, *, scale: float, flips: float, missing: float
) -> tuple[Poses, NDArray[np.bool_]]:
    """What a network of a given quality says, and for which poses it says anything.

    Args:
        gt: The truth.
        rng: Source of chance.
        scale: Size of the errors; 1 for a good network.
        flips: Share of drones taken for one that faces the other way.
        missing: Share of drones that are not found, larger for the far ones.
    """
    n = len(gt.q)
    distance = np.linalg.norm(gt.t, axis=1, keepdims=True)
    # Depth from apparent size: mostly along the ray, on the whole too far, growing with the
    # distance also relative to it.
    relative = scale * 0.0150 * np.sqrt(distance / 1.1)
    along = gt.t * relative * (0.5 * rng.standard_normal((n, 1)) + 1.1)
    heavy = np.sqrt(9.0 / np.maximum(rng.chisquare(9, (n, 1)), 0.5))
    sideways = distance * relative * 0.2 * rng.standard_normal((n, 3))
    t = gt.t + along * np.minimum(heavy, 2.5) + sideways
    # Rotations: Student's t with three degrees of freedom on a random axis.
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    tail = np.abs(rng.standard_normal(n)) / np.sqrt(np.maximum(rng.chisquare(3, n), 0.1) / 3)
    angle = np.radians(np.minimum(scale * 1.45 * tail * np.sqrt(distance[:, 0] / 1.1), 60.0))
    q = multiply(turn(axis, angle), gt.q)
    flipped = rng.random(n) < flips
    q[flipped] = multiply(q[flipped], turn(Z, np.full(int(flipped.sum()), np.pi)))
    found = rng.random(n) >= missing * (0.5 + 0.5 * distance[:, 0] / 1.25)
    return Poses(q, t), found


def csv_text(ids: list[str], poses: Poses, extra: dict[str, list[str]]) -> str:
    """The poses as CSV: micrometres and 1e-8 of a quaternion."""
    lines = [",".join(["id", "qw", "qx", "qy", "qz", "tx", "ty", "tz", *extra])]
    for k, name in enumerate(ids):
        q = poses.q[k] * (-1.0 if poses.q[k, 0] < 0 else 1.0)
        numbers = [f"{c + 0.0:.8f}" for c in q] + [f"{c + 0.0:.6f}" for c in poses.t[k]]
        lines.append(",".join([name, *numbers, *(column[k] for column in extra.values())]))
    return "\n".join(lines) + "\n"


def make() -> dict[str, str]:
    """The text of every file, by name."""
    rng = np.random.default_rng(SEED)
    gt = true_poses(rng)
    scene = [
        SCENES[min(int(len(SCENES) * u), len(SCENES) - 1)] for u in np.sort(rng.random(N_POSES))
    ]
    ids = [f"{name}-{k:04d}" for k, name in enumerate(scene)]
    files = {
        "quadrotor.obj": obj_text(*quadrotor()),
        "gt.csv": csv_text(ids, gt, {"scene": scene}),
    }
    for name, options in (
        ("predictions.csv", {"scale": 1.0, "flips": 0.012, "missing": 0.03}),
        ("predictions_baseline.csv", {"scale": 1.9, "flips": 0.035, "missing": 0.05}),
    ):
        poses, found = predicted(gt, rng, **options)
        kept = np.flatnonzero(found)
        files[name] = csv_text([ids[k] for k in kept], Poses(poses.q[kept], poses.t[kept]), {})
    return files


def differs(made: str, found: str) -> str | None:
    """The first line in which two files differ by more than rounding, or nothing."""
    a, b = made.splitlines(), found.splitlines()
    if len(a) != len(b):
        return f"{len(b)} lines instead of {len(a)}"
    for number, (x, y) in enumerate(zip(a, b, strict=True), 1):
        if x == y:
            continue
        p, r = x.replace(",", " ").split(), y.replace(",", " ").split()
        if len(p) != len(r) or any(not _close(c, d) for c, d in zip(p, r, strict=True)):
            return f"line {number}: '{y}' instead of '{x}'"
    return None


def _close(a: str, b: str) -> bool:
    if a == b:
        return True
    try:
        # Another processor may round the last digit the other way.
        return abs(float(a) - float(b)) <= 1.5e-6
    except ValueError:
        return False


def main() -> int:
    """Write the files, or compare them; 1 if they differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare with the files on disk")
    parser.add_argument("--folder", type=Path, default=Path(__file__).resolve().parent)
    args = parser.parse_args()
    wrong = 0
    for name, text in make().items():
        path: Path = args.folder / name
        if not args.check:
            path.write_text(text, encoding="utf-8", newline="\n")
        elif not path.exists():
            print(f"{path}: missing", file=sys.stderr)
            wrong += 1
        elif difference := differs(text, path.read_text(encoding="utf-8")):
            print(f"{path}: {difference}", file=sys.stderr)
            wrong += 1
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
