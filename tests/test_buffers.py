"""Memory of masks: it comes back, is bounded, and belongs to one array at a time."""

import subprocess
import sys
import threading

import numpy as np

from dronepose._buffers import Buffers


def test_memory_comes_back_when_the_last_view_is_gone():
    pool = Buffers()
    shape = (8, 200, 200)
    first = pool.empty(shape, np.float32)
    address, corner = first.ctypes.data, first[3, :2, :2]
    del first
    assert pool.kept() == 0  # a view is still there
    assert pool.empty(shape, np.float32).ctypes.data != address
    corner[:] = 3.0
    assert (corner == 3).all()
    del corner
    again = [pool.empty(shape, np.float32) for _ in range(2)]
    assert address in [a.ctypes.data for a in again]
    assert again[0].flags.c_contiguous
    assert again[0].flags.writeable
    assert not np.shares_memory(*again)


def test_memory_that_is_kept_is_bounded():
    pool = Buffers(limit=1 << 21)
    arrays = [pool.empty((1 << 18,), np.float32) for _ in range(9)]
    del arrays
    assert 0 < pool.kept() <= 1 << 21
    big = pool.empty((1 << 20,), np.float64)
    del big
    assert pool.kept() <= 1 << 21
    pool.clear()
    assert pool.kept() == 0


def test_memory_is_never_shared_between_threads():
    pool, clashes = Buffers(), []

    def work(mark):
        for _ in range(300):
            a = pool.empty((70_000,), np.float32)
            a.fill(mark)
            b = pool.empty((70_000,), np.float32)
            b.fill(-mark)
            if not ((a == mark).all() and (b == -mark).all()):
                clashes.append(mark)
            del a, b

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        threads = [threading.Thread(target=work, args=(k,)) for k in range(1, 5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not clashes


def test_arrays_that_outlive_everything_are_no_error():
    code = (
        "import numpy as np\nfrom dronepose._buffers import BUFFERS\n"
        "kept = [BUFFERS.empty((1 << 20,), 'f4') for _ in range(3)]\n"
        "np.late = BUFFERS.empty((1 << 20,), 'f4')[3:]"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
