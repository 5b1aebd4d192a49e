"""The torch operator: gradients, torch's own rules, compilation, precision, errors."""

import gc
import resource
import subprocess
import sys

import numpy as np
import pytest

import scenes
from dronepose import Camera, Mesh, render
from scenes import ALL, CAMERA, CUTOFFS, SMOOTH, TETRAHEDRON
from support import EXAMPLES

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from dronepose.torch import (  # noqa: E402
    SoftSilhouette,
    from_kaolin,
    from_pytorch3d,
    silhouette,
    tangent,
)
from dronepose.torch import _models as cache  # noqa: E402
from dronepose.torch._ops import _backward_op, silhouette_op  # noqa: E402

H, W = CAMERA.height, CAMERA.width
FACES = torch.tensor(TETRAHEDRON[1])


def inputs(dtype=torch.float64, batch=2, seed=0, grad=True, distance=2.5):
    """Vertices, R, t, K of a batch."""
    R, t = scenes.poses(np.random.default_rng(seed), batch, distance)
    arrays = (TETRAHEDRON[0], R, t, CAMERA.K)
    return tuple(torch.tensor(a, dtype=dtype, requires_grad=grad) for a in arrays)


def draw(v, R, t, K, **options):
    return silhouette(v, FACES.to(v.device), R, t, K, H, W, **options)


