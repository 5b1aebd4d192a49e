"""Further drones in a picture: the poses of the same flight at other moments."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh
    from dronepose.synth.plan import PlanTable
    from dronepose.synth.studio import Frame

    Array = NDArray[np.float64]

__all__ = ["choose_others", "other_rows", "others_facts"]

NEAR = 1e-3
"""Distance of the renderer's near plane, metres."""


def choose_others(
    plan: PlanTable,
    row: int,
    camera: Camera,
    drones: Sequence[Mesh],
    *,
    seed: int = 0,
    apart_m: float = 0.6,
) -> list[int | None]:
    """The rows of a plan from which a picture takes its further drones.

    Drone ``k`` flies as the drone of another row does, at t and at t + 1. It is drawn uniformly,
    by NumPy's generator seeded with ``[seed, row, k]``, from the rows where, at both times and in
    the exocentric view of this row, the middle of its box is in the image, all of its box is in
    front of the near plane, and the middle is ``apart_m`` from that of every drone before.

    Args:
        plan: The poses.
        row: That of the picture.
        camera: The exocentric camera.
        drones: All drones, the first of which is the plan's.
        seed: Of the run.
        apart_m: Least distance of two drones, metres.

    Returns:
        A row for each drone but the first, or ``None`` where there is none that fits.

    Raises:
        IndexError: There is no such row.

    Example:
        >>> from dronepose import Camera, Mesh
        >>> from dronepose.synth import Track, make_plan
        >>> x = [[0.02 * k, 0, 1.5] for k in range(60)]
        >>> plan = make_plan(Track(x, [[1, 0, 0, 0]] * 60), [[0.5, 1, 1.5]]).table()
        >>> camera = Camera(**plan.manifest["cameras"]["exo"])
        >>> drone = Mesh.from_file("examples/quadrotor.obj")
        >>> (other,) = choose_others(plan, 0, camera, [drone, drone], apart_m=0.4)
        >>> bool(abs(plan["drone_tx"][other] - plan["drone_tx"][0]) >= 0.4)
        True
    """
    R, t = (x[0] for x in plan.pose("exo", slice(row, row + 1)))
    taken: list[int] = [row]
    places: list[Array] = []
    found: list[int | None] = []
    for k, mesh in enumerate(drones):
        at, reach = _flown(plan, mesh)
        if k == 0:
            places.append(at[:, :, row])
            continue
        rows = _in_view(camera, (R, t), at, reach)
        for place, before in zip(places, taken, strict=True):
            for points, other in zip(at, place, strict=True):
                rows = rows[_distance(points[:, rows], other) >= apart_m]
            rows = rows[rows != before]
        if not len(rows):
            found.append(None)
            continue
        generator = np.random.default_rng([seed, row, k])
        chosen = int(rows[generator.integers(len(rows))])
        found.append(chosen)
        taken.append(chosen)
        places.append(at[:, :, chosen])
    return found


@lru_cache(maxsize=64)
def _flown(plan: PlanTable, mesh: Mesh) -> tuple[Array, float]:
    """Middle of a drone's box at t and t + 1 of each row, ``(2, 3, N)``, and half its diagonal."""
    low, high = mesh.bounds
    middle, poses = (low + high) / 2, (plan.pose("drone"), plan.pose("drone_next"))
    at = np.stack([np.einsum("nij,j->in", R, middle) + t.T for R, t in poses])
    return at, float(np.linalg.norm(high - low)) / 2


def _in_view(
    camera: Camera, cam_from_world: tuple[Array, Array], at: Array, reach: float
) -> NDArray[np.intp]:
    """The rows where points, ``(2, 3, N)`` in the world, are in the image both times."""
    (R, t), K = cam_from_world, camera.K
    ahead = [_times(R[2], points) + t[2] > NEAR + reach for points in at]
    rows = np.flatnonzero(ahead[0] & ahead[1])
    for points in at:
        seen = [_times(R[k], points[:, rows]) + t[k] for k in range(3)]
        u, v = (_times(K[k], seen) / seen[2] for k in (0, 1))
        rows = rows[(u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)]
    return rows


def _times(row: Array, columns: Sequence[Array] | Array) -> Array:
    """A row of a matrix times many vectors, in a fixed order of sums."""
    return np.asarray(row[0] * columns[0] + row[1] * columns[1] + row[2] * columns[2])


def _distance(points: Array, place: Array) -> Array:
    """Of points, ``(3, N)``, from one."""
    x, y, z = points - place[:, None]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def others_facts(rows: Sequence[int | None], frames: Sequence[Frame]) -> dict[str, Any]:
    """What the record of a sample says of its further drones; nothing where there are none.

    Args:
        rows: Of :func:`choose_others`.
        frames: The exocentric view at both times.

    Returns:
        ``others``, how many there are, and for each drone, from 1 on, ``other_K``, its row or
        ``None``, and ``other_K_px``, the fewest pixels in which it is seen.
    """
    if not rows:
        return {}
    facts: dict[str, Any] = {"others": sum(row is not None for row in rows)}
    for k, row in enumerate(rows, 1):
        facts[f"other_{k}"] = row
        facts[f"other_{k}_px"] = min(int((frame.instance == k + 1).sum()) for frame in frames)
    return facts


def other_rows(record: Mapping[str, Any]) -> list[int | None]:
    """The rows of the further drones, from the record of a sample.

    Args:
        record: As :func:`others_facts` writes it.

    Returns:
        A row or ``None`` for each.

    Raises:
        ValueError: One is no row.

    Example:
        >>> other_rows({"row": 3, "others": 1, "other_1": 17, "other_2": None})
        [17, None]
        >>> other_rows({"row": 3})
        []
    """
    found: list[int | None] = []
    while (name := f"other_{len(found) + 1}") in record:
        row = record[name]
        if row is not None and not (type(row) is int and row >= 0):
            raise ValueError(f"{name}: expected a row of the plan, or null, got {row!r}")
        found.append(row)
    return found
