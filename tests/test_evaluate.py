"""``dronepose.evaluate``: files and arrays, the same numbers as the functions and the command."""

import json
import re

import numpy as np
import pytest

from dronepose import Mesh, evaluate, metrics
from poses import CAMERA, example_arrays
from support import EXAMPLES


class TestEvaluate:
    def test_arrays_and_files_give_the_same_numbers(self):
        names = ("predictions.csv", "gt.csv")
        from_files = evaluate(*(EXAMPLES / n for n in names), mesh=EXAMPLES / "quadrotor.obj")
        arrays = [example_arrays(n) for n in names]
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        from_tuples = evaluate(*arrays, mesh=mesh)
        from_mappings = evaluate(
            *({"R": R, "t": t, "ids": ids} for R, t, ids in arrays),
            mesh=Mesh(mesh.vertices, mesh.faces),
        )
        assert from_files.n_matched == from_tuples.n_matched == from_mappings.n_matched
        for other in (from_tuples, from_mappings):
            for key in ("npe", "oe_rad", "te_m", "cpe", "add_m", "adds_m"):
                ours, theirs = getattr(other.metrics, key), getattr(from_files.metrics, key)
                assert ours.mean == pytest.approx(theirs.mean, rel=0, abs=1e-12)
            for x, recall in from_files.metrics.acc.items():
                assert other.metrics.acc[x].count == recall.count

    def test_functions_and_evaluation_agree(self):
        est, gt = example_arrays("predictions.csv"), example_arrays("gt.csv")
        index = {name: k for k, name in enumerate(gt[2])}
        chosen = [index[name] for name in est[2]]
        pair = (*est[:2], gt[0][chosen], gt[1][chosen])
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        result = evaluate(est, gt, mesh=mesh, camera=CAMERA)
        m = result.metrics
        for errors, summary in (
            (metrics.cpe(*pair), m.cpe),
            (metrics.add(mesh, *pair), m.add_m),
            (metrics.adds(mesh, *pair), m.adds_m),
            (metrics.mssd(mesh, *pair), m.mssd_m),
            (metrics.mspd(mesh, *pair, CAMERA), m.mspd_px),
            (metrics.projection_error(mesh, *pair, CAMERA), m.proj_px),
        ):
            assert summary.mean == pytest.approx(errors.mean(), rel=1e-12)
            assert summary.p95 == pytest.approx(np.percentile(errors, 95), rel=1e-12)
            assert summary.std == pytest.approx(errors.std(), rel=1e-9)
        assert m.acc["5"].count == metrics.acc(*pair, x=5).sum()
        recall = metrics.add_recall(mesh, *pair, 0.05 * mesh.bbox_diagonal)
        assert m.add_recall.at["5"].percent_of_matched == pytest.approx(100 * recall)
        errors = metrics.add(mesh, *pair)
        for method in ("exact", "ycb"):
            ours = metrics.auc(errors, n_total=len(gt[2]), method=method)
            assert getattr(m.add_auc, method) == pytest.approx(ours, rel=1e-12)

    def test_dataclasses_mirror_the_json(self):
        result = evaluate(
            EXAMPLES / "predictions.csv",
            EXAMPLES / "gt.csv",
            mesh=EXAMPLES / "quadrotor.obj",
            by=["scene", "distance"],
            bootstrap=50,
            compare=[EXAMPLES / "predictions_baseline.csv"],
            add_reference=0.354,
            acc=[5, 2.5],
        )
        data = result.to_dict()
        assert data == json.loads(result.to_json())
        assert data["schema"] == result.schema == "dronepose-eval/1"
        assert list(result.metrics.acc) == sorted(data["metrics"]["acc"])
        assert set(result.metrics.acc) == {"5", "2.5"}
        assert result.metrics.add_recall.reference_m == 0.354
        assert set(result.metrics.add_recall.at) == {"2", "5", "10"}
        assert [b.column for b in result.by] == ["scene", "distance"]
        assert result.by[1].groups[0].from_ == data["by"][1]["groups"][0]["from"]
        assert result.ci95.mean["npe"] == tuple(data["ci95"]["npe"])
        assert result.compare[0].difference["npe"].mean > 0
        assert result.table()
        assert str(result) == result.table()
        assert "npe" in result.table().lower()
        data["n_gt"] = 0
        assert result.to_dict()["n_gt"] == 2000

    def test_a_preset_brings_its_reference_length(self):
        files = (EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv")
        references = {"paper": "bbox-diagonal", "authors": "metres", "bop": "diameter"}
        for preset, reference in references.items():
            result = evaluate(
                *files, mesh=EXAMPLES / "quadrotor.obj", preset=preset, metrics="add", bootstrap=0
            )
            assert result.metrics.add_recall.reference == reference
        result = evaluate(*files, preset="authors", batch_size=64, bootstrap=0)
        assert result.authors.n_batches == -(-result.n_matched // 64)

    def test_a_choice_of_metrics(self):
        files = (EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv")
        mesh = EXAMPLES / "quadrotor.obj"
        result = evaluate(*files, mesh=mesh, metrics=["adds", "mssd"], bootstrap=0)
        assert result.metrics.add_m is None
        assert result.metrics.adds_m.mean <= result.metrics.mssd_m.mean
        with pytest.raises(ValueError, match="adz"):
            evaluate(*files, mesh=mesh, metrics=["adz"])

    def test_the_up_axis_turns_the_elevation(self):
        files = (EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv")
        results = {up: evaluate(*files, by="elevation", up=up, bootstrap=0) for up in "yz"}
        assert {up: r.settings.up for up, r in results.items()} == {"y": "y", "z": "z"}
        assert evaluate(*files, bootstrap=0).settings.up == "z"
        assert results["y"].by[0].groups != results["z"].by[0].groups

    def test_notes_say_what_was_left_out(self):
        one = {"R": np.tile(np.eye(3), (60_000, 1, 1)), "t": np.tile([0.0, 0.0, 2.0], (60_000, 1))}
        result = evaluate(one, one)
        assert result.ci95 is None
        assert any("--bootstrap" in note for note in result.notes)
        assert result.to_dict()["notes"] == result.notes
        assert evaluate(*[EXAMPLES / "gt.csv"] * 2).notes == []

    def test_differences_of_recalls_are_percent_of_ground_truth(self):
        result = evaluate(
            EXAMPLES / "predictions.csv",
            EXAMPLES / "gt.csv",
            mesh=EXAMPLES / "quadrotor.obj",
            compare=EXAMPLES / "predictions_baseline.csv",
            bootstrap=20,
        )
        other = result.compare[0]
        for prefix, ours, theirs in (
            ("acc", result.metrics.acc, other.metrics.acc),
            ("add_recall", result.metrics.add_recall.at, other.metrics.add_recall.at),
            ("adds_recall", result.metrics.adds_recall.at, other.metrics.adds_recall.at),
        ):
            for key, recall in ours.items():
                difference = other.difference[f"{prefix}_{key}"]
                expected = theirs[key].percent_of_gt - recall.percent_of_gt
                assert difference.mean == pytest.approx(expected, abs=1e-9)
                assert difference.n == result.n_gt

    def test_it_is_among_the_metrics(self):
        assert metrics.evaluate is evaluate

    def test_row_numbers_are_ids_where_none_are_given(self):
        R, t = np.tile(np.eye(3), (3, 1, 1)), np.tile([0.0, 0.0, 2.0], (3, 1))
        result = evaluate((R[:2], t[:2]), (R, t))
        assert (result.n_gt, result.n_matched, result.n_predictions) == (3, 2, 2)
        assert result.metrics.cpe.max == 0.0

    @pytest.mark.parametrize(
        ("poses", "error", "text"),
        [
            ((np.eye(3), np.zeros(3)), ValueError, r"predictions R: expected shape \(N, 3, 3\)"),
            ((np.eye(3)[None], np.ones((2, 3))), ValueError, "as many R, t and ids"),
            ((np.eye(3)[None], np.ones((1, 3)), ["a", "b"]), ValueError, "as many R, t and ids"),
            ({"R": np.eye(3)[None]}, ValueError, "keys"),
            (7, TypeError, "predictions: expected a path"),
        ],
    )
    def test_refusals_name_the_input(self, poses, error, text):
        with pytest.raises(error, match=text):
            evaluate(poses, (np.eye(3)[None], np.ones((1, 3))))

    def test_errors_in_files_come_with_their_place(self, tmp_path):
        bad = tmp_path / "bad.csv"
        bad.write_text("id,qw,qx,qy,qz,tx,ty,tz\na,1,0,0,0,0,zero,1\n")
        with pytest.raises(ValueError, match=re.escape("bad.csv:2:ty: ")):
            evaluate(bad, EXAMPLES / "gt.csv")
        with pytest.raises(FileNotFoundError, match=r"none\.csv"):
            evaluate(tmp_path / "none.csv", EXAMPLES / "gt.csv")

    def test_an_unknown_choice_is_an_error(self):
        with pytest.raises(ValueError, match="preset"):
            evaluate(EXAMPLES / "gt.csv", EXAMPLES / "gt.csv", preset="kind")
