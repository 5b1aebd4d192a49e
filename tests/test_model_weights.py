"""Weights in files: ours, the authors', torchvision's; and ONNX."""

import json
import os

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torchvision = pytest.importorskip("torchvision")
pytest.importorskip("roma")
safetensors_torch = pytest.importorskip("safetensors.torch")

from dronepose import Camera  # noqa: E402
from dronepose.model import (  # noqa: E402
    PoseNet,
    WeightsError,
    export_onnx,
    file_sha256,
    load_weights,
    model_from_file,
    read_metadata,
    save_weights,
)
from dronepose.model.metadata import decode, encode  # noqa: E402
from support import EXAMPLES, run  # noqa: E402

CAMERA = Camera(60.0, 55.0, 31.0, 25.0, width=64, height=48)


def small(seed=3, **options):
    torch.manual_seed(seed)
    options = {"backbone": "resnet18", "hidden": (24, 12), **options}
    return PoseNet(**options).eval()


def images(n=2, height=48, width=64):
    return torch.rand(n, 3, height, width, generator=torch.Generator().manual_seed(0))


def same(a, b, *inputs):
    with torch.no_grad():
        for one, other in zip(a.eval()(*inputs), b.eval()(*inputs), strict=True):
            torch.testing.assert_close(one, other, atol=0, rtol=0)


class Authors(torch.nn.Module):
    """The names and the order of VCL3D/DronePose, and no more of it."""

    def __init__(self):
        super().__init__()
        self.model = torchvision.models.resnet34(weights=None)
        self.model.fc = torch.nn.Linear(512, 2048)
        self.head = torch.nn.Module()
        self.head.linear_1 = torch.nn.Linear(2048, 1024)
        self.head.linear_2 = torch.nn.Linear(1024, 512)
        self.head.linear_3 = torch.nn.Linear(512, 128)
        self.head.fc_position = torch.nn.Linear(128, 3)
        self.head.fc_rotation = torch.nn.Linear(128, 6, bias=False)

    def forward(self, image):
        x, head = self.model(image), self.head
        for layer in (head.linear_1, head.linear_2, head.linear_3):
            x = torch.nn.functional.elu(layer(x))
        six = head.fc_rotation(x)
        first = torch.nn.functional.normalize(six[:, :3])
        third = torch.nn.functional.normalize(torch.linalg.cross(first, six[:, 3:]))
        columns = [first, torch.linalg.cross(third, first), third]
        return torch.stack(columns, dim=2), head.fc_position(x)


@pytest.fixture(scope="module")
def authors():
    torch.manual_seed(11)
    return Authors().eval()


class TestAuthors:
    @pytest.mark.parametrize("wrapped", ["parallel", "single", "bare", "state_dict"])
    def test_a_checkpoint_gives_their_poses_in_our_camera(self, authors, wrapped, tmp_path):
        state = authors.state_dict()
        if wrapped == "parallel":
            state = torch.nn.DataParallel(authors).state_dict()
            assert next(iter(state)).startswith("module.model.")
        key = {"bare": None, "state_dict": "state_dict"}.get(wrapped, "model_state_dict")
        optimizer = torch.optim.Adam(authors.parameters()).state_dict()
        held = {"epoch": 3, key: state, "optimizer_state_dict": optimizer} if key else state
        path = tmp_path / "theirs.pth"
        torch.save(held, path)
        net = model_from_file(path)
        with torch.no_grad():
            theirs_R, theirs_t = authors(images())
            R, t = net(images())
        flip = torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # OpenGL's camera to OpenCV's
        torch.testing.assert_close(R, flip @ theirs_R, atol=2e-6, rtol=0)
        torch.testing.assert_close(t, theirs_t @ flip, atol=1e-6, rtol=1e-5)

    def test_a_pickled_module_is_refused_with_a_way_out(self, authors, tmp_path):
        path = tmp_path / "module.pth"
        torch.save(authors, path)
        with pytest.raises(WeightsError, match=r"module.pth: holds Python objects.*convert it"):
            load_weights(None, path)

    def test_a_file_runs_no_code(self, tmp_path):
        class Trap:
            def __reduce__(self):
                return os.mkdir, (str(tmp_path / "sprung"),)

        path = tmp_path / "trap.pth"
        torch.save({"model_state_dict": Trap()}, path)
        with pytest.raises(WeightsError, match="holds Python objects"):
            load_weights(None, path)
        assert not (tmp_path / "sprung").exists()

    def test_for_another_backbone_it_is_refused(self, authors, tmp_path):
        path = tmp_path / "theirs.pth"
        torch.save({"model_state_dict": authors.state_dict()}, path)
        with pytest.raises(WeightsError, match=r"belongs to another network: .*has besides"):
            load_weights(small(hidden=(2048, 1024, 512, 128)), path)


