"""``dronepose render`` through the installed package: files, numbers, resuming, interrupts."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

from support import EXAMPLES, ROOT, command, run

cv2 = pytest.importorskip("cv2")

MESH, POSES = EXAMPLES / "quadrotor.obj", EXAMPLES / "gt.csv"
CAMERA = "126.35,126.35,80,60,160,120"
HEAVY = {"numpy", "torch", "scipy", "trimesh", "cv2"}


dronepose = partial(run, name="dronepose")


def render(out, *args):
    done = dronepose("render", MESH, POSES, "--camera", CAMERA, "--out", out, *args)
    assert done.returncode == 0, done.stderr
    return done


def refused(out, *args):
    done = dronepose("render", MESH, POSES, "--camera", CAMERA, "--out", out, *args)
    assert (done.returncode, done.stdout) == (1, ""), done
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    return done.stderr


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def picture(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return image


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Three poses with all layers in both formats."""
    out = tmp_path_factory.mktemp("render") / "drawn"
    layers = "silhouette,depth,normal,overlay,preview"
    render(out, "--save", layers, "--format", "png,npy", "--limit", 3, "--sigma", 0.7)
    return out


IDS = ["atrium-0000", "atrium-0001", "atrium-0002"]


def test_every_file_is_there_and_listed(drawn):
    both = [
        f"{d}/{i}.{e}"
        for d in ("silhouette", "depth", "normal")
        for i in IDS
        for e in ("png", "npy")
    ]
    wanted = both + [f"{d}/{i}.png" for d in ("overlay", "preview") for i in IDS]
    assert files(drawn) == sorted([*wanted, "manifest.json"])
    manifest = json.loads((drawn / "manifest.json").read_text())
    assert manifest["schema"] == "dronepose-render/1"
    assert manifest["complete"] is True
    assert sorted(f for frame in manifest["frames"] for f in frame["files"]) == sorted(wanted)
    assert [frame["id"] for frame in manifest["frames"]] == IDS
    assert manifest["settings"]["mode"] == {"name": "coverage", "sigma_px": 0.7}
    assert set(manifest["encoding"]) == {"silhouette", "depth", "normal", "overlay", "preview"}


@pytest.mark.parametrize("name", IDS)
def test_pictures_and_arrays_are_the_same_numbers(drawn, name):
    mask = np.load(drawn / "silhouette" / f"{name}.npy")
    assert (mask.dtype, mask.shape) == (np.float32, (120, 160))
    assert 0 <= mask.min() < 0.01
    assert 0.9 < mask.max() <= 1
    seen = picture(drawn / "silhouette" / f"{name}.png")
    assert (seen.dtype, seen.shape) == (np.uint8, mask.shape)
    np.testing.assert_allclose(seen / 255, mask, rtol=0, atol=1 / 255)

    depth = np.load(drawn / "depth" / f"{name}.npy")
    seen = picture(drawn / "depth" / f"{name}.png")
    assert (depth.dtype, seen.dtype) == (np.float32, np.uint16)
    np.testing.assert_allclose(seen / 1000, depth, rtol=0, atol=0.51e-3)
    np.testing.assert_array_equal(seen == 0, depth == 0)

    normal = np.load(drawn / "normal" / f"{name}.npy")
    assert normal.shape == (120, 160, 3)
    on = depth > 0
    np.testing.assert_allclose(np.linalg.norm(normal[on], axis=-1), 1, atol=1e-6)
    assert not normal[~on].any()
    seen = cv2.cvtColor(picture(drawn / "normal" / f"{name}.png"), cv2.COLOR_BGR2RGB)
    np.testing.assert_allclose(seen[on] / 255 * 2 - 1, normal[on], rtol=0, atol=1.01 / 255)
    assert not seen[~on].any()


def test_depth_lies_where_the_poses_say(drawn):
    rows = POSES.read_text().splitlines()
    header = rows[0].split(",")
    for name, row in zip(IDS, rows[1:], strict=False):
        z = float(row.split(",")[header.index("tz")])
        depth = np.load(drawn / "depth" / f"{name}.npy")
        assert abs(np.median(depth[depth > 0]) - z) < 0.3


def test_surfaces_and_silhouettes_agree(tmp_path):
    out = tmp_path / "out"
    render(out, "--save", "silhouette,depth", "--format", "npy", "--mode", "hard", "--limit", 5)
    for mask in (out / "silhouette").iterdir():
        np.testing.assert_array_equal(np.load(mask) > 0, np.load(out / "depth" / mask.name) > 0)


