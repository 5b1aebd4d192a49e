"""Tensors that are not on the CPU: moved there, and what comes of them back."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import scenes
from scenes import ALL

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from torch.utils import backend_registration  # noqa: E402

import torch_workers  # noqa: E402

if not hasattr(backend_registration, "_setup_privateuseone_for_python_backend"):
    pytest.skip("this PyTorch knows no devices written in Python", allow_module_level=True)

CPU, AWAY = "cpu", "elsewhere"


@pytest.fixture(scope="module")
def elsewhere():
    """Runs a function of ``torch_elsewhere`` in a process that has such a device."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        yield lambda name, *given: pool.submit(torch_workers.elsewhere, name, given).result()


def test_the_device_is_none_that_the_cpu_can_read(elsewhere):
    assert "can't convert elsewhere:0 device type tensor to numpy" in elsewhere("refuses_numpy")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["single", "double"])
@pytest.mark.parametrize("options", ALL, ids=scenes.name)
def test_masks_and_gradients_come_back_to_the_device_bit_for_bit(elsewhere, options, dtype):
    here, _ = elsewhere("drawn", dtype, options, [CPU] * 5)
    there, devices = elsewhere("drawn", dtype, options, [AWAY] * 5)
    assert len(there) == len(here) >= 1
    assert set(devices) == {AWAY}
    for k, (a, b) in enumerate(zip(here, there, strict=True)):
        assert a.dtype == b.dtype
        assert a.any() or (k > 0 and options["mode"] == "hard")
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("moved", range(5), ids=["faces", "vertices", "R", "t", "K"])
def test_masks_follow_the_rotations_and_each_gradient_its_tensor(elsewhere, moved):
    places = [CPU] * 5
    places[moved] = AWAY
    here, _ = elsewhere("drawn", torch.float32, {"sigma": 1.0}, [CPU] * 5)
    there, devices = elsewhere("drawn", torch.float32, {"sigma": 1.0}, places, True)
    assert devices == [places[2], *places[1:]]
    for a, b in zip(here, there, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_module_moves_with_its_mesh(elsewhere):
    here, there = elsewhere("module")
    assert here.any()
    np.testing.assert_array_equal(here, there)


def test_errors_name_what_is_wrong_wherever_it_is(elsewhere):
    assert elsewhere("refusal").startswith("vertices: ")
