"""The layout of UAVA, on a small set that the tests write, and on real flights and scenes."""

import csv

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose import Camera, Mesh, render  # noqa: E402
from dronepose.data import DataError, PoseDataModule, UavaDataset  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.geometry import matrix_from_quat_xyzw, quat_wxyz_from_matrix  # noqa: E402
from dronepose.train.source import camera_of  # noqa: E402
from support import SHARED  # noqa: E402

DATE = "2019-12-24-13-30-23"
BLENDER = np.diag([1.0, -1.0, -1.0])  # a camera that looks down -z, y up
SPLITS = SHARED / "data" / "anchors" / "matterport3d" / "splits"


def columns():
    names = []
    for step in ("_t1", "_t2"):
        names += [f"Position({a}){step}" for a in "xyz"]
        names += [f"Orientation({a}){step}" for a in "xyzw"]
    return names + [f"Pilot({a})" for a in "xyz"] + [f"PilotRot({a})" for a in "xyzw"]


def xyzw(R):
    return np.roll(quat_wxyz_from_matrix(R), -1)


def random_rotation(rng):
    q = rng.normal(size=4)
    return matrix_from_quat_xyzw(q / np.linalg.norm(q))


def write(root, buildings=("aaa", "bbb"), rows=3, seed=0):
    """A small UAVA of which the poses are known: ``{name: (R, t)}`` with OpenCV axes."""
    rng = np.random.default_rng(seed)
    mesh, camera = Mesh.from_file(EXAMPLE_MESH), Camera.from_fov(80, 60, horizontal_deg=64.69)
    known = {}
    (root / "data splits").mkdir(parents=True)
    for split in ("train", "val", "test"):
        (root / "data splits" / f"scenes_{split}.txt").write_text("\n".join(buildings) + "\n")
    for building in buildings:
        flight = root / "trajectories" / building / DATE
        flight.mkdir(parents=True)
        (flight / "airsim_rec.txt").write_text("another file of the flight\n")
        lines = ["\t".join(["Time", *columns()])]
        for row in range(rows):
            R_cam, T_cam = random_rotation(rng), rng.normal(size=3) * 5
            cells = []
            for frame in (0, 1):
                R = random_rotation(rng)
                t = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.9, 1.5)])
                known[f"{building}_{row}_{DATE}_{frame}"] = (R, t)
                # cam_from_model in Blender's axes, carried into the world
                world_R, world_t = R_cam @ BLENDER @ R, R_cam @ BLENDER @ t + T_cam
                cells += [*world_t, *xyzw(world_R)]
                mask = render.silhouette(mesh, camera, R[None], t[None])[0]
                for folder, kind, plane in (
                    ("colour", "combined", np.full((60, 80, 3), 8 * row + frame, np.uint8)),
                    ("silhouette", "silhouette", np.round(mask * 255).astype(np.uint8)),
                    ("normal", "normal_map", np.zeros((60, 80, 3), np.uint8)),
                ):
                    images = root / "M2ED" / "exocentric" / folder / building
                    images.mkdir(parents=True, exist_ok=True)
                    file = f"{row}_{DATE}_{frame}_{kind}_exocentric_0000.png"
                    cv2.imwrite(str(images / file), plane)
            cells += [*T_cam, *xyzw(R_cam)]
            lines.append("\t".join(["0", *(f"{x:.12g}" for x in cells)]))
        (flight / "airsim_rec_blender.txt").write_text("\n".join(lines) + "\n")
    return known


@pytest.fixture
def uava(tmp_path):
    return tmp_path, write(tmp_path)


def test_poses_are_those_of_the_paper_in_opencv_axes(uava):
    root, known = uava
    data = UavaDataset(root, "train")
    assert sorted(data.names) == sorted(known)
    for k, name in enumerate(data.names):
        raw, (R, t) = data.load(k), known[name]
        np.testing.assert_allclose(raw.R, R, atol=1e-9)
        np.testing.assert_allclose(raw.t, t, atol=1e-9)
        row, frame = int(name.split("_")[1]), int(name[-1])
        assert (raw.image == 8 * row + frame).all()


def test_poses_need_no_images(uava):
    root, known = uava
    data = UavaDataset(root, "train")
    for image in root.glob("M2ED/exocentric/*/*/*"):
        image.unlink()
    with pytest.raises(FileNotFoundError, match="expected an image"):
        data.load(0)
    for k, name in enumerate(data.names):
        for ours, expected in zip(data.pose(k), known[name], strict=True):
            np.testing.assert_allclose(ours, expected, atol=1e-9)


