"""A rendered data set in the layout of the BOP benchmark: see :func:`export_bop`."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose._files import folder_beside
from dronepose.camera import Camera
from dronepose.render import gbuffer
from dronepose.synth.dataset import SynthError
from dronepose.synth.encode import DEPTH_SCALE, DRONE_ID, png
from dronepose.synth.layout import scene_file
from dronepose.synth.others import other_rows
from dronepose.synth.reading import drone_meshes, read_scenes

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from dronepose.mesh import Mesh
    from dronepose.synth.reading import SceneFolder

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]

__all__ = ["complete_scenes", "export_bop", "rle_counts", "whole_folder"]

_MM = 1000.0
_BOP_CENTRE = 0.5
_AXES = "xyz"


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A hidden folder beside ``target`` that takes its name if all went well, or vanishes.

    What killed exports have left there is swept.

    Args:
        target: The folder to be; it may be there, but empty.

    Yields:
        The folder to write to.

    Raises:
        SynthError: ``target`` is a file, or a folder that holds something.
        OSError: It cannot be made.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise SynthError(f"{target}: is there already; choose another folder, or remove it")
    with folder_beside(target) as part:
        yield part


def complete_scenes(root: str | os.PathLike[str]) -> list[tuple[SceneFolder, list[dict[str, Any]]]]:
    """The scenes of a data set and the records of their kept samples, by row.

    Args:
        root: The data set.

    Returns:
        Those scenes of which samples were kept.

    Raises:
        FileNotFoundError: The folder holds no rendered data set.
        SynthError: A scene is not complete, or no sample was kept.
    """
    found = []
    for scene in read_scenes(root):
        if scene.facts.get("complete") is not True:
            raise SynthError(
                f"{scene_file(scene.root, scene.building)}: the scene is not complete; "
                "render it once more to finish it"
            )
        records = [record for record in scene.records() if record["kept"]]
        if records:
            found.append((scene, records))
    if not found:
        raise SynthError(f"{root}: no sample was kept")
    return found


def rle_counts(mask: NDArray[Any]) -> list[int]:
    """COCO's run lengths of a mask, column by column: of zeros, of ones, of zeros, and on.

    Args:
        mask: ``(H, W)``; what is not 0 is the object.

    Returns:
        Lengths of sum ``H W``; the first is 0 where the mask begins with the object.

    Example:
        >>> rle_counts(np.array([[0, 1], [1, 1]]))
        [1, 3]
        >>> rle_counts(np.array([[1, 0]]))
        [0, 1, 1]
    """
    flat = np.asarray(mask).astype(bool).ravel(order="F")
    ends = np.flatnonzero(np.diff(flat)) + 1
    lengths = np.diff(np.concatenate([[0], ends, [flat.size]])).tolist()
    return [0, *lengths] if flat.size and flat[0] else list(lengths)


def export_bop(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    mesh: str | Sequence[str] | None = None,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Write the exocentric images of all kept samples, both times, as scenes of BOP.

    .. code-block:: text

        SPLIT/000001/rgb, depth, mask, mask_visib
                     scene_camera.json, scene_gt.json, scene_gt_info.json, scene_gt_coco.json
        models/obj_000001.ply, ..., models_info.json
        export.json                                 which image is which row and time of which scene

    Lengths are millimetres. ``cam_K`` has whole numbers at pixel centres, half a pixel less than
    ours, as :class:`dronepose.data.BopDataset` expects. Images of colour and depth are those of
    the data set, byte for byte. ``mask`` is what the drone covers at the centres of the pixels,
    hidden or not, ``mask_visib`` what is seen of it. Where there are further drones, each is an
    object of its own, ``obj_id`` 2 and on; one that an image lacks is not in its lists. As in the
    BOP toolkit, ``px_count_all`` and ``bbox_obj`` count what is outside of the image too, on a
    canvas of three times its size, and the width of ``bbox_obj`` and ``bbox_visib`` is the last
    column minus the first. In
    ``scene_gt_coco.json`` boxes hold whole pixels, and masks are those of what is seen, as run
    lengths that are not compressed.

    Args:
        root: The data set.
        out: The folder to write; written whole or not at all.
        mesh: The drone's mesh file, in the unit that it was rendered with, or those of all drones
            in their order; where there are fewer, the project's example drone is known.
        threads: Number of threads, 0 for one a core.
        progress: Called with the number of samples that are done and of all.

    Returns:
        What ``export.json`` says, without the images.

    Raises:
        FileNotFoundError: A file is missing.
        SynthError: The data set is not complete, a mesh is needed, or ``out`` holds something.
        OSError: A file cannot be read or written.

    Example:
        >>> export_bop("synth", "bop")["images"]  # doctest: +SKIP
        1000
    """
    scenes = complete_scenes(root)
    files = [mesh] if isinstance(mesh, str) else list(mesh or [])
    drones, words = [], []
    for drone, said in drone_meshes([scene for scene, _ in scenes], files):
        if drone is None:
            raise SynthError(f"mesh: {said}")
        drones.append(drone)
        words.append(said)
    total, done = sum(len(records) for _, records in scenes), 0
    table, images = [], []
    with whole_folder(Path(out)) as part:
        for number, (scene, records) in enumerate(scenes, 1):
            writer = _Scene(scene, part / scene.split / f"{number:06d}", drones, threads)
            for record in records:
                for step in (0, 1):
                    images.append([number, writer.count, record["row"], step])
                    writer.add(record, step)
                done += 1
                if progress is not None:
                    progress(done, total)
            writer.finish()
            table.append({"scene": number, "building": scene.building, "split": scene.split})
        _models(part / "models", drones)
        facts = {
            "format": "bop",
            "images": len(images),
            "samples": total,
            "scenes": table,
            "mesh": "; ".join(words),
        }
        columns = {"columns": ["scene", "image", "row", "time"], "rows": images}
        _json(part / "export.json", {**facts, "image_table": columns})
    return facts


