"""The doctor: healthy on a good data set, and each check fails on what is broken in its way."""

import json
import shutil

import numpy as np
import pytest

from support import run

cv2 = pytest.importorskip("cv2")

from dronepose.camera import Camera  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.mesh import Mesh  # noqa: E402
from dronepose.synth import _measures as measures  # noqa: E402
from dronepose.synth._findings import CHECKS, Finding  # noqa: E402
from dronepose.synth.doctor import check_dataset  # noqa: E402
from dronepose.synth.encode import decode_depth, encode_depth, png, read_png  # noqa: E402
from synth_set import kept_rows, write_tiny  # noqa: E402


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return write_tiny(
        tmp_path_factory.mktemp("good"), scenes=(("hall", "train"), ("other", "val"))
    )[0]


@pytest.fixture
def root(good, tmp_path):
    shutil.copytree(good, tmp_path / "data")
    return tmp_path / "data"


def images(root, modality, view="exocentric", building="hall"):
    found = sorted((root / "drone" / view / modality / building).iterdir())
    assert found
    return found


def change(root, modality, function, view="exocentric"):
    for path in images(root, modality, view):
        image = read_png(path.read_bytes())
        path.write_bytes(png(np.asarray(function(image.copy()), image.dtype)))


def edit(path, function):
    content = json.loads(path.read_text())
    function(content)
    path.write_text(json.dumps(content))


def rewrite(path, function):
    """The rows of a flight's file, as numbers, changed."""
    head, *lines = path.read_text().splitlines()
    table = np.array([[float(x) for x in line.split("\t")] for line in lines])
    table = function(table, head.split("\t"))
    lines = ["\t".join(repr(float(x)) for x in row) for row in table]
    path.write_text("\n".join([head, *lines]) + "\n")


def failed(root, **options):
    return {f.check for f in check_dataset(root, **options).findings if f.ok is False}


def test_a_good_data_set_is_healthy_and_every_check_is_made(good):
    found = check_dataset(good)
    assert found.healthy, str(found)
    assert [finding.check for finding in found.findings] == list(CHECKS)
    for finding in found.findings:
        assert finding.ok is True, str(finding)
        assert finding.looked > 0
    assert found.kept == found.samples == 2 * len(kept_rows(good))
    assert found["silhouette"].measured < 0.005
    assert found["normals"].measured > 0.99
    assert found["flow"].measured > 0.99
    assert "without warping" in found["warp"].note
    assert "the example drone" in found["depth"].note


def test_manifest(root):
    edit(root / "dataset.json", lambda x: x.update(format="other"))
    assert failed(root) == {"manifest"}
    edit(root / "dataset.json", lambda x: x.update(format="dronepose-uava-1"))
    assert not failed(root)
    edit(root / "dataset.json", lambda x: x["encodings"].update(depth="PNG, 16 bits, millimetres"))
    assert failed(root) == {"manifest"}
    (root / "dataset.json").unlink()
    assert failed(root) == {"manifest"}


def test_a_list_that_lacks_a_scene_fails_the_manifest(root):
    (root / "data splits/scenes_train.txt").unlink()
    found = check_dataset(root)
    assert found["manifest"].ok is False
    assert "lacks hall" in found["manifest"].problems[0]
    edit(root / "scenes/hall.json", lambda x: x.update(complete=False))
    assert "not complete" in check_dataset(root)["manifest"].problems[0]


def test_records(root):
    row = kept_rows(root)[0]
    (root / f"records/hall/{row:06d}.json").unlink()
    found = check_dataset(root)
    assert found["records"].problems == [f"hall row {row}: has no record"]
    assert found["files"].measured == 22  # they have no record


def test_a_table_that_contradicts_the_records(root):
    table = root / "scenes/hall.csv"
    head, *lines = table.read_text().splitlines()
    place = head.split(",").index("kept")
    cells = lines[0].split(",")
    cells[place] = str(1 - int(cells[place]))
    table.write_text("\n".join([head, ",".join(cells), *lines[1:]]) + "\n")
    assert failed(root) == {"records"}


