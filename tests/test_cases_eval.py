"""Poses with known truth, in every file form, and the numbers that the field's tools print."""

import json
import math
from functools import cache

import pytest

from support import SHARED, evaluate, rows, run

FOLDER = SHARED / "cases" / "eval"
CASES = sorted(p.name for p in FOLDER.glob("c*") if (p / "expected.json").exists())
REFERENCES = {
    "bbox_diagonal": "bbox-diagonal",
    "diameter": "diameter",
    "authors_constant_0.354": "0.354",
}
FORMS = {
    "csv": ("predictions.csv", "gt.csv"),
    "bop": ("bop/case_tudl-test.csv", "bop/scene_gt.json"),
    "speed-2019": ("speed/submission.csv", "speed/labels_speed2019.json"),
    "speed-plus": ("speed/submission.json", "speed/labels_speedplus.json"),
}
STATISTICS = {
    "mean": "mean",
    "median": "median",
    "std_pop": "std",
    "min": "min",
    "max": "max",
    "rmse": "rmse",
    "p90_linear": "p90",
    "p95_linear": "p95",
}

pytestmark = pytest.mark.skipif(
    not CASES, reason="cases/eval is not in ../shared (or DRONEPOSE_SHARED)"
)
every_case = pytest.mark.parametrize("case", CASES or ["none"])


@cache
def expected(case):
    return json.loads((FOLDER / case / "expected.json").read_text(encoding="utf-8"))


def mesh(case):
    name = expected(case)["model"]["file"]
    if name == "DJI.obj":
        path = SHARED / "data" / "drones" / "dji_mavic2" / name
        if not path.exists():
            pytest.skip("data/drones/dji_mavic2/DJI.obj is not in ../shared")
        return path
    return FOLDER / "models" / name


@cache
def result(case, form, *options):
    model = expected(case)["model"]
    k = model["K"]
    camera = [k[0][0], k[1][1], k[0][2], k[1][2], *model["image_size"]]
    if model["symmetries"]:
        options = (*options, "--symmetries", FOLDER / case / "bop" / "models_info.json")
    return evaluate(
        *(FOLDER / case / name for name in FORMS[form]),
        "--mesh",
        mesh(case),
        "--camera",
        ",".join(map(str, camera)),
        *options,
    )


@every_case
@pytest.mark.parametrize("form", FORMS)
class TestTruth:
    def test_counts(self, case, form):
        r, e = result(case, form), expected(case)
        assert (r["n_gt"], r["n_matched"]) == (e["n_gt"], e["n_matched"])
        if form == "csv":
            assert r["n_predictions"] == e["n_pred"]

    @pytest.mark.parametrize("metric", ["oe_rad", "oe_deg", "te_m", "npe", "cpe", "add_m"])
    def test_error_statistics(self, case, form, metric):
        truth, ours = expected(case)["truth"][metric], result(case, form)["metrics"][metric]
        assert set(truth) == set(STATISTICS)
        for theirs, name in STATISTICS.items():
            assert ours[name] == pytest.approx(truth[theirs], rel=0, abs=1e-9), name

    def test_accuracies_count_exactly(self, case, form):
        ours = result(case, form)["metrics"]["acc"]
        truth = expected(case)["truth"]["AccX"]
        assert {f"Acc{x}" for x in ours} == set(truth)
        for name, recall in truth.items():
            same_recall(ours[name.removeprefix("Acc")], recall)

    @pytest.mark.parametrize("reference", REFERENCES)
    def test_add_recalls_count_exactly(self, case, form, reference):
        ours = result(case, form, "--add-reference", REFERENCES[reference])
        truth = dict(expected(case)["truth"]["ADD_thresholds"][reference])
        length = truth.pop("reference_m")
        recalls = ours["metrics"]["add_recall"]
        assert recalls["reference_m"] == pytest.approx(length, rel=0, abs=1e-9)
        assert recalls["reference"] == (
            "metres" if reference.startswith("authors") else REFERENCES[reference]
        )
        for name, recall in truth.items():
            same_recall(recalls[name.removeprefix("ADD@").removesuffix("%")], recall)

    def test_exact_area_under_the_add_curve(self, case, form):
        truth = expected(case)["truth"]["ADD_AUC_0.1m_exact_area_missing_as_inf"]
        ours = result(case, form)["metrics"]["add_auc"]["exact"]
        assert ours == pytest.approx(truth, rel=0, abs=1e-9)

    def test_speedplus_score(self, case, form):
        truth = expected(case)["truth"]["speedplus"]
        ours = result(case, form, "--preset", "speedplus")["metrics"]["speedplus"]
        assert ours["score"] == pytest.approx(truth["E_pose"], rel=0, abs=1e-9)
        assert ours["e_t"] == pytest.approx(truth["E_t"], rel=0, abs=1e-9)
        assert ours["e_q_rad"] == pytest.approx(truth["E_q_rad"], rel=0, abs=1e-9)
        assert (ours["zeroed_t"], ours["zeroed_q"]) == (truth["zeroed_t"], truth["zeroed_q"])


