"""Flights and anchors: what is read, what is refused, and the rate they are brought to."""

import gzip
import json

import numpy as np
import pytest

from dronepose import _native
from dronepose.geometry import matrix_from_quat_wxyz, matrix_from_quat_xyzw
from dronepose.synth import (
    Anchors,
    Placement,
    Rules,
    Track,
    fit_placement,
    read_anchors,
    read_flight,
    sample_free_space,
    write_example,
)
from dronepose.synth.example import example_flight

RADIANS = np.radians


def tum(path, time, positions, quat_wxyz, comment="# t x y z qx qy qz qw\n"):
    """Writes a TUM file."""
    q = np.roll(quat_wxyz, -1, axis=1)
    rows = [
        " ".join(map(repr, map(float, (t, *p, *r))))
        for t, p, r in zip(time, positions, q, strict=True)
    ]
    path.write_text(comment + "\n".join(rows) + "\n")
    return path


def flown(n=60, rate=100.0, seed=0):
    """A smooth random flight: times, positions, quaternions."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / rate
    a, w = rng.normal(size=(3, 3)), rng.uniform(1, 4, (3, 3))
    p = np.stack([(a[k] * np.sin(np.outer(t, w[k]))).sum(axis=1) for k in range(3)], axis=1)
    q = np.stack([np.ones(n), *(0.5 * np.sin(np.outer([1, 2, 3], t)))], axis=1)
    return t, p, q / np.linalg.norm(q, axis=1, keepdims=True)


def angle(a, b):
    m = np.einsum("nji,njk->nik", a, b)
    return np.degrees(np.arccos(np.clip((np.trace(m, axis1=1, axis2=2) - 1) / 2, -1, 1)))


def test_one_flight_in_every_format_is_one_flight(tmp_path):
    t, p, q = flown()
    R = matrix_from_quat_wxyz(q)
    ns = [1403715524907143168 + round(x * 1e9) for x in t]
    files = {"tum": tum(tmp_path / "flight.txt", t + 10, p, q)}
    # AirSim: north-east-down, front-right-down.
    flip = np.diag([1.0, -1.0, -1.0])
    mirrored = q * [1, 1, -1, -1]
    assert np.allclose(matrix_from_quat_wxyz(mirrored), flip @ R @ flip)
    head = "VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile\n"
    rows = [
        "\t".join(["drone", str(1726962106112 + round(x * 1000)), *map(repr, [*a, *b]), "i.png"])
        for x, a, b in zip(t, (p @ flip).tolist(), mirrored.tolist(), strict=True)
    ]
    files["airsim"] = tmp_path / "airsim_rec.txt"
    files["airsim"].write_text(head + "\n".join(rows) + "\n")
    # EuRoC: its IMU's x is up, y right, z forward.
    imu = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])  # forward-left-up from the IMU's axes
    h = np.sqrt(0.5)
    turn = np.array([0.0, h, 0.0, h])
    assert np.allclose(matrix_from_quat_wxyz(turn), imu)
    sensor = np.array([product(x, turn) for x in q])
    rows = [
        ",".join([str(n), *map(repr, [*a, *b]), "0"])
        for n, a, b in zip(ns, p.tolist(), sensor.tolist(), strict=True)
    ]
    files["euroc"] = tmp_path / "data.csv"
    files["euroc"].write_text("#timestamp, p_RS_R_x [m]\n" + "\n".join(rows) + "\n")
    rows = [
        ",".join(map(repr, [*b, *a, n])) for n, a, b in zip(ns, p.tolist(), q.tolist(), strict=True)
    ]
    files["csv"] = tmp_path / "flight.csv"
    files["csv"].write_text("qw,qx,qy,qz,x,y,z,t_ns\n" + "\n".join(rows) + "\n")
    for name, path in files.items():
        flight = read_flight(path)
        assert flight.facts["conventions"]["format"] == name
        np.testing.assert_allclose(flight.time_s, t, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(flight.positions, p, atol=1e-12, err_msg=name)
        R_read = matrix_from_quat_wxyz(flight.quat_wxyz)
        np.testing.assert_allclose(R_read, R, atol=1e-12, err_msg=name)
        again = read_flight(path, format=name)
        np.testing.assert_array_equal(again.positions, flight.positions)
    packed = tmp_path / "flight.txt.gz"
    packed.write_bytes(gzip.compress(files["tum"].read_bytes()))
    np.testing.assert_array_equal(
        read_flight(packed).positions, read_flight(files["tum"]).positions
    )


def product(a, b):
    (w, *v), (s, *u) = a, b
    v, u = np.array(v), np.array(u)
    return np.array([w * s - v @ u, *(w * u + s * v + np.cross(v, u))])


def test_uava_is_read_as_its_training_set_reads_it(tmp_path):
    """The body of a UAVA file is the paper's mesh: x left, y up, z forward."""
    rng = np.random.default_rng(1)
    names = []
    for step in ("_t1", "_t2"):
        names += [f"Position({a}){step}" for a in "xyz"]
        names += [f"Orientation({a}){step}" for a in "xyzw"]
    _t, p, q = flown(5)
    xyzw = np.roll(q, -1, axis=1)
    rows = [[*p[k], *xyzw[k], *p[k + 1], *xyzw[k + 1], *rng.normal(size=7)] for k in range(4)]
    names += [f"Pilot({a})" for a in "xyz"] + [f"PilotRot({a})" for a in "xyzw"]
    path = tmp_path / "blender_x.txt"
    lines = ["\t".join(names), *("\t".join(f"{x:.9f}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    flight = read_flight(path)
    assert flight.facts["conventions"]["body_axes"] == "luf"
    assert (len(flight), len(flight.issues)) == (5, 0)
    np.testing.assert_allclose(flight.positions, p, atol=1e-8)
    # Forward in the mesh is z.
    forward = matrix_from_quat_xyzw(xyzw)[:, :, 2]
    np.testing.assert_allclose(matrix_from_quat_wxyz(flight.quat_wxyz)[:, :, 0], forward, atol=1e-7)
    raw = read_flight(path, body_axes="flu")
    np.testing.assert_allclose(
        matrix_from_quat_wxyz(raw.quat_wxyz), matrix_from_quat_xyzw(xyzw), atol=1e-7
    )


def test_resampling_is_the_natural_spline_and_slerp(tmp_path):
    interpolate = pytest.importorskip("scipy.interpolate", reason="SciPy is not installed")
    spatial = pytest.importorskip("scipy.spatial.transform", reason="SciPy is not installed")
    rng = np.random.default_rng(2)
    t, p, q = flown(80)
    t = t + rng.uniform(0, 0.004, len(t))  # unequal steps
    t -= t[0]
    track = read_flight(tum(tmp_path / "f.txt", t, p, q)).resample(60)
    t = np.round(t * 1e9) * 1e-9
    at = track.frames / 60
    assert at[0] == 0
    assert at[-1] <= t[-1] < at[-1] + 1 / 60
    spline = interpolate.CubicSpline(t, p, bc_type="natural")
    np.testing.assert_allclose(track.positions, spline(at), atol=1e-9)
    slerp = spatial.Slerp(t, spatial.Rotation.from_quat(np.roll(q, -1, axis=1)))
    np.testing.assert_allclose(
        matrix_from_quat_wxyz(track.quat_wxyz), slerp(at).as_matrix(), atol=1e-9
    )
    assert ((track.quat_wxyz[1:] * track.quat_wxyz[:-1]).sum(axis=1) > 0).all()


def test_cuts_and_dropped_rows_are_reported_with_their_lines(tmp_path):
    t, p, q = flown(60)
    t = t.copy()
    t[20:] += 1.0  # a gap at row 20
    p = p.copy()
    p[40:] += 2.0  # a jump at row 40
    t[50] = t[49]  # row 50 again
    flight = read_flight(tum(tmp_path / "f.txt", t, p, -q))
    found = [(issue.kind, issue.line) for issue in flight.issues]
    assert found == [("gap", 22), ("jump", 42), ("duplicate", 52)]
    assert flight.segments.tolist() == [[0, 20], [20, 40], [40, 59]]
    assert "gap: 1" in flight.describe()
    assert "line 22: 1.010 s after" in flight.describe()
    track = flight.resample(60)
    assert len(track.segments) == 3
    inside = np.concatenate([np.diff(track.frames[a:b]) for a, b in track.segments])
    assert (inside == 1).all()
    loose = read_flight(tmp_path / "f.txt", max_gap_s=2, max_speed_m_s=1e9)
    assert len(loose.segments) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "f: found an empty file"),
        ("\n\n", "f: found an empty file"),
        ("1 2 3\n", "f:1: found '1 2 3', expected a flight"),
        ("0 0 0 0 0 0 0 1\n", "f: found one pose, expected two"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0", "f:2: found 6 fields, expected 8"),
        ("0 0 0 0 0 0 0 1\n.1 0 nan 0 0 0 0 1\n", "f:2:y: found 'nan'"),
        ("0 0 0 0 0 0 0 2\n.1 0 0 0 0 0 0 1\n", "f:1:qx: found a quaternion of norm 2.0000"),
        ("0 0 0 0 0 0 0 1\n9 0 0 0 0 0 0 1\n", "f:2: found no two poses that go on"),
        ("\x00\x01", "f: found binary data"),
    ],
)
def test_what_is_no_flight_is_refused_by_line(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f").write_text(text)
    with pytest.raises(ValueError, match=r"^f") as error:
        read_flight("f")
    assert str(error.value).startswith(message)


def test_arguments_out_of_range_are_named(tmp_path):
    path = tum(tmp_path / "f.txt", *flown())
    for arguments in (
        {"format": "ros"},
        {"world": "enu"},
        {"body_axes": "ffu"},
        {"body_axes": "ruf"},
        {"quaternion": "zyxw"},
        {"time_unit": "min"},
        {"mount_rpy_deg": (0, 1)},
        {"max_gap_s": 0},
        {"max_speed_m_s": float("nan")},
    ):
        name = next(iter(arguments))
        with pytest.raises(ValueError, match=rf"^{name}|{name}: "):
            read_flight(path, **arguments)
    with pytest.raises(FileNotFoundError, match="none"):
        read_flight(tmp_path / "none")
    with pytest.raises(ValueError, match="rate_hz"):
        read_flight(path).resample(0)
    with pytest.raises(ValueError, match=r"quat_wxyz: expected shape \(1, 4\)"):
        Track([[0, 0, 0]], [[1, 0, 0]])
    with pytest.raises(ValueError, match=r"quat_wxyz\[0\]"):
        Track([[0, 0, 0]], [[0, 0, 0, 0]])
    with pytest.raises(ValueError, match=r"positions\[1\]"):
        Track([[0, 0, 0], [0, np.nan, 0]], [[1, 0, 0, 0]] * 2)


def test_a_placement_keeps_a_level_drone_level():
    _, p, q = flown()
    track = Track(p, q)
    placement = Placement(scale=1.5, yaw_deg=40, offset=(1, 2, 3))
    placed = track.placed(placement)
    c, s = np.cos(RADIANS(40)), np.sin(RADIANS(40))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(placed.positions, 1.5 * p @ turn.T + [1, 2, 3], atol=1e-12)
    R = turn @ matrix_from_quat_wxyz(q)
    np.testing.assert_allclose(matrix_from_quat_wxyz(placed.quat_wxyz), R, atol=1e-12)
    anchors = np.array([[0.0, 0, 1], [8, 6, 2]])
    for how in ("centre", "fill"):
        found = fit_placement(track, anchors, how=how, given=Placement(yaw_deg=40))
        box = track.placed(found).positions
        middle = (box.min(axis=0) + box.max(axis=0)) / 2
        np.testing.assert_allclose(middle, [4, 3, 1.5], atol=1e-9)
        size = np.ptp(box, axis=0)[:2] / [8, 6]
        assert (how == "centre") == (found.scale == 1.0)
        assert how == "centre" or abs(size.max() - 1) < 1e-9


def viewpoint(name, position, included=True, column_major=False):
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    pose[:3, 3] = position
    flat = (pose.T if column_major else pose).ravel().tolist()
    return {"image_id": name, "pose": flat, "included": included, "visible": [], "height": 1.5}


def test_anchors_of_a_connectivity_file(tmp_path):
    path = tmp_path / "s_connectivity.json"
    views = [viewpoint("a", (1, 2, 3)), viewpoint("b", (4, 5, 6), included=False)]
    views.append(viewpoint("c", (1, 2, 3)))
    path.write_text(json.dumps(views))
    anchors = read_anchors(path)
    assert (anchors.names, anchors.positions.tolist()) == (["a", "c"], [[1, 2, 3], [1, 2, 3]])
    assert (anchors.facts["excluded"], anchors.facts["coincident"]) == (1, 1)
    assert "1 left out" in anchors.describe()
    assert "1 pairs at one place" in anchors.describe()
    assert len(read_anchors(path, include_excluded=True)) == 3
    path.write_text(json.dumps([viewpoint("a", (1, 2, 3), column_major=True)]))
    with pytest.raises(ValueError, match=r"\[0\].pose: found a last row .*row major"):
        read_anchors(path)


def test_free_space_is_free(tmp_path):
    from dronepose import Mesh

    wall = Mesh([[2, 0, 0], [2, 4, 0], [2, 0, 3], [2, 4, 3]], [[0, 1, 2], [1, 3, 2]])
    found = sample_free_space((0, 0, 1), (4, 4, 2), 12, mesh=wall, spacing_m=0.6, seed=4)
    assert isinstance(found, Anchors)
    assert (np.abs(found.positions[:, 0] - 2) >= 0.5).all()
    apart = np.linalg.norm(found.positions[:, None] - found.positions, axis=2)
    assert apart[~np.eye(12, dtype=bool)].min() >= 0.6
    again = sample_free_space((0, 0, 1), (4, 4, 2), 12, mesh=wall, spacing_m=0.6, seed=4, threads=1)
    np.testing.assert_array_equal(found.positions, again.positions)
    found.write_csv(tmp_path / "a.csv")
    read = read_anchors(tmp_path / "a.csv")
    np.testing.assert_array_equal(read.positions, found.positions)
    with pytest.raises(ValueError, match="count: only"):
        sample_free_space((0, 0, 1), (1, 1, 2), 50, mesh=wall)


def test_the_defaults_are_those_of_the_core():
    core = json.loads(_native.synth_defaults())
    rules = json.loads(Rules().encoded())
    assert rules == core["rules"]
    assert core["placement"] == json.loads(Placement().encoded())


def test_the_example_is_flown_as_it_says(tmp_path):
    paths = write_example(tmp_path)
    time, positions, quat_wxyz = example_flight()
    flight = read_flight(paths["flight"])
    np.testing.assert_allclose(flight.positions, positions, atol=1e-7)
    assert not flight.issues
    assert flight.facts["conventions"]["body_axes"] == "flu"
    R = matrix_from_quat_wxyz(quat_wxyz)
    assert angle(R, matrix_from_quat_wxyz(flight.quat_wxyz)).max() < 1e-4
    # Nose ahead: the velocity is in the plane of forward and up.
    velocity = np.gradient(positions, time, axis=0)
    aside = np.einsum("ni,ni->n", velocity, R[:, :, 1])[1:-1]
    assert np.abs(aside).max() < 0.02 * np.linalg.norm(velocity, axis=1).max()
    # The file is the same each time.
    before = paths["flight"].read_bytes()
    assert write_example(tmp_path)["flight"].read_bytes() == before


EUROC = "data/trajectories/euroc/V1_02_medium"


def test_the_two_files_of_a_real_flight_agree(shared):
    a = read_flight(shared(f"{EUROC}.csv"))
    b = read_flight(shared(f"{EUROC}.txt"), body_axes="urf")
    assert (a.facts["rows"], a.facts["sign_flips"], len(a.issues)) == (16702, 8, 0)
    assert (a.facts["segments"], b.facts["rows"]) == (1, 16702)
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-6)
    off = angle(matrix_from_quat_wxyz(a.quat_wxyz), matrix_from_quat_wxyz(b.quat_wxyz))
    assert off.max() < 1e-2
    # Its IMU looks 20 degrees down when the drone hovers; the mount takes that off.
    level = read_flight(shared(f"{EUROC}.csv"), mount_rpy_deg=(0, 20, 0))
    up = matrix_from_quat_wxyz(level.quat_wxyz)[:, 2, 2]
    assert np.median(up) > np.median(matrix_from_quat_wxyz(a.quat_wxyz)[:, 2, 2])
    assert np.median(up) > 0.98


@pytest.mark.parametrize(("name", "flips"), [("forward_5", 3), ("forward_9", 7), ("45_14", 5)])
def test_real_racing_flights_look_ahead(shared, name, flips):
    path = shared(f"data/trajectories/uzhfpv/indoor_{name}_snapdragon_with_gt.txt")
    flight = read_flight(path)
    assert (flight.facts["sign_flips"], len(flight.segments), len(flight.issues)) == (flips, 1, 0)
    track = flight.resample()
    velocity = np.gradient(track.positions, 1 / 60, axis=0)
    R = matrix_from_quat_wxyz(track.quat_wxyz)
    speed = np.linalg.norm(velocity, axis=1)
    ahead = np.einsum("ni,ni->n", velocity, R[:, :, 0]) / np.maximum(speed, 1e-9)
    if name == "forward_5":
        assert abs(np.median(ahead[speed > 0.5]) - 0.93) < 0.01
    assert 4 < speed.max() < 12.5
    # Between rows 2 ms apart nothing moves far.
    t = track.frames / 60
    nearest = np.searchsorted(flight.time_s, t).clip(0, len(flight) - 1)
    assert np.abs(track.positions - flight.positions[nearest]).max() < 0.03


@pytest.mark.parametrize("name", ["airsim_rec.txt", "airsim_rec2.txt"])
def test_real_airsim_recordings_are_too_slow_and_say_so(shared, name):
    path = shared(f"data/trajectories/airsim/{name}")
    with pytest.raises(ValueError, match=r"no two poses that go on.*--max-gap"):
        read_flight(path)
    flight = read_flight(path, max_gap_s=3)
    assert flight.facts["conventions"]["world"] == "ned"
    assert (flight.positions[:5, 2] > 0).all()  # it took off


def test_real_scans_have_the_anchors_that_their_notes_say(shared):
    folder = shared("data/anchors/matterport3d/connectivity")
    excluded = {"17DRP5sb8fy": 4, "HxpKQynjfin": 10, "TbHJrupSAjP": 2}
    files = sorted(folder.glob("*_connectivity.json"))
    assert len(files) == 16
    for path in files:
        scan = path.name.removesuffix("_connectivity.json")
        every = read_anchors(path, include_excluded=True)
        assert 20 <= len(every) <= 131
        assert read_anchors(path).facts["excluded"] == excluded.get(scan, 0)
        assert every.positions[:, 2].min() > -2.3
        assert every.positions[:, 2].max() < 7.4
        assert (every.facts["coincident"] > 0) == (scan == "TbHJrupSAjP"), scan
