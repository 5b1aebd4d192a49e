"""The loaders: order, augmentation, workers, ranks."""

import os

import numpy as np
import pytest

from support import CORES_WARNING, FORK_WARNING

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("lightning", reason="Lightning is not installed")
pytest.importorskip("cv2", reason="OpenCV is not installed")

import data_workers  # noqa: E402
from dronepose.data import FolderDataset, PoseDataModule, write_toyset  # noqa: E402
from dronepose.data.module import EpochSampler, one_thread  # noqa: E402

AUGMENTED = {"rotation_deg": 20.0, "scale": (0.9, 1.2), "shift": 0.1, "photometric": 1.0}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("module") / "set"
    write_toyset(root, counts={"train": 10, "val": 3, "test": 2}, height=48, width=64, seed=2)
    return str(root)


def names(loader):
    return [name for batch in loader for name in batch["name"]]


def test_every_sample_comes_once_and_the_last_batch_is_kept(root):
    data = PoseDataModule(root, batch_size=4)
    data.setup("fit")
    loader = data.train_dataloader()
    assert len(loader) == 3
    assert [len(batch["name"]) for batch in loader] == [4, 4, 2]
    assert sorted(names(loader)) == [f"train-{k:06d}" for k in range(10)]
    assert names(data.val_dataloader()) == [f"val-{k:06d}" for k in range(3)]
    assert names(data.test_dataloader()) == [f"test-{k:06d}" for k in range(2)]
    assert names(data.predict_dataloader()) == names(data.test_dataloader())
    assert PoseDataModule(root, splits=("train", None, "test")).val_dataloader() == []


def test_small_batches_are_left_out_of_training_on_request(root):
    data = PoseDataModule(root, batch_size=4, drop_last=True)
    loader = data.train_dataloader()
    assert len(loader) == 2
    assert [len(batch["name"]) for batch in loader] == [4, 4]
    assert len(names(data.val_dataloader())) == 3
    with pytest.raises(ValueError, match="batch_size: 11 is more than the 10 samples"):
        PoseDataModule(root, batch_size=11, drop_last=True).train_dataloader()


@pytest.mark.parametrize(("size", "batch"), [(10, 2), (11, 2), (13, 1), (7, 3)])
def test_ranks_leave_out_what_one_process_leaves_out(size, batch):
    def batches(rank, of, batch):
        sampler = EpochSampler(size, shuffle=True, seed=1, rank=rank, world_size=of, drop_last=True)
        taken = [number for _, number in sampler]
        assert len(taken) == len(sampler)
        whole = len(taken) // batch * batch
        return np.reshape(taken[:whole], (-1, batch))

    parts = np.stack([batches(rank, 2, batch) for rank in range(2)], axis=2)
    assert parts.reshape(-1, 2 * batch).tolist() == batches(0, 1, 2 * batch).tolist()


def test_the_training_set_is_opened_once(root):
    data = PoseDataModule(root, batch_size=4)
    first = data.training_set()
    data.setup("fit")
    assert data.training_set() is first is data.train_dataloader().dataset


def test_order_and_augmentation_depend_on_seed_and_epoch_alone(root):
    def epoch(number, seed=0, workers=0):
        data = PoseDataModule(root, batch_size=4, seed=seed, workers=workers, **AUGMENTED)
        loader = data.train_dataloader()
        loader.sampler.set_epoch(number)
        batches = list(loader)
        images = torch.cat([batch["image"] for batch in batches])
        return [name for batch in batches for name in batch["name"]], images

    first, again = epoch(0), epoch(0)
    assert first[0] == again[0]
    assert torch.equal(first[1], again[1])
    for other in (epoch(1), epoch(0, seed=1)):
        assert other[0] != first[0]
        a, b = first[0].index("train-000003"), other[0].index("train-000003")
        assert not torch.equal(first[1][a], other[1][b])


@pytest.mark.slow
@pytest.mark.filterwarnings(FORK_WARNING, CORES_WARNING)
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_workers_give_what_one_process_gives(root, start):
    plain = PoseDataModule(root, batch_size=4, **AUGMENTED).train_dataloader()
    several = PoseDataModule(
        root, batch_size=4, workers=2, start=start, **AUGMENTED
    ).train_dataloader()
    for epoch in (0, 1):  # the second epoch reaches workers that live on
        plain.sampler.set_epoch(epoch)
        several.sampler.set_epoch(epoch)
        for one, two in zip(plain, several, strict=True):
            assert one["name"] == two["name"]
            for key in ("image", "mask", "K", "R", "t"):
                assert torch.equal(one[key], two[key])


