"""Malformed input: refused with file, line and column, or read as its meaning is."""

import json
import os
import re
import subprocess

import pytest

from support import SHARED, loads, run

FOLDER = SHARED / "cases" / "bad"
EXPECTATIONS = FOLDER / "expectations.json"
CASES = (
    json.loads(EXPECTATIONS.read_text(encoding="utf-8"))["cases"] if EXPECTATIONS.exists() else []
)
METRICS = {"NPE": "npe", "OE": "oe_rad", "CPE": "cpe"}

pytestmark = pytest.mark.skipif(
    not CASES, reason="cases/bad is not in ../shared (or DRONEPOSE_SHARED)"
)


@pytest.fixture
def arguments(case, tmp_path):
    """The command line of a case, after its set-up."""
    if case.get("skip_if") == "uid==0" and os.geteuid() == 0:
        pytest.skip("the superuser may read everything")
    if case.get("generated"):
        pytest.skip("a generated case without its files")
    if "setup" in case:
        subprocess.run(
            ["bash", "-c", case["setup"]],
            cwd=FOLDER,
            env={**os.environ, "D": str(tmp_path)},
            stdout=subprocess.DEVNULL,  # a pipe would wait for what the script leaves running
            stderr=subprocess.DEVNULL,
            check=True,
        )
    yield [a.replace("$D", str(tmp_path)) for a in case["args"]]
    for path in tmp_path.iterdir():
        if path.is_fifo():  # lets a writer go that nobody read from
            os.close(os.open(path, os.O_RDONLY | os.O_NONBLOCK))


@pytest.mark.parametrize("case", CASES or [{"case": "none"}], ids=lambda c: c["case"])
def test_malformed_input(case, arguments):
    limit = case.get("max_seconds", 60)
    done = run(*arguments, cwd=FOLDER, timeout=limit)
    if case["expect"] == "error" or (case["expect"] == "either" and done.returncode != 0):
        check_refused(case, done)
        return
    assert done.returncode == 0, done.stderr
    assert done.stdout
    if case["case"] == "f07_fifo":  # a pipe is read once
        return
    again = run(*arguments, "--json", "-", cwd=FOLDER, timeout=limit)
    assert again.returncode == 0, again.stderr
    check_metrics(case["metrics"], loads(again.stdout))


def check_refused(case, done):
    assert done.returncode == (2 if not case["args"] else 1), done.stderr
    assert done.stdout == ""
    message = done.stderr
    assert "panicked" not in message
    for alternatives in case["must_mention"]:
        words = alternatives.lower().split("|")
        assert any(word in message.lower() for word in words), f"{alternatives}: {message}"
    name, line, column = case["file"], case["line"], case["column"]
    if name is None:
        return
    place = re.escape(name)
    if line is not None:
        place += f":{line}"
        if column is None:
            place += r"(:[^\s:]+)?"
    if column is not None:
        place += f":{re.escape(column)}"
    if line is not None or column is not None:
        place += ":"
    assert re.search(place, message), f"{place}: {message}"
    if "other_line" in case:
        assert re.search(rf"\b{case['other_line']}\b", message), message


def check_metrics(truth, result):
    assert (result["n_gt"], result["n_matched"]) == (truth["n_gt"], truth["n_matched"])
    for theirs, ours in METRICS.items():
        assert result["metrics"][ours]["mean"] == pytest.approx(truth[theirs], rel=0, abs=1e-9)
    for x in ("2", "5", "10"):
        ours = result["metrics"]["acc"][x]["percent_of_gt"]
        assert ours == pytest.approx(truth[f"Acc{x}_percent_of_gt"], rel=1e-14)


def test_an_error_is_one_line_and_no_result_is_written(tmp_path):
    out = tmp_path / "out.json"
    done = run(FOLDER / "c03_nan/predictions.csv", FOLDER / "c03_nan/gt.csv", "--json", out)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert not out.exists()


def test_strict_turns_a_warning_into_an_error():
    paths = [FOLDER / "a21_missing_predictions" / name for name in ("predictions.csv", "gt.csv")]
    assert run(*paths).returncode == 0
    done = run(*paths, "--strict")
    assert (done.returncode, done.stdout) == (1, "")