def weights(batch=2, dtype=torch.float64, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(batch, H, W, dtype=torch.float64, generator=generator).to(dtype)


def gradients(arguments, **options):
    mask = draw(*arguments, **options)
    loss = (mask * weights(mask.shape[0], mask.dtype)).sum()
    return torch.autograd.grad(loss, [a for a in arguments if a.requires_grad])


# ---------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("options", SMOOTH, ids=scenes.name)
@pytest.mark.parametrize("near", [None, 2.2], ids=["whole", "cut"])
def test_gradcheck_in_vertices_pose_and_camera(options, near):
    arguments = inputs(distance=2.4)

    def masks(*a):
        return draw(*a, near=near, **options)

    assert torch.autograd.gradcheck(masks, arguments, atol=1e-5, nondet_tol=0.0)


@pytest.mark.parametrize("options", SMOOTH, ids=scenes.name)
def test_gradcheck_with_a_mesh_and_a_camera_for_each_pose(options):
    v, R, t, K = inputs()
    many = torch.stack([v.detach(), 1.2 * v.detach()]).requires_grad_()
    cameras = torch.stack([K.detach(), K.detach()])
    cameras[1, 0, 2] += 0.7
    arguments = (many, R, t, cameras.requires_grad_())
    assert torch.autograd.gradcheck(lambda *a: draw(*a, **options), arguments, atol=1e-5)


@pytest.mark.parametrize("options", [*ALL, *CUTOFFS], ids=scenes.name)
def test_numpy_and_torch_are_one(options):
    v, R, t, K = inputs()
    mesh = Mesh(*TETRAHEDRON)
    a = [x.detach().numpy() for x in (R, t)]
    mask = render.silhouette(mesh, CAMERA, *a, dtype=np.float64, **options)
    np.testing.assert_array_equal(draw(v, R, t, K, **options).detach(), mask)
    g = render.silhouette_gradients(mesh, CAMERA, *a, weights().numpy(), **options)
    ours = gradients((v, R, t, K), **options)
    for found, expected in zip(ours, (g.vertices, g.R, g.t, g.K.sum(axis=0)), strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(tangent(ours[1], R.detach()), render.tangent(g.R, a[0]), atol=1e-12)


def test_only_what_is_asked_for_is_computed():
    v, R, t, K = inputs(grad=False)
    assert not draw(v, R, t, K).requires_grad
    t.requires_grad_()
    (only,) = gradients((v, R, t, K))
    np.testing.assert_array_equal(only, gradients(inputs())[2])
    with torch.no_grad():
        assert not draw(*inputs()).requires_grad
    with torch.inference_mode():
        torch.testing.assert_close(draw(*inputs()), draw(v, R, t, K).detach(), rtol=0, atol=0)


def test_noise_in_a_camera_matrix_is_ignored_and_a_transposed_one_refused():
    v, R, t, K = inputs(grad=False)
    noisy = K + torch.tensor([[0, 0, 0], [1e-3, 0, 0], [5e-5, -5e-5, 5e-5]])
    assert torch.equal(draw(v, R, t, noisy), draw(v, R, t, K))
    for bad in (K.T, 2 * K, K.flip(0)):
        with pytest.raises(ValueError, match=r"^K: camera 0 has "):
            draw(v, R, t, bad)


@pytest.mark.parametrize("mode", ["coverage", "dibr", "sigmoid"])
def test_descent_finds_the_pose(mode):
    options = {"coverage": {"sigma": 1.0}, "dibr": {"delta": 100.0}, "sigmoid": {"sigma_ndc": 0.01}}
    v, R, t, K = inputs(torch.float32, batch=1, grad=False)
    target = draw(v, R, t, K, mode=mode, **options[mode])
    guess = (t + torch.tensor([[0.15, -0.1, 0.2]])).requires_grad_()
    optimizer = torch.optim.Adam([guess], lr=0.02)
    for _ in range(150):
        optimizer.zero_grad()
        loss = (draw(v, R, guess, K, mode=mode, **options[mode]) - target).square().sum()
        loss.backward()
        optimizer.step()
    assert (guess - t).abs().max() < 0.02


# ------------------------------------------------------------------------------ torch's rules


def op_arguments(v, R, t, K, mode="coverage", softness=0.5, cutoff=None, count=0, near=None):
    traced = mode == "coverage"
    return (v, FACES, R, t, K, H, W, mode, softness, cutoff, count, near, False, 1, traced)


# opcheck itself looks at .grad of tensors that have none.
OPCHECK_WARNING = "ignore:The .grad attribute of a Tensor that is not a leaf:UserWarning"


@pytest.mark.filterwarnings(OPCHECK_WARNING)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "rest",
    [
        {},
        {"mode": "hard"},
        {"mode": "dibr", "softness": 30.0, "near": 0.1},
        {"mode": "dibr", "softness": 30.0, "cutoff": 0.3, "count": 5},
        {"mode": "sigmoid", "softness": 0.02},
    ],
    ids=lambda r: r.get("mode", "coverage"),
)
def test_opcheck_passes(dtype, rest):
    torch.library.opcheck(silhouette_op, op_arguments(*inputs(dtype), **rest))


@pytest.mark.filterwarnings(OPCHECK_WARNING)
def test_opcheck_passes_with_batches_and_for_the_backward_operator():
    v, R, t, K = inputs()
    batched = (torch.stack([v.detach()] * 2).requires_grad_(), R, t, torch.stack([K.detach()] * 2))
    torch.library.opcheck(silhouette_op, op_arguments(*batched))
    plain = [a.detach() for a in (v, R, t, K)]
    rest = op_arguments(*plain)
    for wanted in (True, False):
        arguments = (weights(), *rest[:5], *rest[7:], wanted)
        torch.library.opcheck(_backward_op, arguments)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the compiler's own
@pytest.mark.parametrize("dynamic", [False, True])
def test_compilation_breaks_no_graph_and_changes_no_bit(dynamic):
    torch._dynamo.reset()

    def loss(v, R, t, K):
        mask = silhouette(v, FACES, R, t, K, H, W, sigma=0.7)
        return (mask * mask).sum() + t.square().sum()

    compiled = torch.compile(loss, fullgraph=True, dynamic=dynamic, backend="aot_eager")
    for batch in (2, 3):
        a, b = inputs(batch=batch), inputs(batch=batch)
        plain, fast = loss(*a), compiled(*b)
        torch.testing.assert_close(fast, plain, rtol=0, atol=0)
        plain.backward()
        fast.backward()
        for x, y in zip(a, b, strict=True):
            torch.testing.assert_close(y.grad, x.grad, rtol=0, atol=0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_module_compiles_with_the_default_compiler():
    torch._dynamo.reset()
    v, R, t, K = inputs(torch.float32)
    module = SoftSilhouette(torch.nn.Parameter(v.detach()), FACES, H, W, mode="dibr", delta=50.0)
    try:
        compiled = torch.compile(module, fullgraph=True)
        mask = compiled(R, t, K)
    except torch._inductor.exc.InductorError as error:  # no C++ compiler here
        pytest.skip(f"torch cannot compile: {error}")
    mask.sum().backward()
    found = t.grad.clone()
    t.grad = None
    module(R, t, K).sum().backward()
    torch.testing.assert_close(found, t.grad)
    assert module.vertices.grad is not None


def test_a_second_derivative_is_refused():
    v, R, t, K = inputs()
    (first,) = torch.autograd.grad(draw(v, R, t, K).square().sum(), t, create_graph=True)
    with pytest.raises(RuntimeError, match="has first derivatives only"):
        first.sum().backward()


def test_a_change_in_place_between_forward_and_backward_is_noticed():
    v, R, t, K = inputs()
    mask = draw(v, R, t, K)
    with torch.no_grad():
        t += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        mask.sum().backward()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_masks_and_gradients_have_the_dtype_of_the_arguments(dtype):
    arguments = inputs(dtype)
    assert draw(*arguments).dtype == dtype
    assert all(g.dtype == dtype for g in gradients(arguments))
    exact = inputs()
    torch.testing.assert_close(draw(*arguments).double(), draw(*exact), atol=1e-5, rtol=0)


def test_a_mixture_is_computed_in_double_and_gradients_keep_their_dtype():
    v, R, _, K = inputs(torch.float32)
    t = inputs()[2]
    assert draw(v, R, t, K).dtype == torch.float64
    assert [g.dtype for g in gradients((v, R, t, K))] == [torch.float32] * 2 + [
        torch.float64,
        torch.float32,
    ]


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_autocast_and_half_precision_are_drawn_in_single(half):
    v, R, t, K = inputs(torch.float32)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        layer = t @ torch.eye(3)  # which autocast makes bfloat16
        assert layer.dtype == torch.bfloat16
        mask = draw(v, R, layer, K)
        assert mask.dtype == torch.float32
        mask.sum().backward()
    assert t.grad.dtype == torch.float32
    assert t.grad.abs().sum() > 0
    low = [a.detach().to(half).requires_grad_() for a in (v, R, t, K)]
    assert draw(*low).dtype == torch.float32
    assert [g.dtype for g in gradients(low)] == [half] * 4


def test_strides_do_not_matter():
    v, R, t, K = inputs(grad=False)
    expected = draw(v, R, t, K)
    assert torch.equal(draw(v.T.contiguous().T, R.mT.contiguous().mT, t[[0, 1]], K), expected)
    shared = inputs(grad=False)[1][:1].expand(2, 3, 3)
    assert draw(v, shared, t, K).shape == (2, H, W)
    x, y = (t.clone().requires_grad_() for _ in range(2))
    draw(v, R, x, K).sum().backward()  # an expanded gradient
    (draw(v, R, y, K) * torch.ones(2, H, W)).sum().backward()
    assert torch.equal(x.grad, y.grad)


def test_an_empty_batch_has_empty_masks_and_zero_gradients():
    arguments = inputs(batch=0)
    assert draw(*arguments).shape == (0, H, W)
    assert not any(g.any() for g in gradients(arguments))


def test_threads_change_no_bit():
    arguments = inputs(batch=11)
    found = [gradients(arguments, num_threads=n) for n in (1, 2, 7)]
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_tensors_come_back_to_their_device():
    arguments = [a.detach().cuda().requires_grad_() for a in inputs()]
    mask = silhouette(arguments[0], FACES, *arguments[1:], H, W)
    assert mask.is_cuda
    mask.square().sum().backward()
    assert all(a.grad.is_cuda for a in arguments)
    torch.testing.assert_close(mask.cpu(), draw(*inputs()), rtol=0, atol=0)


# ---------------------------------------------------------------------------------- the module


def test_the_module_is_the_function():
    v, R, t, K = inputs(torch.float32)
    module = SoftSilhouette(v.detach(), FACES, H, W, sigma=0.5)
    assert torch.equal(module(R, t, K), draw(v, R, t, K, sigma=0.5))
    assert set(module.state_dict()) == {"vertices", "faces"}
    assert not list(module.parameters())
    assert repr(module) == "SoftSilhouette(12 x 16, 4 vertices, 4 faces, sigma=0.5)"
    learnt = SoftSilhouette(torch.nn.Parameter(v.detach()), FACES, H, W, sigma=0.5)
    learnt(R, t, K).square().sum().backward()
    assert learnt.vertices.grad.abs().sum() > 0
    mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
    assert SoftSilhouette.from_mesh(mesh, H, W)(R, t, K).shape == (2, H, W)
    for options in (from_kaolin(70.0, boxlen=0.1), from_pytorch3d(1e-2, 0.1)):
        assert SoftSilhouette(v.detach(), FACES, H, W, **options)(R, t, K).any()
    with pytest.raises(TypeError, match="unexpected keyword"):
        SoftSilhouette(v.detach(), FACES, H, W, colour=3)
    with pytest.raises(ValueError, match=r"^mode: "):
        SoftSilhouette(v.detach(), FACES, H, W, mode="soft")


# -------------------------------------------------------------------------------------- errors


def bad(**change):
    v, R, t, K = inputs(torch.float32, grad=False)
    arguments = {"vertices": v, "faces": FACES, "R": R, "t": t, "K": K, "height": H, "width": W}
    return silhouette(**(arguments | change))


def changed(tensor, place, value):
    tensor = tensor.clone()
    tensor[place] = value
    return tensor


V, R2, T2, K3 = inputs(torch.float32, grad=False)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"vertices": V.numpy()}, TypeError, "vertices: expected a torch.Tensor, got ndarray"),
        ({"vertices": V.long()}, TypeError, "vertices: expected floating point numbers, got"),
        ({"vertices": V[:, :2]}, ValueError, r"vertices: expected shape \(V, 3\) or \(2, V, 3\)"),
        ({"vertices": V[None]}, ValueError, r"vertices: expected shape .* got \(1, 4, 3\)"),
        ({"vertices": V[0]}, ValueError, "vertices: expected shape"),
        ({"vertices": V[:0]}, ValueError, "faces: face 0 is"),
        (
            {"vertices": changed(V, (2, 1), float("nan"))},
            ValueError,
            "vertices: vertex 2 is not finite",
        ),
        (
            {"vertices": torch.stack([V, changed(V, (0, 0), float("inf"))])},
            ValueError,
            "mesh 1 of the batch: vertices: vertex 0 is not finite",
        ),
        ({"vertices": 1e10 * V}, ValueError, "vertices: vertex 0 is"),
        ({"faces": FACES.float()}, TypeError, "faces: expected integers, got torch.float32"),
        ({"faces": FACES[:, :2]}, ValueError, r"faces: expected shape \(F, 3\), got \(4, 2\)"),
        ({"faces": FACES[:0]}, ValueError, "faces: a mesh without faces has no silhouette"),
        ({"faces": FACES - 1}, ValueError, r"faces: face 0 is \[-1, 0, 1\], expected vertices 0"),
        ({"faces": FACES + 1}, ValueError, r"faces: face 1 is .*, expected vertices 0 to 3"),
        ({"R": R2[0]}, ValueError, r"R: expected shape \(B, 3, 3\), got \(3, 3\)"),
        ({"R": changed(R2, (1, 0, 0), float("nan"))}, ValueError, r"R\[1\]: found NaN"),
        ({"t": T2[:1]}, ValueError, r"t: expected shape \(2, 3\) as R has it, got \(1, 3\)"),
        ({"t": changed(T2, (0, 2), float("inf"))}, ValueError, r"t\[0\]: found inf"),
        ({"K": K3[:2]}, ValueError, r"K: expected shape \(3, 3\) or \(2, 3, 3\), got \(2, 3\)"),
        ({"K": K3.expand(3, 3, 3)}, ValueError, "K: expected shape"),
        ({"K": changed(K3, (0, 0), -20.0)}, ValueError, "K: fx is -20; expected a focal length"),
        ({"K": changed(K3, (1, 1), 0.0)}, ValueError, "K: fy is 0; expected a focal length"),
        ({"K": changed(K3, (0, 2), float("nan"))}, ValueError, "K: cx is NaN"),
        ({"height": 0}, ValueError, "height: expected 1 to 65535 pixels, got 0"),
        ({"width": -3}, ValueError, "width: expected 1 to 65535 pixels, got -3"),
        ({"mode": "soft"}, ValueError, "mode: expected 'coverage', 'hard', 'dibr' or 'sigmoid'"),
        ({"sigma": -0.1}, ValueError, "sigma: -0.1"),
        ({"near": 0.0}, ValueError, "near: 0 m"),
        ({"num_threads": -2}, ValueError, "num_threads: expected 0"),
        ({"kaolin_cutoff": (0.02, 30)}, ValueError, "kaolin_cutoff: belongs to mode 'dibr'"),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(change, error, text):
    with pytest.raises(error, match=f"^{text}"):
        bad(**change)


