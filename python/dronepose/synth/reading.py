"""A rendered data set read back: its scenes, records, files and poses."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose.camera import Camera
from dronepose.geometry import matrix_from_quat_xyzw
from dronepose.mesh import Mesh
from dronepose.synth.dataset import SynthError
from dronepose.synth.encode import read_png
from dronepose.synth.layout import MODALITIES, flight_file, image_file, record_file, scene_files
from dronepose.synth.others import other_rows

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

__all__ = [
    "Moments",
    "SceneFolder",
    "drone_mesh",
    "drone_meshes",
    "read_lines",
    "read_scenes",
]

_END = b"IEND\xaeB`\x82"
_OPENCV_FROM_BLENDER = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True)
class Moments:
    """The poses of a flight's file, row by row, at both times.

    Args:
        R: ``(N, 2, 3, 3)`` rotations of ``cam_from_model`` in the exocentric view.
        t: ``(N, 2, 3)`` translations, metres.
        norm: ``(N, 3)`` norms of the quaternions as they are in the file: of the drone at both
            times and of the camera.
        drone: ``world_from_model``, ``(N, 2, 3, 3)`` and ``(N, 2, 3)``.
        camera: ``cam_from_world``, rotations ``(N, 3, 3)``, and the cameras' places ``(N, 3)``.
    """

    R: Array
    t: Array
    norm: Array
    drone: tuple[Array, Array]
    camera: tuple[Array, Array]

    def other(self, row: int, source: int) -> tuple[Array, Array]:
        """``cam_from_model`` of a drone that flies as that of another row, seen from a row.

        Args:
            row: Whose camera.
            source: Whose drone.

        Returns:
            ``(2, 3, 3)`` and ``(2, 3)``, at both times.

        Raises:
            IndexError: There is no such row.
        """
        (turn, place), (camera, eye) = self.drone, self.camera
        return camera[row] @ turn[source], (place[source] - eye[row]) @ camera[row].T


@dataclass(frozen=True, slots=True)
class SceneFolder:
    """A scene of a data set that :func:`dronepose.synth.dataset.write_dataset` wrote.

    Args:
        root: The data set.
        facts: The content of ``scenes/BUILDING.json``.
        cameras: By view.
    """

    root: Path
    facts: dict[str, Any]
    cameras: dict[str, Camera]

    @property
    def building(self) -> str:
        """Name of the scene."""
        return str(self.facts["building"])

    @property
    def split(self) -> str:
        """Its split."""
        return str(self.facts["split"])

    @property
    def flight(self) -> Path:
        """The file of the poses."""
        return flight_file(self.root, self.facts)

    def file(self, row: int, step: int, view: str, modality: str) -> Path:
        """An image of a sample."""
        return image_file(self.root, self.facts, row, step, view, modality)

    def files(self, row: int) -> list[Path]:
        """All images of a kept sample."""
        return [
            self.file(row, step, view, modality)
            for view, modalities in MODALITIES.items()
            for modality in modalities
            for step in (0, 1)
        ]

    def picture(self, row: int, step: int, view: str, modality: str) -> NDArray[Any]:
        """A decoded image, whatever its size.

        Raises:
            OSError: It cannot be read.
            SynthError: It is no PNG.
        """
        path = self.file(row, step, view, modality)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            raise FileNotFoundError(f"{path}: is missing") from None
        if not content.endswith(_END):
            raise SynthError(f"{path}: the PNG file is cut off")
        try:
            return read_png(content)
        except ValueError:
            raise SynthError(f"{path}: cannot be decoded, expected a PNG") from None

    def records(self) -> list[dict[str, Any]]:
        """The records that are there, by row.

        Raises:
            SynthError: One is no JSON, or lacks its row or whether it was kept.
        """
        found = []
        for path in sorted(record_file(self.root, self.building, 0).parent.glob("*.json")):
            record = _json(path)
            if not isinstance(record.get("row"), int) or record.get("kept") not in (0, 1):
                raise SynthError(f"{path}: expected row, a whole number, and kept, 0 or 1")
            try:
                rows = other_rows(record)
            except ValueError as error:
                raise SynthError(f"{path}: {error}") from None
            if any(row is not None and row >= self.facts["rows"] for row in rows):
                raise SynthError(f"{path}: names a row that the plan does not have: {rows}")
            found.append(record)
        return found

    def moments(self) -> Moments:
        """The poses of the flight's file.

        Raises:
            OSError: It cannot be read.
            SynthError: A column or a number is missing.
        """
        path = self.flight
        lines = read_lines(path)
        names = lines[0].split("\t") if lines else []
        columns = {name: k for k, name in enumerate(names)}
        absent = [name for name in _flight_columns() if name not in columns]
        if absent:
            raise SynthError(f"{path}:1: the header has no {', '.join(absent)}")
        table = np.empty((len(lines) - 1, len(names)))
        for k, line in enumerate(lines[1:]):
            try:
                table[k] = [float(cell) for cell in line.split("\t")]
            except ValueError:
                raise SynthError(f"{path}:{k + 2}: expected {len(names)} numbers") from None
        if not np.isfinite(table).all():
            line_number = 2 + int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
            raise SynthError(f"{path}:{line_number}: a number is not finite")

        def of(name: str, axes: str, suffix: str = "") -> Array:
            return table[:, [columns[f"{name}({axis}){suffix}"] for axis in axes]]

        turns = [of("Orientation", "xyzw", s) for s in ("_t1", "_t2")] + [of("PilotRot", "xyzw")]
        norm = np.stack([np.linalg.norm(q, axis=1) for q in turns], axis=1)
        if norm.size and norm.min() < 1e-3:
            line_number = 2 + int(np.flatnonzero(norm.min(axis=1) < 1e-3)[0])
            raise SynthError(f"{path}:{line_number}: a quaternion of zeros")
        first, second, camera = (matrix_from_quat_xyzw(turn) for turn in turns)
        opencv = _OPENCV_FROM_BLENDER @ np.swapaxes(camera, 1, 2)  # cam_from_world
        eye = of("Pilot", "xyz")
        R = np.stack([opencv @ first, opencv @ second], axis=1)
        t = np.stack(
            [
                np.einsum("nij,nj->ni", opencv, of("Position", "xyz", suffix) - eye)
                for suffix in ("_t1", "_t2")
            ],
            axis=1,
        )
        places = np.stack([of("Position", "xyz", suffix) for suffix in ("_t1", "_t2")], axis=1)
        drone = np.stack([first, second], axis=1), places
        return Moments(R, t, norm, drone, (opencv, eye))


def _flight_columns() -> list[str]:
    steps = ("_t1", "_t2")
    names = [f"Position({axis}){step}" for step in steps for axis in "xyz"]
    names += [f"Orientation({axis}){step}" for step in steps for axis in "xyzw"]
    return [*names, *(f"Pilot({a})" for a in "xyz"), *(f"PilotRot({a})" for a in "xyzw")]


def read_scenes(root: str | os.PathLike[str]) -> list[SceneFolder]:
    """The scenes of a data set, by name.

    Args:
        root: Its folder.

    Returns:
        The scenes; complete or not.

    Raises:
        FileNotFoundError: The folder holds no rendered data set.
        SynthError: A scene's file is broken.
    """
    root = Path(root)
    paths = scene_files(root)
    if not paths:
        raise FileNotFoundError(f"{root}: holds no rendered data set (no scenes/BUILDING.json)")
    found = []
    for path in paths:
        facts = _json(path)
        for key in ("building", "drone", "date", "split", "rows", "cameras"):
            if key not in facts:
                raise SynthError(f"{path}: has no {key}")
        if not isinstance(facts["rows"], int) or facts["rows"] < 0:
            raise SynthError(f"{path}: rows: expected a whole number, got {facts['rows']!r}")
        try:
            cameras = {view: Camera(**facts["cameras"][view]) for view in MODALITIES}
        except (KeyError, TypeError, ValueError) as error:
            raise SynthError(f"{path}: cameras: {error}") from None
        found.append(SceneFolder(root, facts, cameras))
    return found


def read_lines(path: Path) -> list[str]:
    """The lines of a UTF-8 file.

    Raises:
        FileNotFoundError: There is no such file.
        SynthError: It is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: is missing") from None
    except UnicodeDecodeError as error:
        raise SynthError(f"{path}: not UTF-8 at byte {error.start}") from None


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise SynthError(f"{path}: no JSON: {error}") from None
    if not isinstance(found, dict):
        raise SynthError(f"{path}: expected a JSON object")
    return found


