"""UAVA, the data set of the DronePose paper: see :class:`UavaDataset`."""

from __future__ import annotations

import csv
import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from dronepose import geometry
from dronepose.camera import Camera
from dronepose.data._errors import DataError, missing, read_text
from dronepose.data._images import read_mask, read_rgb
from dronepose.data._poses import TOLERANCE, check_pose, number
from dronepose.data.sample import PoseDataset, Raw, check_sizes

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray
    from torch import Tensor

    Array = NDArray[np.float64]

_AXES = ("x", "y", "z")
_OPENCV_FROM_BLENDER = np.diag([1.0, -1.0, -1.0])
HORIZONTAL_DEG = 64.69


class UavaDataset(PoseDataset):
    """Exocentric images of UAVA with the pose of the drone in them.

    .. code-block:: text

        DRONE/VIEW/MODALITY/BUILDING/ROW_DATE_FRAME_.._VIEW_..  (M2ED/exocentric/colour/...)
        trajectories/BUILDING/DATE/*blender*                     tab-separated, with a header
        data splits/scenes_train.txt, scenes_val.txt, scenes_test.txt

    A file of a flight has the columns ``Position(x)_t1``, ``Orientation(x)_t1`` (with ``w``), the
    same for ``_t2``, ``Pilot(x)`` and ``PilotRot(x)``; row ``ROW``, from 0, and time step ``FRAME``
    (0 is ``_t1``, 1 is ``_t2``) belong to an image. Quaternions are ``x, y, z, w``; the pose is
    ``R = R_cam^T R_drone``, ``t = R_cam^T (T_drone - T_cam)``, in metres.

    What the authors' code (github.com/VCL3D/DronePose, ``dataset/dataloader.py`` and
    ``importers/extrinsics.py``) leaves open is decided here:

    - It keeps Blender's camera axes (y up, looking down -z). With ``axes="blender"``, the default,
      they are turned into OpenCV's by ``diag(1, -1, -1)``; ``"opencv"`` takes the rows as they are.
    - The model frame is that of the mesh file, which its renderer puts through the pose unchanged.
    - Names have six parts between underscores, or seven where the modality has two
      (``normal_map``): the last but one is the view.
    - Quaternions are not normalised there; here they are, if their norm is within 1 % of 1.
    - Both time steps of a row are samples of their own, ``BUILDING_ROW_DATE_FRAME``; the authors
      train on frame 0 (``frames=(0,)``). :meth:`pairs` finds the two steps of a row.
    - The camera has 64.69 degrees from left to right (the paper's supplement) and its principal
      point in the middle, whatever the size of the images.
    - A building without a folder stops the authors' code, and so it does here, unless
      ``allow_missing`` turns it into a warning.

    Args:
        root: The folder that holds the folders of the drones.
        split: ``"train"``, ``"val"`` or ``"test"``: which list of buildings.
        trajectories: Folder of the flights; ``None`` is ``root/trajectories``.
        splits: Folder of the lists; ``None`` is ``root/data splits``.
        drone: Folder of the drone; ``None`` is the only one that holds the view (M2ED in UAVA).
        view: Folder and name of the view.
        image: Folder of the modality that is the image.
        mask: Folder of the modality that is the mask; ``None`` for none.
        frames: Time steps to use, of 0 and 1.
        horizontal_deg: Field of view of the camera, degrees.
        axes: Camera axes of the files, ``"blender"`` or ``"opencv"``.
        allow_missing: Whether buildings without a folder are left out with a warning.
        height: As in :class:`PoseDataset`, and so are the following.
        width: As in :class:`PoseDataset`.
        geometric: As in :class:`PoseDataset`.
        photometric: As in :class:`PoseDataset`.
        seed: As in :class:`PoseDataset`.

    Raises:
        FileNotFoundError: A list, folder, flight, image or mask is missing.
        DataError: A name, column, row or pose is wrong; the message names file, line and sample.
        ValueError: An argument is out of its range.

    Warns:
        UserWarning: Buildings are missing and ``allow_missing`` is set.

    Example:
        >>> data = UavaDataset("UAVA", "val", frames=(0,))  # doctest: +SKIP
        >>> data[0]["name"]  # doctest: +SKIP
        '2azQ1b91cZZ_0_2019-12-24-13-30-23_0'
    """

    def __init__(
        self,
        root: str | os.PathLike[str],
        split: str,
        *,
        trajectories: str | os.PathLike[str] | None = None,
        splits: str | os.PathLike[str] | None = None,
        drone: str | None = None,
        view: str = "exocentric",
        image: str = "colour",
        mask: str | None = "silhouette",
        frames: Sequence[int] = (0, 1),
        horizontal_deg: float = HORIZONTAL_DEG,
        axes: Literal["blender", "opencv"] = "blender",
        allow_missing: bool = False,
        height: int | None = None,
        width: int | None = None,
        geometric: Callable[[Raw, np.random.Generator], Raw] | None = None,
        photometric: Callable[[Tensor, np.random.Generator], Tensor] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(
            height=height, width=width, geometric=geometric, photometric=photometric, seed=seed
        )
        if axes not in ("blender", "opencv"):
            raise ValueError(f"axes: expected 'blender' or 'opencv', got {axes!r}")
        if not frames or not set(frames) <= {0, 1}:
            raise ValueError(f"frames: expected some of 0 and 1, got {tuple(frames)}")
        Camera.from_fov(4, 3, horizontal_deg=horizontal_deg)
        self.root, self.split = Path(root), split
        self.view, self.frames = view, frozenset(frames)
        self.horizontal_deg, self.axes = horizontal_deg, axes
        self._flights = Path(trajectories) if trajectories else self.root / "trajectories"
        lists = Path(splits) if splits else self.root / "data splits"
        # Plain lists and arrays: tens of thousands of samples travel to each worker.
        self.names: list[str] = []
        self._images: list[str] = []
        self._masks: list[str] = []
        poses: list[tuple[Array, Array]] = []
        folder = self.root / (drone or _only_drone(self.root, view)) / view
        if not folder.is_dir():
            missing(folder, "the images of a drone and a view")
        for building, where in buildings(lists / f"scenes_{split}.txt"):
            if not (folder / image / building).is_dir():
                text = f"{where}: building {building} has no folder {folder / image / building}"
                if not allow_missing:
                    raise FileNotFoundError(text)
                warnings.warn(text, stacklevel=2)
                continue
            flights: dict[str, _Flight] = {}
            masks = None if mask is None else self._files(folder / mask / building)
            for key, path in self._files(folder / image / building).items():
                row, date, frame = key
                name = f"{building}_{row}_{date}_{frame}"
                if masks is not None and key not in masks:
                    raise FileNotFoundError(
                        f"{folder / str(mask) / building}: no mask of sample {name!r}, of the "
                        f"image {path.name}"
                    )
                if date not in flights:
                    flights[date] = self._flight(building, date)
                poses.append(flights[date].pose(row, frame, name, axes))
                self.names.append(name)
                self._images.append(str(path))
                if masks is not None:
                    self._masks.append(str(masks[key]))
        self._R = np.array([R for R, _ in poses]).reshape(-1, 3, 3)
        self._t = np.array([t for _, t in poses]).reshape(-1, 3)

    def _files(self, folder: Path) -> dict[tuple[int, str, int], Path]:
        """The images of a building by row, date and frame, in this order."""
        if not folder.is_dir():
            missing(folder, "a folder of images of a building")
        found: dict[tuple[int, str, int], Path] = {}
        for path in folder.iterdir():
            if not path.is_file() or path.name.startswith("."):
                continue
            row, date, frame, view = parse_name(path)
            if view != self.view or frame not in self.frames:
                continue
            if (row, date, frame) in found:
                raise DataError(
                    f"{path}: the same row, date and frame as {found[row, date, frame]}"
                )
            found[row, date, frame] = path
        return dict(sorted(found.items(), key=lambda each: (each[0][1], each[0][0], each[0][2])))

    def _flight(self, building: str, date: str) -> _Flight:
        folder = self._flights / building / date
        files = sorted(folder.glob("*blender*")) if folder.is_dir() else []
        if len(files) != 1:
            found = ", ".join(path.name for path in files) or "none"
            raise FileNotFoundError(
                f"{folder}: expected one file with 'blender' in its name, found {found}"
            )
        return _Flight(files[0])

    def pose(self, index: int) -> tuple[Array, Array]:
        """The pose in a sample; no image is read.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            ``R`` ``(3, 3)`` and ``t`` ``(3,)`` of ``cam_from_model``, float64, metres.

        Raises:
            IndexError: There is no such sample.

        Example:
            >>> R, t = UavaDataset("UAVA", "val").pose(0)  # doctest: +SKIP
        """
        return self._R[index], self._t[index]

    def load(self, index: int) -> Raw:
        """The sample as it is on the disk.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            The sample.

        Raises:
            FileNotFoundError: Its image or mask is missing.
            DataError: Its image or mask is broken.

        Example:
            >>> UavaDataset("UAVA", "val").load(0).size  # doctest: +SKIP
            (240, 320)
        """
        name, file = self.names[index], Path(self._images[index])
        whose = f"sample {name!r}"
        image = read_rgb(file, whose)
        mask = read_mask(Path(self._masks[index]), whose) if self._masks else None
        check_sizes(image, mask, f"{file}: {whose}")
        K = self._camera(image.shape[0], image.shape[1]).K
        return Raw(image, mask, K, self._R[index], self._t[index], name)

    @property
    def camera(self) -> Camera:
        """The camera of the images, at the size of the first, which is read for it.

        Example:
            >>> UavaDataset("UAVA", "val").camera.cx  # doctest: +SKIP
            160.0
        """
        return self._camera(*self.load(0).size)

    def _camera(self, height: int, width: int) -> Camera:
        return Camera.from_fov(width, height, horizontal_deg=self.horizontal_deg)

    def pairs(self) -> list[tuple[int, int]]:
        """Indices of the two time steps of each row of which both are here.

        Returns:
            ``(index of frame 0, index of frame 1)``.

        Example:
            >>> UavaDataset("UAVA", "val").pairs()[0]  # doctest: +SKIP
            (0, 1)
        """
        place = {name: index for index, name in enumerate(self.names)}
        out = []
        for index, name in enumerate(self.names):
            other = place.get(f"{name[:-1]}1")
            if name.endswith("_0") and other is not None:
                out.append((index, other))
        return out


def _only_drone(root: Path, view: str) -> str:
    """The folder that holds a folder of the view; UAVA's own where there is none.

    Raises:
        DataError: There are several.
    """
    found = sorted(path.parent.name for path in root.glob(f"*/{view}") if path.is_dir())
    if len(found) > 1:
        raise DataError(f"{root}: holds several drones, {', '.join(found)}; say which (drone=...)")
    return found[0] if found else "M2ED"


def buildings(path: Path) -> list[tuple[str, str]]:
    """The buildings of a split, a line each, with their place ``FILE:LINE``.

    Args:
        path: ``scenes_SPLIT.txt``.

    Returns:
        Names and places, in the order of the file.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: A name occurs twice, there is none, or the file is not UTF-8.

    Example:
        >>> buildings(Path("data splits/scenes_val.txt"))[0]  # doctest: +SKIP
        ('2azQ1b91cZZ', 'data splits/scenes_val.txt:1')
    """
    content = read_text(path, "the list of the buildings of a split")
    found: dict[str, str] = {}
    for line, text in enumerate(content.splitlines(), 1):
        name = text.strip()
        if name in found:
            raise DataError(f"{path}:{line}: {name} again, first in {found[name]}")
        if name:
            found[name] = f"{path}:{line}"
    if not found:
        raise DataError(f"{path}: names no building")
    return list(found.items())


def parse_name(path: Path) -> tuple[int, str, int, str]:
    """Row, date, time step and view of an image's name.

    Args:
        path: ``ROW_DATE_FRAME_MODALITY_VIEW_REST``; the modality may hold one underscore.

    Returns:
        ``(row, date, frame, view)``.

    Raises:
        DataError: The name is of another form.

    Example:
        >>> parse_name(Path("12_2019-12-24-13-30-23_0_combined_exocentric_0000.png"))
        (12, '2019-12-24-13-30-23', 0, 'exocentric')
    """
    parts = path.name.split("_")
    if len(parts) not in (6, 7) or not (parts[0].isdecimal() and parts[2].isdecimal()):
        raise DataError(
            f"{path}: expected a name like ROW_DATE_FRAME_MODALITY_VIEW_REST with whole numbers "
            f"for ROW and FRAME"
        )
    return int(parts[0]), parts[1], int(parts[2]), parts[-2]


class _Flight:
    """The rows of a file of a flight."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = read_text(path, "the file of a flight")
        reader = csv.DictReader(io.StringIO(text, newline=""), delimiter="\t")
        absent = [name for name in self.columns() if name not in (reader.fieldnames or [])]
        if absent:
            raise DataError(f"{path}:1: the header has no {', '.join(absent)} (separated by tabs)")
        self.rows = [(reader.line_num, row) for row in reader]

    @staticmethod
    def columns() -> list[str]:
        steps = [f"_t{k}" for k in (1, 2)]
        names = [f"Position({a}){step}" for step in steps for a in _AXES]
        names += [f"Orientation({a}){step}" for step in steps for a in (*_AXES, "w")]
        names += [f"Pilot({a})" for a in _AXES]
        return names + [f"PilotRot({a})" for a in (*_AXES, "w")]

    def pose(self, row: int, frame: int, name: str, axes: str) -> tuple[Array, Array]:
        """``R``, ``t`` of ``cam_from_model`` with OpenCV axes."""
        if row >= len(self.rows):
            raise DataError(
                f"{self.path}: sample {name!r} needs row {row}, the file has {len(self.rows)} rows"
            )
        line, cells = self.rows[row]
        place = f"{self.path}:{line}: sample {name!r}"
        step = f"_t{frame + 1}"
        T_drone = self._vector(cells, "Position({})" + step, place)
        R_drone = self._rotation(cells, "Orientation({})" + step, place)
        T_cam = self._vector(cells, "Pilot({})", place)
        R_cam = self._rotation(cells, "PilotRot({})", place)
        R, t = R_cam.T @ R_drone, R_cam.T @ (T_drone - T_cam)
        if axes == "blender":
            R, t = _OPENCV_FROM_BLENDER @ R, _OPENCV_FROM_BLENDER @ t
        return check_pose(R, t, place), t

    @staticmethod
    def _vector(
        cells: dict[str, str], names: str, place: str, axes: Sequence[str] = _AXES
    ) -> Array:
        columns = [names.format(a) for a in axes]
        return np.array([number(cells[c] or "", place, c) for c in columns])

    def _rotation(self, cells: dict[str, str], names: str, place: str) -> Array:
        q = self._vector(cells, names, place, (*_AXES, "w"))
        norm = float(np.linalg.norm(q))
        if abs(norm - 1) > TOLERANCE:
            raise DataError(
                f"{place}: column {names.format('x')}: a quaternion of norm {norm:.4g}, expected 1"
            )
        return geometry.matrix_from_quat_xyzw(q)
