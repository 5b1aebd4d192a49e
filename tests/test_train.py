"""Training: configurations, schedules, a run that learns, resuming, two processes, the commands."""

import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
pytest.importorskip("lightning", reason="lightning is not installed")

from dronepose import Mesh, cli, evaluate  # noqa: E402
from dronepose.data import PoseDataModule, write_toyset  # noqa: E402
from dronepose.data._poses import poses_csv  # noqa: E402
from dronepose.model import PoseNet, read_metadata, save_weights  # noqa: E402
from dronepose.train import predict, reproduce  # noqa: E402
from dronepose.train.callbacks import overlay  # noqa: E402
from dronepose.train.cli import config_path, shipped_configs  # noqa: E402
from dronepose.train.report import Judge, table_one  # noqa: E402
from dronepose.train.task import Exo, PoseTask, cosine  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")  # of the libraries that train

SIZE = (48, 64)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("toy") / "data"
    counts = {"train": 48, "val": 12, "test": 12}
    write_toyset(root, height=SIZE[0], width=SIZE[1], counts=counts, seed=3)
    return root


def dronepose(*arguments, check=True, **options):
    """The command in a process of its own: a trainer leaves handlers and settings behind."""
    call = [sys.executable, "-m", "dronepose", *map(str, arguments)]
    done = subprocess.run(call, capture_output=True, text=True, **options)
    assert not check or done.returncode == 0, done.stderr
    return done


def train(data, out, *more, **options):
    return dronepose(
        "train", "--config", "smoke", "--data.root", data, "--out", out,
        "--data.batch_size", 12, "--model.lr", "1e-3", "--model.lambda_pose", 0.95, *more,
        **options,
    )  # fmt: skip


def losses_of(out):
    lines = (out / "csv" / "metrics.csv").read_text().splitlines()
    head = lines[0].split(",")
    rows = [dict(zip(head, line.split(","), strict=True)) for line in lines[1:]]
    return [float(row["train/loss"]) for row in rows if row.get("train/loss")]


# -------------------------------------------------------------------------------- parts


def test_the_share_of_the_silhouette_follows_its_schedule():
    task = PoseTask(backbone="resnet18", silhouette="iou", lambda_exo={0: 0.1, 8: 0.3, 12: 0.4})
    assert [task.lambda_exo(e) for e in (0, 7, 8, 11, 12, 19)] == [0.1, 0.1, 0.3, 0.3, 0.4, 0.4]
    assert PoseTask(backbone="resnet18", lambda_exo=0.4).lambda_exo(0) == 0  # no silhouette
    for wrong in ({3: 0.1}, {0: 1.5}, -0.1):
        with pytest.raises(ValueError, match="lambda_exo"):
            PoseTask(backbone="resnet18", silhouette="iou", lambda_exo=wrong)


def test_the_learning_rate_rises_and_falls():
    shares = [cosine(step, 200) for step in range(201)]
    assert shares[0] == pytest.approx(0.1)
    assert shares[9] == shares[10] == 1
    assert shares[105] == pytest.approx(0.5)
    assert shares[200] == pytest.approx(0, abs=1e-12)
    assert all(a >= b for a, b in itertools.pairwise(shares[9:]))
    assert cosine(0, 1) == 1
    with pytest.raises(ValueError, match="lr_schedule: 'step'"):
        PoseTask(backbone="resnet18", lr_schedule="step")


def test_the_objective_is_the_formula_of_the_paper(data):
    mesh = Mesh.from_file(data / "mesh.obj")
    task = PoseTask(
        backbone="resnet18", silhouette="iou", mode="coverage", lambda_exo=0.25, lambda_pose=0.7
    )
    task.exo = Exo(mesh, "iou", mode="coverage")
    R = torch.linalg.qr(torch.randn(2, 3, 3, generator=torch.Generator().manual_seed(0)))[0]
    R = R * torch.linalg.det(R)[:, None, None]
    t = torch.tensor([[0.0, 0.0, 1.5], [0.1, 0.0, 2.0]])
    task.model.forward = lambda image, K: (R, t)
    other = torch.eye(3).expand(2, 3, 3)
    K = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]).expand(2, 3, 3)
    mask = torch.zeros(2, *SIZE)
    mask[:, 20:28, 26:38] = 1
    batch = {
        "image": torch.zeros(2, 3, *SIZE), "K": K, "R": other, "t": t + 0.1, "mask": mask,
        "name": ["a", "b"],
    }  # fmt: skip
    found = task.objective(batch)
    cosine = (torch.einsum("bii->b", R) - 1) / 2
    rotation = torch.acos(cosine.clamp(-1, 1)).mean()
    translation = torch.tensor(0.03)
    drawn = task.exo.draw(R, t, K, *SIZE)
    inter, union = (drawn * mask).sum((1, 2)), (drawn + mask - drawn * mask).sum((1, 2))
    silhouette = (1 - inter / union).mean()
    expected = 0.75 * (0.7 * translation + 0.3 * rotation) + 0.25 * silhouette
    torch.testing.assert_close(found["loss"], expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found["rotation"], rotation, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="silhouette: sample 'a' has no mask"):
        task.objective(batch | {"mask": torch.zeros(2, 0, 0)})


