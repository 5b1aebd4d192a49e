"""From a flight and a scan to training data: the data set of the DronePose paper, for anybody.

A flight is read from a log (:func:`read_flight`), brought to a steady rate and placed among the
anchors of a scene (:func:`read_anchors`, :func:`fit_placement`); rules choose the poses that are
kept and draw a view on each (:func:`make_plan`). The plan holds every pose that is needed to render
the data set, and a funnel that says what each rule removed. The computation is Rust.

**World frame**: metres, z up, right-handed. A file whose z is up keeps its horizontal axes;
north-east-down becomes x north, y west, z up. **Body frame**: x forward, y left, z up. A pose of a
drone is ``world_from_body``; what a camera sees is ``cam_from_model`` with OpenCV axes.

Names are imported when they are first used; none needs torch. Pictures (:func:`draw_poses`,
:func:`draw_map`) need matplotlib, ``pip install "dronepose[synth]"``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dronepose.synth.anchors import Anchors, read_anchors, sample_free_space
    from dronepose.synth.example import write_example
    from dronepose.synth.flight import (
        Flight,
        Issue,
        Placement,
        Track,
        fit_placement,
        read_flight,
    )
    from dronepose.synth.plan import Plan, PlanTable, make_plan, read_plan
    from dronepose.synth.report import draw_map, draw_poses
    from dronepose.synth.rules import Funnel, FunnelStep, Rules
    from dronepose.synth.splits import SceneSplits, check_splits, read_splits

__all__ = [
    "Anchors",
    "Flight",
    "Funnel",
    "FunnelStep",
    "Issue",
    "Placement",
    "Plan",
    "PlanTable",
    "Rules",
    "SceneSplits",
    "Track",
    "check_splits",
    "draw_map",
    "draw_poses",
    "fit_placement",
    "make_plan",
    "read_anchors",
    "read_flight",
    "read_plan",
    "read_splits",
    "sample_free_space",
    "write_example",
]

_HOME = {
    "Anchors": "anchors",
    "Flight": "flight",
    "Funnel": "rules",
    "FunnelStep": "rules",
    "Issue": "flight",
    "Placement": "flight",
    "Plan": "plan",
    "PlanTable": "plan",
    "Rules": "rules",
    "SceneSplits": "splits",
    "Track": "flight",
    "check_splits": "splits",
    "draw_map": "report",
    "draw_poses": "report",
    "fit_placement": "flight",
    "make_plan": "plan",
    "read_anchors": "anchors",
    "read_flight": "flight",
    "read_plan": "plan",
    "read_splits": "splits",
    "sample_free_space": "anchors",
    "write_example": "example",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'dronepose.synth' has no attribute {name!r}")
    value = getattr(import_module(f"dronepose.synth.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
