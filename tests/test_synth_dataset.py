"""A plan rendered to a data set: layout, resuming, what the loader reads, the commands."""

import json
import shutil

import numpy as np
import pytest

from support import run

cv2 = pytest.importorskip("cv2")
pytest.importorskip("torch")

from dronepose.camera import Camera  # noqa: E402
from dronepose.data import DataError, UavaDataset  # noqa: E402
from dronepose.mesh import Mesh  # noqa: E402
from dronepose.render import silhouette  # noqa: E402
from dronepose.synth import Rules, make_plan, read_anchors, read_flight, write_example  # noqa: E402
from dronepose.synth.asset import AssetError  # noqa: E402
from dronepose.synth.dataset import SynthError, write_dataset  # noqa: E402
from dronepose.synth.encode import decode_depth, read_png  # noqa: E402
from dronepose.synth.inputs import cameras_of, read_drone, read_panoramas, read_scene  # noqa: E402
from dronepose.synth.sample import RenderSettings, render_sample  # noqa: E402
from dronepose.synth.studio import Studio  # noqa: E402

ROWS = 5


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    paths = write_example(folder)
    rules = Rules(
        exo=Camera.from_fov(64, 48, horizontal_deg=64.69),
        ego=Camera.from_fov(64, 36, horizontal_deg=85.0),
    )
    made = make_plan(
        read_flight(paths["flight"]), read_anchors(paths["anchors"]), rules, scene="hall"
    )
    made.some(ROWS).write(folder / "plan.csv")
    return folder / "plan.csv"


@pytest.fixture(scope="module")
def table(plan):
    from dronepose.synth import read_plan

    return read_plan(plan)


@pytest.fixture(scope="module")
def studio():
    return Studio(read_scene("example")[0], [read_drone("example")[0]], samples=2)


def write(root, table, studio, **options):
    return write_dataset(
        root, table, studio, cameras_of(table), building="hall",
        environments=read_panoramas(None)[0], **options,
    )  # fmt: skip