@pytest.mark.slow
@pytest.mark.filterwarnings(FORK_WARNING, CORES_WARNING)
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_workers_draw_with_the_threads_of_the_renderer(root, start):
    data = data_workers.Drawn(root, "train")
    expected = [data[k]["mask"] for k in range(6)]  # the parent's pool exists before the workers
    loader = torch.utils.data.DataLoader(
        data,
        batch_size=2,
        sampler=range(6),
        num_workers=2,
        worker_init_fn=one_thread,
        multiprocessing_context=start,
        timeout=120,
    )
    masks = torch.cat([batch["mask"] for batch in loader])
    assert torch.equal(masks, torch.stack(expected))
    written = torch.stack([FolderDataset(root, "train")[k]["mask"] for k in range(6)])
    assert (masks - written).abs().max() < 0.01
    assert torch.equal(data[3]["mask"], expected[3])  # and the parent goes on


@pytest.mark.slow
@pytest.mark.filterwarnings(FORK_WARNING)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="cannot fork")
def test_an_error_in_a_worker_names_the_sample(root, tmp_path):
    import shutil

    copy = shutil.copytree(root, tmp_path / "set")
    (copy / "train/images/000004.png").write_bytes(b"broken")
    data = PoseDataModule(str(copy), batch_size=4, workers=1, start="fork")
    with pytest.raises(ValueError, match=r"images/000004\.png: sample 'train-000004'"):
        list(data.train_dataloader())


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize("size", [7, 8, 2, 1])
def test_ranks_share_the_order(size, shuffle):
    def taken(rank, of):
        sampler = EpochSampler(size, shuffle=shuffle, seed=3, rank=rank, world_size=of)
        sampler.set_epoch(2)
        indices = list(sampler)
        assert len(indices) == len(sampler)
        assert all(epoch == 2 for epoch, _ in indices)
        return [number for _, number in indices]

    whole = taken(0, 1)
    assert (whole if not shuffle else sorted(whole)) == list(range(size))
    parts = [taken(rank, 3) for rank in range(3)]
    assert len({len(part) for part in parts}) == 1  # each takes part in every step
    together = list(np.stack(parts, axis=1).reshape(-1))
    assert together[:size] == whole
    assert together[size:] == (whole * 3)[: len(together) - size]


def test_the_process_group_is_asked(root, monkeypatch):
    for name, value in (("is_initialized", True), ("get_world_size", 3), ("get_rank", 1)):
        monkeypatch.setattr(torch.distributed, name, lambda value=value: value)
    data = PoseDataModule(root, batch_size=4, seed=5)
    alone = EpochSampler(10, shuffle=True, seed=5, rank=0, world_size=1)
    own = [f"train-{number:06d}" for _, number in alone][1::3]
    taken = names(data.train_dataloader())
    assert taken[:3] == own
    assert len(taken) == 4  # the order is lengthened to twelve
    assert names(data.val_dataloader()) == ["val-000001"]


def test_images_are_resized_with_their_camera(root):
    data = PoseDataModule(root, batch_size=10, height=24, width=32)
    batch = next(iter(data.val_dataloader()))
    assert batch["image"].shape == (3, 3, 24, 32)
    assert batch["K"][0, 0, 2] == 16


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "coco"}, "kind: expected"),
        ({"batch_size": 0}, "batch_size: "),
        ({"workers": -1}, "workers: "),
        ({"seed": -1}, "seed: "),
        ({"start": "thread"}, "start: expected one of"),
        ({"photometric": 3.0}, "photometric: "),
        ({"splits": ("train", "val")}, "splits: expected three names"),
        ({"rotation_deg": 200.0}, "rotation_deg: "),
    ],
)
def test_what_is_out_of_range_is_named(root, options, message):
    with pytest.raises(ValueError, match=message):
        PoseDataModule(root, **options)


@pytest.mark.slow
def test_a_trainer_goes_through_it(root, tmp_path):
    import warnings

    from lightning.pytorch import LightningModule, Trainer

    class Nothing(LightningModule):
        def __init__(self):
            super().__init__()
            self.weight = torch.nn.Parameter(torch.zeros(()))
            self.orders = []

        def training_step(self, batch, _):
            self.orders.append((self.current_epoch, tuple(batch["name"])))
            return self.weight * batch["image"].mean()

        def validation_step(self, batch, _):
            assert batch["name"][0].startswith("val")

        def configure_optimizers(self):
            return torch.optim.SGD(self.parameters(), lr=0.1)

    module = Nothing()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Lightning, on the number of workers
        trainer = Trainer(
            accelerator="cpu",
            max_epochs=2,
            default_root_dir=tmp_path,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
        )
        trainer.fit(module, datamodule=PoseDataModule(root, batch_size=5))
    seen = [
        [name for epoch, batch in module.orders if epoch == e for name in batch] for e in (0, 1)
    ]
    for epoch in (0, 1):
        sampler = EpochSampler(10, shuffle=True, seed=0)
        sampler.set_epoch(epoch)
        assert seen[epoch] == [f"train-{number:06d}" for _, number in sampler]
    assert seen[0] != seen[1]