def same_recall(ours, truth):
    assert ours["count"] == truth["count"]
    assert ours["percent_of_gt"] == pytest.approx(truth["percent_of_gt"], rel=1e-14)
    assert ours["percent_of_matched"] == pytest.approx(truth["percent_of_matched"], rel=1e-14)


@every_case
class TestTools:
    def test_ycb_areas(self, case):
        tools, ours = expected(case)["tools"], result(case, "csv")["metrics"]
        octave, cosypose = tools["ycb_toolbox_octave"], tools["cosypose_compute_auc_posecnn"]
        for theirs in (octave["ADD_AUC_10cm"], cosypose["ADD_AUC"]):
            if is_number(theirs):
                assert ours["add_auc"]["ycb"] == pytest.approx(theirs, rel=0, abs=1e-9)
        for theirs in (octave["ADDS_AUC_10cm_on_bop_adi"], cosypose["ADDS_AUC"]):
            if is_number(theirs):
                assert ours["adds_auc"]["ycb"] == pytest.approx(theirs, rel=0, abs=1e-9)

    @pytest.mark.parametrize(
        ("key", "theirs", "factor"),
        [
            ("adds_m", "adi", 1e-3),
            ("mssd_m", "mssd", 1e-3),
            ("mspd_px", "mspd", 1.0),
            ("proj_px", "proj", 1.0),
        ],
    )
    def test_bop_errors(self, case, key, theirs, factor):
        truth = expected(case)["tools"]["bop_toolkit_functions"][theirs]
        ours = result(case, "bop")["metrics"][key]
        assert "n_undefined" not in ours
        for name in ("mean", "median", "max"):
            assert ours[name] == pytest.approx(truth[name] * factor, rel=0, abs=1e-6)

    def test_bop_average_recalls(self, case):
        truth = expected(case)["tools"]["bop_toolkit_functions"]
        ours = result(case, "bop", "--preset", "bop")["metrics"]["bop"]
        mssd, mspd = truth["AR_MSSD_missing_as_wrong"], truth["AR_MSPD_width640_missing_as_wrong"]
        assert ours["ar_mssd"] == pytest.approx(mssd, rel=0, abs=1e-12)
        assert ours["ar_mspd"] == pytest.approx(mspd, rel=0, abs=1e-12)

    def test_bop_recalls(self, case):
        truth = expected(case)["tools"]["bop_toolkit_functions"]
        ours = result(case, "bop", "--add-reference", "diameter")["metrics"]
        for k in ("2", "5", "10"):
            adi = truth["recall_percent_of_gt"][f"adi@{k}%diameter"]
            assert ours["adds_recall"][k]["percent_of_gt"] == pytest.approx(adi, rel=1e-14)
        proj = truth["proj<5px_percent_of_gt"]
        assert ours["proj_recall_5px"]["percent_of_gt"] == pytest.approx(proj, rel=1e-14)

    def test_narrow_images_halve_the_thresholds_of_mspd(self, case):
        truth = expected(case)["tools"]["bop_toolkit_functions"]["AR_MSPD_if_image_width_320"]
        k = expected(case)["model"]["K"]
        camera = f"{k[0][0]},{k[1][1]},{k[0][2]},{k[1][2]},320,240"
        options = ["--preset", "bop", "--mesh", mesh(case), "--camera", camera]
        if expected(case)["model"]["symmetries"]:
            options += ["--symmetries", FOLDER / case / "bop" / "models_info.json"]
        ours = evaluate(*(FOLDER / case / name for name in FORMS["bop"]), *options)
        assert ours["metrics"]["bop"]["ar_mspd"] == pytest.approx(truth, rel=0, abs=1e-12)

    def test_speed_2019_score(self, case):
        truth = expected(case)["tools"]["kelvins_speed_2019_server"]["score_mean"]
        if not is_number(truth):
            pytest.skip("the server refused this case")
        ours = result(case, "speed-2019", "--preset", "speedplus")["metrics"]["speed"]["score"]
        # The server rounds the cosine of half the angle to 15 decimals.
        assert ours == pytest.approx(truth, rel=0, abs=3e-8)

    @pytest.mark.parametrize("batch", [8, 64])
    def test_the_authors_batch_means(self, case, batch):
        tool = expected(case)["tools"]["dronepose_metrics_py"]["float64"]
        truth = tool["mean_of_batch_means_as_train_py"][f"batch_{batch}"]
        options = ("--preset", "authors", "--batch-size", str(batch), "--add-reference", "0.354")
        ours = result(case, "csv", *options)["authors"]
        assert (ours["batch_size"], ours["n_batches"]) == (batch, truth["n_batches"])
        assert ours["npe"] == pytest.approx(truth["NPE"], rel=0, abs=1e-9)
        for k in ("2", "5", "10"):
            assert ours["add_recall"][k] == pytest.approx(truth[f"ADD{k}"], rel=1e-12)
        if tool["n_nan_oe"]:  # their arc cosine made NaN of some angles, which then fail AccX
            return
        for key, theirs in (("oe_rad", "OE"), ("cpe", "CPE")):
            assert ours[key] == pytest.approx(truth[theirs], rel=0, abs=5e-8)
        for x in ("2", "5", "10"):
            assert ours["acc"][x] == pytest.approx(truth[f"Acc{x}"], rel=1e-12)

    def test_orientation_error_to_the_nearest_symmetry(self, case):
        if not expected(case)["model"]["symmetries"]:
            pytest.skip("the model has no symmetry")
        truth = expected(case)["tools"]["gdrnet_evaluator"]["re_deg_closest_symmetry"]
        ours = result(case, "csv")["metrics"]["oe_sym_deg"]
        # GDR-Net takes an arc cosine: up to 2.4e-6 degrees off near zero.
        for name in ("mean", "median", "max"):
            assert ours[name] == pytest.approx(truth[name], rel=0, abs=3e-6)


