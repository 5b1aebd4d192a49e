"""The plan of a data set: against slow loops, its funnel, its files, its pictures, its command."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from dronepose import Camera
from dronepose.geometry import matrix_from_quat_wxyz
from dronepose.synth import (
    Funnel,
    Rules,
    SceneSplits,
    Track,
    check_splits,
    make_plan,
    read_anchors,
    read_flight,
    read_plan,
    read_splits,
    write_example,
)
from dronepose.synth.report import yaw_pitch_roll_deg
from oracles import synth as oracle
from support import EXAMPLES, loads, rows, run

RULES = ("anchor", "distance", "neighbours", "ego-motion", "look-at", "border", "pair")

QUADROTOR = EXAMPLES / "quadrotor.obj"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The example, and its plan as the command makes it."""
    folder = tmp_path_factory.mktemp("demo")
    paths = write_example(folder)
    paths["plan"] = folder / "plan.csv"
    done = synth("plan", *given(paths), "--out", paths["plan"])
    assert done.returncode == 0, done.stderr
    return {**paths, "folder": folder, "text": done.stdout}


def synth(*arguments, cwd=None):
    return run("synth", *arguments, cwd=cwd, name="dronepose")


def given(paths):
    return ["--flight", paths["flight"], "--anchors", paths["anchors"]]


