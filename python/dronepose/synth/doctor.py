"""Whether a rendered data set is whole and true: its files, and what they say of one another."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose.render import gbuffer, silhouette
from dronepose.synth import _measures as measures
from dronepose.synth._findings import CHECKS, NEEDS, Finding
from dronepose.synth.dataset import FORMAT
from dronepose.synth.encode import DRONE_ID, ENCODINGS, decode_depth, decode_flow, decode_normal
from dronepose.synth.layout import MODALITIES, scene_file, split_file
from dronepose.synth.licences import unlicensed
from dronepose.synth.others import other_rows
from dronepose.synth.reading import SceneFolder, drone_mesh, read_lines, read_scenes
from dronepose.synth.splits import SPLITS

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh
    from dronepose.synth.reading import Moments

    Array = NDArray[np.float64]
    Pictures = dict[tuple[int, str], NDArray[Any]]
    Kept = dict[int, list[int | None]]

__all__ = ["Diagnosis", "check_dataset"]

_OF_DRONE = ("silhouette", "depth", "sync", "motion")
_ROUGH = 2.0  # as a drone has an extent
_NOISE = 2.0  # of 255: what colours differ by after a good warp where there is little texture
_KINDS = {
    "colour": ("uint8", 3),
    "depth": ("uint16", 2),
    "normal_map": ("uint16", 3),
    "flow": ("uint16", 3),
}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What the checks of a data set found.

    Args:
        root: The data set.
        findings: One for each of the checks, in order.
        samples: Kept samples whose images were looked at.
        kept: Kept samples.
    """

    root: Path
    findings: tuple[Finding, ...]
    samples: int
    kept: int

    @property
    def healthy(self) -> bool:
        """Whether no check failed."""
        return all(finding.ok is not False for finding in self.findings)

    def __getitem__(self, check: str) -> Finding:
        """A finding by the name of its check."""
        return {finding.check: finding for finding in self.findings}[check]

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "data": str(self.root),
            "healthy": self.healthy,
            "samples": self.samples,
            "kept": self.kept,
            "checks": [finding.facts() for finding in self.findings],
        }

    def __str__(self) -> str:
        """A line for each check, and more where it failed."""
        failed = [finding.check for finding in self.findings if finding.ok is False]
        skipped = sum(finding.ok is None for finding in self.findings)
        end = f"failed: {', '.join(failed)}" if failed else "healthy"
        end += f" ({skipped} of {len(self.findings)} checks not made)" if skipped else ""
        return "\n".join(
            [
                *map(str, self.findings),
                f"{self.samples} of {self.kept} kept samples looked at; {end}",
            ]
        )


