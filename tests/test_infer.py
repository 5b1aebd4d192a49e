"""``dronepose infer``: pictures, folders, videos; cameras and letterboxes; what it writes."""

import csv
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")

import finder  # noqa: E402
from dronepose import Camera  # noqa: E402
from dronepose.commands import infer as command  # noqa: E402
from dronepose.infer import Fit, Predictor, Source, draw  # noqa: E402
from dronepose.infer.sources import read_picture  # noqa: E402
from dronepose.infer.video import video_writer  # noqa: E402
from dronepose.model import WeightsError, file_sha256  # noqa: E402
from support import EXAMPLES, evaluate, loads, rows, run  # noqa: E402

MESH = EXAMPLES / "quadrotor.obj"


@pytest.fixture
def weights(tmp_path):
    return finder.write(tmp_path / "finder.onnx")


def picture(path, image):
    cv2.imwrite(str(path), image[:, :, ::-1])
    return path


def column(k):
    return 30.0 + 4 * k + 2 * (-1) ** k


def video(path, n=12, size=(96, 128), rate=20.0):
    """A disc that moves to the right and shakes; it begins anew before it leaves the image."""
    with video_writer(path, rate) as add:
        for k in range(n):
            add(finder.spot(*size, column(k % 20), 40.0, 9.0))
    return path


def infer(capsys, *args):
    """The command in this process: exit code, standard output and error."""
    code = command.main([str(a) for a in args])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def where(camera, row):
    """The pixel on which a row of the CSV puts the origin of the model."""
    seen = camera.K @ [float(row[name]) for name in ("tx", "ty", "tz")]
    return seen[:2] / seen[2]


class TestFit:
    """The disc is found where it is, whatever is done to the frame on the way."""

    @pytest.mark.parametrize("aware", [False, True])
    @pytest.mark.parametrize(
        "size", [(48, 64), (96, 128), (480, 640), (24, 32), (90, 160), (99, 70)]
    )
    @pytest.mark.parametrize("given", [False, True])
    def test_the_pose_projects_onto_the_disc(self, aware, size, given, tmp_path):
        height, width = size
        camera = None
        if given:  # a principal point and focal lengths of its own
            camera = Camera(1.1 * width, 1.2 * width, 0.45 * width, 0.55 * height, width, height)
        predictor = Predictor(finder.write(tmp_path / "w.onnx", aware=aware))
        fit = Fit.plan(
            size, predictor.image_size, intrinsics=predictor.metadata["intrinsics"],
            camera=camera, aware=predictor.aware,
        )  # fmt: skip
        at = np.array([0.47 * width, 0.52 * height])
        image = fit.image(finder.spot(height, width, *at, 0.1 * min(size)))
        _, t = predictor(image[None], fit.network.K)
        seen = fit.frame.K @ t[0]
        # OpenCV looks up in steps of 1/32 px; half a pixel of the network would be 0.5 of these.
        tolerance = 0.06 * max(1.0, width / 64, height / 48)
        np.testing.assert_allclose(seen[:2] / seen[2], at, atol=tolerance)

    def test_the_same_size_changes_no_byte(self):
        frame = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
        fit = Fit.plan((48, 64), (48, 64), intrinsics=finder.CAMERA.K, camera=None, aware=False)
        np.testing.assert_array_equal(np.rint(255 * fit.image(frame)).transpose(1, 2, 0), frame)
        assert fit.frame == finder.CAMERA

    def test_bars_are_named_and_may_be_refused(self):
        options = {"intrinsics": finder.CAMERA.K, "camera": None, "aware": False}
        fit = Fit.plan((90, 160), (48, 64), **options)
        assert "letterboxed to 64x36, 6 rows above" in fit.note
        assert "is assumed" in fit.note
        with pytest.raises(ValueError, match="another aspect ratio than the network's 64x48"):
            Fit.plan((90, 160), (48, 64), letterbox=False, **options)

    def test_a_camera_for_frames_of_another_size(self):
        with pytest.raises(ValueError, match=r"^camera: is for 64x48, the frames are 160x90"):
            Fit.plan((90, 160), (48, 64), intrinsics=None, camera=finder.CAMERA, aware=True)

    def test_no_camera_at_all(self):
        with pytest.raises(ValueError, match=r"^camera: the weights hold no intrinsics"):
            Fit.plan((90, 160), (48, 64), intrinsics=None, camera=None, aware=True)


