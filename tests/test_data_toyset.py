"""The toy data set: written, resumed, shared out, read back, scored."""

import hashlib
import json
import subprocess

import numpy as np
import pytest

from support import EXAMPLES, command, evaluate, run

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose import Mesh, render  # noqa: E402
from dronepose.data import DataError, ToySettings, render_toy_sample, write_toyset  # noqa: E402
from dronepose.data._poses import read_poses  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH, toy_pose  # noqa: E402

COUNTS = {"train": 5, "val": 2, "test": 1}
SMALL = {"height": 48, "width": 64, "seed": 7}


def content(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    root = tmp_path_factory.mktemp("toy") / "set"
    write_toyset(root, counts=COUNTS, **SMALL)
    return root


def test_the_shipped_mesh_is_that_of_the_examples():
    assert EXAMPLE_MESH.read_bytes() == (EXAMPLES / "quadrotor.obj").read_bytes()


def test_a_sample_does_not_depend_on_the_others(toy):
    image, mask, R, t = render_toy_sample(ToySettings(**SMALL), "train", 3)
    written = cv2.imread(str(toy / "train/images/000003.png"))[..., ::-1]
    np.testing.assert_array_equal(written, image)
    np.testing.assert_array_equal(cv2.imread(str(toy / "train/masks/000003.png"), 0), mask)
    row = read_poses(toy / "train/poses.csv")[3]
    np.testing.assert_allclose(row.R, R, atol=1e-10)
    np.testing.assert_allclose(row.t, t, atol=1e-10)
    other = render_toy_sample(ToySettings(**{**SMALL, "seed": 8}), "train", 3)
    assert not np.allclose(other[3], t)


def test_masks_are_the_exact_silhouettes_of_the_poses(toy):
    camera, mesh = ToySettings(**SMALL).camera, Mesh.from_file(toy / "mesh.obj")
    for row in read_poses(toy / "train/poses.csv"):
        exact = render.silhouette(mesh, camera, row.R[None], row.t[None])[0]
        mask = cv2.imread(str(toy / "train/masks" / row.further["image"]), 0)
        np.testing.assert_allclose(mask / 255, exact, atol=0.5 / 255 + 1e-6)
        assert exact.sum() > 2  # in view


def test_the_drone_is_seen_where_the_mask_is():
    """Two data sets of one seed and other poses differ where a drone is or was, not elsewhere."""
    settings = ToySettings(height=96, width=128, seed=1)
    image, mask, _, _ = render_toy_sample(settings, "train", 0)
    tiny = Mesh([[0, 0, 0], [1e-6, 0, 0], [0, 1e-6, 0]], [[0, 1, 2]])
    empty, _, _, _ = render_toy_sample(settings, "train", 0, tiny)
    change = np.abs(image.astype(int) - empty.astype(int)).max(axis=2)
    inside = cv2.erode(mask, np.ones((3, 3))) == 255
    outside = cv2.dilate(mask, np.ones((9, 9))) == 0
    assert inside.any()
    assert change[outside].max() <= 1
    assert change[inside].mean() > 20


def test_a_run_that_was_stopped_goes_on(toy, tmp_path):
    class Stopped(Exception):  # noqa: N818
        pass

    def stop(done, total):
        assert total == 8
        if done == 3:
            raise Stopped

    root = tmp_path / "set"
    with pytest.raises(Stopped):
        write_toyset(root, counts=COUNTS, progress=stop, **SMALL)
    assert json.loads((root / "dataset.json").read_text())["complete"] is False
    made = write_toyset(root, counts=COUNTS, **SMALL)
    assert made["written"] == 5
    assert made["complete"] is True
    assert content(root) == content(toy)
    assert write_toyset(root, counts=COUNTS, **SMALL)["written"] == 0


def test_shards_make_the_same_set(toy, tmp_path):
    root = tmp_path / "set"
    first = write_toyset(root, counts=COUNTS, shard=(1, 2), **SMALL)
    assert not first["complete"]
    second = write_toyset(root, counts=COUNTS, shard=(0, 2), **SMALL)
    assert second["complete"]
    assert first["written"] + second["written"] == 8
    assert content(root) == content(toy)


def test_shards_run_at_the_same_time(toy, tmp_path):
    root = tmp_path / "set"
    options = ["--train", "5", "--val", "2", "--test", "1", "--seed", "7", "--size", "48x64"]
    running = [
        subprocess.Popen(
            [*command("dronepose"), "toyset", str(root), *options, "--shard", f"{k}/3"]
        )
        for k in range(3)
    ]
    assert [process.wait(timeout=120) for process in running] == [0, 0, 0]
    assert content(root) == content(toy)


def test_other_settings_are_refused(toy, tmp_path):
    with pytest.raises(DataError, match=r"dataset\.json: holds a data set of other settings"):
        write_toyset(toy, counts=COUNTS, **{**SMALL, "seed": 8})
    with pytest.raises(DataError, match="other splits"):
        write_toyset(toy, counts={"train": 6}, **SMALL)
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(DataError, match="is not empty and holds no data set"):
        write_toyset(tmp_path, counts=COUNTS, **SMALL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"height": 3}, "height: expected 16 to 4096"),
        ({"seed": -1}, "seed: "),
        ({"distance": (2.0, 1.0)}, "distance: expected 0 < nearest <= farthest"),
        ({"max_tilt_deg": 200.0}, "max_tilt_deg: expected 0 to 180"),
        ({"horizontal_deg": 0.0}, "horizontal_deg: "),
        ({"distance": (0.1, 1.0)}, "distance: expected more than 0.2"),
        ({"up": "x"}, "up: expected 'y' or 'z'"),
        ({"counts": {"tran": 1}}, "counts: expected train, val, test, got 'tran'"),
        ({"counts": {"train": -1}}, "counts: expected 0 to"),
        ({"shard": (2, 2)}, "shard: "),
    ],
)
def test_what_is_out_of_range_is_named(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        write_toyset(tmp_path / "set", **options)
    assert not (tmp_path / "set").exists()


def test_poses_follow_the_stated_distribution():
    settings = ToySettings(max_tilt_deg=25, max_pitch_deg=0)
    camera = settings.camera
    yaws = []
    for k in range(400):
        R, t, up = toy_pose(settings, np.random.default_rng(k))
        assert 0.8 <= np.linalg.norm(t) <= 3.0
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) > 0
        assert np.degrees(np.arccos(min(1.0, R[:, 2] @ up))) <= 25 + 1e-9
        u, v = (camera.K @ (t / t[2]))[:2]
        assert 0.08 * 160 - 1e-9 <= u <= 0.92 * 160 + 1e-9
        assert 0.08 * 120 - 1e-9 <= v <= 0.92 * 120 + 1e-9
        yaws.append(np.arctan2(R[0, 0], R[2, 0]))
    counts, _ = np.histogram(yaws, bins=4, range=(-np.pi, np.pi))
    assert counts.min() > 70  # 100 each, standard deviation 9