def test_check_finite_names_the_pixel():
    v, R, t, K = inputs()
    upstream = weights()
    upstream[1, 3, 4] = float("nan")
    mask = draw(v, R, t, K)
    mask.backward(upstream)  # goes through without the flag
    mask = draw(v, R, t, K, check_finite=True)
    with pytest.raises(RuntimeError, match="masks is nan at image 1, row 3, column 4"):
        mask.backward(upstream)
    draw(v, R, t, K, check_finite=True).backward(weights())


def test_check_finite_names_the_face():
    v, R, t, K = inputs()
    # Finite, but their sums are not.
    mask = draw(v, R, t, K, check_finite=True)
    with pytest.raises(RuntimeError, match=r"at vertex \d of mesh 0, in face \d"):
        mask.backward(1e308 * weights().sign())


# --------------------------------------------------------------------------- kept models, memory


def test_models_are_found_again_by_content(monkeypatch):
    monkeypatch.setattr(cache, "_kept", ())
    v, faces = TETRAHEDRON[0].copy(), TETRAHEDRON[1].copy()
    (first,) = cache.models(v, faces)
    assert cache.models(v.copy(), faces.copy())[0] is first
    v[0, 0] += 0.1  # in place: the copy that was kept is another
    (second,) = cache.models(v, faces)
    assert second is not first
    v[0, 0] -= 0.1
    assert len(cache._kept) == 2
    for k in range(20):
        cache.models(v + k + 1, faces)
    assert len(cache._kept) == 8
    assert cache.models(v, faces)[0] is not first