def files(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def whole(table, studio, tmp_path_factory):
    root = tmp_path_factory.mktemp("whole")
    made = write(root, table, studio)
    assert made["complete"]
    assert made["written"] == ROWS
    assert made["kept"] > 0
    return root


def test_the_loader_reads_poses_images_and_masks(whole, table):
    data = UavaDataset(whole, "train")
    records = [json.loads(p.read_text()) for p in sorted((whole / "records/hall").iterdir())]
    kept = [record["row"] for record in records if record["kept"]]
    assert len(data) == 2 * len(kept)
    mesh = Mesh.from_file(read_drone_mesh())
    for k, (row, step) in enumerate((row, step) for row in kept for step in (0, 1)):
        R, t = table.pose("next" if step else "")
        raw = data.load(k)
        np.testing.assert_allclose(raw.R, R[row], atol=1e-6)
        np.testing.assert_allclose(raw.t, t[row], atol=1e-6)
        assert raw.image.shape == (48, 64, 3)
        camera = cameras_of(table)[0]
        drawn = silhouette(mesh, camera, raw.R[None], raw.t[None])[0]
        np.testing.assert_allclose(raw.mask / 255, drawn, atol=0.51 / 255)


def test_the_drone_has_to_be_said_where_there_are_several(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "set")
    (tmp_path / "set" / "other" / "exocentric").mkdir(parents=True)
    with pytest.raises(DataError, match="several drones, drone, other; say which"):
        UavaDataset(tmp_path / "set", "train")
    assert len(UavaDataset(tmp_path / "set", "train", drone="drone")) > 0


def read_drone_mesh():
    from dronepose.data.toyset import EXAMPLE_MESH

    return EXAMPLE_MESH


def test_every_modality_of_both_views_is_there(whole):
    names = {path.parent.parent.name for path in (whole / "drone").rglob("*.png")}
    assert names == {
        "colour", "depth", "normal_map", "flow", "silhouette", "matte", "instance",
    }  # fmt: skip
    depth = next((whole / "drone/egocentric/depth/hall").iterdir())
    metres = decode_depth(read_png(depth.read_bytes()))
    assert metres.shape == (36, 64)
    assert metres.min() > 0.05
    assert metres.max() < 14
    manifest = json.loads((whole / "dataset.json").read_text())
    assert manifest["complete"]
    assert manifest["encodings"]["depth"].startswith("PNG, 16 bits")
    assert manifest["plan"]["funnel"]
    lines = (whole / "scenes/hall.csv").read_text().splitlines()
    assert len(lines) == ROWS + 1


def test_a_stopped_run_ends_in_the_same_bits(whole, table, studio, tmp_path):
    class StoppedError(Exception):
        pass

    def stop(done, total):
        assert total == ROWS
        if done == 2:
            raise StoppedError

    root = tmp_path / "set"
    with pytest.raises(StoppedError):
        write(root, table, studio, progress=stop)
    assert not (root / "dataset.json").exists()
    (root / "records/hall/000001.json").unlink()  # killed just before it was done
    made = write(root, table, studio, workers=3)
    assert made["written"] == ROWS - 1
    assert files(root) == files(whole)
    assert write(root, table, studio)["written"] == 0


def test_shards_make_the_same_set(whole, table, studio, tmp_path):
    made = write(tmp_path, table, studio, shard=(1, 2))
    assert not made["complete"]
    made = write(tmp_path, table, studio, shard=(0, 2))
    assert made["complete"]
    assert files(tmp_path) == files(whole)


def test_other_settings_are_refused(whole, table, studio, tmp_path):
    root = tmp_path / "set"
    shutil.copytree(whole, root)
    with pytest.raises(SynthError, match="rendered with another settings"):
        write(root, table, studio, settings=RenderSettings(seed=1))
    with pytest.raises(SynthError, match="rendered with another split"):
        write(root, table, studio, split="val")
    for change, message in (
        ({"split": "all"}, "split"),
        ({"shard": (2, 2)}, "shard"),
        ({"date": "a_b"}, "date"),
        ({"drone": ""}, "drone"),
    ):
        with pytest.raises(SynthError, match=message):
            write(tmp_path / "other", table, studio, **change)


def test_rules_that_look_at_pictures_remove_samples(table, studio):
    cameras = cameras_of(table)
    for settings, rule in (
        (RenderSettings(least_seen=1.0, least_pixels=1e6), "hidden"),
        (RenderSettings(least_depth_m=50.0), "blocked"),
        (RenderSettings(), ""),
    ):
        sample = render_sample(studio, table, 0, cameras, {}, settings)
        assert sample.facts["removed_by"] == rule
        assert bool(sample.files) == (rule == "")
        assert 0.2 < sample.facts["depth_m"] < 20
    with pytest.raises(ValueError, match="strength"):
        RenderSettings(strength=(0.7, 0.3))
    with pytest.raises(ValueError, match="most_hole"):
        RenderSettings(most_hole=2)


def test_the_commands_render_and_show(plan, tmp_path):
    data = tmp_path / "data"
    arguments = ["synth", "render", plan, "--out", data, "--samples", 2]
    done = run(*arguments, "--json", name="dronepose")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"]
    again = run(*arguments, name="dronepose")
    assert "0 of 5 rows rendered now" in again.stdout
    done = run("synth", "sheet", data, "--out", tmp_path / "s.png", "--rows", 2, name="dronepose")
    assert done.returncode == 0, done.stderr
    sheet = cv2.imread(str(tmp_path / "s.png"))
    assert sheet.shape[1] == 9 * 160
    assert sheet.std() > 20
    for wrong, message in (
        (["--shard", "a"], "--shard: expected K/N"),
        (["--scene", tmp_path / "none.glb"], "none.glb: there is no such file"),
        (["--samples", 9], "--samples"),
        (["--panoramas", plan.parent], "expected panoramas"),
    ):
        done = run("synth", "render", plan, "--out", tmp_path / "x", *wrong, name="dronepose")
        assert done.returncode == 1
        assert message in done.stderr
    done = run("synth", "sheet", tmp_path, "--out", tmp_path / "t.png", name="dronepose")
    assert done.returncode == 1
    assert "holds no rendered data set" in done.stderr


def test_panoramas_are_checked(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 9, 3), np.uint8))
    with pytest.raises(AssetError, match="twice as wide"):
        read_panoramas(str(tmp_path))
    cv2.imwrite(str(tmp_path / "a.hdr"), np.full((4, 8, 3), 2.0, np.float32))
    (tmp_path / "a.png").unlink()
    environments, facts = read_panoramas(str(tmp_path))
    assert environments["a"].mean == pytest.approx((2.0, 2.0, 2.0), rel=0.01)
    assert len(facts["a"]) == 64
    (tmp_path / "b.hdr").write_bytes(b"#?RADIANCE\n")
    with pytest.raises(AssetError, match=r"b\.hdr: cannot be read"):
        read_panoramas(str(tmp_path))
