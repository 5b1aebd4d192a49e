"""A rendered data set in other formats, read back."""

import hashlib
import json
import shutil
import tarfile

import numpy as np
import pytest

from support import run

cv2 = pytest.importorskip("cv2")
pytest.importorskip("torch")

from dronepose.data import BopDataset, UavaDataset  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.mesh import Mesh  # noqa: E402
from dronepose.render import gbuffer  # noqa: E402
from dronepose.synth.dataset import SynthError  # noqa: E402
from dronepose.synth.encode import decode_depth, read_png  # noqa: E402
from dronepose.synth.export import export_bop, rle_counts, whole_folder  # noqa: E402
from dronepose.synth.inputs import cameras_of  # noqa: E402
from dronepose.synth.layout import MODALITIES  # noqa: E402
from dronepose.synth.shards import export_webdataset  # noqa: E402
from synth_set import kept_rows, write_tiny  # noqa: E402


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("made"), scenes=(("hall", "train"), ("other", "val")))


@pytest.fixture(scope="module")
def bop(made, tmp_path_factory):
    out = tmp_path_factory.mktemp("bop") / "out"
    facts = export_bop(made[0], out)
    assert facts["images"] == 4 * len(kept_rows(made[0]))
    return out


def decoded(segmentation):
    """Uncompressed run lengths of COCO, pixel by pixel."""
    height, width = segmentation["size"]
    mask = np.zeros((height, width), bool)
    place, value = 0, False
    for length in segmentation["counts"]:
        for _ in range(length):
            mask[place % height, place // height] = value
            place += 1
        value = not value
    assert place == height * width
    return mask


def load(path):
    return json.loads(path.read_text())


def test_bop_poses_images_and_masks_are_those_of_the_data_set(made, bop):
    root, table = made
    for split, building in (("train", "hall"), ("val", "other")):
        data = BopDataset(bop, split)
        whole = UavaDataset(root, split, drone="drone")
        assert len(data) == len(whole) == 2 * len(kept_rows(root, building))
        cases = [(row, step) for row in kept_rows(root, building) for step in (0, 1)]
        for k, (row, step) in enumerate(cases):
            raw, other = data.load(k), whole.load(k)
            R, t = table.pose("next" if step else "")
            np.testing.assert_allclose(raw.R, R[row], atol=1e-9)
            np.testing.assert_allclose(raw.t, t[row], atol=1e-9)
            np.testing.assert_allclose(raw.K, cameras_of(table)[0].K, atol=1e-9)
            np.testing.assert_array_equal(raw.image, other.image)
            name = f"{row}_flight_{step}_instance_exocentric_0.png"
            instance = (root / "drone/exocentric/instance" / building / name).read_bytes()
            np.testing.assert_array_equal(raw.mask, 255 * (read_png(instance) == 2))


def test_bop_masks_depth_and_boxes(made, bop):
    camera = cameras_of(made[1])[0]
    mesh = Mesh.from_file(EXAMPLE_MESH)
    data = BopDataset(bop, "train", mask="mask")
    scene = bop / "train/000001"
    info, cameras = load(scene / "scene_gt_info.json"), load(scene / "scene_camera.json")
    for k in range(len(data)):
        raw, facts = data.load(k), info[str(k)][0]
        plane = gbuffer(mesh, camera, raw.R, raw.t, channels=("mask", "depth"))
        full = raw.mask > 0
        np.testing.assert_array_equal(full, plane.mask)
        visible = read_png((scene / f"mask_visib/{k:06d}_000000.png").read_bytes()) > 0
        assert (visible <= full).all()
        steps = read_png((scene / f"depth/{k:06d}.png").read_bytes())
        assert steps.dtype == np.uint16
        millimetres = steps * cameras[str(k)]["depth_scale"]
        np.testing.assert_allclose(millimetres[visible], 1e3 * plane.depth[visible], atol=0.26)
        np.testing.assert_allclose(millimetres, 1e3 * decode_depth(steps), rtol=1e-6)
        rows, columns = np.nonzero(visible)
        box = [columns.min(), rows.min(), np.ptp(columns), np.ptp(rows)]
        assert facts["bbox_visib"] == box
        assert facts["px_count_visib"] == visible.sum()
        assert facts["px_count_all"] >= full.sum()
        assert facts["px_count_valid"] == (full & (steps > 0)).sum()
        assert facts["visib_fract"] == pytest.approx(visible.sum() / facts["px_count_all"])
        rows, columns = np.nonzero(full)
        low, high = (columns.min(), rows.min()), (columns.max(), rows.max())
        inside = min(low) > 0 and high[0] < 95 and high[1] < 71
        if inside:
            assert facts["px_count_all"] == full.sum()
            assert facts["bbox_obj"] == [
                columns.min(), rows.min(), np.ptp(columns), np.ptp(rows),
            ]  # fmt: skip


def test_bop_counts_what_is_outside_of_the_image(made, tmp_path):
    root = tmp_path / "data"
    shutil.copytree(made[0], root)
    path = root / "trajectories/hall/flight/poses_blender.txt"
    head, *lines = path.read_text().splitlines()
    names = head.split("\t")
    table = np.array([[float(x) for x in line.split("\t")] for line in lines])
    right = made[1].pose("exo")[0][:, 0]  # of the camera, in the world
    columns = [names.index(f"Position({a})_t1") for a in "xyz"]
    table[:, columns] += 0.45 * right
    lines = ["\t".join(repr(float(x)) for x in row) for row in table]
    path.write_text("\n".join([head, *lines]) + "\n")
    export_bop(root, tmp_path / "out")
    scene = tmp_path / "out/train/000001"
    info, cut = load(scene / "scene_gt_info.json"), 0
    for k in range(0, len(info), 2):
        facts = info[str(k)][0]
        full = read_png((scene / f"mask/{k:06d}_000000.png").read_bytes()) > 0
        if facts["bbox_obj"][0] + facts["bbox_obj"][2] > 95:
            assert facts["px_count_all"] > full.sum()
            cut += 1
    assert cut


def test_bop_run_lengths_are_the_masks(bop):
    for scene in (bop / "train/000001", bop / "val/000002"):
        coco = load(scene / "scene_gt_coco.json")
        assert [image["id"] for image in coco["images"]] == list(range(len(coco["images"])))
        assert {a["image_id"] for a in coco["annotations"]} == set(range(len(coco["images"])))
        for one in coco["annotations"]:
            name = f"mask_visib/{one['image_id']:06d}_000000.png"
            mask = read_png((scene / name).read_bytes()) > 0
            np.testing.assert_array_equal(decoded(one["segmentation"]), mask)
            assert one["area"] == mask.sum()
            left, top, width, height = one["bbox"]
            assert mask[top : top + height, left : left + width].sum() == mask.sum()
            assert mask[:, left].any()
            assert mask[top + height - 1].any()


def test_run_lengths_of_any_mask():
    generator = np.random.default_rng(0)
    for shape in ((1, 1), (5, 7), (8, 3)):
        for share in (0.0, 0.2, 0.8, 1.0):
            mask = generator.random(shape) < share
            counts = rle_counts(mask)
            assert sum(counts) == mask.size
            assert all(counts[1:])
            found = decoded({"size": list(shape), "counts": counts})
            np.testing.assert_array_equal(found, mask)


def test_bop_model_in_millimetres(bop):
    mesh = Mesh.from_file(EXAMPLE_MESH)
    held = Mesh.from_file(bop / "models/obj_000001.ply", unit="mm")
    np.testing.assert_allclose(held.vertices, mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(held.faces, mesh.faces)
    facts = load(bop / "models/models_info.json")["1"]
    assert facts["diameter"] == pytest.approx(1e3 * mesh.diameter)
    assert facts["min_x"] == pytest.approx(1e3 * mesh.bounds[0, 0])
    assert facts["size_z"] == pytest.approx(1e3 * np.ptp(mesh.bounds[:, 2]))


def test_bop_says_which_image_is_which(made, bop):
    facts = load(bop / "export.json")
    assert facts["scenes"][1] == {"scene": 2, "building": "other", "split": "val"}
    rows = kept_rows(made[0])
    assert facts["image_table"]["rows"][:3] == [
        [1, 0, rows[0], 0], [1, 1, rows[0], 1], [1, 2, rows[1], 0],
    ]  # fmt: skip


def test_an_export_that_fails_leaves_nothing(made, tmp_path):
    root = tmp_path / "data"
    shutil.copytree(made[0], root)
    last = sorted((root / "drone/exocentric/instance/other").iterdir())[-1]
    last.write_bytes(last.read_bytes()[:-30])
    with pytest.raises(SynthError, match="cut off"):
        export_bop(root, tmp_path / "out")
    last.unlink()
    with pytest.raises(FileNotFoundError, match=last.name):
        export_bop(root, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    scene = root / "scenes/hall.json"
    scene.write_text(json.dumps({**load(scene), "complete": False}))
    with pytest.raises(SynthError, match=r"hall\.json: the scene is not complete"):
        export_bop(root, tmp_path / "out")


def test_a_folder_that_holds_something_is_not_touched(tmp_path):
    (tmp_path / "out").mkdir()
    with whole_folder(tmp_path / "out") as part:
        (part / "a").write_text("a")
    assert (tmp_path / "out/a").read_text() == "a"
    with pytest.raises(SynthError, match="is there already"), whole_folder(tmp_path / "out"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_command_exports_bop(made, tmp_path):
    out = tmp_path / "out"
    arguments = ["synth", "export", made[0], "--format", "bop", "--out", out]
    done = run(*arguments, "--json", name="dronepose")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["format"] == "bop"
    assert (out / "models/obj_000001.ply").exists()
    done = run(*arguments, name="dronepose")
    assert done.returncode == 1
    assert "is there already" in done.stderr
    for wrong, code, message in (
        (["--mesh", tmp_path / "none.obj"], 1, "none.obj: there is no such mesh"),
        (["--format", "voc"], 2, "--format"),
    ):
        done = run(*arguments[:-1], tmp_path / "new", *wrong, name="dronepose")
        assert (done.returncode, message in done.stderr) == (code, True), done.stderr
    assert not (tmp_path / "new").exists()
    other = tmp_path / "data"
    shutil.copytree(made[0], other)
    for path in (other / "scenes").glob("*.json"):
        facts = load(path)
        facts["inputs"]["drone"] = {"file": "DJI.obj"}
        path.write_text(json.dumps(facts))
    done = run("synth", "export", other, *arguments[3:-1], tmp_path / "new", name="dronepose")
    assert done.returncode == 1
    assert "needs --mesh FILE (DJI.obj was rendered)" in done.stderr


@pytest.fixture(scope="module")
def shards(made, tmp_path_factory):
    out = tmp_path_factory.mktemp("shards") / "out"
    export_webdataset(made[0], out, shard_size=2)
    return out


def members(path):
    with tarfile.open(path) as archive:
        return [(one, archive.extractfile(one).read()) for one in archive]


def test_shards_hold_every_image_and_the_poses(made, shards):
    root, table = made
    camera = cameras_of(table)[0]
    for split, building in (("train", "hall"), ("val", "other")):
        files = [one for path in sorted(shards.glob(f"{split}-*.tar")) for one in members(path)]
        found = {one.name: content for one, content in files}
        assert len(found) == len(files) == 24 * len(kept_rows(root, building))
        for row in kept_rows(root, building):
            for step in (0, 1):
                key = f"{building}_{row:06d}_{step}"
                for view, prefix in (("exocentric", ""), ("egocentric", "ego_")):
                    for modality in MODALITIES[view]:
                        name = f"{row}_flight_{step}_{modality}_{view}_0.png"
                        content = (root / "drone" / view / modality / building / name).read_bytes()
                        assert found[f"{key}.{prefix}{modality}.png"] == content
                facts = json.loads(found[f"{key}.json"])
                R, t = table.pose("next" if step else "")
                np.testing.assert_allclose(facts["R"], R[row], atol=1e-9)
                np.testing.assert_allclose(facts["t"], t[row], atol=1e-9)
                np.testing.assert_array_equal(facts["K"], camera.K)
                record = root / f"records/{building}/{row:06d}.json"
                assert facts["facts"] == load(record)
                assert (facts["row"], facts["time"], facts["split"]) == (row, step, split)


def test_shards_keep_pairs_together_and_names_in_order(made, shards):
    facts = load(shards / "shards.json")
    assert sum(shard["samples"] for shard in facts["shards"]) == facts["samples"]
    assert {path.name for path in shards.iterdir()} == {
        "shards.json", *(shard["file"] for shard in facts["shards"]),
    }  # fmt: skip
    for shard in facts["shards"]:
        assert 0 < shard["samples"] <= 2
        path = shards / shard["file"]
        assert shard["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        names = [one.name for one, _ in members(path)]
        assert names == sorted(names)
        keys = list(dict.fromkeys(name.split(".")[0] for name in names))
        assert len(keys) == shard["keys"] == 2 * shard["samples"]
        assert [key[-2:] for key in keys] == ["_0", "_1"] * shard["samples"]
        for one, _ in members(path):
            header = (one.mtime, one.uid, one.gid, one.uname, one.gname, one.mode)
            assert header == (0, 0, 0, "", "", 0o644)


def test_two_runs_give_the_same_bytes(made, shards, tmp_path):
    other = tmp_path / "copy"
    shutil.copytree(made[0], other, copy_function=shutil.copyfile)  # other times and owners
    export_webdataset(other, tmp_path / "out", shard_size=2)
    first, second = (
        {path.name: path.read_bytes() for path in folder.iterdir()}
        for folder in (shards, tmp_path / "out")
    )
    assert first == second
    with pytest.raises(ValueError, match="shard_size"):
        export_webdataset(other, tmp_path / "new", shard_size=0)


def test_shards_that_fail_leave_nothing(made, tmp_path):
    root = tmp_path / "data"
    shutil.copytree(made[0], root)
    gone = sorted((root / "drone/egocentric/flow/other").iterdir())[-1]
    gone.unlink()
    with pytest.raises(FileNotFoundError, match=gone.name):
        export_webdataset(root, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_the_command_exports_webdataset(made, tmp_path):
    arguments = ["synth", "export", made[0], "--format", "webdataset", "--out"]
    done = run(*arguments, tmp_path / "out", "--shard-size", 3, name="dronepose")
    assert done.returncode == 0, done.stderr
    assert "keys, in" in done.stdout
    assert (tmp_path / "out/train-000000.tar").exists()
    for wrong, code, message in (
        (["--shard-size", 0], 2, "at least 1"),
        (["--mesh", "a.obj"], 1, "--mesh: only for --format bop"),
        (["--format", "bop", "--shard-size", 1], 1, "--shard-size: only for --format webdataset"),
    ):
        done = run(*arguments, tmp_path / "new", *wrong, name="dronepose")
        assert (done.returncode, message in done.stderr) == (code, True), done.stderr
    assert not (tmp_path / "new").exists()
