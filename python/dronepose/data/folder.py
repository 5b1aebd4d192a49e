"""The project's own layout of a data set: see :class:`FolderDataset`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.camera import Camera
from dronepose.data._errors import DataError, missing
from dronepose.data._images import read_mask, read_rgb
from dronepose.data._manifest import FORMAT, SPLITS
from dronepose.data._poses import number, read_poses
from dronepose.data.sample import PoseDataset, Raw, check_sizes
from dronepose.mesh import Mesh
from dronepose.model.metadata import file_sha256

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from dronepose.data._poses import PoseRow

    Array = NDArray[np.float64]

_INTRINSICS = ("fx", "fy", "cx", "cy")


def read_manifest(root: str | os.PathLike[str]) -> dict[str, Any]:
    """``dataset.json`` of a data set: seeds, versions, conventions, camera, mesh.

    Args:
        root: The folder of the data set.

    Returns:
        The JSON object.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: It is no JSON, of another format, or of a data set that is not finished.

    Example:
        >>> read_manifest("toy")["format"]  # doctest: +SKIP
        'dronepose-folder-1'
    """
    path = Path(root) / "dataset.json"
    if not path.is_file():
        missing(path, "the description of a data set, as 'dronepose toyset' writes it")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataError(f"{path}: no JSON: {error}") from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        found = manifest.get("format") if isinstance(manifest, dict) else manifest
        raise DataError(f"{path}: format: expected {FORMAT!r}, found {found!r}")
    if manifest.get("complete") is not True:
        raise DataError(
            f"{path}: the data set is not finished; run the command that makes it once more "
            "to complete it"
        )
    return manifest


class FolderDataset(PoseDataset):
    """A split of a data set in the project's layout, as ``dronepose toyset`` writes it.

    .. code-block:: text

        dataset.json    format, seed, versions, conventions, camera, mesh and its SHA-256
        camera.json     fx fy cx cy width height, as dronepose-eval --camera reads it
        mesh.obj        the drone, metres
        train/, val/, test/
            poses.csv   id,qw,qx,qy,qz,tx,ty,tz,image: ground truth of dronepose-eval
            images/     000000.png: RGB, 8 bits
            masks/      000000.png: 255 x the share of the pixel that the drone covers

    ``poses.csv`` may name the file in a column ``image`` (else it is the id with ``.png``), and
    hold the intrinsics of each image in columns ``fx,fy,cx,cy``, which go before ``camera``. A
    split without a folder ``masks`` has no masks.

    Args:
        root: The folder of the data set.
        split: ``"train"``, ``"val"`` or ``"test"``, or another folder in it.
        height: As in :class:`PoseDataset`, and so are the following.
        width: As in :class:`PoseDataset`.
        geometric: As in :class:`PoseDataset`.
        photometric: As in :class:`PoseDataset`.
        seed: As in :class:`PoseDataset`.

    Raises:
        FileNotFoundError: The data set, the split or its poses are missing.
        DataError: The description or a pose is wrong; the message names file, line and sample.
        ValueError: As in :class:`PoseDataset`.

    Example:
        >>> data = FolderDataset("toy", "train")  # doctest: +SKIP
        >>> data[0]["image"].shape  # doctest: +SKIP
        torch.Size([3, 120, 160])
    """

    def __init__(
        self,
        root: str | os.PathLike[str],
        split: str,
        *,
        height: int | None = None,
        width: int | None = None,
        geometric: Callable[[Raw, np.random.Generator], Raw] | None = None,
        photometric: Callable[[Tensor, np.random.Generator], Tensor] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(
            height=height, width=width, geometric=geometric, photometric=photometric, seed=seed
        )
        self.root = Path(root)
        self.split = split
        self.manifest = read_manifest(root)
        self.folder = self.root / split
        if not self.folder.is_dir():
            raise FileNotFoundError(
                f"{self.folder}: no such folder, expected a split ({', '.join(SPLITS)})"
            )
        self.poses_file = self.folder / "poses.csv"
        self.rows = read_poses(self.poses_file)
        self.names = [row.name for row in self.rows]
        self.camera = self._camera()
        if self.camera is None and self.rows:
            absent = [name for name in _INTRINSICS if name not in self.rows[0].further]
            if absent:
                raise DataError(
                    f"{self.poses_file}:1: the header has no {','.join(absent)}, and "
                    f"{self.root / 'dataset.json'} no camera"
                )
        self.has_masks = (self.folder / "masks").is_dir()

    def _camera(self) -> Camera | None:
        """The camera of all images, of ``dataset.json``."""
        given = self.manifest.get("camera")
        if given is None:
            return None
        try:
            return Camera(**given)
        except (TypeError, ValueError) as error:
            raise DataError(f"{self.root / 'dataset.json'}: camera: {error}") from None

    @property
    def mesh_file(self) -> Path:
        """The drone's mesh.

        Example:
            >>> FolderDataset("toy", "train").mesh_file  # doctest: +SKIP
            PosixPath('toy/mesh.obj')
        """
        return self.root / str(self.manifest.get("mesh", {}).get("file", "mesh.obj"))

    def mesh(self) -> Mesh:
        """The drone, metres; its SHA-256 is compared with ``dataset.json``.

        Returns:
            The mesh.

        Raises:
            OSError: The file cannot be read.
            DataError: It is not the file that the data set was made with.

        Example:
            >>> FolderDataset("toy", "train").mesh()  # doctest: +SKIP
            Mesh(2032 vertices, 3912 faces, 0.387 x 0.392 x 0.16 m)
        """
        path = self.mesh_file
        if not path.is_file():
            missing(path, "the mesh of the data set")
        stated = self.manifest.get("mesh", {}).get("sha256")
        found = file_sha256(path)
        if stated is not None and stated != found:
            raise DataError(f"{path}: SHA-256 is {found}, dataset.json says {stated}")
        return Mesh.from_file(path)

    def pose(self, index: int) -> tuple[Array, Array]:
        """The pose in a sample; no image is read.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            ``R`` ``(3, 3)`` and ``t`` ``(3,)`` of ``cam_from_model``, float64, metres.

        Raises:
            IndexError: There is no such sample.

        Example:
            >>> R, t = FolderDataset("toy", "train").pose(0)  # doctest: +SKIP
        """
        row = self.rows[index]
        return row.R, row.t

    def load(self, index: int) -> Raw:
        """The sample as it is on the disk.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            The sample.

        Raises:
            FileNotFoundError: Its image or mask is missing.
            DataError: Its image, mask or intrinsics are broken.

        Example:
            >>> FolderDataset("toy", "train").load(0).image.shape  # doctest: +SKIP
            (120, 160, 3)
        """
        row = self.rows[index]
        file = row.further.get("image") or f"{row.name}.png"
        place = f"{self.poses_file}:{row.line}: sample {row.name!r}"
        whose = f"sample {row.name!r} ({self.poses_file}:{row.line})"
        image = read_rgb(self.folder / "images" / file, whose)
        mask = None
        if self.has_masks:
            mask = read_mask((self.folder / "masks" / file).with_suffix(".png"), whose)
        check_sizes(image, mask, place)
        K = self._matrix(row, place, (image.shape[0], image.shape[1]))
        return Raw(image, mask, K, row.R, row.t, row.name)

    def _matrix(self, row: PoseRow, place: str, size: tuple[int, int]) -> Array:
        height, width = size
        own = [row.further.get(name) for name in _INTRINSICS]
        if all(own):
            values = [
                number(text or "", place, name) for name, text in zip(_INTRINSICS, own, strict=True)
            ]
            try:
                return Camera(values[0], values[1], values[2], values[3], width, height).K
            except ValueError as error:
                raise DataError(f"{place}: {error}") from None
        if self.camera is None:
            raise DataError(f"{place}: no intrinsics, expected {','.join(_INTRINSICS)}")
        if (self.camera.width, self.camera.height) != (width, height):
            raise DataError(
                f"{place}: the image is {width}x{height} pixels, the camera of dataset.json "
                f"{self.camera.width}x{self.camera.height}"
            )
        return self.camera.K