def test_the_mesh_lands_on_the_mask(uava):
    root, _ = uava
    data, mesh = UavaDataset(root, "test"), Mesh.from_file(EXAMPLE_MESH)
    sample = data[3]
    camera = Camera.from_K(sample["K"].numpy(), 80, 60)
    drawn = render.silhouette(mesh, camera, sample["R"][None].numpy(), sample["t"][None].numpy())[0]
    assert np.abs(drawn - sample["mask"].numpy()).max() < 0.01
    assert drawn.sum() > 50


def test_axes_as_they_are(uava):
    root, known = uava
    plain = UavaDataset(root, "train", frames=(0,))
    name = plain.names[0]
    with pytest.raises(DataError, match=r"behind the camera"):
        UavaDataset(root, "train", axes="opencv")  # Blender's camera looks down -z
    np.testing.assert_allclose(plain.load(0).t, known[name][1], atol=1e-9)


def test_frames_and_pairs(uava):
    root, _ = uava
    both = UavaDataset(root, "train")
    pairs = both.pairs()
    assert len(pairs) == 6
    for first, second in pairs:
        assert both.names[first][:-1] == both.names[second][:-1]
        assert (both.names[first][-1], both.names[second][-1]) == ("0", "1")
    one = UavaDataset(root, "train", frames=(1,))
    assert len(one) == 6
    assert one.pairs() == []


def test_names_with_a_modality_of_two_words(uava):
    root, known = uava
    data = UavaDataset(root, "train", image="normal", mask=None)
    assert len(data) == len(known)
    assert data[0]["mask"].shape == (0, 0)


def test_through_the_data_module(uava):
    root, known = uava
    data = PoseDataModule(str(root), kind="uava", batch_size=5, options={"frames": (0,)})
    names = [name for batch in data.test_dataloader() for name in batch["name"]]
    assert sorted(names) == sorted(name for name in known if name.endswith("_0"))


@pytest.mark.parametrize("size", [{}, {"height": 30, "width": 50}])
def test_training_knows_the_camera(uava, size):
    root, _ = uava
    data = PoseDataModule(str(root), kind="uava", **size)
    sample = data.training_set()[0]
    camera = camera_of(data)
    assert (3, camera.height, camera.width) == sample["image"].shape
    np.testing.assert_allclose(camera.K, sample["K"], rtol=1e-6)


def test_errors_name_file_line_and_sample(uava):
    root, _ = uava
    file = root / "trajectories" / "bbb" / DATE / "airsim_rec_blender.txt"
    good = file.read_text()
    lines = good.splitlines()

    def refused(text, message):
        file.write_text(text)
        with pytest.raises(DataError, match=message):
            UavaDataset(root, "train")
        file.write_text(good)

    refused(good.replace("Pilot(y)", "Pilot[y]"), r"blender\.txt:1: the header has no Pilot\(y\) ")
    refused(good.replace("\t", ","), r"blender\.txt:1: the header has no Position\(x\)_t1, ")
    refused("\n".join(lines[:3]), r"sample 'bbb_2_.*_0' needs row 2, the file has 2 rows")
    cells = lines[2].split("\t")
    for place, value, message in (
        (1, "nan", r"column Position\(x\)_t1: found 'nan', expected a finite number"),
        (4, "5", r"column Orientation\(x\)_t1: a quaternion of norm"),
    ):
        changed = "\t".join([*cells[:place], value, *cells[place + 1 :]])
        text = "\n".join([*lines[:2], changed, *lines[3:]])
        refused(text, rf"blender\.txt:3: sample 'bbb_1_{DATE}_0': {message}")
    refused(
        "\n".join([*lines[:2], "0\t1", *lines[3:]]), r":3: .*: column Position\(y\)_t1: found ''"
    )


def test_files_that_are_no_text_are_named(uava):
    root, _ = uava
    scenes = root / "data splits" / "scenes_train.txt"
    flight = next((root / "trajectories").rglob("*blender*"))
    for file in (scenes, flight):
        good = file.read_bytes()
        file.write_bytes(b"\xff" + good)
        with pytest.raises(DataError, match=rf"{file.name}: not UTF-8 at byte 0, expected the"):
            UavaDataset(root, "train")
        file.write_bytes(good)