class TestCommand:
    def test_a_picture(self, weights, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(96, 128, 70, 40, 9))
        code, text, err = infer(capsys, file, "-w", weights, "-o", tmp_path / "out", "--mesh", MESH)
        assert (code, err) == (0, "")
        assert "1 frames" in text
        assert "frames/s" in text
        (row,) = rows(tmp_path / "out/poses.csv")
        assert list(row) == ["id", "qw", "qx", "qy", "qz", "tx", "ty", "tz"]
        assert row["id"] == "photo"
        camera = Camera(120.0, 110.0, 62.0, 50.0, 128, 96)
        np.testing.assert_allclose(where(camera, row), [70, 40], atol=0.1)
        drawn = read_picture(tmp_path / "out/overlays/photo.png")
        assert drawn.shape == (96, 128, 3)
        assert np.abs(drawn.astype(int) - read_picture(file)).max() > 50

    def test_a_folder_is_read_by_the_evaluation(self, weights, tmp_path, capsys):
        folder = tmp_path / "frames"
        folder.mkdir()
        for k in (1, 2, 10):
            picture(folder / f"f{k}.png", finder.spot(48, 64, 20 + k, 24, 6))
        (folder / "notes.txt").write_text("no picture")
        code, _, err = infer(capsys, folder, "-w", weights, "-o", tmp_path / "out", "--no-overlay")
        assert (code, err) == (0, "")
        poses = tmp_path / "out/poses.csv"
        assert [row["id"] for row in rows(poses)] == ["f1", "f2", "f10"]
        assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["poses.csv"]
        result = evaluate(poses, poses)
        assert result["counts"]["matched"] == 3 if "counts" in result else result

    def test_a_video_with_a_filter(self, weights, tmp_path, capsys):
        file = video(tmp_path / "in.mp4")
        out = tmp_path / "out"
        code, text, err = infer(
            capsys, file, "-w", weights, "-o", out, "--mesh", MESH, "--filter", "rts", "--json"
        )
        assert (code, err) == (0, "")
        summary = loads(text)
        assert summary["schema"] == "dronepose-infer/1"
        assert (summary["kind"], summary["frames"], summary["rate"]) == ("video", 12, 20.0)
        assert summary["frames_per_second"] > 0
        (model,) = summary["models"]
        assert model["jitter"]["position_m"] < model["jitter_raw"]["position_m"]
        assert sorted(p.name for p in out.iterdir()) == [
            "overlay.mp4", "poses.csv", "poses_raw.csv",
        ]  # fmt: skip
        raw = rows(out / "poses_raw.csv")
        assert [row["time_s"] for row in raw][:3] == ["0.000000", "0.050000", "0.100000"]
        camera = Camera(120.0, 110.0, 62.0, 50.0, 128, 96)
        for k, row in enumerate(raw):
            np.testing.assert_allclose(where(camera, row), [column(k), 40], atol=0.5)
        frames = list(Source(str(out / "overlay.mp4")).frames())
        assert [len(frames), *frames[0].image.shape] == [12, 96, 128, 3]

    def test_two_networks_side_by_side(self, weights, tmp_path, capsys):
        other = finder.write(tmp_path / "other.onnx", aware=True)
        file, out = video(tmp_path / "in.mp4", n=3, size=(95, 127)), tmp_path / "out"
        code, _, _ = infer(capsys, file, "-w", weights, "--compare", other, "-o", out, "-q")
        assert code == 0
        frame = next(Source(str(out / "overlay.mp4")).frames())
        assert frame.image.shape == (96, 256, 3)
        assert len(rows(out / "poses.csv")) == len(rows(out / "poses_2.csv")) == 3

    def test_the_same_input_gives_the_same_poses(self, weights, tmp_path, capsys):
        file = video(tmp_path / "in.mp4")
        texts = set()
        for k, batch in enumerate((1, 5, 8)):
            out = tmp_path / f"out{k}"
            args = ("--filter", "one-euro", "--batch", batch, "--no-overlay")
            assert infer(capsys, file, "-w", weights, "-o", out, *args)[0] == 0
            texts.add((out / "poses.csv").read_text())
        assert len(texts) == 1

    def test_it_runs_without_torch(self, weights, tmp_path):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        code = (
            "import sys\nfor name in ('torch', 'torchvision', 'roma', 'safetensors', 'onnx'):\n"
            "    sys.modules[name] = None\n"
            "from dronepose.cli import dronepose\nsys.exit(dronepose(sys.argv[1:]))"
        )
        args = ["infer", file, "-w", weights, "-o", tmp_path / "out", "--mesh", MESH]
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, args)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert (tmp_path / "out/poses.csv").exists()

    def test_another_mesh_than_in_training(self, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        for sha, warned in ((file_sha256(MESH), False), ("0" * 64, True)):
            weights = finder.write(tmp_path / "w.onnx", mesh_sha256=sha)
            code, _, err = infer(
                capsys, file, "-w", weights, "-o", tmp_path / "out", "--mesh", MESH
            )
            assert code == 0
            assert ("was trained with another mesh" in err) == warned

    def test_help_has_an_example(self):
        done = run("infer", "--help", name="dronepose")
        assert done.returncode == 0
        assert "dronepose infer --weights drone.onnx flight.mp4" in done.stdout


class TestRefusals:
    def refused(self, capsys, tmp_path, *args):
        code, out, err = infer(capsys, *args, "-o", tmp_path / "out")
        assert (code, out) == (1, "")
        assert err.startswith("error: ")
        left = [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
        assert not left
        return err

    def test_a_missing_file(self, weights, tmp_path, capsys):
        err = self.refused(capsys, tmp_path, tmp_path / "no.mp4", "-w", weights)
        assert "no.mp4: no such file" in err
        err = self.refused(capsys, tmp_path, MESH, "-w", tmp_path / "no.onnx")
        assert "quadrotor.obj: neither a picture nor a video" in err

    def test_missing_weights(self, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        err = self.refused(capsys, tmp_path, file, "-w", tmp_path / "no.onnx")
        assert "no.onnx: no such file" in err

    @pytest.mark.parametrize("name", ["fake.mp4", "fake.png", "fake"])
    def test_what_is_neither_a_picture_nor_a_video(self, name, weights, tmp_path, capsys):
        (tmp_path / name).write_bytes(b"this is text " * 50)
        err = self.refused(capsys, tmp_path, tmp_path / name, "-w", weights)
        assert f"{name}: n" in err

    def test_a_damaged_picture_among_others_is_named(self, weights, tmp_path, capsys):
        folder = tmp_path / "frames"
        folder.mkdir()
        picture(folder / "a.png", finder.spot(48, 64, 30, 20, 6))
        (folder / "b.png").write_bytes((folder / "a.png").read_bytes()[:40])
        code, _, err = infer(capsys, folder, "-w", weights, "-o", tmp_path / "out")
        assert code == 1
        assert "b.png: not a picture" in err
        assert not (tmp_path / "out/poses.csv").exists()

    def test_an_empty_folder(self, weights, tmp_path, capsys):
        (tmp_path / "frames").mkdir()
        assert "expected pictures" in self.refused(
            capsys, tmp_path, tmp_path / "frames", "-w", weights
        )

    def test_weights_of_others(self, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        (tmp_path / "w.onnx").write_bytes(b"nothing")
        assert "cannot read it" in self.refused(capsys, tmp_path, file, "-w", tmp_path / "w.onnx")
        finder.write(tmp_path / "w.onnx", names=("scores", "boxes"))
        err = self.refused(capsys, tmp_path, file, "-w", tmp_path / "w.onnx")
        assert "expected inputs image (and K) and outputs R, t" in err
        assert "scores" in err

    def test_another_aspect_ratio_if_wanted(self, weights, tmp_path, capsys):
        file = picture(tmp_path / "wide.png", finder.spot(45, 80, 30, 20, 6))
        err = self.refused(capsys, tmp_path, file, "-w", weights, "--fit", "refuse")
        assert "frames of 80x45 have another aspect ratio" in err

    def test_a_camera_for_another_size(self, weights, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        args = (file, "-w", weights, "--camera", "60,60,40,30,80,60")
        assert "camera: is for 80x60" in self.refused(capsys, tmp_path, *args)

    def test_a_filter_for_one_picture(self, weights, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        err = self.refused(capsys, tmp_path, file, "-w", weights, "--filter", "rts")
        assert "one picture does not move" in err

    def test_no_pose_is_invented(self, weights, tmp_path, capsys):
        """The finder divides by the brightness: black gives NaN."""
        file = picture(tmp_path / "night.png", np.zeros((48, 64, 3), dtype=np.uint8))
        assert "not finite" in self.refused(capsys, tmp_path, file, "-w", weights)

    @pytest.mark.parametrize(
        "args",
        [
            ("--camera", "1,2,3"),
            ("--filter", "kalman"),
            ("--fps", "0"),
            ("--limit", "-1"),
            ("--unknown",),
        ],
    )
    def test_a_command_line_that_is_not_understood(self, args, weights, tmp_path, capsys):
        assert infer(capsys, "x.png", "-w", weights, "-o", tmp_path, *args)[0] == 2

    def test_a_colour(self, weights, tmp_path, capsys):
        file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
        err = self.refused(capsys, tmp_path, file, "-w", weights, "--fill", "mauve")
        assert "expected #rrggbb" in err

    @pytest.mark.parametrize("kind", ["video", "folder"])
    def test_interrupted(self, kind, weights, tmp_path, capsys, monkeypatch):
        from dronepose.infer import run as runner

        if kind == "video":
            file = video(tmp_path / "in.mp4")
        else:
            file = tmp_path / "frames"
            file.mkdir()
            for k in range(6):
                picture(file / f"{k}.png", finder.spot(48, 64, 20 + k, 24, 6))
        calls = []

        def stop(*args, **options):
            calls.append(1)
            if len(calls) == 4:
                raise KeyboardInterrupt
            return draw(*args, **options)

        monkeypatch.setattr(runner, "draw", stop)
        code, _, err = infer(capsys, file, "-w", weights, "-o", tmp_path / "out")
        assert code == 130
        assert "interrupted" in err
        left = [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
        assert len(left) == (0 if kind == "video" else 3)
        for each in left:  # complete ones
            read_picture(each)


def test_ctrl_c_ends_the_recording_of_a_camera(weights, tmp_path, capsys, monkeypatch):
    from dronepose.infer import run as runner
    from dronepose.infer import sources

    def endless(name):
        assert name == 0
        while True:
            yield finder.spot(48, 64, 30, 20, 6)

    calls = []

    def stop(*args, **options):
        calls.append(1)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return draw(*args, **options)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sources, "_capture", endless)
    monkeypatch.setattr(runner, "draw", stop)
    code, text, err = infer(
        capsys, "0", "-w", weights, "-o", "out", "--filter", "one-euro", "--json"
    )
    assert (code, err) == (0, "")
    assert loads(text)["frames"] == len(rows(tmp_path / "out/poses.csv")) == 4
    assert len(list(Source(str(tmp_path / "out/overlay.mp4")).frames())) == 4
    code, _, err = infer(capsys, "0", "-w", weights, "-o", "out2", "--filter", "rts")
    assert (code, "needs a recording" in err) == (1, True)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_leaves_nothing_half_written(name, weights, tmp_path):
    file, out = video(tmp_path / "in.mp4", n=200), tmp_path / "out"
    code = (
        "import sys, time\nfrom dronepose.infer import run\ndraw = run.draw\n"
        "def slow(*args, **options):\n    time.sleep(0.05)\n    return draw(*args, **options)\n"
        "run.draw = slow\nfrom dronepose.cli import dronepose\nsys.exit(dronepose(sys.argv[1:]))"
    )
    args = [sys.executable, "-c", code, "infer", file, "-w", weights, "-o", out]
    with subprocess.Popen([str(a) for a in args], stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not list(out.glob(".*part*")) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert process.poll() is None
        process.send_signal(getattr(signal, name))
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert not list(out.iterdir())


class TestSources:
    def test_both_readers_see_the_same_frames(self, tmp_path, monkeypatch):
        pytest.importorskip("av")
        from dronepose.infer import sources

        file = video(tmp_path / "in.mp4", n=4)
        ours = [frame.image.astype(int) for frame in Source(str(file)).frames()]
        monkeypatch.setattr(sources, "_has_av", lambda: False)
        source = Source(str(file))
        assert (source.rate, source.count) == (20.0, 4)
        theirs = [frame.image.astype(int) for frame in source.frames()]
        assert len(ours) == len(theirs) == 4
        assert np.abs(np.array(ours) - theirs).mean() < 2.0

    def test_a_video_that_ends_early_names_the_frame_or_ends(self, tmp_path):
        file = video(tmp_path / "in.mp4", n=30)
        file.write_bytes(file.read_bytes()[:300])
        with pytest.raises(ValueError, match=r"in.mp4: neither a picture nor a video"):
            Source(str(file))

    def test_a_failed_video_leaves_nothing(self, tmp_path):
        def write():
            with video_writer(tmp_path / "out.mp4", 30.0) as add:
                add(np.zeros((32, 32, 3), dtype=np.uint8))
                add(np.zeros((32, 48, 3), dtype=np.uint8))

        with pytest.raises(ValueError, match="expected frames of 32x32, got 48x32"):
            write()
        assert not list(tmp_path.iterdir())


def test_safetensors_and_onnx_give_the_same_poses(tmp_path):
    torch = pytest.importorskip("torch")
    for name in ("torchvision", "roma", "safetensors", "onnxscript"):
        pytest.importorskip(name)
    from dronepose.model import PoseNet, export_onnx, save_weights

    torch.manual_seed(0)
    net = PoseNet("resnet18", hidden=(16,), camera="normalised")
    save_weights(net, tmp_path / "w.safetensors", {"intrinsics": finder.CAMERA})
    export_onnx(
        net, tmp_path / "w.onnx", height=48, width=64, metadata={"intrinsics": finder.CAMERA}
    )
    images = np.random.default_rng(0).random((2, 3, 48, 64), dtype=np.float32)
    one, other = (Predictor(tmp_path / f"w.{kind}") for kind in ("safetensors", "onnx"))
    for a, b in zip(one(images, finder.CAMERA.K), other(images, finder.CAMERA.K), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)
    assert one.metadata["architecture"] == other.metadata["architecture"]
    with pytest.raises(ValueError, match=r"^images: expected shape \(B, 3, 48, 64\)"):
        one(images[..., :32], finder.CAMERA.K)


def test_weights_that_do_not_say_their_size(tmp_path):
    path = finder.write(tmp_path / "w.onnx")
    import onnx

    model = onnx.load(path)
    kept = {p.key: p.value for p in model.metadata_props if p.key != "image_size"}
    onnx.helper.set_model_props(model, kept)
    onnx.save(model, path)
    with pytest.raises(WeightsError, match="does not say the size of its images"):
        Predictor(path)


def test_the_csv_has_unix_lines(weights, tmp_path, capsys):
    file = picture(tmp_path / "photo.png", finder.spot(48, 64, 30, 20, 6))
    assert infer(capsys, file, "-w", weights, "-o", tmp_path / "out")[0] == 0
    text = (tmp_path / "out/poses.csv").read_bytes()
    assert b"\r" not in text
    assert len(list(csv.reader(text.decode().splitlines()))) == 2
