"""Samples of the project's layout, and what is said of broken ones."""

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from torch.utils.data import default_collate  # noqa: E402

from dronepose import evaluate  # noqa: E402
from dronepose.data import DataError, FolderDataset, read_manifest, write_toyset  # noqa: E402
from dronepose.data._poses import poses_csv, read_poses  # noqa: E402

HEADER = "id,qw,qx,qy,qz,tx,ty,tz"


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    root = tmp_path_factory.mktemp("folder") / "set"
    write_toyset(root, counts={"train": 3}, height=48, width=64, seed=2)
    return root


@pytest.fixture
def copy(toy, tmp_path):
    return shutil.copytree(toy, tmp_path / "set")


def test_samples_have_the_stated_types_and_collate(toy):
    data = FolderDataset(toy, "train")
    assert len(data) == 3
    batch = default_collate([data[k] for k in range(3)])
    shapes = {key: tuple(batch[key].shape) for key in ("image", "K", "R", "t", "mask")}
    assert shapes == {
        "image": (3, 3, 48, 64),
        "K": (3, 3, 3),
        "R": (3, 3, 3),
        "t": (3, 3),
        "mask": (3, 48, 64),
    }
    assert all(batch[key].dtype == torch.float32 for key in shapes)
    assert batch["name"] == ["train-000000", "train-000001", "train-000002"]
    assert 0 <= batch["image"].min() < batch["image"].max() <= 1
    assert batch["mask"].max() > 0.9
    raw = data.load(1)
    red = cv2.imread(str(toy / "train/images/000001.png"))[..., 2]
    np.testing.assert_array_equal(raw.image[..., 0], red)
    assert torch.equal(data[1]["image"][0], torch.from_numpy(red).float() / 255)
    assert data[-1]["name"] == "train-000002"
    with pytest.raises(IndexError, match="index: expected 0 to 2, got 3"):
        data[3]


def test_resizing_changes_the_camera_alike(toy):
    plain, small = FolderDataset(toy, "train"), FolderDataset(toy, "train", height=24, width=16)
    K, k = plain[0]["K"], small[0]["K"]
    assert torch.allclose(k[0], K[0] / 4)
    assert torch.allclose(k[1], K[1] / 2)
    assert small[0]["image"].shape == (3, 24, 16)
    mean = plain[0]["mask"].reshape(24, 2, 16, 4).mean(dim=(1, 3))
    assert torch.allclose(small[0]["mask"], mean, atol=1 / 255)
    with pytest.raises(ValueError, match="height, width: expected both or none"):
        FolderDataset(toy, "train", height=24)


def test_intrinsics_of_each_image_go_first(copy):
    poses = copy / "train/poses.csv"
    lines = poses.read_text().splitlines()
    lines[0] += ",fx,fy,cx,cy"
    for k in range(1, 4):
        lines[k] += f",{100 + k},{200 + k},30,20"
    poses.write_text("\n".join(lines) + "\n")
    K = FolderDataset(copy, "train")[1]["K"]
    assert K.tolist() == [[102, 0, 30], [0, 202, 20], [0, 0, 1]]


def test_without_masks_they_are_empty(copy):
    shutil.rmtree(copy / "train/masks")
    data = FolderDataset(copy, "train")
    assert default_collate([data[0], data[1]])["mask"].shape == (2, 0, 0)


def test_the_mesh_is_the_stated_one(copy):
    assert len(FolderDataset(copy, "train").mesh().faces) == 3912
    (copy / "mesh.obj").write_text("v 0 0 0\n")
    with pytest.raises(DataError, match=r"mesh\.obj: SHA-256 is \w+, dataset\.json says"):
        FolderDataset(copy, "train").mesh()


def test_a_missing_image_names_the_sample(copy):
    (copy / "train/images/000001.png").unlink()
    data = FolderDataset(copy, "train")
    data[0]
    message = r"images/000001\.png: no such file, expected an image of sample 'train-000001' "
    with pytest.raises(FileNotFoundError, match=message + r"\(.*train/poses\.csv:3\)"):
        data[1]


