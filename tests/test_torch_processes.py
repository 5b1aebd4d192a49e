"""Silhouettes in data loaders' workers, forked and spawned."""

import os
import signal
import threading

import numpy as np
import pytest

import scenes
from dronepose import Mesh, render
from scenes import CAMERA, TETRAHEDRON
from support import CORES_WARNING, FORK_WARNING

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import torch_workers  # noqa: E402

PATIENCE = 120  # seconds: a process that hangs fails, a machine that is busy does not


@pytest.mark.slow
@pytest.mark.filterwarnings(FORK_WARNING, CORES_WARNING)
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_the_workers_of_a_data_loader_draw_what_their_parent_draws(method):
    data = torch_workers.Masks(6)
    expected = [data[k] for k in range(6)]  # the parent's threads exist before the workers do
    loader = torch.utils.data.DataLoader(
        data, batch_size=2, num_workers=2, multiprocessing_context=method, timeout=PATIENCE
    )
    masks = torch.cat([mask for mask, _ in loader])
    assert torch.equal(masks, torch.stack([mask for mask, _ in expected]))
    gradients = torch.cat([gradient for _, gradient in loader])
    assert torch.equal(gradients, torch.stack([gradient for _, gradient in expected]))
    assert torch.equal(data[3][0], expected[3][0])  # and the parent goes on


@pytest.mark.filterwarnings(FORK_WARNING)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="cannot fork")
def test_a_plain_fork_draws_too():
    mesh, (R, t) = Mesh(*TETRAHEDRON), scenes.poses(np.random.default_rng(0), 5)
    expected = render.silhouette(mesh, CAMERA, R, t)
    kept = render.silhouette(mesh, CAMERA, R, t)
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(PATIENCE)
            same = np.array_equal(render.silhouette(mesh, CAMERA, R, t), expected)
            g = render.silhouette_gradients(mesh, CAMERA, R, t, expected)
            os._exit(0 if same and np.isfinite(g.R).all() and (kept == expected).all() else 1)
        except BaseException:
            os._exit(2)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    np.testing.assert_array_equal(render.silhouette(mesh, CAMERA, R, t), expected)


@pytest.mark.filterwarnings(FORK_WARNING)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="cannot fork")
@pytest.mark.parametrize("before", [(1,), (2,), (1, 2, 1)])
def test_a_thread_that_drew_by_itself_forks(before):
    mesh, (R, t) = Mesh(*TETRAHEDRON), scenes.poses(np.random.default_rng(1), 5)
    drawn = [render.silhouette(mesh, CAMERA, R, t, threads=threads) for threads in before]
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(PATIENCE)
            again = [render.silhouette(mesh, CAMERA, R, t, threads=k) for k in (1, 2, 1, 0)]
            os._exit(0 if all(np.array_equal(mask, drawn[0]) for mask in again) else 1)
        except BaseException:
            os._exit(2)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    for threads in (1, 2, 0):
        again = render.silhouette(mesh, CAMERA, R, t, threads=threads)
        np.testing.assert_array_equal(again, drawn[0])


def test_many_threads_draw_by_themselves():
    mesh, (R, t) = Mesh(*TETRAHEDRON), scenes.poses(np.random.default_rng(2), 1)
    expected, found = render.silhouette(mesh, CAMERA, R, t), []

    def draw():
        found.extend(render.silhouette(mesh, CAMERA, R, t, threads=k) for k in (1, 0, 2))

    for _ in range(30):  # more in all than may each be a pool of their own
        crowd = [threading.Thread(target=draw) for _ in range(10)]
        for thread in crowd:
            thread.start()
        for thread in crowd:
            thread.join()
    assert len(found) == 900
    assert all(np.array_equal(mask, expected) for mask in found)