class TestBackbone:
    def test_weights_of_torchvision_replace_the_backbone_only(self, tmp_path):
        torch.manual_seed(5)
        classifier = torchvision.models.resnet18(weights=None)
        path = tmp_path / "resnet18.pth"
        torch.save(classifier.state_dict(), path)
        net = small(weights=path)
        assert torch.equal(net.backbone.conv1.weight, classifier.conv1.weight)
        assert torch.equal(net.rotation.weight, small().rotation.weight)

    def test_with_features(self, tmp_path):
        classifier = torchvision.models.squeezenet1_1(weights=None)
        path = tmp_path / "squeezenet.pth"
        torch.save(classifier.state_dict(), path)
        net = PoseNet("squeezenet1_1", hidden=(8,), weights=path)
        assert torch.equal(net.backbone.features[0].weight, classifier.features[0].weight)

    def test_of_another_network(self, tmp_path):
        path = tmp_path / "alexnet.pth"
        torch.save({"features.0.weight": torch.zeros(3)}, path)
        with pytest.raises(WeightsError, match="belongs to another network"):
            small(weights=path)
        with pytest.raises(WeightsError, match="does not say which network"):
            load_weights(None, path)


class TestSafetensors:
    def test_a_round_trip(self, tmp_path):
        net = small(camera="normalised", normalisation="imagenet")
        path = tmp_path / "w.safetensors"
        mesh = file_sha256(EXAMPLES / "quadrotor.obj")
        given = {
            "intrinsics": CAMERA,
            "mesh_sha256": mesh,
            "config": {"lr": 1e-4},
            "metrics": {"cpe": 0.25},
            "seed": 3,
        }
        save_weights(net, path, given)
        assert [p.name for p in tmp_path.iterdir()] == ["w.safetensors"]
        found = read_metadata(path)
        np.testing.assert_array_equal(found["intrinsics"], CAMERA.K)
        assert found["image_size"] == (48, 64)
        assert (found["seed"], found["mesh_sha256"]) == (3, mesh)
        assert found["architecture"] == net.architecture
        assert "OpenCV" in found["conventions"]
        assert found["torch_version"] == torch.__version__
        same(net, model_from_file(path), images(), torch.tensor(CAMERA.K, dtype=torch.float32))

    def test_into_a_network_that_is_there(self, tmp_path):
        save_weights(small(), tmp_path / "w.safetensors")
        other = small(seed=9)
        load_weights(other, tmp_path / "w.safetensors")
        same(small(), other, images())

    @pytest.mark.parametrize(
        "options", [{"hidden": (24,)}, {"normalisation": "imagenet"}, {"camera": "normalised"}]
    )
    def test_other_arguments_are_refused(self, options, tmp_path):
        save_weights(small(), tmp_path / "w.safetensors")
        with pytest.raises(WeightsError, match=rf"was saved for {next(iter(options))}="):
            load_weights(small(**options), tmp_path / "w.safetensors")

    def test_not_strict_takes_what_fits(self, tmp_path):
        save_weights(small(), tmp_path / "w.safetensors")
        other = small(seed=9, hidden=(24, 12, 12))
        load_weights(other, tmp_path / "w.safetensors", strict=False)
        assert torch.equal(other.backbone.conv1.weight, small().backbone.conv1.weight)

    def test_a_checkpoint_of_a_trainer(self, tmp_path):
        state = {f"net.{k}": v for k, v in small().state_dict().items()}
        state["render.vertices"] = torch.zeros(3, 3)
        torch.save({"state_dict": state, "epoch": 3}, tmp_path / "last.ckpt")
        other = small(seed=9)
        load_weights(other, tmp_path / "last.ckpt")
        same(small(), other, images())

    def test_damaged_files(self, tmp_path):
        path = tmp_path / "w.safetensors"
        with pytest.raises(FileNotFoundError, match=r"cannot read .*w.safetensors: no such file"):
            load_weights(None, path)
        path.write_bytes(b"nothing")
        with pytest.raises(WeightsError, match="not a complete safetensors file"):
            load_weights(None, path)
        save_weights(small(), path)
        path.write_bytes(path.read_bytes()[:-100])
        with pytest.raises(WeightsError, match="not a complete safetensors file"):
            load_weights(None, path)
        (tmp_path / "w.pth").write_bytes(b"nothing")
        with pytest.raises(WeightsError, match=r"w.pth: "):
            load_weights(None, tmp_path / "w.pth")
        torch.save([1, 2], tmp_path / "w.pth")
        with pytest.raises(WeightsError, match="expected a dictionary of tensors"):
            load_weights(None, tmp_path / "w.pth")
        with pytest.raises(WeightsError, match=r"expected .safetensors, .pth"):
            load_weights(None, EXAMPLES / "quadrotor.obj")

    def test_weights_that_are_not_finite(self, tmp_path):
        net = small()
        with torch.no_grad():
            net.rotation.weight[2, 3] = float("nan")
        with pytest.raises(WeightsError, match=r"rotation.weight holds numbers that are not fin"):
            save_weights(net, tmp_path / "w.safetensors")
        assert not list(tmp_path.iterdir())

    def test_metadata_of_others(self, tmp_path):
        path = tmp_path / "w.safetensors"
        safetensors_torch.save_file({"a": torch.zeros(2)}, path)
        with pytest.raises(WeightsError, match="expected metadata of dronepose"):
            read_metadata(path)