def test_poses_need_no_images(copy):
    data = FolderDataset(copy, "train")
    known = [data.load(k) for k in range(len(data))]
    shutil.rmtree(copy / "train/images")
    for k, raw in enumerate(known):
        R, t = data.pose(k)
        assert (R.tolist(), t.tolist()) == (raw.R.tolist(), raw.t.tolist())


@pytest.mark.parametrize("folder", ["images", "masks"])
@pytest.mark.parametrize("how", ["cut", "flipped", "empty", "text"])
def test_a_broken_png_names_the_sample(copy, folder, how):
    file = copy / "train" / folder / "000002.png"
    whole = file.read_bytes()
    half = len(whole) // 2
    broken = {
        "cut": whole[:half],
        "flipped": whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :],
        "empty": b"",
        "text": b"not an image",
    }
    file.write_bytes(broken[how])
    with pytest.raises(DataError, match=rf"{folder}/000002\.png: sample 'train-000002' \(.*:4\)"):
        FolderDataset(copy, "train")[2]


def test_sizes_have_to_fit(copy):
    cv2.imwrite(str(copy / "train/masks/000000.png"), np.zeros((5, 6), np.uint8))
    with pytest.raises(DataError, match=r"csv:2: sample 'train-000000': the mask is 6x5, .* 64x48"):
        FolderDataset(copy, "train")[0]
    for kind in ("images", "masks"):
        cv2.imwrite(str(copy / f"train/{kind}/000001.png"), np.zeros((5, 6), np.uint8))
    with pytest.raises(DataError, match=r"the image is 6x5 pixels, the camera .* 64x48"):
        FolderDataset(copy, "train")[1]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("a,nan,0,0,0,0,0,1", r":2: sample 'a': column qw: found 'nan', expected a finite number"),
        ("a,1,0,0,0,0,1_0,1", r":2: sample 'a': column ty: found '1_0'"),
        ("a,2,0,0,0,0,0,1", r":2: sample 'a': column qw: a quaternion of norm 2"),
        ("a,1,0,0,0,0,0,-1", r":2: sample 'a': the model is behind the camera: z = -1 m"),
        ("a,1,0,0,0,0,0", r":2: found 7 columns, expected 8"),
        (",1,0,0,0,0,0,1", r":2: column id: found an empty id"),
        ("a,1,0,0,0,0,0,1\na,1,0,0,0,0,0,1", r":3: column id: found 'a' again, first in line 2"),
    ],
)
def test_a_wrong_pose_names_file_line_and_sample(copy, row, message):
    (copy / "train/poses.csv").write_text(f"{HEADER}\n{row}\n")
    with pytest.raises(DataError, match=r"train/poses\.csv" + message):
        FolderDataset(copy, "train")


