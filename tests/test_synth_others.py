"""Several drones in one picture: where they fly, what hides what, and what is said of them."""

import json
import shutil

import numpy as np
import pytest

from support import run

cv2 = pytest.importorskip("cv2")
pytest.importorskip("trimesh")

from dronepose.camera import Camera  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.mesh import Mesh, obj_text  # noqa: E402
from dronepose.render import gbuffer  # noqa: E402
from dronepose.synth import make_plan, read_anchors, read_flight, write_example  # noqa: E402
from dronepose.synth.asset import Asset  # noqa: E402
from dronepose.synth.dataset import SynthError  # noqa: E402
from dronepose.synth.doctor import check_dataset  # noqa: E402
from dronepose.synth.encode import DRONE_ID, decode_depth, read_png  # noqa: E402
from dronepose.synth.export import export_bop  # noqa: E402
from dronepose.synth.inputs import cameras_of, read_more_drones  # noqa: E402
from dronepose.synth.others import choose_others, other_rows  # noqa: E402
from dronepose.synth.plan import PlanTable  # noqa: E402
from dronepose.synth.reading import drone_meshes, read_scenes  # noqa: E402
from dronepose.synth.sample import RenderSettings  # noqa: E402
from dronepose.synth.shards import export_webdataset  # noqa: E402
from dronepose.synth.studio import DRONE, SCENE, Studio  # noqa: E402
from synth_set import kept_rows, write_tiny  # noqa: E402

ROWS, APART = 12, 0.5


@pytest.fixture(scope="module")
def crate(tmp_path_factory):
    """A mesh of another shape, in centimetres, x left, y up, z forward."""
    path = tmp_path_factory.mktemp("mesh") / "crate.obj"
    corners = [[x, y, z] for x in (-14, 14) for y in (-3, 7) for z in (-9, 20)]
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    path.write_text(obj_text(corners, faces, "centimetres"))
    return path


@pytest.fixture(scope="module")
def more(crate):
    return {"names": ["example", str(crate)], "axes": ["flu", "luf"], "metres_per_unit": [1, 0.01]}


@pytest.fixture(scope="module")
def made(tmp_path_factory, more):
    return write_tiny(tmp_path_factory.mktemp("made"), rows=ROWS, more=more, apart_m=APART)


def records(root):
    return [json.loads(path.read_text()) for path in sorted((root / "records/hall").iterdir())]


def picture(root, row, step, modality, view="exocentric"):
    name = f"{row}_flight_{step}_{modality}_{view}_0.png"
    return read_png((root / "drone" / view / modality / "hall" / name).read_bytes())


def files(root):
    paths = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(path.relative_to(root)): path.read_bytes() for path in paths}


# ------------------------------------------------------------------------------ where


def fitting(poses, camera, meshes, row, rows, k, apart):
    """The rows that may be drone ``k``, one after the other."""
    middle = [mesh.bounds.mean(axis=0) for mesh in meshes]

    def at(drone, source, name):
        R, t = poses[name]
        return R[source] @ middle[drone] + t[source]

    placed = [(0, row), *((j, r) for j, r in enumerate(rows[: k - 1], 1) if r is not None)]
    R, t = (x[row] for x in poses["exo"])
    found = []
    for source in range(len(poses["exo"][1])):
        good = source not in [r for _, r in placed]
        for name in ("drone", "drone_next"):
            p = at(k, source, name)
            x, y, z = camera.K @ (R @ p + t)
            good &= z > 0.001 + np.linalg.norm(np.ptp(meshes[k].bounds, axis=0)) / 2
            good &= 0 <= x / z < camera.width and 0 <= y / z < camera.height
            good &= all(np.linalg.norm(p - at(j, r, name)) >= apart for j, r in placed)
        if good:
            found.append(source)
    return found


@pytest.mark.parametrize("apart", [0.5, 1.5])
def test_others_are_drawn_from_the_rows_that_fit(tmp_path, more, apart):
    paths = write_example(tmp_path)
    plan = make_plan(read_flight(paths["flight"]), read_anchors(paths["anchors"]))
    table = plan.table()
    poses = {name: table.pose(name) for name in ("exo", "drone", "drone_next")}
    camera = cameras_of(table)[0]
    meshes = [Mesh.from_file(EXAMPLE_MESH), *(drone.mesh for drone in read_more_drones(**more)[0])]

    meshes[2] = Mesh(8 * meshes[2].vertices, meshes[2].faces)  # too large to be near
    sizes, near = [], 0
    for row in range(0, len(table), 100):
        for seed in (0, 7):
            draw = choose_others(table, row, camera, meshes, seed=seed, apart_m=apart)
            for k in (1, 2):
                fit = fitting(poses, camera, meshes, row, draw, k, apart)
                place = np.random.default_rng([seed, row, k]).integers(len(fit)) if fit else 0
                assert draw[k - 1] == (fit[place] if fit else None)
                sizes.append(len(fit))
        near += len(fitting(poses, camera, meshes, row, [], 1, 0)) - sizes[-2]
    assert near > 50  # some are too near
    assert max(sizes) > 50
    few = PlanTable(
        table.ids[:2], table.anchors[:2], {n: c[:2] for n, c in table.columns.items()}, {}
    )
    assert choose_others(few, 0, camera, meshes[:1] * 3, apart_m=0) == [1, None]
    assert choose_others(table, 0, camera, meshes, apart_m=1e3) == [None, None]
    assert choose_others(table, 0, camera, meshes[:1]) == []
    with pytest.raises(ValueError, match="apart_m"):
        RenderSettings(apart_m=-1)