def drone_mesh(scenes: list[SceneFolder], file: str | None) -> tuple[Mesh | None, str]:
    """The mesh of a data set's first drone, and words on where it is from: :func:`drone_meshes`."""
    return drone_meshes(scenes, [] if file is None else [file])[0]


def drone_meshes(scenes: list[SceneFolder], files: Sequence[str]) -> list[tuple[Mesh | None, str]]:
    """The meshes of a data set's drones, and words on where each is from.

    Args:
        scenes: Those of the data set.
        files: The mesh files in the order of the drones; scaled and turned as the data set says.
            Where there are fewer, the project's example drone is known.

    Returns:
        For each drone its mesh in metres, or ``None`` where a file is needed.

    Raises:
        ValueError: A file holds no mesh, or there are more files than drones.
        OSError: One cannot be read.
    """
    several = [scene.facts.get("inputs", {}) for scene in scenes]
    drones = [[of.get("drone", {}), *of.get("more_drones", [])] for of in several]
    if any(other != drones[0] for other in drones):
        return [(None, "the scenes are of several drones")]
    if len(files) > len(drones[0]):
        raise SynthError(f"mesh: expected {len(drones[0])} files at most, got {len(files)}")
    named = [*files, *[None] * (len(drones[0]) - len(files))]
    return [_mesh_of(facts, file) for facts, file in zip(drones[0], named, strict=True)]


def _mesh_of(facts: dict[str, Any], file: str | None) -> tuple[Mesh | None, str]:
    """The mesh that a data set's inputs speak of."""
    turn = np.array(facts.get("turned", np.eye(3)))
    if file is None:
        if facts.get("file") == "example":
            from dronepose.data.toyset import EXAMPLE_MESH

            return _turned(Mesh.from_file(EXAMPLE_MESH), turn), "the example drone"
        named = f" ({facts['file']} was rendered)" if "file" in facts else ""
        return None, f"needs --mesh FILE{named}"
    path, unit = Path(file), float(facts.get("metres_per_unit", 1.0))
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such mesh")
    if path.suffix.lower() in (".obj", ".ply", ".stl"):
        mesh = Mesh.from_file(path)
        mesh = mesh if unit == 1 else Mesh(mesh.vertices * unit, mesh.faces)
    else:
        from dronepose.synth.asset import load_asset

        mesh = load_asset(path, metres_per_unit=unit).mesh
    same = hashlib.sha256(path.read_bytes()).hexdigest() == facts.get("sha256")
    words = f"{path.name}, {'the file' if same else 'NOT the file'} that was rendered"
    return _turned(mesh, turn), words


def _turned(mesh: Mesh, turn: Array) -> Mesh:
    if np.array_equal(turn, np.eye(3)):
        return mesh
    return Mesh(mesh.vertices @ turn.T, mesh.faces)
