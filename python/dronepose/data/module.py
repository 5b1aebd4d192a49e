"""Loaders of training, validation and test data: see :class:`PoseDataModule`."""

from __future__ import annotations

import multiprocessing
from typing import TYPE_CHECKING, Any, Literal

import torch
from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader, DistributedSampler

from dronepose.data.augment import GeometricAugmentation, PhotometricAugmentation

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dronepose.data.sample import PoseDataset, Sample


class EpochSampler(DistributedSampler[Any]):
    """Indices ``(epoch, number)`` in an order that depends on seed and epoch only.

    Rank ``r`` of ``n`` takes every n-th index of that order from the r-th on, so that ``n``
    processes with a batch of ``b`` each see, step by step, what one process with a batch of
    ``n b`` sees. As each rank has to take part in every step, of training and of validation, the
    order is lengthened by its own beginning until it can be divided by ``n``, or cut with
    ``drop_last``. Whoever scores what several ranks predict tells samples that came twice by their
    names, as :class:`dronepose.train.report.Judge` does.

    Being a ``DistributedSampler``, it is left alone by Lightning, which calls :meth:`set_epoch`.

    Args:
        size: Number of samples.
        shuffle: Whether the order is random; else it is that of the data set.
        seed: Of the order.
        rank: This process; ``None`` asks ``torch.distributed`` and is 0 without it.
        world_size: Number of processes; ``None`` alike, and 1.
        drop_last: Whether the order is cut to a multiple of the processes, not lengthened.

    Example:
        >>> list(EpochSampler(3, shuffle=False, seed=0))
        [(0, 0), (0, 1), (0, 2)]
    """

    def __init__(
        self,
        size: int,
        *,
        shuffle: bool,
        seed: int,
        rank: int | None = None,
        world_size: int | None = None,
        drop_last: bool = False,
    ) -> None:
        grouped = torch.distributed.is_available() and torch.distributed.is_initialized()
        if world_size is None:
            world_size = torch.distributed.get_world_size() if grouped else 1
        if rank is None:
            rank = torch.distributed.get_rank() if grouped else 0
        super().__init__(
            range(size),  # type: ignore[arg-type]
            num_replicas=world_size,
            rank=rank,
            shuffle=shuffle,
            seed=seed,
            drop_last=drop_last,
        )
        self.size = size

    def _own(self) -> list[int]:
        order = list(range(self.size))
        if self.shuffle:
            generator = torch.Generator().manual_seed((self.seed << 20) + self.epoch)
            order = torch.randperm(self.size, generator=generator).tolist()
        if self.drop_last:
            del order[self.size - self.size % self.num_replicas :]
        while order and len(order) % self.num_replicas:
            order += order[: self.num_replicas - len(order) % self.num_replicas]
        return order[self.rank :: self.num_replicas]

    def __iter__(self) -> Iterator[Any]:
        return iter([(self.epoch, number) for number in self._own()])

    def __len__(self) -> int:
        spare = 0 if self.drop_last else self.num_replicas - 1
        return (self.size + spare) // self.num_replicas