def test_a_second_run_draws_what_is_missing(tmp_path):
    out = tmp_path / "out"
    render(out, "--limit", 4)
    first = out / "silhouette" / "atrium-0000.png"
    before = first.stat().st_mtime_ns
    (out / "silhouette" / "atrium-0002.png").unlink()
    assert "1 of 6 poses drawn" not in render(out, "--limit", 6).stdout
    assert first.stat().st_mtime_ns == before
    assert len(files(out)) == 7
    assert "0 of 6 poses drawn, 6 were there: 0 files" in render(out, "--limit", 6).stdout
    assert "6 of 6 poses drawn: 6 files" in render(out, "--limit", 6, "--force").stdout
    assert first.stat().st_mtime_ns != before
    # Two poses are not fewer: the others stay listed.
    render(out, "--limit", 2)
    manifest = json.loads((out / "manifest.json").read_text())
    assert len(manifest["frames"]) == 6


def test_other_settings_do_not_mix(tmp_path):
    out = tmp_path / "out"
    render(out, "--limit", 3)
    assert "mode.sigma_px = 0.0, expected 2.0" in refused(out, "--limit", 3, "--sigma", 2)
    assert "--force" in refused(out, "--mesh-unit", "cm")
    render(out, "--limit", 1, "--sigma", 2, "--force")
    assert files(out) == ["manifest.json", "silhouette/atrium-0000.png"]


def test_files_of_others_are_not_written_over(tmp_path):
    out = tmp_path / "out"
    (out / "silhouette").mkdir(parents=True)
    mine = out / "silhouette" / "atrium-0001.png"
    mine.write_text("mine")
    assert "is there already" in refused(out, "--limit", 2)
    assert mine.read_text() == "mine"
    (out / "manifest.json").write_text('{"made": "by others"}')
    assert "manifest dronepose-render/1" in refused(out, "--limit", 2)
    render(out, "--limit", 2, "--force")
    assert picture(mine).shape == (120, 160)


def test_any_number_of_threads_draws_the_same(tmp_path):
    for threads in (1, 3):
        render(
            tmp_path / str(threads),
            "--limit",
            4,
            "--threads",
            threads,
            "--save",
            "silhouette,overlay",
            "--contact-sheet",
        )
    a, b = tmp_path / "1", tmp_path / "3"
    assert files(a) == files(b)
    for name in files(a):
        if name != "manifest.json":
            assert (a / name).read_bytes() == (b / name).read_bytes()


def test_the_background_is_under_the_overlay(tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for name, value in (("atrium-0000.png", 40), ("atrium-0001.jpg", 200)):
        cv2.imwrite(str(frames / name), np.full((120, 160, 3), value, np.uint8))
    out = tmp_path / "out"
    render(out, "--save", "overlay", "--limit", 2, "--background", frames)
    for name, value in (("atrium-0000", 40), ("atrium-0001", 200)):
        seen = picture(out / "overlay" / f"{name}.png")
        assert abs(np.median(seen) - value) <= 2
        assert (seen != seen[0, 0]).any()
    assert "no picture for 'atrium-0002'" in refused(
        tmp_path / "more", "--save", "overlay", "--limit", 3, "--background", frames
    )
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((60, 80, 3), np.uint8))
    error = refused(tmp_path / "more", "--save", "overlay", "--background", small)
    assert "found a picture of 80x60 pixels, expected 160x120" in error


def test_comparisons_and_sheets_are_pictures(tmp_path):
    out = tmp_path / "out"
    render(out, "--compare", "--contact-sheet", "--every", 500)
    assert len(files(out)) == 4 + 1 + 1
    sheet = picture(out / "contact_sheet.png")
    assert sheet.shape[0] > 200
    for path in (out / "compare").iterdir():
        assert picture(path).shape[1] > 4 * 320