def test_predictions_are_judged_as_the_command_does(data, tmp_path):
    rng = np.random.default_rng(2)
    names = [f"n{k}" for k in range(9)]
    R = torch.tensor(np.linalg.qr(rng.normal(size=(9, 3, 3)))[0])
    R = R * torch.linalg.det(R)[:, None, None]
    t = torch.tensor(rng.uniform([-0.1, -0.1, 1], [0.1, 0.1, 2], (9, 3)))
    moved = t + torch.tensor(rng.normal(size=(9, 3)) * 0.02)
    judge = Judge(Mesh.from_file(data / "mesh.obj"))
    for part in (slice(0, 4), slice(4, 9), slice(2, 5)):  # some come twice
        judge.add(names[part], (R[part], moved[part]), (R[part], t[part]))
    found = judge.finish()
    for name, poses in (("p.csv", moved), ("gt.csv", t)):
        (tmp_path / name).write_text(poses_csv(names, R.numpy(), poses.numpy()))
    expected = evaluate(tmp_path / "p.csv", tmp_path / "gt.csv", mesh=data / "mesh.obj")
    assert found == pytest.approx(table_one(expected), rel=1e-12)
    assert judge.finish() is None


def test_images_are_brought_to_the_size_of_training(data, tmp_path):
    weights, out = tmp_path / "w.safetensors", tmp_path / "p.csv"
    torch.manual_seed(0)
    model = PoseNet("resnet18", hidden=(16,))
    save_weights(model, weights, {"image_size": (24, 32)})
    call = ["predict", "--weights", weights, "--data", data, "--out", out]
    assert cli.dronepose(list(map(str, call))) == 0
    small = PoseDataModule(str(data), height=24, width=32).dataset("test")
    assert out.read_text() == poses_csv(*predict.predict(weights, small))
    plain = PoseDataModule(str(data)).dataset("test")
    assert out.read_text() != poses_csv(*predict.predict(weights, plain))
    assert predict.image_size(data / "mesh.obj") == (None, None)


def test_a_pose_that_is_not_finite_is_refused_by_name(data, tmp_path):
    weights = tmp_path / "w.safetensors"
    model = PoseNet("resnet18", hidden=(16,))
    with torch.no_grad():
        model.translation.weight.mul_(1e38)
        model.translation.bias.fill_(3e38)
        model.embedding.bias.fill_(1e3)
    save_weights(model, weights)
    with pytest.raises(ValueError, match=r"w\.safetensors: .* sample 'test-000000' is not finite"):
        predict.predict(weights, PoseDataModule(str(data)).dataset("test"))


def test_true_poses_are_written_without_reading_images(data, tmp_path, monkeypatch):
    copy = shutil.copytree(data, tmp_path / "data")
    shutil.rmtree(copy / "test" / "images")
    names, poses = ["test-000000"], (np.eye(3)[None], np.ones((1, 3)))
    monkeypatch.setattr(predict, "predict", lambda *_, **__: (names, *poses))
    weights, truth = tmp_path / "w.safetensors", tmp_path / "gt.csv"
    weights.touch()
    call = ["--weights", weights, "--data", copy, "--out", tmp_path / "p.csv", "--gt-out", truth]
    assert cli.dronepose(["predict", *map(str, call)]) == 0
    found = evaluate(truth, data / "test" / "poses.csv")
    assert (found.n_gt, found.n_predictions, found.n_matched) == (12, 12, 12)
    assert found.metrics.npe.mean < 1e-9


def test_overlays_are_red_green_and_yellow():
    image = torch.full((1, 3, 1, 4), 0.5)
    predicted = torch.tensor([[[1.0, 1.0, 0.0, 0.0]]])
    truth = torch.tensor([[[1.0, 0.0, 1.0, 0.0]]])
    found = overlay(image, predicted, truth)[0, :, 0]
    expected = [[0.75, 0.75, 0.25], [0.75, 0.25, 0.25], [0.25, 0.75, 0.25], [0.5, 0.5, 0.5]]
    torch.testing.assert_close(found.T, torch.tensor(expected))