def wandering(seed, n=400):
    """A rough flight in two pieces among random anchors, with rests and spins."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.005, 0.05, (n, 1)) * (rng.random((n, 1)) > 0.1)
    steps = rng.normal(size=(n, 3)) * [1, 1, 0.3]
    p = np.cumsum(speed * steps / np.linalg.norm(steps, axis=1, keepdims=True), axis=0)
    turns = rng.normal(size=(n, 3)) * rng.choice(
        [0.0, 0.004, 0.02, 0.3], p=[0.1, 0.4, 0.45, 0.05], size=(n, 1)
    )
    q = [np.array([1.0, 0, 0, 0])]
    for v in turns[1:]:
        w = np.array([1.0, *(v / 2)])
        a, b = q[-1], w / np.linalg.norm(w)
        r = [
            a[0] * b[0] - a[1:] @ b[1:],
            *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])),
        ]
        q.append(np.array(r) / np.linalg.norm(r))
    anchors = p[rng.integers(n, size=9)] + rng.normal(size=(9, 3)) * [0.7, 0.7, 0.2]
    anchors[4] = anchors[2]  # a tie
    return Track(p, np.array(q)), anchors


@pytest.mark.parametrize("seed", range(6))
def test_the_plan_is_that_of_the_slow_loops(seed):
    track, anchors = wandering(seed)
    rules = Rules(
        seed=seed * 1_000_003,
        stride=1 + seed % 3,
        motion="all" if seed % 2 else "any",
        min_move_m=0.002 if seed % 2 else 0.01,
        min_turn_deg=0.05 if seed % 2 else 0.5,
        border=0.2,
        anchor_cube_m=0.6,
        drone_cube_m=0.7,
        min_distance_m=0.4,
        exo=Camera(200, 210, 150, 130, 320, 240, skew=3.0),
        centroid_m=(0.02, -0.05, 0.1),
        whole_box_m=((-0.2, -0.1, 0), (0.15, 0.1, 0.1)) if seed in (2, 3) else None,
    )
    expected, removed = oracle.plan(track, anchors, rules)
    plan = make_plan(track, anchors, rules)
    assert {step.rule: step.removed for step in plan.funnel.steps} == removed
    table = plan.table()
    assert table["frame"].tolist() == [frame for frame, _, _ in expected]
    assert table["anchor_index"].tolist() == [anchor for _, anchor, _ in expected]
    assert len(expected) > 5
    for name, k in (("", 0), ("next", 1)):
        R, t = table.pose(name)
        np.testing.assert_allclose(R, [poses[k][0] for _, _, poses in expected], atol=1e-12)
        np.testing.assert_allclose(t, [poses[k][1] for _, _, poses in expected], atol=1e-12)


def test_every_rule_of_the_oracle_is_at_work():
    """Or the comparison with it would say little."""
    total = dict.fromkeys([*RULES, "whole"], 0)
    for seed in range(6):
        track, anchors = wandering(seed)
        box = ((-0.2, -0.2, -0.1), (0.2, 0.2, 0.1))
        rules = Rules(seed=seed, border=0.2, drone_cube_m=0.7, min_distance_m=0.4, whole_box_m=box)
        for rule, count in oracle.plan(track, anchors, rules)[1].items():
            total[rule] += count
    assert all(total[rule] for rule in total if rule not in ("anchor", "look-at", "neighbours")), (
        total
    )


def test_a_view_straight_down_has_no_roll_to_be_zero_and_is_removed():
    above = Track([[0.02 * k, 0, 1] for k in range(5)], [[1, 0, 0, 0]] * 5)
    anchors = [[0.02 * k, 0, 2] for k in range(5)]
    plan = make_plan(above, anchors, Rules(anchor_cube_m=0, drone_cube_m=0))
    steps = {step.rule: step for step in plan.funnel.steps}
    assert (steps["look-at"].came_in, steps["look-at"].removed) == (3, 3)


def test_poses_of_a_plan_agree_with_one_another(demo):
    table = read_plan(demo["plan"])
    flight = read_flight(demo["flight"]).resample()
    anchors = read_anchors(demo["anchors"]).positions
    index = table["frame"].astype(int)
    np.testing.assert_array_equal(flight.frames[index], index)
    p, R_body = flight.positions[index], matrix_from_quat_wxyz(flight.quat_wxyz)[index]
    R_drone, t_drone = table.pose("drone")
    np.testing.assert_allclose(t_drone, p, atol=1e-9)
    np.testing.assert_allclose(R_drone, R_body, atol=1e-9)
    R_exo, t_exo = table.pose("exo")
    for now, later in (("", "drone"), ("next", "drone_next")):
        R, t = table.pose(now)
        R_world, t_world = table.pose(later)
        np.testing.assert_allclose(R_exo @ R_world, R, atol=1e-9)
        moved = np.einsum("nij,nj->ni", R_exo, t_world) + t_exo
        np.testing.assert_allclose(moved, t, atol=1e-9)
    near = anchors[table["anchor_index"].astype(int)]
    np.testing.assert_allclose(np.linalg.norm(near - p, axis=1), table["distance_m"], atol=1e-9)
    assert (table["distance_m"] >= 0.8).all()
    assert (table["distance_m"] <= 1.5).all()
    # The view: no roll, upright, from the anchor's cube.
    eye = -np.einsum("nji,nj->ni", R_exo, t_exo)
    assert np.abs(eye - near).max() <= 0.25 + 1e-9
    np.testing.assert_allclose(R_exo[:, 0, 2], 0, atol=1e-9)
    assert (R_exo[:, 1, 2] < 0).all()
    # The drone's camera looks where the drone's nose points, and stays upright with it.
    R_ego, t_ego = table.pose("ego")
    np.testing.assert_allclose(R_ego[:, 2], R_body[:, :, 0], atol=1e-9)
    np.testing.assert_allclose(R_ego[:, 1], -R_body[:, :, 2], atol=1e-9)
    np.testing.assert_allclose(-np.einsum("nji,nj->ni", R_ego, t_ego), p, atol=1e-9)


def test_ids_and_draws_do_not_depend_on_what_else_is_kept(demo):
    flight, anchors = read_flight(demo["flight"]), read_anchors(demo["anchors"])
    every = make_plan(flight, anchors, Rules(seed=9)).table()
    few = make_plan(flight, anchors, Rules(seed=9, max_distance_m=1.1), threads=1).table()
    assert 0 < len(few) < len(every)
    where = {name: k for k, name in enumerate(every.ids)}
    index = [where[name] for name in few.ids]
    for column, values in few.columns.items():
        np.testing.assert_array_equal(values, every[column][index])
    other = make_plan(flight, anchors, Rules(seed=10)).table()
    assert not set(map(tuple, other.pose("exo")[1])) & set(map(tuple, every.pose("exo")[1]))


def test_rules_that_need_pictures_have_their_place(demo):
    flight, anchors = read_flight(demo["flight"]), read_anchors(demo["anchors"])
    plan = make_plan(flight, anchors)
    assert plan.funnel.pending == ("hidden", "invalid", "blocked")
    mask = np.arange(len(plan)) % 3 > 0
    seen = plan.keep(mask, "hidden", "half of the drone seen")
    assert [step.rule for step in seen.funnel.steps] == [*RULES, "hidden"]
    assert (seen.funnel.pending, len(seen)) == (("invalid", "blocked"), mask.sum())
    kept = np.array(plan.table().ids)[mask].tolist()
    assert seen.table().ids == kept
    assert "invalid" in str(seen.funnel)
    with pytest.raises(ValueError, match="rule: 'hidden' was applied before"):
        seen.keep([True] * len(seen), "hidden", "again")
    with pytest.raises(ValueError, match="mask: expected shape"):
        plan.keep([True], "invalid", "no holes")
    with pytest.raises(ValueError, match="removed: expected 0 to 0"):
        Funnel().and_then("hidden", 1, "")


def test_a_few_samples_are_spread_evenly(demo):
    plan = make_plan(read_flight(demo["flight"]), read_anchors(demo["anchors"]))
    ids = plan.table().ids
    few = plan.some(4).table().ids
    assert [few[0], few[-1]] == [ids[0], ids[-1]]
    steps = np.diff([ids.index(name) for name in few])
    assert len(few) == 4
    assert np.ptp(steps) <= 1
    for count in (len(plan), len(plan) + 7):
        assert plan.some(count).table().ids == ids
    assert len(plan.some(len(plan) - 1)) == len(plan) - 1
    with pytest.raises(ValueError, match="count: expected at least 1"):
        plan.some(0)


def test_settings_out_of_range_are_named(demo):
    flight, anchors = read_flight(demo["flight"]), read_anchors(demo["anchors"])
    for settings in (
        {"min_distance_m": -1},
        {"max_distance_m": float("inf")},
        {"stride": 0},
        {"border": 0.5},
        {"model_axes": "ruf"},
        {"max_turn_deg": 0.1},
    ):
        name = next(iter(settings)).removeprefix("max_")
        with pytest.raises(ValueError, match=name):
            make_plan(flight, anchors, Rules(**settings))
    for settings in (
        {"motion": "some"},
        {"model_axes": "xyz"},
        {"seed": -1},
        {"seed": 0.5},
        {"centroid_m": (1, 2)},
        {"whole_box_m": ((0, 0, 0),)},
    ):
        with pytest.raises(ValueError, match=next(iter(settings))):
            Rules(**settings)
    with pytest.raises(ValueError, match="anchors"):
        make_plan(flight, np.zeros((0, 3)))
    with pytest.raises(ValueError, match=r"anchors\[0\]"):
        make_plan(flight, [[0, 0, np.nan]])


def test_a_scene_in_two_splits_is_refused_with_both_places(tmp_path):
    (tmp_path / "scenes_train.txt").write_text("hall\nroom\n\n")
    (tmp_path / "scenes_test.txt").write_text("attic\n")
    splits = read_splits(tmp_path)
    assert (splits.split_of("room"), splits.split_of("attic")) == ("train", "test")
    with pytest.raises(ValueError, match="'cellar' is in none"):
        splits.split_of("cellar")
    (tmp_path / "scenes_val.txt").write_text("\nroom\n")
    with pytest.raises(ValueError, match=r"scenes_val.txt:2: the scene 'room' is in .*train.txt:2"):
        read_splits(tmp_path)
    with pytest.raises(ValueError, match=r"train\[1\]: the scene 'a' is in train\[0\]"):
        check_splits({"train": ["a", "a"]})
    with pytest.raises(ValueError, match="'a' is in train"):
        SceneSplits({"train": ("a",), "test": ("a",)})
    with pytest.raises(FileNotFoundError, match="scenes_train"):
        read_splits(tmp_path / "none")


def test_angles_are_those_of_a_turn_seen_from_the_camera():
    away = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # nose away, upright

    def about(axis, degrees):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        m = np.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        m[[i, i, j, j], [i, j, i, j]] = [c, -s, s, c]
        return m

    R = away @ about(2, 30) @ about(1, -20) @ about(0, 10)
    np.testing.assert_allclose(yaw_pitch_roll_deg(R[None]), [[30, -20, 10]], atol=1e-9)
    # The same drone, modelled with x left, y up, z forward.
    flu_from_luf = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(
        yaw_pitch_roll_deg((R @ flu_from_luf)[None], "luf"), [[30, -20, 10]], atol=1e-9
    )


def test_the_command_says_what_it_did(demo):
    text = demo["text"]
    for rule in RULES:
        assert f"\n{rule} " in text
    samples = len(rows(demo["plan"]))
    assert f"{samples} samples in {demo['plan']}" in text
    assert samples > 200
    manifest = loads((demo["folder"] / "plan.json").read_text())
    assert (manifest["format"], manifest["samples"]) == ("dronepose-plan-1", samples)
    for name in ("flight", "anchors"):
        digest = hashlib.sha256(demo[name].read_bytes()).hexdigest()
        assert manifest[name]["source"]["sha256"] == digest
    assert [step["rule"] for step in manifest["funnel"]["steps"]] == list(RULES)
    assert manifest["funnel"]["steps"][-1]["left"] == samples
    assert manifest["rules"]["max_distance_m"] == 1.5
    assert round(manifest["cameras"]["exo"]["fx"], 1) == 252.7
    assert manifest["conventions"]["world"] == "metres, z up, right-handed"


def test_the_same_command_writes_the_same_bytes(demo, tmp_path):
    done = synth("plan", *given(demo), "--out", tmp_path / "p.csv", "--threads", 1, "--json")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "p.csv").read_bytes() == demo["plan"].read_bytes()
    assert (tmp_path / "p.json").read_bytes() == (demo["folder"] / "plan.json").read_bytes()
    said = loads(done.stdout)
    assert said["plan"] == str(tmp_path / "p.csv")
    assert "map" not in said


def test_other_commands_read_the_plan(demo, tmp_path):
    camera = ["--camera", "252.7,252.7,160,120,320,240"]
    scored = run(demo["plan"], demo["plan"], "--mesh", QUADROTOR, "--json", "-")
    assert scored.returncode == 0, scored.stderr
    drawn = run(
        *["render", QUADROTOR, demo["plan"], *camera],
        *["--out", tmp_path / "drawn", "--limit", 2, "--save", "silhouette"],
        name="dronepose",
    )
    assert drawn.returncode == 0, drawn.stderr


def test_refusals_write_nothing(demo, tmp_path):
    out = tmp_path / "p.csv"
    broken = tmp_path / "broken.txt"
    broken.write_text("0 0 0 0 0 0 0 1\n0.1 0 0 x 0 0 0 1\n")
    for arguments, message in (
        (["--flight", broken, "--anchors", demo["anchors"]], f"{broken}:2:z: found 'x'"),
        (["--flight", demo["flight"], "--anchors", broken], f"{broken}:1: found"),
        ([*given(demo), "--offset", 100, 0, 0], "no sample is left: rule distance removed 1801"),
        ([*given(demo), "--border", 0.7], "border: found 0.7"),
        ([*given(demo), "--whole"], "--whole: expected --mesh"),
        ([*given(demo), "--body-axes", "ruf"], "body_axes: 'ruf' are left-handed"),
        ([*given(demo), "--splits", tmp_path], "--splits: expected --scene"),
        ([*given(demo), "--splits", tmp_path, "--scene", "a"], "expected scenes_train.txt"),
        ([*given(demo), "--mesh", tmp_path / "none.obj"], "none.obj"),
        ([*given(demo), "--mesh", QUADROTOR, "--mesh-unit", 100], "--mesh-unit says how many"),
        ([*given(demo), "--manifest", out], "manifest: "),
    ):
        done = synth("plan", *arguments, "--out", out)
        assert (done.returncode, done.stdout) == (1, ""), done.stderr
        assert message in done.stderr.splitlines()[-1], done.stderr
        assert "Traceback" not in done.stderr
        assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.txt"]
    done = synth("plan", *given(demo), "--out", tmp_path / "none" / "p.csv")
    assert done.returncode == 1
    assert "p.csv: No such file" in done.stderr
    for arguments in (
        [],
        ["plan"],
        ["plan", *given(demo), "--out", out, "--size", "320"],
        ["draw"],
    ):
        done = synth(*arguments)
        assert (done.returncode, done.stdout) == (2, ""), arguments
    for command in ("plan", "report", "anchors", "example"):
        done = synth(command, "--help")
        assert done.returncode == 0
        assert "dronepose synth" in done.stdout
        assert "example" in done.stdout


def test_placement_scene_split_and_centroid_reach_the_manifest(demo, tmp_path):
    (tmp_path / "scenes_val.txt").write_text("hall\n")
    out = tmp_path / "p.csv"
    done = synth(
        *["plan", *given(demo), "--out", out, "--fit", "fill", "--yaw", 180],
        *["--scene", "hall", "--splits", tmp_path, "--seed", 5, "--stride", 2],
        *["--mesh", QUADROTOR, "--model-axes", "luf", "--fov", 70, "--whole"],
    )
    assert done.returncode == 0, done.stderr
    manifest = loads(out.with_suffix(".json").read_text())
    assert (manifest["scene"], manifest["split"], manifest["seed"]) == ("hall", "val", 5)
    assert manifest["placement"]["fit"] == "fill"
    assert manifest["placement"]["scale"] < 1
    assert "placed (fit fill): scale 0." in done.stdout
    assert rows(out)[0]["id"].startswith("hall-000")
    assert manifest["rules"]["stride"] == 2
    assert "\nwhole " in done.stdout
    assert any(manifest["rules"]["centroid_m"])


def test_free_space_makes_anchors_for_the_command(tmp_path):
    out = tmp_path / "new" / "a.csv"
    box = ["--low", 0, 0, 1, "--high", 6, 6, 2, "--count", 9]
    done = synth("anchors", *box, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert (loads(done.stdout)["count"], len(rows(out))) == (9, 9)
    done = synth("anchors", "--mesh", "example", "--count", 5, "--out", out)
    assert done.returncode == 0, done.stderr
    assert len(rows(out)) == 5
    done = synth("anchors", "--out", out)
    assert done.returncode == 1
    assert "--low, --high: expected both" in done.stderr


def test_broken_plans_are_refused_by_line(demo, tmp_path):
    text = demo["plan"].read_text()
    lines = text.splitlines()
    path = tmp_path / "plan.csv"
    cells = lines[2].split(",")
    for content, message in (
        ("", "plan.csv:1: found a header without id, anchor, frame"),
        (text.replace("distance_m", "d", 1), "plan.csv:1: found a header without distance_m"),
        (lines[0], "plan.csv: found no sample"),
        ("\n".join([*lines[:2], lines[2][:40]]), "plan.csv:3: found "),
        ("\n".join([*lines[:2], ",".join([*cells[:5], "nan", *cells[6:]])]), "plan.csv:3:source"),
    ):
        path.write_text(content)
        with pytest.raises(ValueError, match=message):
            read_plan(path)
    path.write_bytes(b"\xff" + text.encode())
    with pytest.raises(ValueError, match=r"plan\.csv: found bytes that are not UTF-8"):
        read_plan(path)
    path.write_text(lines[0] + "\n" + "x" * 200_000)
    with pytest.raises(ValueError, match=r"plan\.csv:2: found"):
        read_plan(path)
    path.write_text(text)
    assert read_plan(path).manifest == {}
    for content in ("{", "[]", '{"format": "other"}'):
        path.with_suffix(".json").write_text(content)
        with pytest.raises(ValueError, match=r"plan\.json: found"):
            read_plan(path)


def test_pictures_are_drawn(demo, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    out = tmp_path / "report"
    done = synth("report", demo["plan"], "--out", out)
    assert done.returncode == 0, done.stderr
    for name in ("poses.png", "map.png"):
        image = cv2.imread(str(out / name))
        assert min(image.shape[:2]) > 400
        assert image.std() > 10
    before = (out / "map.png").read_bytes()
    assert synth("report", demo["plan"], "--out", out, "--json").returncode == 0
    assert (out / "map.png").read_bytes() == before


def test_without_matplotlib_the_remedy_is_named(demo, tmp_path):
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "from dronepose.commands.synth import main\n"
        f"raise SystemExit(main(['report', {str(demo['plan'])!r}, '--out', {str(tmp_path)!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert 'pip install "dronepose[synth]"' in done.stderr
    assert not list(tmp_path.iterdir())


def test_planning_needs_neither_torch_nor_matplotlib():
    code = (
        "import sys, dronepose.synth as s\nfrom dronepose.commands import synth\n"
        "synth._parser(); s.make_plan, s.read_flight, s.read_splits, s.write_example\n"
        "print([m for m in ('torch', 'matplotlib', 'scipy', 'cv2') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