def test_files(root):
    gone = images(root, "matte")[0]
    gone.rename(gone.with_name(gone.name.replace("0_flight", "77_flight", 1)))
    found = check_dataset(root)
    assert found["files"].measured == 2
    assert "is missing" in found["files"].problems[0]
    assert "no kept record" in found["files"].problems[1]
    assert found["pairs"].ok is False
    hidden = images(root, "depth")[0]
    (hidden.parent / f".{hidden.stem}.12.part.png").write_bytes(b"")  # of a run that was killed
    assert check_dataset(root)["files"].measured == 2


def test_splits_that_leak(root):
    path = root / "data splits/scenes_val.txt"
    path.write_text(path.read_text() + "hall\n")
    found = check_dataset(root)
    assert {f.check for f in found.findings if f.ok is False} == {"splits"}
    assert found["splits"].problems == ["hall: in the lists of train and val"]
    path.write_text("unknown\nother\n")
    assert check_dataset(root)["splits"].problems == [
        "unknown: in the list of val, but was not rendered"
    ]


def test_pairs(root):
    row = kept_rows(root)[0]
    for path in (root / "drone").glob(f"*/*/hall/{row}_flight_1_*"):
        path.unlink()
    found = check_dataset(root)
    assert found["pairs"].measured == 11
    assert found["images"].ok is False


def test_a_time_that_is_a_copy_of_the_other(root):
    for path in list((root / "drone").glob("*/*/hall/*_flight_0_*")):
        shutil.copy(path, path.with_name(path.name.replace("_flight_0_", "_flight_1_")))
    found = check_dataset(root)
    assert "the images are the same" in found["pairs"].problems[0]
    assert {"pairs", "silhouette", "flow", "motion"} <= failed(root)