def test_kept_models_are_bounded(monkeypatch):
    monkeypatch.setattr(cache, "_kept", ())
    monkeypatch.setattr(cache, "_ELEMENTS", 40)
    for k in range(5):
        cache.models(TETRAHEDRON[0] + np.full((4, 1, 1), k), TETRAHEDRON[1])
        assert len(cache._kept) == 1  # 4 models of 4 + 4: another would be too much
    cache.models(TETRAHEDRON[0] + 9, TETRAHEDRON[1])
    assert [len(entry.models) for entry in cache._kept] == [1, 4]


def test_vertices_that_change_each_step_give_what_new_ones_give(monkeypatch):
    _, R, t, K = inputs(grad=False)
    for k in range(4):
        v = torch.tensor(TETRAHEDRON[0]) * (1 + 0.1 * k)
        if k == 2:
            v[3] = v[0]  # corners that meet: the edges are found anew
        masks = draw(v, R, t, K)
        expected = render.silhouette(
            Mesh(v.numpy(), FACES.numpy()), CAMERA, R.numpy(), t.numpy(), dtype=np.float64
        )
        np.testing.assert_array_equal(masks, expected)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads kilobytes of ru_maxrss")
def test_memory_does_not_grow_with_calls():
    mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
    camera = Camera.from_fov(320, 240, horizontal_deg=64.69)
    v, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    R, t = (torch.tensor(a) for a in scenes.poses(np.random.default_rng(0), 8, 1.0, 0.05))
    K = torch.tensor(camera.K)

    def step(k):
        vertices = (v * (1 + 1e-3 * k)).requires_grad_()
        mask = silhouette(vertices, faces, R, t, K, camera.height, camera.width, sigma=1.0)
        mask.square().sum().backward()

    def peak():
        gc.collect()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    for k in range(12):
        step(k)
    before = peak()
    for k in range(60):
        step(k)
    assert peak() - before < 20  # MiB; a batch is 4.7, in each of 60 calls


def test_without_torch_the_remedy_is_named():
    code = (
        "import sys\nsys.modules['torch'] = None\nimport dronepose\n"
        "try:\n    dronepose.torch\nexcept ImportError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "dronepose[torch]"' in done.stdout


def test_the_package_and_the_renderer_do_not_import_torch():
    code = "import sys, dronepose\ndronepose.render\nassert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
