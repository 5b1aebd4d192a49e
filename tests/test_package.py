"""The package as a whole: what it imports, its names, its stub, its version."""

import ast
import os
import signal
import subprocess
import sys
import tomllib
from importlib import metadata

import pytest

import dronepose
from support import EXAMPLES, ROOT, run

HEAVY = {"numpy", "torch", "scipy", "trimesh", "dronepose.metrics", "dronepose.evaluation"}


def modules_after(code):
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(sorted(sys.modules))"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(ast.literal_eval(done.stdout.splitlines()[-1]))


def test_importing_the_package_loads_nothing_heavy():
    assert not modules_after("import dronepose") & HEAVY


def test_the_command_loads_neither_numpy_nor_torch():
    arguments = [str(EXAMPLES / "predictions.csv"), str(EXAMPLES / "gt.csv"), "--quiet"]
    code = f"from dronepose.cli import main\nassert main({arguments!r}) == 0"
    assert not modules_after(code) & HEAVY


def test_names_are_loaded_when_they_are_used():
    loaded = modules_after("import dronepose\ndronepose.Camera")
    assert "dronepose.camera" in loaded
    assert "dronepose.evaluation" not in loaded


def test_every_public_name_resolves():
    for name in dronepose.__all__:
        assert getattr(dronepose, name) is not None
        assert name in dir(dronepose)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = dronepose.nothing


def test_the_version_is_one():
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    version = cargo["workspace"]["package"]["version"]
    assert dronepose.__version__ == version
    assert metadata.version("dronepose") == version
    assert version in run("--version").stdout


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "python" / "dronepose" / "py.typed").exists()


def test_the_stub_matches_the_extension():
    pytest.importorskip("mypy")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "dronepose._native"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_exit_codes_of_the_command(tmp_path):
    good = [EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv"]
    assert run(*good).returncode == 0
    assert run(tmp_path / "none.csv", good[1]).returncode == 1
    done = run(*good, "--no-such-option")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--no-such-option" in done.stderr


def test_a_closed_pipe_is_no_error():
    process = subprocess.Popen(
        [sys.executable, "-m", "dronepose.cli", "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    errors = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 0
    assert errors == b""


def test_ctrl_c_is_left_to_the_system():
    code = (
        "import signal\nfrom dronepose.cli import main\nmain(['--version'])\n"
        "assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_DFL


@pytest.mark.skipif(not hasattr(os, "fork"), reason="cannot fork")
def test_a_child_of_a_process_that_ran_the_command_can_be_terminated():
    code = (
        "import os, signal, time\nfrom dronepose.cli import main\nmain(['--version'])\n"
        "child = os.fork()\n"
        "if child == 0:\n    signal.alarm(60)\n    while True:\n        time.sleep(1)\n"
        "time.sleep(0.2)\nos.kill(child, signal.SIGTERM)\n"
        "assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGTERM"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_the_results_are_flushed_when_python_ends(tmp_path):
    out = tmp_path / "out.txt"
    with out.open("w") as file:
        paths = [EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv"]
        subprocess.run(
            [sys.executable, "-m", "dronepose.cli", *paths, "--json", "-"],
            stdout=file,
            check=True,
        )
    assert out.read_text().rstrip().endswith("}")