class _Scene:
    """One scene on its way to a BOP folder."""

    def __init__(
        self, scene: SceneFolder, folder: Path, drones: Sequence[Mesh], threads: int
    ) -> None:
        self.scene, self.folder, self.drones, self.threads = scene, folder, drones, threads
        self.moments = scene.moments()
        self.count = 0
        self.camera: Camera = scene.cameras["exocentric"]
        self._cameras: dict[str, Any] = {}
        self._truth: dict[str, Any] = {}
        self._info: dict[str, Any] = {}
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []
        K = self.camera.K
        K[:2, 2] -= _BOP_CENTRE
        self._K = K.ravel().tolist()
        c = self.camera
        self._large = Camera(
            c.fx, c.fy, c.cx + c.width, c.cy + c.height, 3 * c.width, 3 * c.height, skew=c.skew
        )
        for name in ("rgb", "depth", "mask", "mask_visib"):
            (folder / name).mkdir(parents=True)

    def add(self, record: dict[str, Any], step: int) -> None:
        """One image."""
        scene, camera, number = self.scene, self.camera, self.count
        row, sources = int(record["row"]), other_rows(record)
        if len(sources) >= len(self.drones):
            raise SynthError(f"{scene.building} row {row}: drones that the manifest does not name")
        for source in (row, *sources):
            if source is not None and source >= len(self.moments.t):
                raise SynthError(f"{scene.flight}: has no row {source}, of a kept sample")
        for folder, modality in (("rgb", "colour"), ("depth", "depth")):
            content = scene.file(row, step, "exocentric", modality).read_bytes()
            (self.folder / folder / f"{number:06d}.png").write_bytes(content)
        instance = scene.picture(row, step, "exocentric", "instance")
        depth = scene.picture(row, step, "exocentric", "depth")
        size = (camera.height, camera.width)
        for modality, image in (("instance", instance), ("depth", depth)):
            if image.shape != size:
                path = scene.file(row, step, "exocentric", modality)
                raise SynthError(f"{path}: expected {size}, found {image.shape}")
        key = str(number)
        self._cameras[key] = {"cam_K": self._K, "depth_scale": DEPTH_SCALE * _MM}
        self._truth[key], self._info[key] = [], []
        own = self.moments.R[row], self.moments.t[row]
        for k, source in enumerate((row, *sources)):
            if source is None:
                continue
            R, t = own if k == 0 else self.moments.other(row, source)
            self._object(number, k, (R[step], t[step]), instance == DRONE_ID + k, depth > 0)
        self._images.append(
            {"id": number, "file_name": f"rgb/{number:06d}.png", "width": size[1],
             "height": size[0]}
        )  # fmt: skip
        self.count += 1

    def _object(
        self, number: int, drone: int, pose: tuple[Array, Array], seen: Mask, valid: Mask
    ) -> None:
        """One drone in an image."""
        (R, t), size, key = pose, seen.shape, str(number)
        place = len(self._truth[key])
        plane = gbuffer(
            self.drones[drone], self._large, R, t, channels=("mask",), threads=self.threads
        )
        assert plane.mask is not None
        large = plane.mask.copy()
        middle = large[size[0] : 2 * size[0], size[1] : 2 * size[1]]
        middle |= seen  # where rounding of the poses has moved an edge over a pixel's centre
        for folder, mask in (("mask", middle), ("mask_visib", seen)):
            name = f"{number:06d}_{place:06d}.png"
            (self.folder / folder / name).write_bytes(png(255 * mask.astype(np.uint8)))
        count = int(large.sum())
        self._truth[key].append(
            {
                "cam_R_m2c": R.ravel().tolist(),
                "cam_t_m2c": (_MM * t).tolist(),
                "obj_id": drone + 1,
            }
        )
        self._info[key].append(
            {
                "bbox_obj": _box(large, (size[1], size[0])),
                "bbox_visib": _box(seen),
                "px_count_all": count,
                "px_count_valid": int((middle & valid).sum()),
                "px_count_visib": int(seen.sum()),
                "visib_fract": int(seen.sum()) / count if count else 0.0,
            }
        )
        if seen.any():
            left, top, width, height = _box(seen)
            self._annotations.append(
                {
                    "id": len(self._annotations) + 1,
                    "image_id": number,
                    "category_id": drone + 1,
                    "iscrowd": 0,
                    "area": int(seen.sum()),
                    "bbox": [left, top, width + 1, height + 1],
                    "segmentation": {"size": list(size), "counts": rle_counts(seen)},
                    "width": size[1],
                    "height": size[0],
                }
            )

    def finish(self) -> None:
        """The files of the scene."""
        name = str(self.scene.facts["drone"])
        _json(self.folder / "scene_camera.json", self._cameras)
        _json(self.folder / "scene_gt.json", self._truth)
        _json(self.folder / "scene_gt_info.json", self._info)
        coco = {
            "info": {"description": f"{self.scene.building} ({self.scene.split})"},
            "licenses": [],
            "categories": [
                {"id": k, "name": str(k), "supercategory": name}
                for k in range(1, len(self.drones) + 1)
            ],
            "images": self._images,
            "annotations": self._annotations,
        }
        _json(self.folder / "scene_gt_coco.json", coco)


