"""Plans of real flights over real anchors, where the data folder has them."""

from dataclasses import replace

import pytest

from dronepose.synth import Placement, Rules, make_plan, read_anchors, read_flight, read_splits
from oracles import synth as oracle

FLIGHTS = (
    ("euroc/V1_02_medium.csv", {}),
    ("euroc/V1_02_medium.txt", {"body_axes": "urf"}),
    ("uzhfpv/indoor_forward_5_snapdragon_with_gt.txt", {}),
    ("uzhfpv/indoor_45_14_snapdragon_with_gt.txt", {}),
)


@pytest.mark.parametrize("scan", ["17DRP5sb8fy", "8194nk5LbLH", "TbHJrupSAjP"])
@pytest.mark.parametrize(("name", "options"), FLIGHTS)
def test_real_flights_over_real_anchors(shared, scan, name, options):
    anchors = read_anchors(
        shared(f"data/anchors/matterport3d/connectivity/{scan}_connectivity.json"),
        include_excluded=True,
    )
    flight = read_flight(shared(f"data/trajectories/{name}"), **options)
    plan = make_plan(flight, anchors, fit="centre", scene=scan)
    steps = plan.funnel.steps
    assert steps[0].came_in == plan.facts["frames"]
    assert steps[-1].left == len(plan) > 50
    if scan == "8194nk5LbLH":
        track = flight.resample().placed(
            Placement(**{k: v for k, v in plan.facts["placement"].items() if k != "fit"})
        )
        _, removed = oracle.plan(track, anchors.positions, Rules())
        assert {step.rule: step.removed for step in steps} == removed


def test_the_paper_s_splits_do_not_leak(shared):
    splits = read_splits(shared("data/anchors/matterport3d/splits"))
    assert [len(splits.scenes[s]) for s in ("train", "val", "test")] == [61, 11, 18]


def test_a_settings_change_of_a_real_plan_is_seen(shared):
    """The rule that a real flight fails most is its distance from the anchors."""
    anchors = read_anchors(
        shared("data/anchors/matterport3d/connectivity/TbHJrupSAjP_connectivity.json")
    )
    flight = read_flight(shared("data/trajectories/uzhfpv/indoor_45_14_snapdragon_with_gt.txt"))
    near = make_plan(flight, anchors, Rules(), fit="centre")
    wide = make_plan(flight, anchors, replace(Rules(), max_distance_m=3.0), fit="centre")
    assert len(wide) > len(near)
    assert max(near.funnel.steps, key=lambda step: step.removed).rule == "distance"
