"""What a data set gives for an image, and the base of all data sets."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict

import cv2
import numpy as np
import torch
from torch.utils.data import Dataset

from dronepose.data._errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from torch import Tensor

    Array = NDArray[np.float64]
    Bytes = NDArray[np.uint8]


class Sample(TypedDict):
    """An image with the pose of the drone in it; torch's ``default_collate`` makes batches of it.

    Args:
        image: ``(3, H, W)`` float32, RGB in ``[0, 1]``.
        K: ``(3, 3)`` float32, camera matrix in pixels, pixel centres at ``+ 0.5``.
        R: ``(3, 3)`` float32, rotation of ``cam_from_model``.
        t: ``(3,)`` float32, translation of ``cam_from_model``, metres.
        mask: ``(H, W)`` float32, share of each pixel that the drone covers; ``(0, 0)`` if the data
            set has no masks.
        name: The id of the sample, once in the data set; the key of predictions and ground truth.

    Example:
        >>> Sample.__required_keys__ == {"image", "K", "R", "t", "mask", "name"}
        True
    """

    image: Tensor
    K: Tensor
    R: Tensor
    t: Tensor
    mask: Tensor
    name: str


@dataclass(frozen=True, slots=True)
class Raw:
    """A sample as it comes from the disk, in NumPy; what geometric augmentation works on.

    Args:
        image: ``(H, W, 3)`` uint8, RGB.
        mask: ``(H, W)`` uint8, 255 where the drone covers all of the pixel, or ``None``.
        K: ``(3, 3)`` float64, pixels.
        R: ``(3, 3)`` float64, rotation of ``cam_from_model``.
        t: ``(3,)`` float64, metres.
        name: The id of the sample.

    Example:
        >>> Raw(np.zeros((4, 6, 3), np.uint8), None, np.eye(3), np.eye(3), np.ones(3), "a").size
        (4, 6)
    """

    image: Bytes
    mask: Bytes | None
    K: Array
    R: Array
    t: Array
    name: str

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the image.

        Example:
            >>> Raw(np.zeros((4, 6, 3), np.uint8), None, np.eye(3), np.eye(3), np.ones(3), "a").size
            (4, 6)
        """
        return self.image.shape[0], self.image.shape[1]


def resized(raw: Raw, height: int, width: int) -> Raw:
    """The sample at another size; ``K`` follows: ``u' = u width'/width`` with centres at ``+ 0.5``.

    Args:
        raw: The sample.
        height: Rows, at least 1.
        width: Columns, at least 1.

    Returns:
        The sample with image and mask of this size, averaged over areas where they shrink.

    Raises:
        cv2.error: A size is below 1.

    Example:
        >>> K = np.array([[4.0, 0, 3], [0, 4, 2], [0, 0, 1]])
        >>> raw = Raw(np.zeros((4, 6, 3), np.uint8), None, K, np.eye(3), np.ones(3), "a")
        >>> resized(raw, 8, 12).K[0].tolist()
        [8.0, 0.0, 6.0]
    """
    rows, columns = raw.size
    if (rows, columns) == (height, width):
        return raw
    shrinks = height <= rows and width <= columns
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR

    def scaled(plane: Bytes) -> Bytes:
        return cv2.resize(plane, (width, height), interpolation=how).astype(np.uint8, copy=False)

    K = np.diag([width / columns, height / rows, 1.0]) @ raw.K
    mask = None if raw.mask is None else scaled(raw.mask)
    return replace(raw, image=scaled(raw.image), mask=mask, K=K)


def to_sample(raw: Raw) -> Sample:
    """The sample as tensors.

    Args:
        raw: The sample in NumPy.

    Returns:
        Tensors of their own memory.

    Raises:
        TypeError: An array is of another type.

    Example:
        >>> raw = Raw(np.zeros((4, 6, 3), np.uint8), None, np.eye(3), np.eye(3), np.ones(3), "a")
        >>> to_sample(raw)["image"].shape, to_sample(raw)["mask"].shape
        (torch.Size([3, 4, 6]), torch.Size([0, 0]))
    """
    planes = np.ascontiguousarray(raw.image.transpose(2, 0, 1))
    if raw.mask is None:
        mask = torch.zeros(0, 0)
    else:
        mask = torch.from_numpy(raw.mask.copy()).to(torch.float32) / 255
    return Sample(
        image=torch.from_numpy(planes).to(torch.float32) / 255,
        K=torch.tensor(raw.K, dtype=torch.float32),
        R=torch.tensor(raw.R, dtype=torch.float32),
        t=torch.tensor(raw.t, dtype=torch.float32),
        mask=mask,
        name=raw.name,
    )