def _box(mask: Mask, origin: tuple[int, int] = (0, 0)) -> list[int]:
    """BOP's box: first column and row, and from there to the last; -1 where there is nothing."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return [-1, -1, -1, -1]
    left, top = int(columns[0]), int(rows[0])
    return [left - origin[0], top - origin[1], int(columns[-1]) - left, int(rows[-1]) - top]


def _models(folder: Path, drones: Sequence[Mesh]) -> None:
    """The drones in millimetres, as ASCII PLY, and their measures."""
    folder.mkdir()
    facts = {str(k): _model(folder / f"obj_{k:06d}.ply", mesh) for k, mesh in enumerate(drones, 1)}
    _json(folder / "models_info.json", facts)


def _model(path: Path, mesh: Mesh) -> dict[str, float]:
    points = _MM * mesh.vertices
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property double {axis}" for axis in _AXES]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    lines.append("end_header")
    lines += [" ".join(repr(float(x)) for x in point) for point in points]
    lines += ["3 " + " ".join(str(int(k)) for k in face) for face in mesh.faces]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    low, high = _MM * mesh.bounds
    facts = {"diameter": _MM * mesh.diameter}
    facts |= {f"min_{axis}": float(low[k]) for k, axis in enumerate(_AXES)}
    facts |= {f"size_{axis}": float(high[k] - low[k]) for k, axis in enumerate(_AXES)}
    return facts


def _json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content) + "\n", encoding="utf-8")