def check_dataset(
    root: str | os.PathLike[str],
    *,
    mesh: str | None = None,
    limit: int | None = None,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Diagnosis:
    """Check a data set that :func:`dronepose.synth.dataset.write_dataset` wrote.

    The folder is checked as a whole: manifest, records, files, lists, poses. Of each kept sample
    all images are decoded and compared with one another: depth with normals, the silhouette with
    the pose, the matte with both, colours and flow of the two times.

    Args:
        root: The folder.
        mesh: The drone's mesh file, in the unit that it was rendered with; ``None`` knows the
            project's example drone. Without it three checks are not made.
        limit: Samples to look at, spread evenly over each scene; ``None`` is all.
        threads: Number of threads, 0 for one a core.
        progress: Called with the number of samples that are done and of all.

    Returns:
        What was found.

    Raises:
        FileNotFoundError: The folder holds no rendered data set, or there is no such mesh.
        ValueError: A scene's file or a record is broken; ``limit`` is below 1.
        OSError: A file cannot be read.

    Example:
        >>> print(check_dataset("synth"))  # doctest: +SKIP
    """
    if limit is not None and limit < 1:
        raise ValueError(f"limit: expected a number of samples of at least 1, got {limit}")
    root = Path(root)
    scenes = read_scenes(root)
    found = {check: Finding(check) for check in CHECKS}
    drone, words = drone_mesh(scenes, mesh)
    for check in ("silhouette", "depth", "sync"):
        found[check].note = f"mesh: {words}"
    if drone is None:
        found["sync"].note = "by the origin of the model, as there is no mesh"
    _manifest(root, scenes, found["manifest"])
    _splits(root, scenes, found["splits"])
    work: list[tuple[SceneFolder, int, Moments | None]] = []
    kept_of: dict[str, Kept] = {}
    for scene in scenes:
        kept = _records(scene, found["records"])
        kept_of[scene.building] = kept
        moments = _poses(scene, kept, found["poses"])
        work += [(scene, row, moments) for row in kept]
    _files(root, scenes, kept_of, found["files"], found["pairs"])
    total = len(work)
    if limit is not None and limit < total:
        work = [work[round(k)] for k in np.linspace(0, total - 1, limit)]
    for count, (scene, row, moments) in enumerate(work, 1):
        others = kept_of[scene.building][row]
        _sample(scene, row, moments, others, drone, found, threads)
        if progress is not None:
            progress(count, len(work))
    if found["warp"].levels:
        warped, still = np.mean(found["warp"].levels, axis=0)
        found["warp"].note = f"mean error {warped:.2f} of 255, and {still:.2f} without warping"
    return Diagnosis(root, tuple(found.values()), len(work), total)


def _manifest(root: Path, scenes: list[SceneFolder], finding: Finding) -> None:
    problems = []
    path = root / "dataset.json"
    if not path.is_file():
        problems.append(f"{path}: is missing: the data set is not complete")
    else:
        try:
            facts = json.loads("\n".join(read_lines(path)))
        except ValueError as error:
            facts, problems = None, [f"{path}: no JSON: {error}"]
        held = facts if isinstance(facts, dict) else {}
        if held.get("format") != FORMAT:
            problems.append(f"{path}: format: expected {FORMAT!r}, found {held.get('format')!r}")
        encodings = held.get("encodings")
        for name, text in ENCODINGS.items():
            found = encodings.get(name) if isinstance(encodings, dict) else None
            if found != text:
                problems.append(f"{path}: encodings: {name}: expected {text!r}, found {found!r}")
    for scene in scenes:
        file = scene_file(root, scene.building)
        if scene.facts.get("complete") is not True:
            problems.append(f"{file}: the scene is not complete; render it once more")
            continue
        table = scene_file(root, scene.building, ".csv")
        if not table.is_file():
            problems.append(f"{table}: is missing")
        kept = scene.facts.get("kept")
        if kept and scene.building not in _listed(root, scene.split):
            problems.append(f"{split_file(root, scene.split)}: lacks {scene.building}")
    lacking = sorted({name for s in scenes for name in unlicensed(s.facts.get("inputs", {}))})
    if lacking:
        finding.note = f"no licence is known of {', '.join(lacking)} (synth render --licence)"
    finding.count(1 + len(scenes), problems)


def _listed(root: Path, split: str) -> list[str]:
    path = split_file(root, split)
    if not path.is_file():
        return []
    return [name for line in read_lines(path) if (name := line.strip())]


def _splits(root: Path, scenes: list[SceneFolder], finding: Finding) -> None:
    own = {scene.building: scene.split for scene in scenes}
    problems: list[str] = []
    before: dict[str, str] = {}
    count = 0
    for split in SPLITS:
        for name in _listed(root, split):
            count += 1
            if name in before:
                problems.append(f"{name}: in the lists of {before[name]} and {split}")
            elif own.get(name) != split:
                belongs = f"belongs to {own[name]}" if name in own else "was not rendered"
                problems.append(f"{name}: in the list of {split}, but {belongs}")
            before.setdefault(name, split)
    finding.count(count, problems)


def _records(scene: SceneFolder, finding: Finding) -> Kept:
    """The rows that were kept, in order, with the rows of their further drones."""
    records = {record["row"]: record for record in scene.records()}
    rows, name = int(scene.facts["rows"]), scene.building
    problems = [f"{name} row {k}: has no record" for k in range(rows) if k not in records]
    problems += [f"{name} row {k}: the plan has {rows} rows" for k in records if k >= rows]
    path = scene_file(scene.root, name, ".csv")
    if path.is_file():
        table = list(csv.DictReader(read_lines(path)))
        told = {line.get("row"): line.get("kept") for line in table}
        for k, record in records.items():
            if told.get(str(k)) != str(record["kept"]):
                problems.append(f"{name} row {k}: {path.name} says kept {told.get(str(k))}")
    finding.count(rows, problems)
    return {k: other_rows(record) for k, record in sorted(records.items()) if record["kept"]}


def _poses(scene: SceneFolder, kept: Kept, finding: Finding) -> Moments | None:
    path, rows = scene.flight, int(scene.facts["rows"])
    try:
        moments = scene.moments()
    except (OSError, ValueError) as error:
        finding.count(1, [str(error)])
        return None
    if len(moments.t) != rows:
        finding.count(1, [f"{path}: holds {len(moments.t)} rows, the plan has {rows}"])
        return None
    for row, norm in enumerate(moments.norm):
        off = float(np.abs(norm - 1).max())
        finding.add(off, f"{path}:{row + 2}", f"a quaternion is {off:.4g} off norm 1")
    for row in kept:
        if row < rows and (moments.t[row, :, 2] <= 0).any():
            finding.problems.append(f"{path}:{row + 2}: the drone is behind the camera")
    return moments


def _files(
    root: Path,
    scenes: list[SceneFolder],
    kept: dict[str, Kept],
    finding: Finding,
    pairs: Finding,
) -> None:
    wanted: set[Path] = set()
    halves: list[str] = []
    for scene in scenes:
        for row in kept[scene.building]:
            wanted.update(scene.files(row))
    there = {
        path
        for drone in sorted({str(scene.facts["drone"]) for scene in scenes})
        for path in (root / drone).rglob("*.png")
        if not path.name.startswith(".")
    }
    for scene in scenes:
        for row in kept[scene.building]:
            files = scene.files(row)
            for first, second in zip(files[::2], files[1::2], strict=True):
                if (first in there) != (second in there):
                    gone = second if first in there else first
                    halves.append(f"{scene.building} row {row}: lacks {gone.relative_to(root)}")
    problems = [f"{path.relative_to(root)}: is missing" for path in sorted(wanted - there)]
    problems += [f"{path.relative_to(root)}: no kept record" for path in sorted(there - wanted)]
    finding.count(len(wanted | there), problems)
    pairs.count(sum(map(len, kept.values())), halves)


def _sample(
    scene: SceneFolder,
    row: int,
    moments: Moments | None,
    others: list[int | None],
    drone: Mesh | None,
    found: dict[str, Finding],
    threads: int,
) -> None:
    """All checks of the images of a sample, as far as the images are whole."""
    for view, camera in scene.cameras.items():
        pictures: Pictures = {}
        problems = []
        for modality in MODALITIES[view]:
            kind, axes = _KINDS.get(modality, ("uint8", 2))
            size = (camera.height, camera.width, 3)[:axes]
            for step in (0, 1):
                path = scene.file(row, step, view, modality)
                try:
                    image = scene.picture(row, step, view, modality)
                except (OSError, ValueError) as error:
                    problems.append(str(error))
                    continue
                if image.shape != size or str(image.dtype) != kind:
                    problems.append(
                        f"{path}: expected {size} {kind}, found {image.shape} {image.dtype}"
                    )
                    continue
                pictures[step, modality] = image
        found["images"].count(2 * len(MODALITIES[view]), problems)
        able = {
            check
            for check, needs in NEEDS.items()
            if all((step, modality) in pictures for modality in needs for step in (0, 1))
        }
        where = f"{scene.building} row {row}"
        _both(camera, pictures, f"{where} {view}", found, able)
        if view == "exocentric":
            _masks(pictures, where, found, able)
            if moments is None or row >= len(moments.t):
                for check in _OF_DRONE:
                    found[check].note = f"the poses of {scene.building} cannot be read"
                continue
            pose = moments.R[row], moments.t[row]
            _pose(camera, pictures, where, pose, drone, found, able, threads)
            further = [None if other is None else moments.other(row, other) for other in others]
            for k, seen in enumerate([pose, *further]):
                if seen is not None and "motion" in able:
                    _motion(camera, pictures, where, k, seen, found["motion"])


def _both(
    camera: Camera, pictures: Pictures, where: str, found: dict[str, Finding], able: set[str]
) -> None:
    """What holds in either view."""
    flows = [decode_flow(pictures[step, "flow"]) for step in (0, 1)] if "flow" in able else []
    for step in (0, 1):
        place = f"{where} time {step}"
        if "range" in able:
            found["range"].add(float(np.median(decode_depth(pictures[step, "depth"]))), place)
        if "normals" in able:
            depth = decode_depth(pictures[step, "depth"])
            normal = decode_normal(pictures[step, "normal_map"])
            share, count = measures.normals_agree(camera, depth, normal)
            if measures.enough(count):
                found["normals"].add(share, place)
        if "warp" in able:
            here, there = pictures[step, "colour"], pictures[1 - step, "colour"]
            warped, still, count = measures.warp_errors(here, there, *flows[step])
            if measures.enough(count):
                found["warp"].levels.append((warped, still))
                words = f"{warped:.1f} of 255, and {still:.1f} without warping"
                found["warp"].add(warped / max(still, _NOISE), place, words)
        if "flow" in able:
            share, count = measures.flow_consistency(flows[step], flows[1 - step])
            if measures.enough(count):
                found["flow"].add(share, place)


def _masks(pictures: Pictures, where: str, found: dict[str, Finding], able: set[str]) -> None:
    """What the masks of the exocentric view say of one another."""
    for step in (0, 1):
        place = f"{where} time {step}"
        if "matte" in able:
            matte, held = (_share(pictures[step, name]) for name in ("matte", "silhouette"))
            found["matte"].add(measures.matte_excess(matte, held), place)
        if "instance" in able:
            matte = _share(pictures[step, "matte"])
            found["instance"].add(measures.instance_error(pictures[step, "instance"], matte), place)


def _share(image: NDArray[Any]) -> NDArray[np.float32]:
    return image.astype(np.float32) / np.float32(255)


def _pose(
    camera: Camera,
    pictures: Pictures,
    where: str,
    pose: tuple[Array, Array],
    mesh: Mesh | None,
    found: dict[str, Finding],
    able: set[str],
    threads: int,
) -> None:
    """What the images of the exocentric view say of the poses at both times."""
    R, t = pose
    colours = [pictures.get((step, "colour")) for step in (0, 1)]
    moved = float(np.abs(t[1] - t[0]).max()) > 1e-6
    if moved and colours[0] is not None and np.array_equal(colours[0], colours[1]):  # type: ignore[arg-type]
        found["pairs"].count(0, [f"{where}: the pose moves, the images are the same"])
    centre = np.zeros(3) if mesh is None else mesh.bounds.mean(axis=0)
    for step in (0, 1):
        place, view = f"{where} time {step}", (R[step], t[step])
        x, y, z = camera.K @ (view[0] @ centre + view[1])
        if z <= 0:
            continue  # the check of the poses says so
        if "sync" in able:
            held = _share(pictures[step, "silhouette"])
            inside = measures.box_holds(held, np.array([x, y]) / z)
            if inside is not None:
                out = [] if inside else [f"{place}: at pixel {x / z:.1f}, {y / z:.1f}"]
                found["sync"].count(1, out)
        if "depth" in able:
            depth, drone = (
                decode_depth(pictures[step, "depth"]),
                pictures[step, "instance"] == DRONE_ID,
            )
            _unit(camera, depth, drone & (depth > 0), place, view, (mesh, z), found, threads)
        if mesh is not None and "silhouette" in able:
            held = _share(pictures[step, "silhouette"])
            drawn = silhouette(mesh, camera, view[0][None], view[1][None], threads=threads)[0]
            found["silhouette"].add(measures.silhouette_error(drawn, held), place)


def _motion(
    camera: Camera,
    pictures: Pictures,
    where: str,
    number: int,
    pose: tuple[Array, Array],
    finding: Finding,
) -> None:
    """Flow of a drone against its depth and its poses at both times."""
    R, t = pose
    for step in (0, 1):
        depth = decode_depth(pictures[step, "depth"])
        drone = pictures[step, "instance"] == DRONE_ID + number
        flow = decode_flow(pictures[step, "flow"])
        views = [(R[k], t[k]) for k in (step, 1 - step)]
        error, count = measures.flow_against_pose(camera, depth, drone, flow, views[0], views[1])
        if measures.enough(count):
            name = f" drone {number + 1}" if number else ""
            finding.add(error, f"{where} time {step}{name}")


def _unit(
    camera: Camera,
    depth: NDArray[np.float32],
    drone: NDArray[np.bool_],
    place: str,
    view: tuple[Array, Array],
    model: tuple[Mesh | None, float],
    found: dict[str, Finding],
    threads: int,
) -> None:
    """Depth of the drone against that of its mesh, or roughly against the distance of its pose."""
    mesh, distance = model
    if not measures.enough(int(drone.sum())):
        return
    if mesh is not None:
        plane = gbuffer(mesh, camera, *view, channels=("depth",), threads=threads).depth
        assert plane is not None
        both = drone & (plane > 0)
        if measures.enough(int(both.sum())):
            ratio = float(np.median(depth[both] / plane[both]))
            words = f"depth is {ratio:.4g} times that of the drone under its pose: which unit?"
            found["depth"].add(ratio, place, words)
            return
    ratio = float(np.median(depth[drone])) / distance
    if not 1 / _ROUGH < ratio < _ROUGH:
        words = f"depth is about {ratio:.2g} times the distance of the pose: which unit?"
        found["depth"].add(ratio, place, words)
