"""The example files: made by their script, and what their README promises."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dronepose import Camera, Mesh
from support import EXAMPLES, evaluate, rows


def script(*args):
    return subprocess.run(
        [sys.executable, EXAMPLES / "make_examples.py", *args],
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_files_are_what_the_script_makes():
    done = script("--check")
    assert done.returncode == 0, done.stderr


def test_the_check_sees_a_change(tmp_path):
    assert script("--folder", tmp_path).returncode == 0
    path = tmp_path / "gt.csv"
    lines = path.read_text().splitlines(keepends=True)
    fields = lines[7].split(",")
    fields[5] = f"{float(fields[5]) + 1e-5:.6f}"
    lines[7] = ",".join(fields)
    path.write_text("".join(lines))
    done = script("--check", "--folder", tmp_path)
    assert done.returncode == 1
    assert "gt.csv: line 8" in done.stderr


def test_the_quadrotor_is_closed_and_of_its_size():
    mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
    assert 2500 <= len(mesh.faces) <= 4000
    check = mesh.check()
    assert check["closed"] is True
    assert check["duplicate_vertices"] == check["degenerate_faces"] == 0
    assert check["unreferenced_vertices"] == 0
    assert 0.35 < mesh.diameter < 0.6
    # Left and right are alike but for the gimbal, front and back are not.
    (x0, y0, _), (x1, y1, _) = mesh.bounds
    assert abs(y0 + y1) < 2e-3
    # All parts look outwards: the enclosed volume is that of a small drone.
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert 5e-4 < np.einsum("ij,ij->", a, np.cross(b, c)) / 6 < 3e-3
    assert x1 - x0 < 0.5


def test_the_drones_are_in_the_image_and_in_range():
    table = rows(EXAMPLES / "gt.csv")
    assert len(table) == len({r["id"] for r in table}) == 2000
    assert 4 <= len({r["scene"] for r in table}) <= 10
    t = np.array([[float(r[k]) for k in ("tx", "ty", "tz")] for r in table])
    distance = np.linalg.norm(t, axis=1)
    assert distance.min() >= 0.8 - 1e-6
    assert distance.max() <= 5.0 + 1e-6
    assert np.mean(distance < 1.5) > 0.85
    uv = t @ Camera.from_fov(320, 240, horizontal_deg=64.69).K.T
    uv = uv[:, :2] / uv[:, 2:]
    assert (t[:, 2] > 0).all()
    assert ((uv > 0) & (uv < [320, 240])).all()
    q = np.array([[float(r[k]) for k in ("qx", "qy", "qz", "qw")] for r in table])
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-7)
    up = Rotation.from_quat(q).as_matrix()[:, :, 2]
    assert np.degrees(np.arccos(-up[:, 1])).max() < 75  # drones fly upright
    forward = Rotation.from_quat(q).as_matrix()[:, :, 0]
    yaw = np.histogram(np.arctan2(forward[:, 0], forward[:, 2]), bins=8, range=(-np.pi, np.pi))
    assert yaw[0].min() > 150  # and in every direction


def test_the_numbers_that_the_readme_tells():
    paths = [EXAMPLES / n for n in ("predictions.csv", "gt.csv")]
    result = evaluate(*paths, "--mesh", EXAMPLES / "quadrotor.obj")
    assert result["n_gt"] == 2000
    assert 0.95 < result["n_matched"] / 2000 < 0.98
    metrics = result["metrics"]
    assert metrics["npe"]["mean"] == pytest.approx(0.02, abs=0.003)
    assert metrics["oe_rad"]["mean"] == pytest.approx(0.06, abs=0.01)
    assert 80 < metrics["acc"]["5"]["percent_of_gt"] < 92
    assert metrics["oe_deg"]["max"] > 170  # a drone taken for one that flies the other way
    assert result["worst"][0]["oe_deg"] > 170


def test_the_baseline_is_worse_beyond_doubt():
    result = evaluate(
        EXAMPLES / "predictions.csv",
        EXAMPLES / "gt.csv",
        "--compare",
        EXAMPLES / "predictions_baseline.csv",
        "--bootstrap",
        200,
    )
    difference = result["compare"][0]["difference"]
    for key in ("npe", "oe_rad", "cpe"):
        assert difference[key]["ci95"][0] > 0
        assert difference[key]["p"] < 0.05
