"""docs/synthesis.md: its commands run, and it names every rule and default."""

import pytest

from dronepose.synth import Rules, Track, make_plan
from dronepose.synth.rules import PIXEL_RULES
from support import EXAMPLES, ROOT, run


def test_the_commands_of_the_page_run(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    page = (ROOT / "docs" / "synthesis.md").read_text(encoding="utf-8")
    console = page.split("```console\n")[1].split("```")[0]
    lines = [line.removeprefix("$ dronepose ") for line in console.splitlines()]
    assert len(lines) == 6
    (tmp_path / "examples").symlink_to(EXAMPLES)
    for line in lines:
        some = ("--shard", "0/60") if line.startswith("synth render") else ()  # takes a minute
        done = run(*line.split(), *some, cwd=tmp_path, name="dronepose")
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    monkeypatch.chdir(tmp_path)
    before = (tmp_path / "demo" / "plan.csv").read_bytes()
    exec(page.split("```python\n")[1].split("```")[0], {})
    assert (tmp_path / "demo" / "plan.csv").read_bytes() != before  # another seed


def test_the_page_names_every_rule_and_default():
    page = (ROOT / "docs" / "synthesis.md").read_text(encoding="utf-8")
    rules = Rules()
    flight = Track([[0.02 * k, 0, 1.5] for k in range(9)], [[1, 0, 0, 0]] * 9)
    plan = make_plan(flight, [[0, 1, 1.5]], Rules(whole_box_m=((0, 0, 0), (0.1, 0.1, 0.1))))
    names = [step.rule for step in plan.funnel.steps]
    assert "whole" in names
    for name in (*names, *PIXEL_RULES):
        assert f"`{name}`" in page, name
    for sentence in (
        f"`{rules.min_distance_m} <= \\|p_t - a_t\\| <= {rules.max_distance_m}` m",
        f"moves {rules.min_move_m} m or turns {rules.min_turn_deg} degrees at least, "
        f"{rules.max_move_m} m and {rules.max_turn_deg:.0f} degrees at most",
        f"cubes of {rules.anchor_cube_m} m and {rules.drone_cube_m} m",
        f"not within {rules.border} of the width",
    ):
        assert sentence in page, sentence
