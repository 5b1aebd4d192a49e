"""A rendered data set as shards of WebDataset: see :func:`export_webdataset`."""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.dataset import FORMAT, SynthError
from dronepose.synth.encode import DRONE_ID, ENCODINGS
from dronepose.synth.export import complete_scenes, whole_folder
from dronepose.synth.layout import MODALITIES
from dronepose.synth.others import other_rows

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from dronepose.synth.reading import Moments, SceneFolder

__all__ = ["export_webdataset"]

_PREFIX = {"exocentric": "", "egocentric": "ego_"}


def export_webdataset(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    shard_size: int = 500,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Write all kept samples as tar files, ``SPLIT-000000.tar`` and on.

    A sample of the plan makes two keys, ``BUILDING_ROW_0`` and ``BUILDING_ROW_1``, one for each
    time; they stand beside one another in one shard. A key has

    .. code-block:: text

        KEY.colour.png, KEY.depth.png, KEY.normal_map.png, KEY.flow.png,
        KEY.silhouette.png, KEY.matte.png, KEY.instance.png      exocentric
        KEY.ego_colour.png, KEY.ego_depth.png, ...                egocentric
        KEY.json                                                  pose, cameras, facts

    Images are those of the data set, byte for byte. In the JSON ``R`` and ``t`` are
    ``cam_from_model`` of the drone in the exocentric image, metres, OpenCV axes, ``K`` has pixel
    centres at ``+ 0.5``, ``facts`` is the sample's record, and ``others``, where there are further
    drones, has the same of each with its number in ``instance``. Headers hold no times and owners
    and names are sorted, so that the same data set gives the same bytes. ``shards.json`` says what
    is in which file, with SHA-256 and the encodings.

    Args:
        root: The data set.
        out: The folder to write; written whole or not at all.
        shard_size: Samples of the plan in a file at most, two keys each.
        progress: Called with the number of samples that are done and of all.

    Returns:
        What ``shards.json`` says.

    Raises:
        FileNotFoundError: A file is missing.
        SynthError: The data set is not complete, names are ambiguous, or ``out`` holds something.
        ValueError: ``shard_size`` is below 1.
        OSError: A file cannot be read or written.

    Example:
        >>> export_webdataset("synth", "shards", shard_size=100)["keys"]  # doctest: +SKIP
        2000
    """
    if shard_size < 1:
        raise ValueError(f"shard_size: expected at least 1 sample, got {shard_size}")
    work: dict[str, list[tuple[SceneFolder, Moments, dict[str, Any]]]] = {}
    names: dict[str, str] = {}
    for scene, records in complete_scenes(root):
        name = _name(scene)
        if name in names:
            raise SynthError(f"{scene.building}: makes the same keys as {names[name]}")
        names[name] = scene.building
        moments = scene.moments()
        for record in records:
            for row in (record["row"], *other_rows(record)):
                if row is not None and row >= len(moments.t):
                    raise SynthError(f"{scene.flight}: has no row {row}, of a kept sample")
            work.setdefault(scene.split, []).append((scene, moments, record))
    total, done = sum(map(len, work.values())), 0
    shards: list[dict[str, Any]] = []
    with whole_folder(Path(out)) as part:
        for split, samples in sorted(work.items()):
            for number, begin in enumerate(range(0, len(samples), shard_size)):
                chosen = samples[begin : begin + shard_size]
                path = part / f"{split}-{number:06d}.tar"
                with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as archive:
                    for sample in chosen:
                        _add(archive, *sample)
                        done += 1
                        if progress is not None:
                            progress(done, total)
                with path.open("rb") as file:
                    digest = hashlib.file_digest(file, "sha256").hexdigest()
                shards.append(
                    {
                        "file": path.name,
                        "split": split,
                        "samples": len(chosen),
                        "keys": 2 * len(chosen),
                        "bytes": path.stat().st_size,
                        "sha256": digest,
                    }
                )
        facts = {
            "format": "webdataset",
            "source": FORMAT,
            "samples": total,
            "keys": 2 * total,
            "shards": shards,
            "encodings": ENCODINGS,
        }
        (part / "shards.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return facts


def _name(scene: SceneFolder) -> str:
    """Of a scene in keys: these end at the first dot."""
    return scene.building.replace(".", "-")


def _add(
    archive: tarfile.TarFile, scene: SceneFolder, moments: Moments, record: dict[str, Any]
) -> None:
    """Both times of a sample."""
    row, sources = int(record["row"]), other_rows(record)
    for step in (0, 1):
        key = f"{_name(scene)}_{row:06d}_{step}"
        files = {
            f"{key}.{_PREFIX[view]}{modality}.png": scene.file(row, step, view, modality)
            for view, modalities in MODALITIES.items()
            for modality in modalities
        }
        contents = {name: path.read_bytes() for name, path in files.items()}
        facts = {
            "building": scene.building,
            "split": scene.split,
            "drone": scene.facts["drone"],
            "date": scene.facts["date"],
            "row": row,
            "time": step,
            "R": moments.R[row, step].tolist(),
            "t": moments.t[row, step].tolist(),
            "K": scene.cameras["exocentric"].K.tolist(),
            "ego_K": scene.cameras["egocentric"].K.tolist(),
            "facts": record,
        }
        if sources:
            facts["others"] = [
                {"instance": DRONE_ID + k, "R": R[step].tolist(), "t": t[step].tolist()}
                for k, source in enumerate(sources, 1)
                if source is not None
                for R, t in [moments.other(row, source)]
            ]
        contents[f"{key}.json"] = (json.dumps(facts, sort_keys=True) + "\n").encode()
        for name, content in sorted(contents.items()):
            header = tarfile.TarInfo(name)  # no time, no owner
            header.size, header.mode = len(content), 0o644
            archive.addfile(header, io.BytesIO(content))