def test_records_say_where_the_others_are_from(made):
    root, _ = made
    counts = set()
    for record in records(root):
        rows = other_rows(record)
        assert len(rows) == 2
        assert record["others"] == sum(row is not None for row in rows)
        counts.add(record["others"])
        for k, row in enumerate(rows, 1):
            if record["kept"]:
                pixels = [
                    int((picture(root, record["row"], step, "instance") == DRONE_ID + k).sum())
                    for step in (0, 1)
                ]
                assert record[f"other_{k}_px"] == min(pixels)
                assert row is not None or not any(pixels)
    assert len(counts) > 1
    assert max(counts) == 2
    head = (root / "scenes/hall.csv").read_text().splitlines()[0]
    assert head.endswith("others,other_1,other_1_px,other_2,other_2_px")
    with pytest.raises(ValueError, match="other_1: expected a row of the plan"):
        other_rows({"other_1": -1})
    facts = json.loads((root / "dataset.json").read_text())
    assert (facts["drones"], facts["settings"]["apart_m"]) == (3, APART)


# ------------------------------------------------------------------------------- what


CAMERA = Camera.from_fov(96, 72, horizontal_deg=64.69)
VIEW = (np.eye(3), np.zeros(3))


@pytest.fixture(scope="module")
def studio():
    wall = Mesh([[-9, -9, 4], [9, -9, 4], [0, 18, 4]], [[0, 1, 2]])
    plate = [Mesh([[-s, -s, 0], [s, -s, 0], [s, s, 0], [-s, s, 0]], [[0, 1, 2], [0, 2, 3]])
             for s in (0.3, 0.2)]  # fmt: skip
    return Studio(Asset.plain(wall), [Asset.plain(mesh, (0.8, 0.1, 0.1)) for mesh in plate])


def place(x, z):
    return np.eye(3), np.array([x, 0.0, z])


def test_a_drone_hides_another(studio):
    alone = studio.frame(CAMERA, VIEW, [place(0, 2), None])
    assert alone.seen == pytest.approx(1, abs=0.02)
    front = studio.frame(CAMERA, VIEW, [place(0, 2), place(0.1, 1)])
    behind = studio.frame(CAMERA, VIEW, [place(0, 2), place(0.1, 3)])
    for frame in (front, behind):
        np.testing.assert_array_equal(frame.silhouette, alone.silhouette)
    np.testing.assert_array_equal(behind.matte, alone.matte)
    assert front.seen < 0.5
    second = front.instance == DRONE + 1
    assert second.sum() > 100
    assert front.matte[second].mean() < 0.05
    assert front.matte[front.instance == DRONE].mean() > 0.9
    assert set(np.unique(behind.instance)) <= {SCENE, DRONE, DRONE + 1}
    hidden = studio.frame(CAMERA, VIEW, [place(0, 2), place(0, 1)])
    assert hidden.seen < 0.05


def test_a_drone_that_is_not_there_keeps_the_numbers_of_the_others(studio):
    frame = studio.frame(CAMERA, VIEW, [None, place(0, 1)])
    assert set(np.unique(frame.instance)) == {SCENE, DRONE + 1}
    assert frame.seen == frame.silhouette.sum() == frame.matte.sum() == 0
    np.testing.assert_allclose(frame.depth[frame.instance == DRONE + 1], 1)
    first, second = ((VIEW, [None, place(x, 1)]) for x in (0, 0.02))
    flow = studio.flow(CAMERA, first, second).flow
    np.testing.assert_allclose(flow[36, 48], [0.02 * CAMERA.fx, 0], atol=1e-3)
    with pytest.raises(ValueError, match="the same drones"):
        studio.flow(CAMERA, first, (VIEW, [place(0, 1), None]))
    with pytest.raises(ValueError, match="expected 2, got 1"):
        studio.frame(CAMERA, VIEW, [None])


