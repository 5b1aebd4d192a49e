"""Forked and spawned processes, and threads: what data loaders do to a library."""

import multiprocessing
import sys
import threading

import numpy as np
import pytest

import workers
from dronepose import Mesh, Symmetries, _native
from poses import HALF_TURN, near, random_mesh, random_poses
from support import EXAMPLES, FORK_WARNING

# Much longer than it takes: a process that hangs fails, a machine that is busy does not.
PATIENCE = 300.0


def in_child(method, *arguments):
    with multiprocessing.get_context(method).Pool(1) as pool:
        return pool.apply_async(workers.both, arguments).get(timeout=PATIENCE)


@pytest.fixture
def model():
    # Arrays, not the file: the evaluation names its inputs, and a copy has forgotten the file.
    mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
    return Mesh(mesh.vertices, mesh.faces), Symmetries(HALF_TURN[None])


@pytest.mark.filterwarnings(FORK_WARNING)
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_a_child_computes_what_its_parent_computed(method, model):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system cannot {method}")
    errors, evaluation = workers.both(*model)  # the parent's pool exists before the child does
    theirs, their_evaluation = in_child(method, *model)
    for a, b in zip(errors, theirs, strict=True):
        np.testing.assert_array_equal(a, b)
    assert evaluation == their_evaluation
    # And the parent goes on.
    np.testing.assert_array_equal(workers.errors(*model)[2], errors[2])


@pytest.mark.filterwarnings(FORK_WARNING)
@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="cannot fork")
def test_a_fork_in_the_middle_of_a_computation(model):
    stop = threading.Event()

    def compute():
        while not stop.is_set():
            workers.errors(*model, n=200)

    expected = workers.errors(*model)
    busy = threading.Thread(target=compute)
    busy.start()
    try:
        for _ in range(3):
            theirs, _ = in_child("fork", *model)
            for a, b in zip(expected, theirs, strict=True):
                np.testing.assert_array_equal(a, b)
    finally:
        stop.set()
        busy.join()


class Counter:
    """Counts on a thread of its own whenever Python lets it."""

    def __init__(self):
        self.count = 0
        self._stop = False
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        self._started.set()
        while not self._stop:
            self.count += 1
            self._nap.wait(1e-4)

    _nap = threading.Event()

    def __enter__(self):
        # Nobody is interrupted: another thread runs only when a call lets go of the interpreter.
        self._interval = sys.getswitchinterval()
        self._thread.start()
        self._started.wait()
        sys.setswitchinterval(1000.0)
        return self

    def __exit__(self, *_):
        sys.setswitchinterval(self._interval)
        self._stop = True
        self._thread.join()


@pytest.mark.parametrize("function", ["add", "adds", "mssd", "evaluate"])
def test_python_goes_on_during_a_native_call(function):
    rng = np.random.default_rng(5)
    mesh, gt = random_mesh(rng, 500), random_poses(rng, 3000)
    poses = near(rng, *gt) + gt
    native = mesh._native
    files = [str(path) for path in workers.FILES]
    call = {
        "add": lambda: _native.add(native, *poses, 1),
        "adds": lambda: _native.adds(native, *poses, 1),
        "mssd": lambda: _native.mssd(native, *poses, Symmetries(HALF_TURN[None])._native, 1),
        "evaluate": lambda: _native.evaluate(["--bootstrap=20", "--threads=1"], *files, None),
    }[function]
    with Counter() as counter:
        for _ in range(1000):  # the first call is enough, unless the machine looks away
            before = counter.count
            call()
            after = counter.count
            if after > before:
                return
    pytest.fail("no other thread ran during 1000 calls")