class TestMetadata:
    @pytest.mark.parametrize(
        ("given", "error", "message"),
        [
            ({"colour": 1}, ValueError, r"^metadata\['colour'\]: expected one of"),
            ({"mesh_sha256": "12"}, ValueError, r"^metadata\['mesh_sha256'\]"),
            ({"image_size": (0, 3)}, ValueError, r"^metadata\['image_size'\]"),
            ({"intrinsics": [[1, 0, 0]]}, ValueError, r"^metadata\['intrinsics'\]"),
            ({"intrinsics": np.zeros((3, 3))}, ValueError, r"^metadata\['intrinsics'\]"),
            ({"metrics": {"cpe": float("nan")}}, ValueError, r"^metadata\['metrics'\]"),
            ({"config": {1, 2}}, TypeError, r"^metadata\['config'\]"),
            ({"seed": "3"}, TypeError, r"^metadata\['seed'\]"),
            ({"architecture": 3}, TypeError, r"^metadata\['architecture'\]"),
        ],
    )
    def test_wrong_values(self, given, error, message):
        with pytest.raises(error, match=message):
            encode(given)

    def test_damaged_values_name_file_and_key(self):
        texts = encode({"image_size": (4, 5)})
        texts["image_size"] = "[4"
        with pytest.raises(WeightsError, match=r"^w: metadata 'image_size' is damaged"):
            decode(texts, "w")