def test_half_a_pixel_is_added_where_asked(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    common = ["--format", "npy", "--limit", 1, "--out"]
    moved = "126.35,126.35,79.5,59.5,160,120"
    base = ["render", MESH, POSES]
    assert dronepose(*base, "--camera", CAMERA, *common, a).returncode == 0
    assert dronepose(*base, "--camera", moved, "--integer-centers", *common, b).returncode == 0
    masks = [np.load(out / "silhouette" / "atrium-0000.npy") for out in (a, b)]
    np.testing.assert_array_equal(*masks)


def test_the_manifest_goes_to_standard_output(tmp_path):
    out = tmp_path / "out"
    done = render(out, "--limit", 2, "--json")
    assert json.loads(done.stdout) == json.loads((out / "manifest.json").read_text())
    assert render(out, "--limit", 2, "--quiet").stdout == ""


@pytest.mark.skipif(sys.platform != "linux", reason="signals")
def test_an_interrupt_leaves_whole_files_and_the_next_run_goes_on(tmp_path):
    out = tmp_path / "out"
    arguments = [
        "render",
        MESH,
        POSES,
        "--camera",
        "505.4,505.4,320,240,640,480",
        "--out",
        out,
        "--save",
        "silhouette,preview",
        "--format",
        "png,npy",
        "--limit",
        400,
    ]
    started = subprocess.Popen(
        [*command("dronepose"), *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    while started.poll() is None and not any((out / "preview").glob("*.png")):
        time.sleep(0.01)
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate(timeout=60)
    assert started.returncode == 130, errors
    left = files(out)
    assert len(left) < 3 * 400
    assert not [name for name in left if name.endswith(".part")]
    for name in left:
        if name.endswith(".png"):
            assert picture(out / name).size
        elif name.endswith(".npy"):
            assert np.load(out / name).shape == (480, 640)
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["complete"] is False
    done = dronepose(*[5 if a == 400 else a for a in arguments])
    assert done.returncode == 0, done.stderr
    manifest = json.loads((out / "manifest.json").read_text())
    listed = sorted(f for frame in manifest["frames"] for f in frame["files"])
    assert manifest["complete"] is True
    assert files(out) == sorted([*listed, "manifest.json"])
    assert set(left) <= set(files(out))


def test_modes_and_their_parameters_reach_the_masks(tmp_path):
    runs = {
        "exact": [],
        "blurred": ["--sigma", 2],
        "hard": ["--mode", "hard"],
        "dibr": ["--mode", "dibr"],
        "sharp": ["--mode", "dibr", "--delta", 1e6],
        "kaolin": ["--mode", "dibr", "--cutoffs"],
        "sigmoid": ["--mode", "sigmoid"],
        "narrow": ["--mode", "sigmoid", "--sigma-ndc", 1e-7],
    }
    area = {}
    for name, options in runs.items():
        render(tmp_path / name, "--limit", 1, "--format", "npy", *options)
        area[name] = float(np.load(tmp_path / name / "silhouette" / "atrium-0000.npy").sum())
    true = area["exact"]
    assert area["blurred"] == pytest.approx(true, rel=1e-4)
    for near in ("hard", "sharp", "narrow"):
        assert area[near] == pytest.approx(true, rel=0.1)
    assert area["dibr"] > 1.3 * true
    assert area["sigmoid"] > 1.3 * true
    assert area["kaolin"] != area["dibr"]


def test_the_pictures_of_the_documentation_are_what_the_script_makes(tmp_path):
    script = ROOT / "docs" / "make_pictures.py"
    subprocess.run(
        [sys.executable, script, "--folder", tmp_path], check=True, stdout=subprocess.DEVNULL
    )
    kept = ROOT / "docs" / "pictures"
    # Those of losses and synthesis are made by scripts of their own.
    shown = [name for name in files(kept) if not name.startswith(("loss", "synth"))]
    assert files(tmp_path) == shown
    page = (ROOT / "docs" / "rendering.md").read_text(encoding="utf-8")
    for name in shown:
        made, there = picture(tmp_path / name).astype(float), picture(kept / name).astype(float)
        assert made.shape == there.shape
        assert np.abs(made - there).mean() < 0.5, name
        assert f"pictures/{name}" in page


def test_exit_codes(tmp_path):
    out = tmp_path / "out"
    assert dronepose("render", MESH, POSES, "--out", out).returncode == 2
    assert (
        dronepose(
            "render", MESH, tmp_path / "none.csv", "--camera", CAMERA, "--out", out
        ).returncode
        == 1
    )
    assert dronepose("no-such-command").returncode == 2
    assert dronepose("--help").returncode == 0
    assert not out.exists()


@pytest.mark.skipif(
    sys.platform != "linux" or os.geteuid() == 0, reason="the superuser may write everywhere"
)
def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    assert "Permission denied" in refused(tmp_path / "locked" / "out", "--limit", 1)


def test_eval_is_a_subcommand():
    arguments = [EXAMPLES / "predictions.csv", POSES, "--json", "-", "--bootstrap", 0]
    done = dronepose("eval", *arguments)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["n_gt"] == 2000


def test_neither_numpy_nor_torch_is_loaded(tmp_path):
    arguments = [
        "render",
        str(MESH),
        str(POSES),
        "--camera",
        CAMERA,
        "--out",
        str(tmp_path / "out"),
        "--limit",
        "1",
        "--quiet",
    ]
    code = (
        "import sys\nfrom dronepose.cli import dronepose\n"
        f"assert dronepose({arguments!r}) == 0\nassert dronepose(['--version']) == 0\n"
        f"assert not set(sys.modules) & {HEAVY!r}, sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_subcommands_in_python_are_run_and_listed_without_being_imported(tmp_path):
    # In a process of its own: the command takes the signals over.
    (tmp_path / "new_thing.py").write_text(
        '"""Do a new thing.\n\nMore."""\n\n\ndef main(argv):\n    return len(argv)\n'
    )
    code = f"""
import pathlib, sys
import dronepose.commands
from dronepose import cli
folder = {str(tmp_path)!r}
cli._modules = lambda: {{"new-thing": pathlib.Path(folder, "new_thing.py")}}
dronepose.commands.__path__.append(folder)
assert cli.dronepose(["--help"]) == 0
assert cli.dronepose(["nothing"]) == 2
assert "dronepose.commands.new_thing" not in sys.modules
assert cli.dronepose(["new-thing", "a", "b"]) == 2
assert "dronepose.commands.new_thing" in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "new-thing  Do a new thing\n" in done.stdout