class PoseDataset(Dataset[Sample], ABC):
    """Base of the data sets: a list of names, and :meth:`pose` and :meth:`load` for each.

    An index is a number, or ``(epoch, number)``, which also seeds the augmentation: the same
    seed, epoch and index give the same sample, in any worker and any order.

    Args:
        height: Rows of the samples; ``None`` as on the disk.
        width: Columns of the samples; ``None`` as on the disk.
        geometric: ``(raw, generator) -> raw``, such as
            :class:`dronepose.data.GeometricAugmentation`, or ``None``.
        photometric: ``(image, generator) -> image`` on ``(3, H, W)`` float32, such as
            :class:`dronepose.data.PhotometricAugmentation`, or ``None``.
        seed: Of the augmentation.

    Raises:
        ValueError: A size or the seed is out of range, or only one of height and width is given.

    Example:
        See :class:`dronepose.data.FolderDataset`.
    """

    names: list[str]

    def __init__(
        self,
        *,
        height: int | None = None,
        width: int | None = None,
        geometric: Callable[[Raw, np.random.Generator], Raw] | None = None,
        photometric: Callable[[Tensor, np.random.Generator], Tensor] | None = None,
        seed: int = 0,
    ) -> None:
        if (height is None) != (width is None):
            raise ValueError("height, width: expected both or none")
        for name, value in (("height", height), ("width", width)):
            if value is not None and not 1 <= value <= 16_384:
                raise ValueError(f"{name}: expected 1 to 16384 pixels, got {value}")
        if seed < 0:
            raise ValueError(f"seed: expected a whole number >= 0, got {seed}")
        self.height, self.width = height, width
        self.geometric, self.photometric = geometric, photometric
        self.seed = seed

    @abstractmethod
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

    @abstractmethod
    def load(self, index: int) -> Raw:
        """The sample as it is on the disk.

        Args:
            index: 0 to ``len(self) - 1``.

        Returns:
            The sample.

        Raises:
            FileNotFoundError: A file of it is missing.
            DataError: A file of it is broken.

        Example:
            >>> FolderDataset("toy", "train").load(0)  # doctest: +SKIP
        """

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int | tuple[int, int]) -> Sample:
        epoch, number = index if isinstance(index, tuple) else (0, index)
        if not -len(self) <= number < len(self):
            raise IndexError(f"index: expected 0 to {len(self) - 1}, got {number}")
        number %= len(self)
        raw = self.load(number)
        generator = np.random.default_rng([self.seed, epoch, number])
        if self.geometric is not None:
            raw = self.geometric(raw, generator)
        if self.height is not None and self.width is not None:
            raw = resized(raw, self.height, self.width)
        sample = to_sample(raw)
        if self.photometric is not None:
            sample["image"] = self.photometric(sample["image"], generator)
        return sample


def check_sizes(image: Bytes, mask: Bytes | None, place: str) -> None:
    """Raise unless image and mask have the same size.

    Args:
        image: ``(H, W, 3)`` uint8.
        mask: ``(H, W)`` uint8 or ``None``.
        place: File and sample, for the message.

    Returns:
        Nothing.

    Raises:
        DataError: They do not.

    Example:
        >>> check_sizes(np.zeros((4, 6, 3), np.uint8), np.zeros((4, 6), np.uint8), "a.png")
    """
    if mask is not None and mask.shape != image.shape[:2]:
        raise DataError(
            f"{place}: the mask is {mask.shape[1]}x{mask.shape[0]}, "
            f"the image {image.shape[1]}x{image.shape[0]} pixels"
        )
