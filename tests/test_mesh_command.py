"""`dronepose mesh`: what a file holds, and fewer faces."""

import json

import numpy as np
import pytest

from support import run

cv2 = pytest.importorskip("cv2")

from dronepose import Mesh  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402


def mesh(*arguments):
    return run("mesh", *arguments, name="dronepose")


def test_the_example_is_a_drone_in_metres(tmp_path):
    picture = tmp_path / "p.png"
    done = mesh("check", EXAMPLE_MESH, "--picture", picture)
    assert done.returncode == 0, done.stderr
    assert "3912" in done.stdout
    drawn = cv2.imread(str(picture))
    assert drawn.shape == (240, 960, 3)
    for side in np.split(drawn, 4, axis=1):
        assert (side.std(axis=-1) + np.abs(side.astype(float).mean(-1) - 243) > 12).mean() > 0.02
    found = json.loads(mesh("check", EXAMPLE_MESH, "--json").stdout)
    assert found["unit_guess"] == "metres"
    assert found["faces"] == 3912
    assert found["notes"] == []


def test_a_wrong_unit_and_too_many_faces_are_told():
    done = mesh("check", EXAMPLE_MESH, "--unit", "mm", "--budget", 1000, "--json")
    notes = " ".join(json.loads(done.stdout)["notes"])
    assert "as a drone it would be in" in notes
    assert "--faces 1000" in notes


def test_fewer_faces_keep_the_box(tmp_path):
    pytest.importorskip("fast_simplification")
    out = tmp_path / "small.obj"
    done = mesh("simplify", EXAMPLE_MESH, "--faces", 1500, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    small, whole = Mesh.from_file(out), Mesh.from_file(EXAMPLE_MESH)
    assert len(small.faces) <= 1500
    np.testing.assert_allclose(small.bounds, whole.bounds, atol=0.01)
    assert json.loads(done.stdout)["box_moved_m"] < 0.01
    same = tmp_path / "same.obj"
    mesh("simplify", EXAMPLE_MESH, "--faces", 9000, "--out", same)
    assert len(Mesh.from_file(same).faces) == 3912


def test_errors_name_what_is_wrong(tmp_path):
    for arguments, message in (
        (("check", tmp_path / "no.obj"), "no.obj"),
        (("simplify", EXAMPLE_MESH, "--faces", 2, "--out", "a.obj"), "--faces: expected 4"),
        (("simplify", EXAMPLE_MESH, "--faces", 9, "--out", "a.stl"), "--out: expected an OBJ"),
    ):
        done = mesh(*arguments)
        assert done.returncode == 1
        assert done.stderr.startswith("error: ")
        assert message in done.stderr
    assert mesh("check").returncode == 2