@every_case
def test_every_sample_has_its_true_errors(case, tmp_path):
    out = tmp_path / "samples.csv"
    paths = [FOLDER / case / name for name in FORMS["csv"]]
    done = run(*paths, "--mesh", mesh(case), "--per-sample", out)
    assert done.returncode == 0, done.stderr
    ours = {r["id"]: r for r in rows(out) if r["oe_deg"]}
    truth = {
        r["id"]: r for r in rows(FOLDER / case / "expected_per_sample.csv") if r["truth_oe_rad"]
    }
    assert len(ours) == expected(case)["n_matched"]
    assert set(ours) == set(truth)
    for name, row in truth.items():
        angle = math.degrees(float(row["truth_oe_rad"]))
        assert float(ours[name]["oe_deg"]) == pytest.approx(angle, rel=0, abs=1e-9)
        for key in ("te_m", "npe", "add_m"):
            truth_value = float(row[f"truth_{key}"])
            assert float(ours[name][key]) == pytest.approx(truth_value, rel=0, abs=1e-9)


@every_case
def test_the_number_of_threads_changes_no_bit(case):
    one, all_cores = (result(case, "csv", "--threads", n) for n in ("1", "0"))
    assert one["metrics"] == all_cores["metrics"]


def is_number(value):
    return isinstance(value, int | float) and math.isfinite(value) and value != -1
