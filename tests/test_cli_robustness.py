"""Odd files, odd outputs and interrupts: no hang, no partial file, no control characters."""

import gzip
import os
import signal
import subprocess
import sys
import time

import pytest

from support import command, loads, run

HEADER = "id,qw,qx,qy,qz,tx,ty,tz\n"
ROW = "a,1,0,0,0,0,0,1\n"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="devices and pipes of Linux")


@pytest.fixture
def poses(tmp_path):
    """A file of one pose."""
    path = tmp_path / "poses.csv"
    path.write_text(HEADER + ROW, encoding="utf-8")
    return path


def refused(*args, cwd=None):
    """The one line that the command ends with."""
    done = run(*args, cwd=cwd, timeout=60)
    assert done.returncode == 1, done
    assert not done.stdout
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert done.stderr[:-1].isprintable()
    return done.stderr


@pytest.mark.parametrize("option", ["--mesh", "--camera", "--symmetries"])
def test_an_endless_file_is_refused(poses, option):
    assert "larger than" in refused(poses, poses, option, "/dev/zero")


def test_endless_predictions_are_refused(poses):
    assert "binary data" in refused("/dev/zero", poses)


@pytest.mark.parametrize(
    ("start", "piece"),
    [
        (HEADER, b"\0"),
        (HEADER, b"1"),
        (HEADER, b"\n"),
        (HEADER + '"', b"\n"),
        (HEADER, b","),
        ('[{"filename":"x","q":[', b"0,"),
        ('{"1":[{"cam_R_m2c":[', b"0,"),
    ],
    ids=["zeros", "one number", "blank lines", "a quote", "commas", "SPEED", "BOP"],
)
def test_a_small_packed_file_does_not_fill_the_memory(tmp_path, poses, start, piece):
    bomb = tmp_path / "bomb.gz"
    member = gzip.compress(piece * (1 << 24), 1)
    bomb.write_bytes(gzip.compress(start.encode()) + 100 * member)
    refused(bomb, poses)


def test_a_mesh_may_be_a_pipe(poses):
    reader, writer = os.pipe()
    with os.fdopen(writer, "wb") as pipe:
        pipe.write(b"v 0 0 0\nv 1 0 0\n")
    with os.fdopen(reader, "rb"):
        done = subprocess.run(
            [*command(), poses, poses, "--mesh", f"/dev/fd/{reader}", "--json", "-"],
            pass_fds=[reader],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert loads(done.stdout)["inputs"]


def test_a_full_disk_is_an_error(poses):
    assert "No space left" in refused(poses, poses, "--json", "/dev/full")
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123
        done = subprocess.run([*command(), poses, poses], stdout=full, timeout=60, check=False)
    assert done.returncode == 1


def test_a_reader_may_go_away(poses):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as pipe:
        done = subprocess.run(
            [*command(), poses, poses],
            stdout=pipe,
            stderr=subprocess.PIPE,
            timeout=60,
            check=False,
        )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_that_cannot_be_written(tmp_path, poses):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    assert "Permission denied" in refused(poses, poses, "--json", folder / "out.json")


def test_a_link_keeps_pointing_where_it_did(tmp_path, poses):
    link = tmp_path / "link.json"
    link.symlink_to("there.json")
    assert run(poses, poses, "--json", link).returncode == 0
    assert link.is_symlink()
    assert loads((tmp_path / "there.json").read_text(encoding="utf-8"))


def test_no_input_is_written_over(poses):
    done = run(poses, poses, "--per-sample", poses)
    assert done.returncode == 2
    assert poses.read_text(encoding="utf-8") == HEADER + ROW


def test_an_id_cannot_steer_the_terminal(tmp_path, poses):
    steering = tmp_path / "steering.csv"
    steering.write_text(HEADER + ROW + ROW.replace("a", "\x1b[2J\x07b", 1), encoding="utf-8")
    for arguments in [(steering, poses), (poses, steering)]:
        done = run(*arguments, timeout=60)
        assert done.returncode == 0
        assert done.stderr
        assert "\x1b" not in done.stdout + done.stderr
        assert "\x07" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    "row",
    [
        "a,1e300,1e300,0,0,0,0,1",
        "a,1.7e308,1.7e308,1.7e308,1.7e308,0,0,1",
        "a,1,5e-324,0,0,5e-324,0,1",
        "a,-0.0,-1,-0.0,-0.0,-0.0,0,1",
        "a,1,0,0,0,1e15,1e15,1e15",
        "a,1,0,0,0,1e-160,0,1e-160",
    ],
)
def test_numbers_at_the_edges_are_scored(tmp_path, poses, row):
    odd = tmp_path / "odd.csv"
    odd.write_text(HEADER + row + "\n", encoding="utf-8")
    for arguments in [(odd, poses), (poses, odd), (odd, odd)]:
        done = run(*arguments, timeout=60)
        if done.returncode == 0:
            words = (done.stdout + done.stderr).lower().split()
            assert not {"nan", "inf", "-inf"} & set(words)
            loads(run(*arguments, "--json", "-").stdout)
        else:
            refused(*arguments)


@pytest.mark.slow
def test_an_interrupt_leaves_no_file(tmp_path):
    big = tmp_path / "big.csv"
    rows = "".join(f"{k},1,0,0,0,0,0,1\n" for k in range(1_000_000))
    big.write_text(HEADER + rows, encoding="utf-8")
    folder = tmp_path / "out"
    folder.mkdir()
    started = subprocess.Popen(
        [*command(), big, big, "--per-sample", folder / "out.csv"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while started.poll() is None and not any(folder.iterdir()):
        time.sleep(0.01)
    started.send_signal(signal.SIGINT)
    code = started.wait(60)
    left = [p.name for p in folder.iterdir()]
    assert (code, left) in [(130, []), (0, ["out.csv"])]
