"""Scenes of the BOP layout, on files that the tests write, and on those of the cases folder."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose import Camera, Mesh, render  # noqa: E402
from dronepose.data import BopDataset, DataError, PoseDataModule, render_toy_sample  # noqa: E402
from dronepose.data._poses import poses_csv  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH, ToySettings  # noqa: E402
from support import SHARED, evaluate  # noqa: E402

CASE = SHARED / "cases" / "eval" / "c08_symmetric_box" / "bop"
SETTINGS = ToySettings(height=48, width=64)


def write(scene, images=3, objects=(5,), seed=0):
    """A scene with one image for each number, and of each object an instance in it."""
    for folder in ("rgb", "mask_visib"):
        (scene / folder).mkdir(parents=True)
    K = SETTINGS.camera.K.copy()
    K[:2, 2] -= 0.5  # BOP counts pixel centres as whole numbers
    truth, cameras, info = {}, {}, {}
    for n in range(images):
        truth[n], info[n] = [], []
        for k, obj in enumerate(objects):
            image, mask, R, t = render_toy_sample(SETTINGS, "train", 10 * n + k + seed)
            cv2.imwrite(str(scene / "mask_visib" / f"{n:06d}_{k:06d}.png"), mask)
            truth[n].append(
                {
                    "cam_R_m2c": R.reshape(-1).tolist(),
                    "cam_t_m2c": (1000 * t).tolist(),
                    "obj_id": obj,
                }
            )
            info[n].append({"visib_fract": 0.3 + 0.1 * k})
        cv2.imwrite(str(scene / "rgb" / f"{n:06d}.png"), image[..., ::-1])
        cameras[n] = {"cam_K": K.reshape(-1).tolist(), "depth_scale": 1.0}
    for name, content in (("gt", truth), ("camera", cameras), ("gt_info", info)):
        (scene / f"scene_{name}.json").write_text(json.dumps(content))
    return truth


def change(file, edit):
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


def test_metres_pixel_centres_and_masks(tmp_path):
    write(tmp_path / "val" / "000001")
    data = BopDataset(tmp_path, "val", object_id=5)
    assert data.names == ["0", "1", "2"]
    mesh = Mesh.from_file(EXAMPLE_MESH)
    for k in range(3):
        sample = data[k]
        np.testing.assert_allclose(sample["K"], SETTINGS.camera.K, rtol=1e-6)
        assert 0.7 < sample["t"].norm() < 3.1
        raw = data.load(k)
        camera = Camera.from_K(raw.K, 64, 48)
        drawn = render.silhouette(mesh, camera, raw.R[None], raw.t[None])[0]
        assert np.abs(drawn - raw.mask / 255).max() < 0.01
    with_centres = BopDataset(tmp_path, "val", pixel_centre=0.0, mask=None)
    assert with_centres[0]["K"][0, 2] == 31.5
    assert with_centres[0]["mask"].shape == (0, 0)


def test_poses_need_no_images(tmp_path):
    write(tmp_path / "test" / "000001")
    data = BopDataset(tmp_path, "test", object_id=5)
    known = [data.load(k) for k in range(len(data))]
    for image in tmp_path.rglob("*.png"):
        image.unlink()
    for k, raw in enumerate(known):
        R, t = data.pose(k)
        assert (R.tolist(), t.tolist()) == (raw.R.tolist(), raw.t.tolist())


def test_names_are_the_ids_of_the_evaluation(tmp_path):
    for number, seed in ((1, 0), (2, 100)):
        write(tmp_path / "val" / f"{number:06d}", objects=(5, 6), seed=seed)
    data = BopDataset(tmp_path, "val", object_id=5)
    assert data.names == ["1/0/5", "1/1/5", "1/2/5", "2/0/5", "2/1/5", "2/2/5"]
    loaded = [data.load(k) for k in range(6)]
    R, t = (np.stack([getattr(raw, name) for raw in loaded]) for name in "Rt")
    (tmp_path / "est.csv").write_text(poses_csv([raw.name for raw in loaded], R, t))
    found = evaluate(tmp_path / "est.csv", tmp_path / "val", "--objects", "5")
    assert found["metrics"]["acc"]["2"]["percent_of_gt"] == 100
    one = BopDataset(tmp_path / "val", "000002", object_id=6)
    assert one.names == ["0", "1", "2"]


def test_several_instances_need_a_choice(tmp_path):
    write(tmp_path / "val" / "000001", images=2, objects=(5, 6, 5))
    with pytest.raises(ValueError, match=r"instance: .*image 0 has 2 instances of object 5"):
        BopDataset(tmp_path, "val", object_id=5)
    best = BopDataset(tmp_path, "val", object_id=5, instance="most_visible")
    every = BopDataset(tmp_path, "val", object_id=5, instance="all")
    assert every.names == ["0#0", "0#2", "1#0", "1#2"]
    assert torch.equal(best[1]["t"], every[3]["t"])
    with pytest.raises(ValueError, match=r"object_id: .* holds objects 5 and 6; choose one"):
        BopDataset(tmp_path, "val")
    with pytest.raises(DataError, match="no instance of object 9"):
        BopDataset(tmp_path, "val", object_id=9)


def test_through_the_data_module(tmp_path):
    write(tmp_path / "test" / "000001")
    data = PoseDataModule(str(tmp_path), kind="bop", options={"object_id": 5})
    assert next(iter(data.test_dataloader()))["image"].shape == (3, 3, 48, 64)


def test_errors_name_the_file_and_the_sample(tmp_path):
    scene = tmp_path / "val" / "000001"
    write(scene)
    truth, camera = scene / "scene_gt.json", scene / "scene_camera.json"
    good = {path: path.read_text() for path in (truth, camera)}

    def refused(file, edit, message):
        change(file, edit)
        with pytest.raises(DataError, match=message):
            BopDataset(tmp_path, "val")[1]
        file.write_text(good[file])

    refused(
        truth,
        lambda c: c["1"][0].update(cam_t_m2c=[0, 0, -5]),
        r"scene_gt\.json: image 1, instance 0: sample '1': the model is behind the camera",
    )
    refused(truth, lambda c: c["1"][0].update(cam_R_m2c=[1] * 9), "sample '1': not a rotation")
    refused(truth, lambda c: c["1"][0].update(cam_R_m2c=[1]), "cam_R_m2c: expected 9 numbers")
    refused(truth, lambda c: c["1"][0].pop("obj_id"), "image 1: an instance without")
    refused(camera, lambda c: c.pop("1"), r"scene_camera\.json: image 1: no such image")
    refused(camera, lambda c: c["1"].pop("cam_K"), "image 1: cam_K: expected 9 numbers")
    refused(camera, lambda c: c["1"]["cam_K"].__setitem__(0, -1), "image 1: fx: expected a focal")
    truth.write_text("{\n  oops")
    with pytest.raises(DataError, match=r"scene_gt\.json:2:3: no JSON"):
        BopDataset(tmp_path, "val")
    truth.write_text(good[truth])
    (scene / "mask_visib" / "000001_000000.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"000001_000000\.png: no such file, .*sample '1'"):
        BopDataset(tmp_path, "val")[1]
    (scene / "rgb" / "000002.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"rgb/000002\.png: no such file, .*sample '2'"):
        BopDataset(tmp_path, "val")[2]
    with pytest.raises(FileNotFoundError, match="a folder of BOP scenes"):
        BopDataset(tmp_path, "nothing")


@pytest.mark.skipif(not CASE.is_dir(), reason=f"{CASE} is not there")
def test_a_scene_of_the_cases_folder():
    data = BopDataset(CASE, "", instance="one", mask=None)
    truth = json.loads((CASE / "scene_gt.json").read_text())
    assert data.names == sorted(truth, key=int)
    np.testing.assert_allclose(
        data._items[0].t, np.array(truth[data.names[0]][0]["cam_t_m2c"]) / 1000
    )
    assert data._items[0].K[0].tolist() == [500.0, 0.0, 320.5]
