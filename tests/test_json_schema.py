"""``--json`` keeps to its schema, and the schema to the documentation and the dataclasses."""

import copy
import dataclasses
import json

import jsonschema
import pytest

from dronepose import results
from support import EXAMPLES, ROOT, SHARED, evaluate, loads, run

SCHEMA = json.loads((ROOT / "docs" / "dronepose-eval-1.schema.json").read_text(encoding="utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
FILES = (EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv")
MESH = ("--mesh", EXAMPLES / "quadrotor.obj")
CAMERA = ("--camera", "252.7,252.7,160,120,320,240")


@pytest.mark.parametrize(
    "options",
    [
        (),
        MESH,
        CAMERA,
        (*MESH, *CAMERA),
        (*MESH, "--preset", "authors", "--batch-size", "64"),
        (*MESH, *CAMERA, "--preset", "bop"),
        ("--preset", "speedplus"),
        (*MESH, "--add-reference", "0.354", "--add", "1,2.5", "--acc", "0.5,20"),
        (*MESH, "--by", "scene", "--by", "distance", "--by", "azimuth", "--by", "elevation"),
        (*MESH, "--bootstrap", "50", "--seed", "7"),
        (*MESH, "--bootstrap", "50", "--compare", EXAMPLES / "predictions_baseline.csv"),
        ("--compare", EXAMPLES / "predictions_baseline.csv", "--bootstrap", "0"),
    ],
    ids=lambda o: " ".join(str(x).rpartition("/")[2] for x in o) or "plain",
)
def test_the_output_keeps_to_the_schema(options):
    result = evaluate(*FILES, *options)
    VALIDATOR.validate(result)
    assert results.Evaluation.from_json(json.dumps(result)).n_gt == result["n_gt"]


def test_other_formats_and_symmetries_keep_to_it_too():
    folder = SHARED / "cases" / "eval" / "c08_symmetric_box"
    if not folder.exists():
        pytest.skip("cases/eval/c08_symmetric_box is not in ../shared (or DRONEPOSE_SHARED)")
    mesh = ("--mesh", folder.parent / "models" / "box.obj", "--camera", "500,500,320,240,640,480")
    symmetries = ("--symmetries", folder / "bop" / "models_info.json")
    for paths in (
        ("bop/case_tudl-test.csv", "bop/scene_gt.json"),
        ("speed/submission.json", "speed/labels_speedplus.json"),
    ):
        result = evaluate(*(folder / p for p in paths), *mesh, *symmetries)
        VALIDATOR.validate(result)
        assert result["settings"]["n_symmetries"] == 4


def test_points_behind_the_camera_do_not_make_infinite_numbers(tmp_path):
    gt, est = tmp_path / "gt.csv", tmp_path / "est.csv"
    head = "id,qw,qx,qy,qz,tx,ty,tz\n"
    gt.write_text(head + "a,1,0,0,0,0,0,2\nb,1,0,0,0,0,0,2\n")
    est.write_text(head + "a,1,0,0,0,0,0,2.1\nb,1,0,0,0,0,0,-2\n")
    result = evaluate(est, gt, *MESH, *CAMERA)
    VALIDATOR.validate(result)
    assert result["metrics"]["proj_px"]["n_undefined"] == 1
    assert result["metrics"]["proj_recall_5px"]["percent_of_gt"] <= 50.0


def test_the_file_holds_what_standard_output_shows(tmp_path):
    out = tmp_path / "result.json"
    assert run(*FILES, "--json", out).returncode == 0
    assert loads(out.read_text(encoding="utf-8")) == evaluate(*FILES)


def test_the_schema_refuses_what_it_should():
    good = evaluate(*FILES, *MESH)

    def broken(*path, value):
        data = copy.deepcopy(good)
        *parents, last = path
        target = data
        for key in parents:
            target = target[key]
        target[last] = value
        return data

    for data in (
        broken("schema", value="dronepose-eval/2"),
        broken("extra", value=1),
        broken("n_gt", value=-1),
        broken("metrics", "npe", "mean", value=None),
        broken("metrics", "npe", "extra", value=1),
        broken("metrics", "acc", "five", value=good["metrics"]["acc"]["5"]),
        broken("metrics", "add_recall", "reference", value="metre"),
        broken("inputs", "gt", "sha256", value="0"),
        {k: v for k, v in good.items() if k != "settings"},
    ):
        assert not VALIDATOR.is_valid(data)


def test_the_dataclasses_have_the_keys_of_the_schema():
    definitions = {**SCHEMA["$defs"], "Evaluation": SCHEMA}
    del definitions["Interval"]
    for name, definition in definitions.items():
        fields = [
            f.metadata.get("key", f.name)
            for f in dataclasses.fields(getattr(results, name))
            if not {"flatten", "internal"} & set(f.metadata)
        ]
        assert sorted(fields) == sorted(definition["properties"]), name


def test_the_documentation_has_every_key():
    text = (ROOT / "docs" / "json.md").read_text(encoding="utf-8")
    sections = dict(s.split("\n", 1) for s in text.split("\n## ")[1:])
    definitions = {**SCHEMA["$defs"], "Evaluation": SCHEMA}
    del definitions["Interval"]
    assert set(sections) == set(definitions)
    for name, definition in definitions.items():
        for key in definition["properties"]:
            assert f"| `{key}` |" in sections[name], f"{name}.{key}"