class TestOnnx:
    @pytest.fixture(autouse=True)
    def _installed(self):
        for name in ("onnx", "onnxscript", "onnxruntime"):
            pytest.importorskip(name)

    @pytest.mark.parametrize("camera", [None, "normalised"])
    def test_it_agrees_with_torch_for_any_batch(self, camera, tmp_path):
        import onnxruntime

        net = small(camera=camera).train()
        path = tmp_path / "m.onnx"
        report = export_onnx(
            net, path, height=48, width=64, metadata={"intrinsics": CAMERA, "seed": 3}
        )
        assert report.max_difference < 1e-4
        assert net.training
        session = onnxruntime.InferenceSession(path)
        feed = {"image": images(5).numpy()}
        K = torch.tensor(CAMERA.K, dtype=torch.float32).expand(5, 3, 3)
        if camera:
            feed["K"] = K.numpy()
        R, t = session.run(["R", "t"], feed)
        with torch.no_grad():
            expected = net.eval()(images(5), K)
        np.testing.assert_allclose(R, expected.R, atol=1e-5)
        np.testing.assert_allclose(t, expected.t, atol=1e-5)
        props = session.get_modelmeta().custom_metadata_map
        assert json.loads(props["image_size"]) == [48, 64]
        found = read_metadata(path)
        assert (found["seed"], found["architecture"]) == (3, net.architecture)
        assert [p.name for p in tmp_path.iterdir()] == ["m.onnx"]

    def test_a_difference_is_refused_and_nothing_is_left(self, tmp_path, monkeypatch):
        from dronepose.model import onnx_export

        monkeypatch.setattr(onnx_export, "_compare", lambda *_: 2e-4)
        with pytest.raises(WeightsError, match=r"differs from torch by 0.0002"):
            export_onnx(small(), tmp_path / "m.onnx", height=32, width=32)
        assert not list(tmp_path.iterdir())

    def test_the_check_sees_other_weights(self, tmp_path):
        from dronepose.model import onnx_export

        path = tmp_path / "m.onnx"
        export_onnx(small(), path, height=32, width=32)
        other = onnx_export._Tuple(small(seed=4)).eval()
        assert onnx_export._compare(other, path, 32, 32) > 1e-3

    def test_wrong_arguments(self, tmp_path):
        with pytest.raises(ValueError, match=r"^path: "):
            export_onnx(small(), tmp_path / "m.pb", height=32, width=32)
        with pytest.raises(ValueError, match=r"^height: "):
            export_onnx(small(), tmp_path / "m.onnx", height=8, width=32)
        with pytest.raises(ValueError, match=r"^metadata\['image_size'\]: is \(4, 5\)"):
            export_onnx(
                small(), tmp_path / "m.onnx", height=32, width=32, metadata={"image_size": (4, 5)}
            )

    def test_the_command(self, tmp_path):
        weights, out = tmp_path / "w.safetensors", tmp_path / "m.onnx"
        save_weights(small(), weights, {"intrinsics": CAMERA, "seed": 8})
        done = run("export", "--weights", weights, "--out", out, name="dronepose")
        assert done.returncode == 0, done.stderr
        assert "largest difference" in done.stdout
        found = read_metadata(out)
        assert found["seed"] == 8
        np.testing.assert_array_equal(found["intrinsics"], CAMERA.K)

    def test_the_command_takes_a_checkpoint_of_the_authors(self, authors, tmp_path):
        theirs, out = tmp_path / "theirs.pth", tmp_path / "w.safetensors"
        torch.save({"model_state_dict": authors.state_dict()}, theirs)
        done = run("export", "--weights", theirs, "--size", "320x240", "--fov", "50.8",
                   "--out", out, name="dronepose")  # fmt: skip
        assert done.returncode == 0, done.stderr
        found = read_metadata(out)
        assert found["image_size"] == (240, 320)
        assert found["intrinsics"][1, 1] == pytest.approx(120 / np.tan(np.radians(25.4)))
        same(model_from_file(theirs), model_from_file(out), images())

    def test_the_command_refuses(self, tmp_path):
        done = run("export", "--weights", tmp_path / "no.safetensors", "--out", tmp_path / "m.onnx",
                   name="dronepose")  # fmt: skip
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("error: cannot read ")
        save_weights(small(), tmp_path / "w.safetensors")
        done = run("export", "--weights", tmp_path / "w.safetensors", "--out", tmp_path / "m.onnx",
                   name="dronepose")  # fmt: skip
        assert done.returncode == 1
        assert "--size" in done.stderr
        assert not (tmp_path / "m.onnx").exists()