def test_every_configuration_that_ships_is_understood(tmp_path):
    names = shipped_configs()
    assert len(names) >= 20
    code = (
        "import sys; from dronepose.train.cli import Cli, config_path, PoseTask, PoseDataModule\n"
        "for name in sys.argv[1:]:\n"
        "    made = Cli(PoseTask, PoseDataModule, run=False, save_config_callback=None,\n"
        "        args=['--config', config_path(name), '--model.backbone', 'resnet18'])\n"
        "    assert made.model.exo is None\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *names], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert config_path("configs/gauss01.yaml").endswith("gauss01.yaml")
    with pytest.raises(FileNotFoundError, match="expected a file, or one of"):
        config_path("configs/none.yaml")


# --------------------------------------------------------------------------------- runs


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "smoke"
    done = train(data, out, "--trainer.max_epochs", 6, "--trainer.log_every_n_steps", 1)
    return out, done


@pytest.mark.slow
def test_the_loss_falls_and_the_share_of_the_renderer_is_told(trained):
    out, done = trained
    found = losses_of(out)
    assert np.mean(found[-4:]) < 0.7 * np.mean(found[:4])
    assert "CPE" in done.stderr
    told = re.search(
        r"drawing ([0-9.]+) ms, ([0-9.]+) %, with its loss ([0-9.]+) ms, ([0-9.]+) %", done.stderr
    )
    assert told is not None
    drawing, share, objective, objective_share = map(float, told.groups())
    assert 0 < drawing < objective
    assert 0 < share < objective_share < 100
    assert (out / "checkpoints" / "last.ckpt").exists()
    assert list((out / "tensorboard").glob("events*"))


@pytest.mark.slow
def test_prediction_and_evaluation_follow_from_the_weights(trained, data, tmp_path):
    out, _ = trained
    csv, truth = tmp_path / "p.csv", tmp_path / "gt.csv"
    done = dronepose(
        "predict", "--weights", out / "best.safetensors", "--data", data, "--split", "val",
        "--out", csv, "--gt-out", truth, "--json",
    )  # fmt: skip
    assert json.loads(done.stdout)["images"] == 12
    found = table_one(evaluate(csv, truth, mesh=data / "mesh.obj"))
    assert found["cpe"] == pytest.approx(
        table_one(evaluate(csv, data / "val" / "poses.csv", mesh=data / "mesh.obj"))["cpe"]
    )
    told = read_metadata(out / "best.safetensors")
    assert found["cpe"] == pytest.approx(told["metrics"]["cpe"], rel=1e-4)
    assert told["seed"] == 0
    assert told["extra"]["compat"] == "paper"
    assert told["extra"]["chosen_on"] == "val"
    assert len(told["mesh_sha256"]) == 64


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on(data, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    same = ("--model.lr_schedule", "constant")  # a cosine would end with the first epoch
    train(data, whole, "--trainer.max_epochs", 3, *same)
    train(data, parts, "--trainer.max_epochs", 1, *same)
    refused = train(data, parts, "--trainer.max_epochs", 3, *same, check=False)
    assert refused.returncode == 1
    assert "--resume true" in refused.stderr
    train(data, parts, "--trainer.max_epochs", 3, "--resume", "true", *same)
    a, b = (
        torch.load(out / "checkpoints" / "last.ckpt", weights_only=False) for out in (whole, parts)
    )
    assert (a["epoch"], a["global_step"]) == (b["epoch"], b["global_step"]) == (2, 12)
    for name, value in a["state_dict"].items():
        torch.testing.assert_close(value, b["state_dict"][name], rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_what_the_authors_code_does_with_data_is_done_on_request(data, tmp_path):
    copy, out = shutil.copytree(data, tmp_path / "data"), tmp_path / "out"
    shutil.rmtree(copy / "val")  # is never read
    done = train(
        copy, out, "--model.compat", "authors", "--trainer.max_epochs", 2, "--data.batch_size", 10,
        "--trainer.log_every_n_steps", 1,
    )  # fmt: skip
    assert "chosen on the test split 'test'" in done.stderr
    assert "smaller than 10 are left out" in done.stderr
    assert len(losses_of(out)) == 2 * 4  # of 48 samples 8 are left out
    told = read_metadata(out / "best.safetensors")
    assert (
        told["extra"] | {"compat": "authors", "chosen_on": "test", "drop_last": True}
        == (told["extra"])
    )
    assert "drop_last: true" in told["config"]
    csv = tmp_path / "p.csv"
    dronepose("predict", "--weights", out / "best.safetensors", "--data", copy, "--out", csv)
    truth = copy / "test" / "poses.csv"
    expected = table_one(evaluate(csv, truth, mesh=copy / "mesh.obj", preset="authors"))
    assert told["metrics"]["cpe"] == pytest.approx(expected["cpe"], rel=1e-4)
    assert expected["cpe"] != pytest.approx(table_one(evaluate(csv, truth))["cpe"], rel=1e-4)
    again = train(
        copy, out, "--model.compat", "authors", "--data.batch_size", 50, "--resume", "true",
        check=False,
    )  # fmt: skip
    assert again.returncode == 1
    assert "batch_size: 50 is more than the 48 samples" in again.stderr


def train_on_two(data, out, *more):
    """Two processes, connected by gloo."""
    call = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2",
        "-m", "dronepose", "train", "--config", "smoke", "--data.root", data, "--out", out,
        "--trainer.strategy", "ddp", "--trainer.devices", "2", "--trainer.accelerator", "cpu",
        *more,
    ]  # fmt: skip
    done = subprocess.run(
        list(map(str, call)),
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done


@pytest.mark.slow
def test_two_processes_learn_what_one_does(data, tmp_path):
    more = ("--trainer.max_epochs", 2, "--model.freeze_norm", "true", "--model.silhouette", "iou",
            "--model.silhouette_options", "{}",
            "--trainer.log_every_n_steps", 1, "--model.lr", "1e-4",
            "--model.lambda_pose", 0.95)  # fmt: skip
    one, two = tmp_path / "one", tmp_path / "two"
    train(data, one, *more)
    train_on_two(data, two, "--data.batch_size", 6, *more)
    a, b = losses_of(one), losses_of(two)
    assert len(a) == len(b) == 8
    np.testing.assert_allclose(a, b, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 5])
def test_two_processes_score_each_sample_once(count, tmp_path):
    data, out, csv = tmp_path / "data", tmp_path / "out", tmp_path / "p.csv"
    write_toyset(data, height=48, width=64, counts={"train": 8, "val": count}, seed=3)
    done = train_on_two(
        data, out, "--data.batch_size", 2, "--trainer.max_epochs", 1, "--model.silhouette", "none"
    )
    assert "sync_dist" not in done.stderr
    weights = out / "best.safetensors"
    dronepose("predict", "--weights", weights, "--data", data, "--split", "val", "--out", csv)
    expected = table_one(evaluate(csv, data / "val" / "poses.csv", mesh=data / "mesh.obj"))
    assert read_metadata(weights)["metrics"] == pytest.approx(expected, rel=1e-4)


def test_errors_of_the_commands_name_what_is_missing(tmp_path, capsys):
    assert cli.dronepose(["train", "--config", "nothing.yaml"]) == 1
    assert "nothing.yaml: no such configuration" in capsys.readouterr().err
    assert cli.dronepose(["train", "--help"]) == 0
    assert "Example:" in capsys.readouterr().out
    missing = ["predict", "--weights", str(tmp_path / "w"), "--data", str(tmp_path), "--out", "o"]
    assert cli.dronepose(missing) == 1
    assert "no such file of weights" in capsys.readouterr().err
    assert cli.dronepose(["predict"]) == 2
    assert cli.dronepose(["reproduce", "mini", "--out", str(tmp_path), "--size", "a"]) == 1
    assert "--size" in capsys.readouterr().err


# ---------------------------------------------------------------------------- reproduce


def test_intervals_are_students():
    assert reproduce.interval([1.0]) is None
    assert reproduce.interval([1.0, 3.0]) == pytest.approx(12.706, rel=1e-3)
    assert reproduce.interval([1.0, 2.0, 3.0]) == pytest.approx(4.303 / 3**0.5, rel=1e-3)


@pytest.mark.slow
def test_the_comparison_is_resumable(tmp_path):
    call = [
        "reproduce", "mini", "--out", tmp_path, "--train", 24, "--val", 6, "--test", 6,
        "--size", "48x64", "--epochs", 1, "--seeds", 0, 1, "--variants", "direct", "tanimoto01",
        "--batch-size", 12, "--json",
    ]  # fmt: skip
    first = json.loads(dronepose(*call).stdout)
    assert [r["variant"] for r in first] == ["direct", "tanimoto01"] * 2
    again = json.loads(dronepose(*call).stdout)
    assert again == first
    text = (Path(tmp_path) / "results.md").read_text()
    assert "| Direct | 2 |" in text
    assert "±" in text