def test_matrices_have_to_be_rotations(tmp_path):
    names = ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    file = tmp_path / "poses.csv"
    for matrix, message in (
        ("-1,0,0,0,1,0,0,0,1", r"not a rotation: .*the determinant is -1"),
        ("1.1,0,0,0,1,0,0,0,1", r"not a rotation: R R\^T is off by 0\.21"),
    ):
        file.write_text(f"id,{names},tx,ty,tz\na,{matrix},0,0,1\n")
        with pytest.raises(DataError, match=rf"poses\.csv:2: sample 'a': {message}"):
            read_poses(file)
    file.write_text(f"id,{names},tx,ty,tz\na,0,-1.001,0,1,0,0,0,0,1,0,0,1\n")
    np.testing.assert_allclose(read_poses(file)[0].R @ [1, 0, 0], [0, 1, 0], atol=1e-6)
    file.write_text("id,rx,ry,rz,tx,ty,tz\na,0,0,1.5707963267948966,0,0,1\n")
    np.testing.assert_allclose(read_poses(file)[0].R @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    file.write_text("id,qw,qx,qy,tx,ty,tz\n")
    with pytest.raises(DataError, match=re.escape("poses.csv:1: the header has no qw,qx,qy,qz")):
        read_poses(file)


def test_written_poses_are_read_back(tmp_path):
    rng = np.random.default_rng(0)
    q, _ = np.linalg.qr(rng.normal(size=(4, 3, 3)))
    q *= np.linalg.det(q)[:, None, None]
    t = rng.random((4, 3)) + 1
    names, images = [f'a "{k}",\n' for k in range(4)], [f"{k}" for k in range(4)]
    text = poses_csv(names, q, t, form=".12g", further={"image": images})
    (tmp_path / "p.csv").write_text(text)
    for k, back in enumerate(read_poses(tmp_path / "p.csv")):
        np.testing.assert_allclose(back.R, q[k], atol=1e-10)
        np.testing.assert_allclose(back.t, t[k], atol=1e-10)
        assert back.name == names[k].strip()
        assert back.further == {"image": images[k]}
    assert k == 3


def test_numbers_and_cells_are_written_as_asked_for(tmp_path):
    names = ['a,"b"', "c\nd", "e\rf", "g"]
    R, t = np.stack([np.eye(3)] * 4), np.full((4, 3), 1 / 3)
    exact = tmp_path / "exact.csv"
    exact.write_text(poses_csv(names, R, t, further={"image": names}), newline="")
    found = read_poses(exact)
    assert [row.name for row in found] == [row.further["image"] for row in found] == names
    assert all(row.t.tolist() == t[0].tolist() for row in found)
    assert evaluate(exact, exact).n_matched == 4
    last = poses_csv(names, R, t, form=".9f", further={"x": ["1"] * 4}).splitlines()[-1]
    assert last == "g,1.000000000,0.000000000,0.000000000,0.000000000" + 3 * ",0.333333333" + ",1"
    assert poses_csv([], R[:0], t[:0]) == "id,qw,qx,qy,qz,tx,ty,tz\n"
    for wrong in ({"names": names[:3]}, {"t": t[:3]}, {"further": {"x": ["1"]}}):
        with pytest.raises(ValueError, match="zip"):
            poses_csv(**{"names": names, "R": R, "t": t, **wrong})


def test_a_set_that_is_not_whole_is_refused(copy):
    file = copy / "dataset.json"
    manifest = json.loads(file.read_text())
    for change, message in (
        ({"complete": False}, "the data set is not finished"),
        ({"format": "other"}, "format: expected 'dronepose-folder-1', found 'other'"),
        ({"camera": {"fx": 1}}, "camera: "),
        ({"camera": None}, r"poses\.csv:1: the header has no fx,fy,cx,cy"),
    ):
        file.write_text(json.dumps({**manifest, **change}))
        with pytest.raises(DataError, match=message):
            FolderDataset(copy, "train")
    file.write_text("{")
    with pytest.raises(DataError, match=r"dataset\.json: no JSON"):
        read_manifest(copy)
    file.unlink()
    with pytest.raises(FileNotFoundError, match="the description of a data set"):
        read_manifest(copy)
    file.write_text(json.dumps(manifest))
    with pytest.raises(FileNotFoundError, match=r"val: no such folder, expected a split"):
        FolderDataset(copy, "val")


@pytest.mark.parametrize("absent", ["torch", "cv2", "lightning"])
def test_what_is_not_installed_is_named(absent):
    code = (
        f"import sys; sys.modules[{absent!r}] = None\n"
        "import dronepose.data\n"
        "assert 'numpy' not in sys.modules\n"
        "try:\n"
        "    dronepose.data.PoseDataModule\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    wanted = (
        f'PoseDataModule needs {absent}, which is not installed: pip install "dronepose[train]"'
    )
    assert wanted in done.stdout


def test_the_toy_set_needs_no_torch(tmp_path):
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from dronepose.data import write_toyset\n"
        f"write_toyset({str(tmp_path / 'set')!r}, counts={{'train': 1}})\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
    assert (tmp_path / "set/train/images/000000.png").exists()


def test_every_public_name_resolves():
    import dronepose.data

    for name in dronepose.data.__all__:
        assert getattr(dronepose.data, name) is not None
        assert name in dir(dronepose.data)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = dronepose.data.nothing