def test_missing_files_are_named(uava):
    root, _ = uava
    lists = root / "data splits" / "scenes_train.txt"
    lists.write_text("aaa\nccc\n")
    with pytest.raises(FileNotFoundError, match=r"scenes_train\.txt:2: building ccc has no folder"):
        UavaDataset(root, "train")
    with pytest.warns(UserWarning, match="building ccc has no folder"):
        assert len(UavaDataset(root, "train", allow_missing=True)) == 6
    lists.write_text("aaa\naaa\n")
    with pytest.raises(DataError, match=r"scenes_train\.txt:2: aaa again"):
        UavaDataset(root, "train")
    with pytest.raises(FileNotFoundError, match=r"scenes_trian\.txt: no such file"):
        UavaDataset(root, "trian")
    exocentric = root / "M2ED" / "exocentric"
    mask = next((exocentric / "silhouette" / "bbb").glob("1_*_1_*"))
    mask.unlink()
    with pytest.raises(FileNotFoundError, match=rf"no mask of sample 'bbb_1_{DATE}_1'"):
        UavaDataset(root, "val")
    image = next((exocentric / "colour" / "aaa").glob("0_*_0_*"))
    image.write_bytes(image.read_bytes()[:-20])
    data = UavaDataset(root, "val", mask=None)
    index = data.names.index(f"aaa_0_{DATE}_0")
    with pytest.raises(DataError, match=rf"{image.name}: sample 'aaa_0_{DATE}_0': .* cut off"):
        data[index]
    (exocentric / "colour" / "aaa" / "notes.txt").write_text("x")
    with pytest.raises(DataError, match=r"notes\.txt: expected a name like ROW_DATE_FRAME"):
        UavaDataset(root, "val")
    (exocentric / "colour" / "aaa" / "notes.txt").unlink()
    (root / "trajectories" / "aaa" / DATE / "airsim_rec_blender.txt").unlink()
    with pytest.raises(FileNotFoundError, match="expected one file with 'blender' in its name"):
        UavaDataset(root, "val", mask=None)


def test_what_is_out_of_range_is_named(uava):
    root, _ = uava
    for options, message in (
        ({"frames": (2,)}, "frames: expected some of 0 and 1"),
        ({"axes": "opengl"}, "axes: expected"),
        ({"horizontal_deg": 200.0}, "horizontal_deg: "),
    ):
        with pytest.raises(ValueError, match=message):
            UavaDataset(root, "train", **options)


@pytest.mark.skipif(not SPLITS.is_dir(), reason=f"{SPLITS} is not there")
def test_the_lists_of_scenes_of_the_data_folder(tmp_path):
    from dronepose.data.uava import buildings

    found = {s: buildings(SPLITS / f"scenes_{s}.txt") for s in ("train", "val", "test")}
    assert {split: len(names) for split, names in found.items()} == {
        "train": 61,
        "val": 11,
        "test": 18,
    }
    write(tmp_path, buildings=("2azQ1b91cZZ", "8194nk5LbLH"), rows=1)
    with pytest.warns(UserWarning, match="has no folder"):
        data = UavaDataset(tmp_path, "val", splits=SPLITS, allow_missing=True)
    assert len(data) == 4


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"{SHARED} is not there")
def test_a_real_flight_seen_from_a_real_anchor(tmp_path):
    """A flight of the data folder, written as UAVA's, comes back as the relative pose."""
    import json

    files = sorted(SHARED.glob("data/**/V1_02_medium.csv"))
    anchors = sorted(SHARED.glob("data/anchors/matterport3d/connectivity/*_connectivity.json"))
    if not files or not anchors:
        pytest.skip("the flights or anchors of the data folder are not there")
    with files[0].open(newline="", encoding="utf-8") as file:
        rows = [[float(x) for x in row[1:8]] for row in csv.reader(file) if row[0][0].isdecimal()]
    rows = np.array(rows[5000:15000:500])
    positions, wxyz = rows[:, :3], rows[:, 3:7]
    pose = np.array(json.loads(anchors[0].read_text())[0]["pose"]).reshape(4, 4)
    write(tmp_path, buildings=("aaa",), rows=len(rows))
    flight = tmp_path / "trajectories" / "aaa" / DATE / "airsim_rec_blender.txt"
    lines = ["\t".join(columns())]
    R_cam = pose[:3, :3] @ BLENDER  # the anchors are OpenCV cameras, world from camera
    centre = positions.mean(axis=0) - 6 * pose[:3, 2]
    for p, q in zip(positions, wxyz, strict=True):
        drone = [*p, *q[1:], q[0]]
        cells = [*drone, *drone, *centre, *xyzw(R_cam)]
        lines.append("\t".join(f"{x:.12g}" for x in cells))
    flight.write_text("\n".join(lines) + "\n")
    data = UavaDataset(tmp_path, "train", frames=(0,))
    assert len(data) == len(rows)
    world_from_cam = pose[:3, :3]
    for k in range(len(rows)):
        raw = data.load(k)
        row = int(data.names[k].split("_")[1])
        np.testing.assert_allclose(world_from_cam @ raw.t + centre, positions[row], atol=1e-4)
        R = matrix_from_quat_xyzw(np.roll(wxyz[row], -1))
        np.testing.assert_allclose(world_from_cam @ raw.R, R, atol=1e-4)