def test_images_hold_the_others_at_the_poses_of_their_rows(made, more):
    root, table = made
    camera = cameras_of(table)
    meshes = [drone.mesh for drone in read_more_drones(**more)[0]]
    near = 0
    for record in records(root):
        if not record["kept"]:
            continue
        row = record["row"]
        for step, name in enumerate(("drone", "drone_next")):
            for k, source in enumerate(other_rows(record), 1):
                if source is None:
                    continue
                turn, shift = (x[source] for x in table.pose(name))
                views = {"exocentric": "exo", "egocentric": ("ego", "ego_next")[step]}
                for (view, pose), cam in zip(views.items(), camera, strict=True):
                    R, t = (x[row] for x in table.pose(pose))
                    plane = gbuffer(
                        meshes[k - 1], cam, R @ turn, R @ shift + t, channels=("depth",)
                    ).depth
                    depth = decode_depth(picture(root, row, step, "depth", view))
                    on = plane > 0
                    if view == "exocentric":
                        on &= picture(root, row, step, "instance") == DRONE_ID + k
                    np.testing.assert_array_less(depth[on], plane[on] + 1e-3)
                    same = np.abs(depth[on] - plane[on]) < 1e-3
                    if view == "exocentric":
                        assert same.all()
                    else:
                        near += same.sum()
    assert near > 100  # pixels of the egocentric views


def test_a_picture_without_others_is_that_of_one_drone(tmp_path, more):
    one, several = tmp_path / "one", tmp_path / "several"
    one.mkdir(), several.mkdir()
    a, b = (files(write_tiny(folder, rows=3, **options)[0]) for folder, options in (
        (one, {}), (several, {"more": more, "apart_m": 1e3})
    ))  # fmt: skip
    assert a.keys() == b.keys()
    assert {name for name in a if name.endswith(".png") and a[name] != b[name]} == set()
    assert "others" not in a["scenes/hall.csv"].decode()
    assert "apart_m" not in a["dataset.json"].decode()


def test_the_bits_depend_on_neither_shards_nor_workers(made, more, tmp_path):
    from dronepose.synth.dataset import write_dataset
    from dronepose.synth.inputs import read_drone, read_panoramas, read_scene

    root, table = made
    drone, facts = read_drone("example")
    further, more_facts = read_more_drones(**more)
    studio = Studio(read_scene("example")[0], [drone, *further], samples=3)
    for shard in ((1, 2), (0, 2)):
        done = write_dataset(
            tmp_path, table, studio, cameras_of(table), building="hall",
            environments=read_panoramas(None)[0], workers=3, shard=shard,
            settings=RenderSettings(least_pixels=20, least_seen=0.4, apart_m=APART),
            inputs={"drone": facts, "more_drones": more_facts},
        )  # fmt: skip
    assert done["complete"]
    assert files(tmp_path) == files(root)
    alone = Studio(read_scene("example")[0], [drone], samples=3)
    with pytest.raises(SynthError, match="rendered with another"):
        write_dataset(tmp_path, table, alone, cameras_of(table), building="hall",
                      settings=RenderSettings(least_pixels=20, least_seen=0.4),
                      environments=read_panoramas(None)[0])  # fmt: skip


# ---------------------------------------------------------------------------- readers


def test_the_doctor_looks_at_all_drones(made, tmp_path):
    root, _ = made
    found = check_dataset(root)
    assert found.healthy, str(found)
    drones = sum(1 + record["others"] for record in records(root) if record["kept"])
    assert 2 * len(kept_rows(root)) < found["motion"].looked <= 2 * drones
    shutil.copytree(root, tmp_path / "data")
    for record in records(tmp_path / "data"):
        rows = other_rows(record)
        record |= {f"other_{k}": (row + 1) % ROWS for k, row in enumerate(rows, 1) if row}
        path = tmp_path / f"data/records/hall/{record['row']:06d}.json"
        path.write_text(json.dumps(record))
    found = check_dataset(tmp_path / "data")
    assert {f.check for f in found.findings if f.ok is False} == {"motion"}
    assert all(" drone " in problem for problem in found["motion"].problems)
    record["other_1"] = ROWS
    path.write_text(json.dumps(record))
    with pytest.raises(SynthError, match=r"000011\.json: names a row that the plan does not have"):
        check_dataset(tmp_path / "data")


