"""The plan of a data set by loops that anybody can read, with the generator written out."""

import itertools
import math

import numpy as np

MASK64, MASK128 = (1 << 64) - 1, (1 << 128) - 1
MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645  # PCG's for 128 bits


def seeded(seed):
    """Sixteen bytes from a seed, as rand_core spreads them: PCG32, four bytes at a time."""
    state, out = seed, b""
    for _ in range(4):
        state = (state * 6364136223846793005 + 11634580027462260723) & MASK64
        word = (((state >> 18) ^ state) >> 27) & 0xFFFFFFFF
        turn = state >> 59
        word = ((word >> turn) | (word << (32 - turn))) & 0xFFFFFFFF
        out += word.to_bytes(4, "little")
    return int.from_bytes(out, "little")


def uniform(seed, frame, count):
    """The first numbers in [0, 1) of a frame: PCG XSL RR 128/64, multiplicative."""
    state = seeded(seed ^ ((frame + 1) * 0x9E3779B97F4A7C15 & MASK64)) | 1
    numbers = []
    for _ in range(count):
        state = state * MULTIPLIER & MASK128
        turn = state >> 122
        folded = (state >> 64) ^ (state & MASK64)
        word = ((folded >> turn) | (folded << (64 - turn))) & MASK64
        numbers.append((word >> 11) / 2**53)
    return numbers


def matrix(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def angle_deg(a, b):
    m = matrix(a).T @ matrix(b)
    axis = [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    return math.degrees(math.atan2(np.linalg.norm(axis), np.trace(m) - 1))


def plan(track, anchors, rules):
    """Kept frames with anchor, cam_from_model at t and t + 1; and how many each rule removed."""
    p, q, frames = track.positions, track.quat_wxyz, track.frames
    piece = np.concatenate([[k] * (b - a) for k, (a, b) in enumerate(track.segments)])
    s, n = rules.stride, len(p)
    nearest = [int(np.argmin([np.linalg.norm(x - a) for a in anchors])) for x in p]
    removed = dict.fromkeys(
        ["anchor", "distance", "neighbours", "ego-motion", "look-at", "border", "whole", "pair"], 0
    )
    if rules.whole_box_m is None:
        del removed["whole"]

    def moving(i, j):
        move, turn = np.linalg.norm(p[i] - p[j]), angle_deg(q[i], q[j])
        some = [move >= rules.min_move_m, turn >= rules.min_turn_deg]
        enough = any(some) if rules.motion == "any" else all(some)
        return enough and move <= rules.max_move_m and turn <= rules.max_turn_deg

    def passes(i, count):
        distance = np.linalg.norm(p[i] - anchors[nearest[i]])
        if not rules.min_distance_m <= distance <= rules.max_distance_m:
            count["distance"] += 1
            return False
        if i < s or i + s >= n or not piece[i - s] == piece[i] == piece[i + s]:
            count["neighbours"] += 1
            return False
        if not (moving(i - s, i) and moving(i, i + s)):
            count["ego-motion"] += 1
            return False
        return True

    def inside(R, t, point, b):
        x = R @ np.asarray(point) + t
        if x[2] <= 0:
            return False
        u, v, _ = rules.exo.K @ (x / x[2])
        w, h = rules.exo.width, rules.exo.height
        return b * w <= u <= (1 - b) * w and b * h <= v <= (1 - b) * h

    samples = []
    for i in range(n):
        if not passes(i, removed):
            continue
        draw = np.array(uniform(rules.seed, int(frames[i]), 6)) - 0.5
        eye = anchors[nearest[i]] + rules.anchor_cube_m * draw[:3]
        target = p[i] + rules.drone_cube_m * draw[3:]
        z = (target - eye) / np.linalg.norm(target - eye)
        x = np.array([z[1], -z[0], 0.0])
        if np.linalg.norm(x) < 1e-6:
            removed["look-at"] += 1
            continue
        x /= np.linalg.norm(x)
        R_cam = np.stack([x, np.cross(z, x), z])
        poses = [(R_cam @ matrix(q[j]), R_cam @ (p[j] - eye)) for j in (i, i + s)]
        if not all(inside(R, t, rules.centroid_m, rules.border) for R, t in poses):
            removed["border"] += 1
            continue
        corners = (
            []
            if rules.whole_box_m is None
            else itertools.product(*zip(*rules.whole_box_m, strict=True))
        )
        corners = list(corners)
        if not all(inside(R, t, corner, 0) for R, t in poses for corner in corners):
            removed["whole"] += 1
            continue
        if not passes(i + s, dict.fromkeys(removed, 0)) or nearest[i + s] != nearest[i]:
            removed["pair"] += 1
            continue
        samples.append((int(frames[i]), nearest[i], poses))
    return samples, removed
