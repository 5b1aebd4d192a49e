"""Real submissions: LINEMOD-Occluded against a third party's numbers, and SPEED."""

import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oracles import metrics as oracle
from support import evaluate, rows, run

# 10 (egg box) and 11 (glue) are symmetric; the third party took the best symmetry for them.
OBJECTS = [1, 5, 6, 8, 9, 12]


@pytest.mark.parametrize("obj", OBJECTS)
def test_epos_on_lmo_has_the_errors_a_third_party_found(obj, shared, tmp_path):
    folder = shared("data/eval/bop_lmo")
    truth = {}
    for line in (folder / "epos" / "metrics_lmo-epos.txt").read_text().splitlines():
        if not line.startswith("#"):
            scene, image, number, angle, distance, *_ = line.split("\t")
            if int(number) == obj:
                truth[f"{int(scene)}/{int(image)}/{obj}"] = float(angle), float(distance)
    out = tmp_path / "samples.csv"
    done = run(
        folder / "epos" / f"lmo-{obj}-epos.csv",
        folder / "gt-pbrreal-rgb-mmodel_lmo-test_lmo.csv",
        "--objects",
        obj,
        "--per-sample",
        out,
    )
    assert done.returncode == 0, done.stderr
    ours = {r["id"]: r for r in rows(out) if r["oe_deg"]}
    # The predictions also hold images in which this ground truth has no such object.
    assert len(ours) > 150
    assert set(ours) <= set(truth)
    for name, row in ours.items():
        angle, distance = truth[name]
        assert float(row["oe_deg"]) == pytest.approx(angle, rel=0, abs=1e-9)
        assert float(row["te_m"]) == pytest.approx(distance, rel=0, abs=1e-12)


def test_without_a_choice_all_objects_of_the_ground_truth_count(shared):
    folder = shared("data/eval/bop_lmo")
    gt = folder / "gt-pbrreal-rgb-mmodel_lmo-test_lmo.csv"
    result = evaluate(folder / "epos" / "lmo-1-epos.csv", gt)
    assert result["n_gt"] == 1445
    assert result["n_matched"] == 175


def test_two_speed_submissions_against_each_other(shared):
    folder = shared("data/eval/speed")
    paths = [folder / f"{n}bins_submission_pytorch.csv" for n in (12, 16)]
    result = evaluate(*paths)
    poses = []
    for path in paths:
        with path.open(newline="") as file:
            poses.append({r[0]: np.array(r[1:], dtype=np.float64) for r in csv.reader(file)})
    assert result["n_gt"] == result["n_matched"] == len(poses[0]) == 3298
    angles, npes = [], []
    for name, est in poses[0].items():
        gt = poses[1][name]
        R_est, R_gt = (Rotation.from_quat(p[[1, 2, 3, 0]]).as_matrix() for p in (est, gt))
        angles.append(np.degrees(oracle.orientation_error(R_est, R_gt)))
        npes.append(oracle.npe(est[4:], gt[4:]))
    ours = result["metrics"]
    assert ours["oe_deg"]["median"] == pytest.approx(np.median(angles), rel=0, abs=1e-9)
    assert ours["oe_deg"]["mean"] == pytest.approx(np.mean(angles), rel=0, abs=1e-9)
    assert ours["npe"]["mean"] == pytest.approx(np.mean(npes), rel=0, abs=1e-12)


@pytest.mark.parametrize(
    "path",
    [
        "cases/eval/c01_random_near_2000/gt.csv",
        "cases/eval/c01_random_near_2000/bop/scene_gt.json",
        "cases/eval/c08_symmetric_box/bop/case_tudl-test.csv",
        "cases/eval/c01_random_near_2000/speed/submission.csv",
        "cases/eval/c01_random_near_2000/speed/submission.json",
        "cases/eval/c01_random_near_2000/speed/labels_speed2019.json",
        "cases/eval/c01_random_near_2000/speed/labels_speedplus.json",
        "data/eval/bop_lmo/gt-pbrreal-rgb-mmodel_lmo-test_lmo.csv",
        "data/eval/speed/12bins_submission_pytorch.csv",
        "data/eval/sixd_eval/scene_gt.json",
    ],
)
def test_every_format_scores_itself_perfect(path, shared):
    file = shared(path)
    result = evaluate(file, file)
    assert result["n_gt"] == result["n_matched"] > 0
    for metric in ("npe", "oe_rad", "te_m", "cpe"):
        assert result["metrics"][metric]["max"] == 0.0
    for recall in result["metrics"]["acc"].values():
        assert recall["percent_of_gt"] == 100.0