@pytest.mark.parametrize("how", ["cut", "size", "bits", "empty"])
def test_images(root, how):
    path = images(root, "depth", "egocentric")[0]
    content = path.read_bytes()
    image = read_png(content)
    path.write_bytes(
        {
            "cut": content[:-40],
            "size": png(image[:-1]),
            "bits": png((image // 256).astype(np.uint8)),
            "empty": b"",
        }[how]
    )
    found = check_dataset(root)
    assert {f.check for f in found.findings if f.ok is False} == {"images"}
    assert found["images"].measured == 1
    assert path.name in found["images"].problems[0]


def test_poses_that_are_not_orthonormal(root):
    path = root / "trajectories/hall/flight/poses_blender.txt"

    def longer(table, names):
        table[1, [names.index(f"PilotRot({a})") for a in "xyzw"]] *= 1.01
        return table

    rewrite(path, longer)
    found = check_dataset(root)
    assert {f.check for f in found.findings if f.ok is False} == {"poses"}
    assert found["poses"].measured == pytest.approx(0.01)
    assert "poses_blender.txt:3" in found["poses"].problems[0]
    rewrite(path, lambda table, _: table[:-1])
    found = check_dataset(root)
    assert "rows, the plan has" in found["poses"].problems[0]
    assert found["silhouette"].looked == 2 * len(kept_rows(root, "other"))
    assert "the poses of hall cannot be read" in str(found["silhouette"])
    path.write_text("nothing\n")
    assert "the header has no Position(x)_t1" in check_dataset(root)["poses"].problems[0]


def test_poses_out_of_sync_with_the_images(root):
    def shifted(table, _):
        return np.roll(table, 1, axis=0)

    rewrite(root / "trajectories/hall/flight/poses_blender.txt", shifted)
    assert {"sync", "silhouette", "motion"} <= failed(root)


def test_the_two_times_exchanged(root):
    def exchanged(table, names):
        for name in names:
            if name.endswith("_t1"):
                k, other = names.index(name), names.index(name[:-1] + "2")
                table[:, [k, other]] = table[:, [other, k]]
        return table

    rewrite(root / "trajectories/hall/flight/poses_blender.txt", exchanged)
    assert {"silhouette", "motion"} <= failed(root)


def test_depth_of_another_unit(root):
    change(root, "depth", lambda image: image // 2)  # steps of a millimetre
    found = check_dataset(root)
    assert found["depth"].measured == pytest.approx(0.5, abs=0.01)
    assert "which unit" in found["depth"].problems[0]
    assert "motion" in failed(root)
    assert "normals" not in failed(root)  # they do not depend on the scale


def test_poses_of_another_unit(root):
    def millimetres(table, names):
        places = [k for k, name in enumerate(names) if name.startswith(("Position", "Pilot("))]
        table[:, places] *= 1000
        return table

    rewrite(root / "trajectories/hall/flight/poses_blender.txt", millimetres)
    found = check_dataset(root)
    assert found["depth"].measured == pytest.approx(0.001, rel=0.3)
    assert "times the distance of the pose" in found["depth"].problems[0]
    for path in (root / "scenes").glob("*.json"):
        edit(path, lambda x: x["inputs"].update(drone={"file": "DJI.obj"}))
    assert "depth" in failed(root)  # without a mesh too


def test_a_camera_of_another_focal_length(root):
    edit(root / "scenes/hall.json", lambda x: x["cameras"]["exocentric"].update(fx=100.0))
    assert {"silhouette", "motion", "normals"} <= failed(root)


def test_files_that_cannot_be_understood(root):
    for content in ("[]", "{}", "{"):
        (root / "dataset.json").write_text(content)
        assert failed(root) == {"manifest"}
    (root / "trajectories/hall/flight/poses_blender.txt").unlink()
    assert "poses_blender.txt: is missing" in check_dataset(root)["poses"].problems[0]
    edit(root / "scenes/hall.json", lambda x: x.update(rows="5"))
    with pytest.raises(ValueError, match="rows: expected a whole number"):
        check_dataset(root)
    edit(root / "scenes/hall.json", lambda x: x.update(rows=4))
    (root / "scenes/hall.csv").write_bytes(b"\xff")
    with pytest.raises(ValueError, match=r"hall\.csv: not UTF-8 at byte 0"):
        check_dataset(root)


def test_depth_out_of_range(root):
    change(root, "depth", lambda image: image // 60, "egocentric")
    assert "range" in failed(root)


def test_normals_of_other_axes(root):
    def flipped(image):
        image[..., 1] = np.where(image.any(axis=-1), 65_535 - image[..., 1], 0)
        return image

    change(root, "normal_map", flipped, "egocentric")
    assert failed(root) == {"normals"}


def test_a_silhouette_of_another_place(root):
    change(root, "silhouette", lambda image: np.roll(image, 1, axis=1))
    assert {"silhouette"} <= failed(root) <= {"silhouette", "matte"}
    change(root, "silhouette", lambda image: np.roll(image, 20, axis=1))
    assert {"silhouette", "sync", "matte"} <= failed(root)


def test_a_matte_that_is_more_than_the_silhouette(root):
    change(root, "matte", lambda image: cv2.dilate(image, np.ones((3, 3))))
    assert {"matte"} <= failed(root) <= {"matte", "instance"}


def test_an_instance_that_the_matte_contradicts(root):
    change(root, "instance", lambda image: np.where(image == 2, 1, image))
    assert failed(root) == {"instance"}


@pytest.mark.parametrize("view", ["exocentric", "egocentric"])
def test_flow_of_the_wrong_sign(root, view):
    def negative(image):
        known = image[..., 2:] > 0
        image[..., :2] = np.where(known, np.clip(65_536 - image[..., :2].astype(int), 0, 65_535), 0)
        return image

    change(root, "flow", negative, view)
    # Forward and backward agree, as both are wrong.
    assert failed(root) >= ({"warp", "motion"} if view == "exocentric" else {"warp"})


def test_flow_of_one_way_only(root):
    def still(image):
        image[..., :2] = 32_768
        return image

    for path in images(root, "flow", "egocentric"):
        if "_flight_1_" in path.name:
            path.write_bytes(png(still(read_png(path.read_bytes()).copy())))
    assert "flow" in failed(root)


def test_colours_of_another_moment(root):
    def turned(image):
        return image[::-1, ::-1]

    change(root, "colour", turned)
    assert failed(root) == {"warp"}


def test_another_mesh_is_told(root, tmp_path):
    mesh = Mesh.from_file(EXAMPLE_MESH)
    path = tmp_path / "bigger.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices * 1.2]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in mesh.faces]
    path.write_text("\n".join(lines))
    found = check_dataset(root, mesh=str(path))
    assert found["silhouette"].ok is False
    assert "NOT the file" in found["silhouette"].note
    same = check_dataset(root, mesh=str(EXAMPLE_MESH))
    assert same.healthy


def test_without_a_mesh_it_says_what_it_cannot_check(root):
    for path in (root / "scenes").glob("*.json"):
        edit(path, lambda x: x["inputs"].update(drone={"file": "DJI.obj", "sha256": "0"}))
    found = check_dataset(root)
    assert found.healthy
    for check in ("silhouette", "depth"):
        assert found[check].ok is None
        assert "needs --mesh FILE (DJI.obj was rendered)" in str(found[check])
    assert found["sync"].ok is True
    assert "2 of 17 checks not made" in str(found)


def test_without_a_modality_the_others_are_checked(root):
    shutil.rmtree(root / "drone/exocentric/flow")
    shutil.rmtree(root / "drone/egocentric/flow")
    found = check_dataset(root)
    assert {f.check for f in found.findings if f.ok is False} == {"files", "images"}
    for check in ("flow", "warp", "motion"):
        assert found[check].ok is None
        assert "not checked: no sample with " in str(found[check])
    assert found["normals"].ok is True


def test_limit_and_progress(good):
    ticks = []
    found = check_dataset(good, limit=1, progress=lambda *x: ticks.append(x))
    assert (found.samples, found.kept) == (1, 2 * len(kept_rows(good)))
    assert ticks == [(1, 1)]
    with pytest.raises(ValueError, match="limit"):
        check_dataset(good, limit=0)


def test_the_command(root, tmp_path):
    done = run("synth", "doctor", root, name="dronepose")
    assert done.returncode == 0, done.stderr
    assert "healthy" in done.stdout
    (root / "dataset.json").unlink()
    done = run("synth", "doctor", root, "--json", "--limit", 1, name="dronepose")
    assert done.returncode == 1
    facts = json.loads(done.stdout)
    assert not facts["healthy"]
    assert [c["check"] for c in facts["checks"] if c["ok"] is False] == ["manifest"]
    for wrong, code, message in (
        ([tmp_path / "none"], 1, "holds no rendered data set"),
        ([root, "--mesh", tmp_path / "none.obj"], 1, "none.obj: there is no such mesh"),
        ([root, "--limit", 0], 2, "at least 1"),
        ([], 2, "DATA"),
    ):
        done = run("synth", "doctor", *wrong, name="dronepose")
        assert (done.returncode, message in done.stderr) == (code, True), done.stderr
    (root / "scenes/hall.json").write_text("{")
    done = run("synth", "doctor", root, name="dronepose")
    assert done.returncode == 1
    assert "hall.json: no JSON" in done.stderr


def test_normals_of_a_plane_are_found_and_edges_left_out():
    camera = Camera.from_fov(64, 48, horizontal_deg=64.69)
    rays = measures._rays(camera)
    normal = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    depth = np.full((48, 64), 3.0)
    depth[:, :32] = (-2 / (rays @ normal))[:, :32]
    held = decode_depth(encode_depth(depth.astype(np.float32)))
    found, flat = measures.normals_from_depth(camera, held)
    assert flat[2:-2, 2:30].all()
    assert flat[2:-2, 34:-2].all()
    assert not flat[:, 31:33].any()
    assert not flat[:2].any()
    assert np.degrees(np.arccos((found @ normal)[flat & (np.arange(64) < 32)].min())) < 0.5
    np.testing.assert_allclose(found[flat & (np.arange(64) > 33)][:, 2], -1, atol=1e-5)


def test_a_finding_keeps_the_worst_value():
    finding = Finding("depth")
    for value in (1.001, 0.99, 1.005):
        finding.add(value, "a")
    assert (finding.measured, finding.ok, finding.looked) == (0.99, True, 3)
    finding.add(1.5, "b")
    assert (finding.measured, finding.ok) == (1.5, False)
    finding = Finding("matte")
    finding.add(0.01, "a")
    finding.add(0.0, "b")
    assert finding.measured == 0.01
    assert "not checked: nothing to look at" in str(Finding("files"))


def test_one_image_in_a_hundred_may_be_warped_badly():
    for looked, ok in ((99, False), (100, True)):
        finding = Finding("warp")
        finding.add(0.9, "hall row 0")
        for k in range(1, looked):
            finding.add(0.1, f"hall row {k}")
        assert finding.ok is ok
        assert finding.measured == 0.9
        assert ("1 beyond" in str(finding)) is ok
        assert ("hall row 0" in str(finding)) is not ok
    strict = Finding("flow")
    for k in range(200):
        strict.add(0.5 if k == 7 else 1.0, f"hall row {k}")
    assert strict.ok is False