def test_up_y_is_the_same_drone_with_other_axes():
    axes = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # left, up, forward of forward, left, up
    z, y = (toy_pose(ToySettings(up=up), np.random.default_rng(3))[0] for up in ("z", "y"))
    np.testing.assert_allclose(y @ axes, z, atol=1e-12)


def test_backgrounds_from_a_folder(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    ramp = np.linspace(10, 240, 90)[None, :, None] * np.ones((60, 1, 3))
    cv2.imwrite(str(photos / "a.png"), ramp.astype(np.uint8))
    cv2.imwrite(str(photos / "b.hdr"), np.full((64, 128, 3), 7.0, np.float32))
    settings = {**SMALL, "backgrounds": str(photos)}
    write_toyset(tmp_path / "set", counts={"train": 6}, **settings)
    kinds = set()
    for k in range(6):
        image = cv2.imread(str(tmp_path / f"set/train/images/{k:06d}.png")).astype(float)
        mask = cv2.imread(str(tmp_path / f"set/train/masks/{k:06d}.png"), 0)
        far = cv2.dilate(mask, np.ones((9, 9))) == 0
        kinds.add(bool(image[far].std() < 15))  # a flat panorama, or a ramp
    assert kinds == {True, False}
    cv2.imwrite(str(photos / "a.png"), np.zeros((60, 90, 3), np.uint8))
    with pytest.raises(DataError, match="holds a data set of other backgrounds"):
        write_toyset(tmp_path / "set", counts={"train": 6}, **settings)
    (tmp_path / "none").mkdir()
    with pytest.raises(DataError, match="no images, expected"):
        write_toyset(tmp_path / "x", counts={"train": 1}, backgrounds=str(tmp_path / "none"))
    with pytest.raises(FileNotFoundError, match="a folder of background images"):
        write_toyset(tmp_path / "y", counts={"train": 1}, backgrounds=str(tmp_path / "nowhere"))


def test_a_panorama_is_looked_into_through_the_camera(tmp_path):
    """Rows of a panorama are angles: seen levelly, its middle row is the horizon."""
    from dronepose.data.backgrounds import Photographs

    panorama = np.zeros((90, 180, 3), np.uint8)
    panorama[45:] = 255  # ground
    cv2.imwrite(str(tmp_path / "p.png"), panorama)
    seen = Photographs(tmp_path, 60.0)(40, 60, np.random.default_rng(0))
    assert seen[0].max() < 0.01
    assert seen[-1].min() > 0.5


def test_the_command(toy, tmp_path):
    root = tmp_path / "set"
    options = ["--train", 5, "--val", 2, "--test", 1, "--seed", 7, "--size", "48x64"]
    done = run("toyset", root, *options, "--json", name="dronepose")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["written"] == 8
    assert said["splits"] == COUNTS
    assert content(root) == content(toy)
    digest = hashlib.sha256((root / "mesh.obj").read_bytes()).hexdigest()
    assert said["mesh"]["sha256"] == digest
    again = run("toyset", root, *options, name="dronepose")
    assert "0 made" in again.stdout


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--size", "48"], 2, "expected HxW"),
        (["--shard", "1"], 2, "expected K/N"),
        (["--train", "-3"], 1, "counts: "),
        (["--mesh", "nothing.obj"], 1, "nothing.obj"),
        (["--distance", "3", "1"], 1, "distance: "),
    ],
)
def test_the_command_refuses(tmp_path, options, code, message):
    done = run("toyset", tmp_path / "set", *options, name="dronepose")
    assert done.returncode == code
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_the_help_of_the_command_has_an_example():
    done = run("toyset", "--help", name="dronepose")
    assert done.returncode == 0
    assert "dronepose toyset toy --train 2000" in done.stdout


def test_poses_are_ground_truth_for_the_evaluation(toy):
    poses = toy / "train/poses.csv"
    found = evaluate(
        poses, poses, "--mesh", toy / "mesh.obj", "--camera", toy / "camera.json", "--quiet"
    )
    assert found["metrics"]["acc"]["2"]["percent_of_gt"] == 100
