"""The paper's table of data sets for one that was rendered: counted in its files."""

import json
import re
import shutil

import pytest

from support import SHARED, run

pytest.importorskip("cv2")
pytest.importorskip("trimesh")

from dronepose.synth.dataset import SynthError
from dronepose.synth.table import PAPER, ROWS, SOURCES, DataTable, data_table
from synth_set import kept_rows, write_tiny


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    scenes = (("hall", "train"), ("attic", "train"), ("other", "val"))
    return write_tiny(tmp_path_factory.mktemp("good"), scenes=scenes)[0]


@pytest.fixture
def root(good, tmp_path):
    shutil.copytree(good, tmp_path / "data")
    return tmp_path / "data"


def test_everything_is_counted(good):
    made = data_table(good)
    kept = len(kept_rows(good))
    assert list(made.values)[: len(ROWS)] == list(ROWS)
    assert made.values == {
        "Number of trajectories": "3",
        "Environments": "3",
        "Resolution": "96x72 96x54",
        "Data type": "synthetic",
        "Egocentric views": "Yes",
        "Exocentric views": "Yes",
        "Environment type": "unknown",
        "6D pose": "Yes",
        "IMU data": "No",
        "Depth map": "Yes",
        "Surface normals": "Yes",
        "Scene semantics": "No",
        "Optical flow": "Yes",
        "Silhouettes": "Yes",
        "Samples kept": f"{3 * kept} of 12, each at two times",
        "Drones": "1 (example)",
        "Splits": f"train {2 * kept} (2 scenes), val {kept} (1 scene)",
        "Licences of inputs": "not looked for",
    }
    assert made.facts["splits"]["train"] == {"scenes": 2, "samples": 2 * kept}
    assert made.facts["images"]["exocentric"]["matte"] == 6 * kept
    assert made.facts["samples"] == 3 * kept


def test_what_is_not_there_is_not_claimed(root):
    def cell(row):
        return data_table(root).values[row]

    shutil.rmtree(root / "drone/exocentric/flow")
    assert cell("Optical flow") == "Yes"  # of the other view
    first = sorted((root / "drone/egocentric/flow/hall").iterdir())[0]
    first.unlink()
    assert cell("Optical flow") == "partly"
    shutil.rmtree(root / "drone/egocentric")
    assert cell("Optical flow") == "No"
    assert cell("Egocentric views") == "No"
    assert cell("Resolution") == "96x72"
    assert cell("Depth map") == "Yes"
    shutil.rmtree(root / "drone/exocentric/silhouette/attic")
    assert cell("Silhouettes") == "partly"
    flight = root / "trajectories/hall/flight"
    lines = (flight / "poses_blender.txt").read_text().splitlines()
    (flight / "poses_blender.txt").write_text("\n".join(lines[:2]) + "\n")
    assert cell("6D pose") == "partly"
    (flight / "imu0.csv").write_text("")
    assert cell("IMU data") == "Yes"
    shutil.copytree(root / "drone/exocentric/instance", root / "drone/exocentric/semantics")
    for path in (root / "drone/exocentric/semantics").rglob("*.png"):
        path.rename(path.with_name(path.name.replace("instance", "semantics")))
    assert cell("Scene semantics") == "Yes"


def test_manifests_tell_scenes_drones_and_licences(root):
    for name, scene in (("hall", "a"), ("attic", "a"), ("other", "b")):
        path = root / f"scenes/{name}.json"
        facts = json.loads(path.read_text())
        facts["inputs"]["scene"] = {"file": "x.glb", "sha256": scene}
        facts["inputs"]["more_drones"] = [{"file": "crate.obj"}, {"file": "example"}]
        facts["drones"] = 3
        facts["inputs"]["licences"] = {
            "scene": {"spdx": "CC0-1.0", "files": []},
            "flight": {"spdx": None if scene == "b" else "MIT", "files": []},
        }
        path.write_text(json.dumps(facts))
    values = data_table(root).values
    assert values["Environments"] == "2"
    assert values["Number of trajectories"] == "3"
    assert values["Drones"] == "2 (crate, example), up to 3 in a picture"
    assert values["Licences of inputs"] == "CC0-1.0, MIT; unknown of flight"


def test_markdown_and_latex_have_the_same_cells(good):
    made = data_table(good, name="a_b & c|d", environment="Indoor", data_type="50 % real")
    markdown, latex = made.markdown(), made.latex()
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    table = [
        [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for line in (lines[0], *lines[2:])
    ]
    assert len({len(row) for row in table}) == 1
    heads = [f"{name} [{k}]" for k, name in enumerate(PAPER, 1)]
    assert table[0] == ["", "a_b & c|d", *heads]
    assert ["Data type", "50 % real", *(column[3] for column in PAPER.values())] in table
    rows = [line.removesuffix(r" \\") for line in latex.splitlines() if line.endswith(r" \\")]
    plain = [[re.sub(r"\\([&%_])", r"\1", cell) for cell in re.split(" & ", row)] for row in rows]
    keys = [f"{name}\\cite{{{SOURCES[name][0]}}}" for name in PAPER]
    assert rows[0] == rf" & a\_b \& c|d & {' & '.join(keys)}"
    assert plain[1:] == table[1:]
    assert r"50 \% real" in latex
    for k, (_, text) in enumerate(SOURCES.values(), 1):
        assert f"[{k}] {text}." in markdown


def test_the_paper_is_cited_as_it_is():
    path = SHARED / "paper" / "dronepose-paper.tex"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    text = path.read_text(encoding="utf-8")
    text = text[text.index(r"\label{tab:datasets}") :]
    text = text[text.index(r"\hline") : text.index(r"\end{tabular")]
    lines = [line.replace(r"\\", "").split("&") for line in text.splitlines() if "&" in line]
    found = {re.sub(r"\s+", " ", row[0]).strip().lower(): row[1:] for row in lines[1:]}
    assert len(found) == len(ROWS)
    for k, row in enumerate(ROWS):
        cells = [re.sub(r"\s+", " ", cell).strip() for cell in found[row.lower().replace(
            "scene semantics", "scenes semantics")]]  # fmt: skip
        assert cells == [column[k] for column in PAPER.values()], row
    keys = re.findall(r"\\cite{(\w+)}", " ".join(lines[0]))
    assert keys == [key for key, _ in list(SOURCES.values())[1:]]


def test_a_set_that_is_not_complete_has_no_table(root):
    path = root / "scenes/hall.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "complete": False}))
    with pytest.raises(SynthError, match=r"hall\.json: the scene is not complete"):
        data_table(root)


def test_the_command_prints_it(good, tmp_path):
    made = data_table(good)
    assert isinstance(made, DataTable)
    for options, text in (([], made.markdown()), (["--latex"], made.latex())):
        done = run("synth", "table", good, *options, name="dronepose")
        assert (done.returncode, done.stdout) == (0, text), done.stderr
    done = run("synth", "table", good, "--json", "--environment", "Indoor", name="dronepose")
    facts = json.loads(done.stdout)
    assert facts["column"] == {**made.values, "Environment type": "Indoor"}
    done = run("synth", "table", tmp_path, name="dronepose")
    assert (done.returncode, "holds no rendered data set" in done.stderr) == (1, True)