class PoseDataModule(LightningDataModule):
    """Training, validation and test data for a Lightning ``Trainer``.

    The training split is augmented and shuffled, both from ``seed`` and the epoch alone: any number
    of workers gives the same batches. The last batch is kept, however small, unless ``drop_last``.

    Args:
        kind: ``"folder"`` (:class:`FolderDataset`), ``"uava"`` (:class:`UavaDataset`) or ``"bop"``
            (:class:`BopDataset`).
        root: The folder of the data.
        batch_size: Samples in a batch of one process, at least 1.
        workers: Processes that load data; 0 loads in this one.
        seed: Of order and augmentation.
        height: Rows of the samples, ``K`` follows; ``None`` as on the disk. With ``width``.
        width: Columns of the samples.
        rotation_deg: As in :class:`GeometricAugmentation`.
        scale: As in :class:`GeometricAugmentation`.
        shift: As in :class:`GeometricAugmentation`.
        photometric: Strength of :class:`PhotometricAugmentation`: 0 none, 1 its defaults.
        erase: As in :class:`PhotometricAugmentation`.
        splits: Names of the splits for training, validation and test; the validation split may be
            ``None``, if there is none.
        drop_last: Whether training leaves out a last batch smaller than ``batch_size``.
        start: How workers start: ``"fork"``, ``"spawn"`` or ``"forkserver"``; ``None`` is the
            system's. All work with the threads of the renderer.
        options: Further arguments of the data set, such as ``object_id`` of :class:`BopDataset`.

    Raises:
        ValueError: An argument is out of its range; the message starts with its name.

    Example:
        >>> data = PoseDataModule(root="toy", batch_size=16)  # doctest: +SKIP
        >>> data.setup("fit")  # doctest: +SKIP
        >>> next(iter(data.train_dataloader()))["image"].shape  # doctest: +SKIP
        torch.Size([16, 3, 120, 160])
    """

    def __init__(
        self,
        root: str,
        kind: Literal["folder", "uava", "bop"] = "folder",
        batch_size: int = 64,
        workers: int = 0,
        seed: int = 0,
        height: int | None = None,
        width: int | None = None,
        rotation_deg: float = 0.0,
        scale: tuple[float, float] = (1.0, 1.0),
        shift: float = 0.0,
        photometric: float = 0.0,
        erase: float = 0.0,
        splits: tuple[str, str | None, str] = ("train", "val", "test"),
        drop_last: bool = False,
        start: Literal["fork", "spawn", "forkserver"] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        if kind not in ("folder", "uava", "bop"):
            raise ValueError(f"kind: expected 'folder', 'uava' or 'bop', got {kind!r}")
        if batch_size < 1:
            raise ValueError(f"batch_size: expected at least 1, got {batch_size}")
        if workers < 0:
            raise ValueError(f"workers: expected at least 0, got {workers}")
        if seed < 0:
            raise ValueError(f"seed: expected at least 0, got {seed}")
        if start is not None and start not in multiprocessing.get_all_start_methods():
            known = ", ".join(multiprocessing.get_all_start_methods())
            raise ValueError(f"start: expected one of {known}, got {start!r}")
        if not 0 <= photometric <= 2:
            raise ValueError(f"photometric: expected 0 to 2, got {photometric}")
        if len(splits) != 3:
            raise ValueError(f"splits: expected three names, got {splits}")
        self.root, self.kind = root, kind
        self.batch_size, self.workers, self.seed, self.start = batch_size, workers, seed, start
        self.height, self.width = height, width
        self.splits, self.drop_last, self.options = splits, drop_last, dict(options or {})
        self.geometric: GeometricAugmentation | None = None
        if rotation_deg or shift or tuple(scale) != (1.0, 1.0):
            self.geometric = GeometricAugmentation(
                rotation_deg=rotation_deg, scale=(scale[0], scale[1]), shift=shift
            )
        self.photometric: PhotometricAugmentation | None = None
        if photometric or erase:
            p = photometric
            self.photometric = PhotometricAugmentation(
                min(0.3 * p, 1), min(0.3 * p, 1), min(0.3 * p, 1), 0.05 * p, p, 0.02 * p, erase
            )
        self._sets: dict[str, PoseDataset] = {}

    def dataset(self, split: str, *, augmented: bool = False) -> PoseDataset:
        """A split of the data.

        Args:
            split: Its name.
            augmented: Whether the augmentation of the training split is applied.

        Returns:
            The data set.

        Raises:
            FileNotFoundError: A file is missing.
            DataError: A file is wrong.

        Example:
            >>> PoseDataModule("toy").dataset("val")  # doctest: +SKIP
        """
        further: dict[str, Any] = {
            "height": self.height,
            "width": self.width,
            "seed": self.seed,
            "geometric": self.geometric if augmented else None,
            "photometric": self.photometric if augmented else None,
            **self.options,
        }
        if self.kind == "uava":
            from dronepose.data.uava import UavaDataset

            return UavaDataset(self.root, split, **further)
        if self.kind == "bop":
            from dronepose.data.bop import BopDataset

            return BopDataset(self.root, split, **further)
        from dronepose.data.folder import FolderDataset

        return FolderDataset(self.root, split, **further)

    def setup(self, stage: str | None = None) -> None:
        """Open the splits that a stage needs; called by Lightning.

        Args:
            stage: ``"fit"``, ``"validate"``, ``"test"``, ``"predict"``, or ``None`` for all.

        Returns:
            Nothing; the loaders have their data.

        Raises:
            FileNotFoundError: A file is missing.
            DataError: A file is wrong.

        Example:
            >>> PoseDataModule("toy").setup("fit")  # doctest: +SKIP
        """
        _, val, test = self.splits
        if stage in ("fit", None):
            self.training_set()
        if stage in ("fit", "validate", None) and val is not None:
            self._open("val", val)
        if stage in ("test", "predict", None):
            self._open("test", test)

    def training_set(self) -> PoseDataset:
        """The training split with its augmentation, opened at the first call.

        Returns:
            The data set.

        Raises:
            FileNotFoundError: A file is missing.
            DataError: A file is wrong.
            ValueError: It holds no samples.

        Example:
            >>> PoseDataModule("toy").training_set().names[0]  # doctest: +SKIP
            'train-000000'
        """
        return self._open("train", self.splits[0], augmented=True)

    def _open(self, role: str, split: str, *, augmented: bool = False) -> PoseDataset:
        if role not in self._sets:
            found = self.dataset(split, augmented=augmented)
            if len(found) == 0:
                raise ValueError(f"splits: {split!r} of {self.root} holds no samples")
            self._sets[role] = found
        return self._sets[role]

    def train_dataloader(self) -> DataLoader[Sample]:
        """Batches of the training split, shuffled and augmented.

        Returns:
            The loader; a new one starts at epoch 0, or at the trainer's.

        Raises:
            ValueError: There is no whole batch, and ``drop_last`` leaves out smaller ones.

        Example:
            >>> PoseDataModule("toy").train_dataloader()  # doctest: +SKIP
        """
        return self._loader("train", shuffle=True)

    def val_dataloader(self) -> DataLoader[Sample] | list[Any]:
        """Batches of the validation split, in order; an empty list if there is none.

        Returns:
            The loader.

        Example:
            >>> PoseDataModule("toy").val_dataloader()  # doctest: +SKIP
        """
        return [] if self.splits[1] is None else self._loader("val")

    def test_dataloader(self) -> DataLoader[Sample]:
        """Batches of the test split, in order.

        Returns:
            The loader.

        Example:
            >>> PoseDataModule("toy").test_dataloader()  # doctest: +SKIP
        """
        return self._loader("test")

    def predict_dataloader(self) -> DataLoader[Sample]:
        """Batches of the test split, in order.

        Returns:
            The loader.

        Example:
            >>> PoseDataModule("toy").predict_dataloader()  # doctest: +SKIP
        """
        return self._loader("test")

    def _loader(self, role: str, *, shuffle: bool = False) -> DataLoader[Sample]:
        if role not in self._sets:
            stage = {"train": "fit", "val": "validate", "test": "test"}[role]
            self.setup(stage)
        data = self._sets[role]
        drop_last = self.drop_last and role == "train"
        sampler = EpochSampler(len(data), shuffle=shuffle, seed=self.seed, drop_last=drop_last)
        if drop_last and len(sampler) < self.batch_size:
            raise ValueError(
                f"batch_size: {self.batch_size} is more than the {len(sampler)} samples that a "
                f"process has of split {self.splits[0]!r}, and drop_last leaves out smaller batches"
            )
        if self.trainer is not None:
            sampler.set_epoch(self.trainer.current_epoch)
        return DataLoader(
            data,
            batch_size=self.batch_size,
            sampler=sampler,
            num_workers=self.workers,
            worker_init_fn=one_thread,
            multiprocessing_context=self.start if self.workers else None,
            persistent_workers=self.workers > 0 and self.start != "fork",
            pin_memory=torch.cuda.is_available(),
            drop_last=drop_last,
        )


def one_thread(worker: int) -> None:
    """Leave the cores to the other workers; run in each worker when it starts.

    Args:
        worker: Its number.

    Returns:
        Nothing.

    Raises:
        Nothing.

    Example:
        >>> one_thread(0)
    """
    del worker
    import cv2

    cv2.setNumThreads(0)
    torch.set_num_threads(1)
