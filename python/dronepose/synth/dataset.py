"""A plan rendered to a data set in the layout of UAVA, resumable and in shards."""

from __future__ import annotations

import csv
import io
import json
import platform
from contextlib import closing
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from dronepose import _native
from dronepose._files import write_bytes, write_text
from dronepose.geometry import quat_wxyz_from_matrix
from dronepose.synth.encode import ENCODINGS
from dronepose.synth.layout import (
    flight_file,
    image_file,
    record_file,
    scene_file,
    scene_files,
    split_file,
)
from dronepose.synth.resuming import difference, room, rows_there, tidy
from dronepose.synth.rules import PIXEL_RULES
from dronepose.synth.running import by_threads
from dronepose.synth.sample import RenderSettings, render_sample

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.render import Environment
    from dronepose.synth.cluster import Cluster
    from dronepose.synth.plan import PlanTable
    from dronepose.synth.studio import Studio

    Array = NDArray[np.float64]

__all__ = ["FORMAT", "SynthError", "versions", "write_dataset", "write_row"]

FORMAT = "dronepose-uava-1"
_BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


class SynthError(ValueError):
    """A folder or an argument that does not fit; the message names it."""


def write_dataset(
    root: str | os.PathLike[str],
    plan: PlanTable,
    studio: Studio,
    cameras: tuple[Camera, Camera],
    *,
    building: str,
    drone: str = "drone",
    split: str = "train",
    date: str = "flight",
    environments: Mapping[str, Environment] | None = None,
    settings: RenderSettings | None = None,
    inputs: Mapping[str, Any] | None = None,
    shard: tuple[int, int] = (0, 1),
    workers: int = 1,
    cluster: Cluster | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Render a plan into a data set, or what is missing of it.

    Every file is written whole or not at all, and a sample counts as done when its last file,
    ``records/BUILDING/ROW.json``, is there; so a run that was stopped at any moment is taken up by
    calling it once more, and ends in the same bits. Several scenes go into one folder one after the
    other, each into one split.

    Args:
        root: The folder, in the layout of :class:`dronepose.data.UavaDataset`.
        plan: The poses, of one flight in one scene.
        studio: The scene and the drone, and perhaps further ones.
        cameras: The exocentric and the egocentric camera.
        building: Name of the scene; no underscores or slashes.
        drone: Name of the drone.
        split: ``"train"``, ``"val"`` or ``"test"``.
        date: Name of the flight; no underscores or slashes.
        environments: Panoramas by name.
        settings: Light and rules.
        inputs: What the manifest says of the files that went in.
        shard: ``(k, n)`` renders every n-th row from the k-th on; the shard that finds all records
            there finishes the data set.
        workers: Threads that render a row each; the studio's own threads are beside these.
        cluster: Whose workers render in place of this process.
        progress: Called with the number of rows of the shard that are done, and of all of them;
            first with what is there at the beginning.

    Returns:
        The manifest, with ``"written"``: rows that this call rendered.

    Raises:
        SynthError: The folder holds a data set of other settings, the scene is in another split,
            or a name cannot be part of a file's name.
        OSError: A file cannot be written; of a full disk the message says how many rows are done.

    Example:
        >>> made = write_dataset("set", plan, studio, cameras, building="hall")  # doctest: +SKIP
        >>> made["kept"]  # doctest: +SKIP
        600
    """
    root, settings = Path(root), settings or RenderSettings()
    for name, value in (("building", building), ("date", date), ("drone", drone)):
        if not value or set(value) & set("_/\\ \t\n"):
            raise SynthError(f"{name}: expected a name without underscores and slashes: {value!r}")
    if split not in ("train", "val", "test"):
        raise SynthError(f"split: expected train, val or test, got {split!r}")
    k, n = shard
    if not 0 <= k < n:
        raise SynthError(f"shard: expected (k, n) with 0 <= k < n, got {shard}")
    facts = {
        "building": building,
        "drone": drone,
        "date": date,
        "split": split,
        "rows": len(plan),
        "settings": settings.facts(len(studio.drones)),
        "cameras": {"exocentric": asdict(cameras[0]), "egocentric": asdict(cameras[1])},
        "environments": sorted(environments or {}),
        "inputs": json.loads(json.dumps(dict(inputs or {}))),
        "plan": plan.manifest,
        **({"drones": len(studio.drones)} if len(studio.drones) > 1 else {}),
    }
    own = range(k, len(plan), n)
    with room(root, building, own):
        _begin(root, building, facts)
        tidy(root, facts)
        there = rows_there(root, building)
        missing = [row for row in own if row not in there]

        def work(row: int) -> int:
            write_row(root, facts, studio, plan, row, cameras, environments or {}, settings)
            return 1

        if cluster is not None and missing:
            counts = cluster.render(root, facts, cameras, settings, missing)
        else:
            counts = by_threads(work, missing, workers)
        done = len(own) - len(missing)
        with closing(counts):  # at an error, too, nothing is left running
            for count in chain((0,), counts):
                done += count
                if progress is not None:
                    progress(done, len(own))
        if cluster is not None:
            tidy(root, facts, missing)
        complete = rows_there(root, building).issuperset(range(len(plan)))
        if complete:
            facts = _finish(root, facts, plan)
    return {**facts, "complete": complete, "written": len(missing)}


def write_row(
    root: Path,
    facts: Mapping[str, Any],
    studio: Studio,
    plan: PlanTable,
    row: int,
    cameras: tuple[Camera, Camera],
    environments: Mapping[str, Environment],
    settings: RenderSettings,
) -> None:
    """Render a row and write its images, and at last its record, with which it is done.

    Args:
        root: The data set.
        facts: Of the scene: ``building``, ``drone`` and ``date``.
        studio: As for :func:`render_sample`, and so are all that follow.
        plan: The poses.
        row: Which, from 0.
        cameras: The exocentric and the egocentric camera.
        environments: Panoramas by name.
        settings: Light and rules.

    Raises:
        OSError: A file cannot be written.
    """
    sample = render_sample(studio, plan, row, cameras, environments, settings)
    for (view, modality, step), content in sample.files.items():
        write_bytes(image_file(root, facts, row, step, view, modality), content)
    write_text(record_file(root, facts["building"], row), json.dumps(sample.facts) + "\n")


def _begin(root: Path, building: str, facts: dict[str, Any]) -> None:
    """Make sure that what is there is of the same settings, and the scene of no other split."""
    path = scene_file(root, building)
    if path.exists():
        before = json.loads(path.read_text(encoding="utf-8"))
        differs = difference({key: before.get(key) for key in facts}, json.loads(json.dumps(facts)))
        if differs is not None:
            name = ".".join(differs[0])
            raise SynthError(
                f"{path}: was rendered with another {name}; choose another folder, or remove it"
            )
        return
    write_text(path, json.dumps({**facts, "complete": False}, indent=1) + "\n")


def versions() -> dict[str, str]:
    """Of what the bits of the pictures depend on."""
    return {
        "dronepose": _native.__version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "python": platform.python_version(),
    }


def _finish(root: Path, facts: dict[str, Any], plan: PlanTable) -> dict[str, Any]:
    """The flight's file, the lists of scenes and the manifest, once all rows are rendered."""
    building, count = facts["building"], len(plan)
    table = io.StringIO()
    writer, kept, removed = None, 0, dict.fromkeys(PIXEL_RULES, 0)
    for row in range(count):
        record = json.loads(record_file(root, building, row).read_text(encoding="utf-8"))
        if writer is None:
            writer = csv.DictWriter(table, list(record), lineterminator="\n")
            writer.writeheader()
        writer.writerow(record)
        kept += record["kept"]
        if record["removed_by"]:
            removed[record["removed_by"]] += 1
    write_text(scene_file(root, building, ".csv"), table.getvalue())
    write_text(flight_file(root, facts), _flight_text(plan))
    steps, came = [], count
    for rule, number in removed.items():
        steps.append({"rule": rule, "came": came, "removed": number})
        came -= number
    facts = {
        "format": FORMAT,
        "complete": True,
        **facts,
        "kept": kept,
        "rendered_rules": steps,
        "encodings": ENCODINGS,
        "versions": versions(),
    }
    held = {key: value for key, value in facts.items() if key != "format"}
    text = json.dumps({**held, "complete": True}, indent=1) + "\n"
    write_text(scene_file(root, building), text)
    _lists(root)
    write_text(root / "dataset.json", json.dumps(facts, indent=1) + "\n")
    return facts


def _lists(root: Path) -> None:
    """The lists of the splits from the scenes that are complete."""
    scenes: dict[str, list[str]] = {}
    for path in scene_files(root):
        found = json.loads(path.read_text(encoding="utf-8"))
        if found.get("complete") and found.get("kept"):
            scenes.setdefault(found["split"], []).append(found["building"])
    for split, names in scenes.items():
        write_text(split_file(root, split), "\n".join(names) + "\n")


def _flight_text(plan: PlanTable) -> str:
    """The poses as UAVA's files have them: tabs, quaternions x y z w, Blender's camera axes."""
    R, t = plan.pose("exo")
    camera = np.swapaxes(R, 1, 2) @ _BLENDER_FROM_OPENCV  # world_from_camera
    eye = -np.einsum("nji,nj->ni", R, t)
    columns: dict[str, Array] = {}
    for suffix, name in (("_t1", "drone"), ("_t2", "drone_next")):
        turn, place = plan.pose(name)  # type: ignore[arg-type]
        columns |= _columns("Position", suffix, place) | _turns("Orientation", suffix, turn)
    columns |= _columns("Pilot", "", eye) | _turns("PilotRot", "", camera)
    lines = ["\t".join(columns)]
    lines += ["\t".join(repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def _columns(name: str, suffix: str, values: Array) -> dict[str, Array]:
    return {f"{name}({axis}){suffix}": values[:, k] for k, axis in enumerate("xyz")}


def _turns(name: str, suffix: str, R: Array) -> dict[str, Array]:
    q = quat_wxyz_from_matrix(R)
    return {
        f"{name}({axis}){suffix}": q[:, k] for axis, k in zip("xyzw", (1, 2, 3, 0), strict=True)
    }
