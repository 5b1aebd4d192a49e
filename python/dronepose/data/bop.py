"""Scenes of the BOP benchmark: see :class:`BopDataset`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose.camera import Camera
from dronepose.data._errors import DataError, missing
from dronepose.data._images import read_mask, read_rgb
from dronepose.data._poses import check_pose
from dronepose.data.sample import PoseDataset, Raw, check_sizes

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from numpy.typing import NDArray
    from torch import Tensor

    Array = NDArray[np.float64]

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".bmp")
_METRES = 1e-3


@dataclass(frozen=True, slots=True)
class _Item:
    """One instance of the object in one image."""

    name: str
    scene: Path
    number: int
    instance: int
    R: Array
    t: Array
    K: Array
    place: str


class BopDataset(PoseDataset):
    """Images of one object in scenes of the BOP layout, millimetres turned into metres.

    .. code-block:: text

        SPLIT/000001/scene_gt.json, scene_camera.json, scene_gt_info.json (for "most_visible")
                     rgb/000000.png (or gray/, .jpg), mask_visib/000000_000000.png

    ``cam_K`` has whole numbers at pixel centres in BOP (OpenCV's habit): ``cx`` and ``cy`` gain
    half a pixel. Names are the ids of ``dronepose-eval --objects``: the number of the image where
    there is one scene, else ``SCENE/IMAGE/OBJECT``; with ``instance="all"`` ``#INSTANCE`` follows.

    Args:
        root: The folder of the data set, or with ``split=""`` of the scenes.
        split: Folder of the scenes in it, such as ``"train_pbr"``; a folder that holds
            ``scene_gt.json`` itself is one scene.
        object_id: ``obj_id``; ``None`` if the scenes hold one object only.
        instance: ``"one"`` refuses images with several instances of the object, ``"most_visible"``
            takes that of the largest ``visib_fract``, ``"all"`` makes each a sample.
        mask: Folder of the masks, ``"mask_visib"`` or ``"mask"``; ``None`` for none.
        pixel_centre: Added to ``cx`` and ``cy``: 0.5, or 0 if the files count as we do.
        height: As in :class:`PoseDataset`, and so are the following.
        width: As in :class:`PoseDataset`.
        geometric: As in :class:`PoseDataset`.
        photometric: As in :class:`PoseDataset`.
        seed: As in :class:`PoseDataset`.

    Raises:
        FileNotFoundError: A folder or file is missing.
        DataError: A file is no JSON, lacks a key, or holds a wrong pose or camera.
        ValueError: An argument is out of its range, or the object has several instances.

    Example:
        >>> data = BopDataset("lmo", "test", object_id=5)  # doctest: +SKIP
    """

    def __init__(
        self,
        root: str | os.PathLike[str],
        split: str,
        *,
        object_id: int | None = None,
        instance: Literal["one", "most_visible", "all"] = "one",
        mask: str | None = "mask_visib",
        pixel_centre: float = 0.5,
        height: int | None = None,
        width: int | None = None,
        geometric: Callable[[Raw, np.random.Generator], Raw] | None = None,
        photometric: Callable[[Tensor, np.random.Generator], Tensor] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(
            height=height, width=width, geometric=geometric, photometric=photometric, seed=seed
        )
        if instance not in ("one", "most_visible", "all"):
            raise ValueError(f"instance: expected 'one', 'most_visible' or 'all', got {instance!r}")
        self.folder = Path(root) / split
        self.object_id, self.instance, self.mask = object_id, instance, mask
        self.pixel_centre = pixel_centre
        self._assumed = object_id is None  # the first object is taken, and has to be the only one
        scenes = _scenes(self.folder)
        self._items = [
            item for scene in scenes for item in self._scene(scene, several=len(scenes) > 1)
        ]
        if not self._items:
            raise DataError(f"{self.folder}: no instance of object {object_id}")
        self.names = [item.name for item in self._items]

    def _scene(self, scene: Path, *, several: bool) -> list[_Item]:
        truth, cameras = _numbered(scene / "scene_gt.json"), _numbered(scene / "scene_camera.json")
        visible: dict[int, Any] = {}
        if self.instance == "most_visible":
            visible = _numbered(scene / "scene_gt_info.json")
        label = str(int(scene.name)) if scene.name.isdecimal() else scene.name
        out = []
        for number, instances in truth.items():
            place = f"{scene / 'scene_gt.json'}: image {number}"
            if not isinstance(instances, list):
                raise DataError(f"{place}: expected a list of instances")
            own = [k for k, one in enumerate(instances) if self._wanted(one, place)]
            if len(own) > 1 and self.instance == "one":
                raise ValueError(
                    f"instance: {place} has {len(own)} instances of object {self.object_id}; "
                    "choose 'most_visible' or 'all'"
                )
            if len(own) > 1 and self.instance == "most_visible":
                own = [max(own, key=lambda k: _visibility(visible, number, k, scene))]
            for k in own:
                name = f"{label}/{number}/{self.object_id}" if several else str(number)
                name += f"#{k}" if self.instance == "all" else ""
                out.append(self._item(scene, number, k, instances[k], cameras, name))
        return out

    def _wanted(self, one: Any, place: str) -> bool:
        if not isinstance(one, dict) or not isinstance(one.get("obj_id"), int):
            raise DataError(f"{place}: an instance without a whole number obj_id")
        if self.object_id is None:
            self.object_id = one["obj_id"]
        same: bool = one["obj_id"] == self.object_id
        if not same and self._assumed:
            raise ValueError(
                f"object_id: {place} holds objects {self.object_id} and {one['obj_id']}; choose one"
            )
        return same

    def _item(
        self, scene: Path, number: int, k: int, one: Any, cameras: dict[int, Any], name: str
    ) -> _Item:
        place = f"{scene / 'scene_gt.json'}: image {number}, instance {k}: sample {name!r}"
        R = _floats(one, "cam_R_m2c", 9, place).reshape(3, 3)
        t = _floats(one, "cam_t_m2c", 3, place) * _METRES
        of_camera = f"{scene / 'scene_camera.json'}: image {number}"
        if number not in cameras:
            raise DataError(f"{of_camera}: no such image, needed by sample {name!r}")
        K = _floats(cameras[number], "cam_K", 9, of_camera).reshape(3, 3).copy()
        K[:2, 2] += self.pixel_centre
        return _Item(name, scene, number, k, check_pose(R, t, place), t, K, place)

    def pose(self, index: int) -> tuple[Array, Array]:
        """The pose in a sample; no image is read.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            ``R`` ``(3, 3)`` and ``t`` ``(3,)`` of ``cam_from_model``, float64, metres.

        Raises:
            IndexError: There is no such sample.

        Example:
            >>> R, t = BopDataset("lmo", "test", object_id=5).pose(0)  # doctest: +SKIP
        """
        item = self._items[index]
        return item.R, item.t

    def load(self, index: int) -> Raw:
        """The sample as it is on the disk.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            The sample.

        Raises:
            FileNotFoundError: Its image or mask is missing.
            DataError: Its image, mask or camera is broken.

        Example:
            >>> BopDataset("lmo", "test", object_id=5).load(0).size  # doctest: +SKIP
            (480, 640)
        """
        item = self._items[index]
        whose = f"sample {item.name!r} ({item.place})"
        image = read_rgb(_image(item), whose)
        mask = None
        if self.mask is not None:
            file = item.scene / self.mask / f"{item.number:06d}_{item.instance:06d}.png"
            mask = read_mask(file, whose)
        check_sizes(image, mask, whose)
        try:
            K = Camera.from_K(item.K, image.shape[1], image.shape[0]).K
        except ValueError as error:
            raise DataError(
                f"{item.scene / 'scene_camera.json'}: image {item.number}: {error}"
            ) from None
        return Raw(image, mask, K, item.R, item.t, item.name)


def _scenes(folder: Path) -> list[Path]:
    if not folder.is_dir():
        missing(folder, "a folder of BOP scenes")
    if (folder / "scene_gt.json").is_file():
        return [folder]
    found = sorted(path for path in folder.iterdir() if (path / "scene_gt.json").is_file())
    if not found:
        missing(folder / "000001" / "scene_gt.json", "a BOP scene")
    return found


def _numbered(path: Path) -> dict[int, Any]:
    """A JSON object whose keys are whole numbers, in their order."""
    if not path.is_file():
        missing(path, "a file of a BOP scene")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return dict(sorted((int(key), value) for key, value in content.items()))
    except json.JSONDecodeError as error:
        raise DataError(f"{path}:{error.lineno}:{error.colno}: no JSON: {error.msg}") from None
    except (AttributeError, ValueError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: expected an object with numbers of images: {error}") from None


def _floats(content: Any, key: str, count: int, place: str) -> Array:
    values = content.get(key) if isinstance(content, dict) else None
    numbers = isinstance(values, list) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in values
    )
    if not isinstance(values, list) or not numbers or len(values) != count:
        raise DataError(f"{place}: {key}: expected {count} numbers, found {values!r}")
    return np.array(values, dtype=np.float64)


def _visibility(visible: dict[int, Any], number: int, k: int, scene: Path) -> float:
    try:
        return float(visible[number][k]["visib_fract"])
    except (KeyError, IndexError, TypeError, ValueError):
        raise DataError(
            f"{scene / 'scene_gt_info.json'}: image {number}, instance {k}: no visib_fract"
        ) from None


def _image(item: _Item) -> Path:
    names = [f"{folder}/{item.number:06d}" for folder in ("rgb", "gray")]
    paths = [item.scene / f"{name}{suffix}" for name in names for suffix in _SUFFIXES]
    for path in paths:
        if path.is_file():
            return path
    return missing(
        item.scene / "rgb" / f"{item.number:06d}.png", f"the image of sample {item.name!r}"
    )