def test_bop_has_every_drone_as_an_object(made, more, crate, tmp_path):
    root, table = made
    with pytest.raises(SynthError, match=r"mesh: needs --mesh FILE \(crate.obj was rendered\)"):
        export_bop(root, tmp_path / "no")
    with pytest.raises(SynthError, match="expected 3 files at most, got 4"):
        export_bop(root, tmp_path / "no", mesh=[str(crate)] * 4)
    out = tmp_path / "bop"
    export_bop(root, out, mesh=[str(EXAMPLE_MESH), str(EXAMPLE_MESH), str(crate)])
    scene = out / "train/000001"
    truth, info, coco = (
        json.loads((scene / f"scene_{name}.json").read_text())
        for name in ("gt", "gt_info", "gt_coco")
    )
    assert [one["id"] for one in coco["categories"]] == [1, 2, 3]
    by_row = {record["row"]: record for record in records(root)}
    images = [(row, step) for row in kept_rows(root) for step in (0, 1)]
    assert len(truth) == len(images)
    annotated = 0
    for number, (row, step) in enumerate(images):
        sources = {1: row, **dict(enumerate(other_rows(by_row[row]), 2))}
        there = [k for k, source in sources.items() if source is not None]
        assert [one["obj_id"] for one in truth[str(number)]] == there
        instance = picture(root, row, step, "instance")
        R, t = (x[row] for x in table.pose("exo"))
        for place, (k, one) in enumerate(zip(there, truth[str(number)], strict=True)):
            turn, shift = (x[sources[k]] for x in table.pose(("drone", "drone_next")[step]))
            np.testing.assert_allclose(np.reshape(one["cam_R_m2c"], (3, 3)), R @ turn, atol=1e-9)
            np.testing.assert_allclose(one["cam_t_m2c"], 1e3 * (R @ shift + t), atol=1e-6)
            file = f"{number:06d}_{place:06d}.png"
            visible = read_png((scene / "mask_visib" / file).read_bytes()) > 0
            np.testing.assert_array_equal(visible, instance == 1 + k)
            full = read_png((scene / "mask" / file).read_bytes()) > 0
            assert (visible <= full).all()
            assert info[str(number)][place]["px_count_visib"] == visible.sum()
            annotated += visible.any()
    assert len(coco["annotations"]) == annotated
    assert {one["category_id"] for one in coco["annotations"]} == {1, 2, 3}
    drones, _ = read_more_drones(**more)
    held = Mesh.from_file(out / "models/obj_000003.ply", unit="mm")
    np.testing.assert_allclose(held.bounds, drones[1].mesh.bounds, atol=1e-9)
    np.testing.assert_allclose(held.bounds, [[-0.09, -0.14, -0.03], [0.2, 0.14, 0.07]], atol=1e-9)
    assert json.loads((out / "models/models_info.json").read_text()).keys() == {"1", "2", "3"}
    read = drone_meshes(read_scenes(root), [str(crate)])
    assert "NOT the file" in read[0][1]


def test_shards_have_the_poses_of_all_drones(made, tmp_path):
    import tarfile

    root, table = made
    export_webdataset(root, tmp_path / "out")
    by_row = {record["row"]: record for record in records(root)}
    looked = 0
    with tarfile.open(tmp_path / "out/train-000000.tar") as archive:
        for member in archive:
            if not member.name.endswith(".json"):
                continue
            facts = json.load(archive.extractfile(member))
            rows = other_rows(by_row[facts["row"]])
            numbers = [DRONE_ID + k for k, row in enumerate(rows, 1) if row is not None]
            assert [one["instance"] for one in facts["others"]] == numbers
            R, t = (x[facts["row"]] for x in table.pose("exo"))
            for one in facts["others"]:
                source = rows[one["instance"] - DRONE_ID - 1]
                _, shift = table.pose("drone_next" if facts["time"] else "drone")
                np.testing.assert_allclose(one["t"], R @ shift[source] + t, atol=1e-9)
                looked += 1
    assert looked > ROWS


def test_the_command_takes_more_drones(made, crate, tmp_path):
    plan = made[0].parent / "plan.csv"
    base = ["synth", "render", plan, "--out", tmp_path / "data", "--samples", 1]
    both = [*base, "--more-drones", "example", crate]
    for wrong, message in (
        (["--more-units", 1, 1, 1], "metres_per_unit: expected 2 values"),
        (["--more-axes", "flu", "fru"], "are mirrored against flu"),
        (["--more-axes", "fff"], "axes: expected which way x, y and z point"),
        (["--apart", -1], "apart_m: expected metres >= 0"),
    ):
        done = run(*both, *wrong, name="dronepose")
        assert (done.returncode, message in done.stderr) == (1, True), done.stderr
    done = run(*base, "--more-drones", tmp_path / "none.obj", name="dronepose")
    assert "none.obj" in done.stderr
    units = ["--more-units", 1, 0.01, "--more-axes", "flu", "luf", "--json"]
    done = run(*both, *units, "--apart", 0.5, name="dronepose")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (facts["drones"], facts["complete"]) == (3, True)
    said = facts["inputs"]["more_drones"]
    assert said[0] == {"file": "example"}
    assert said[1]["turned"] == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
