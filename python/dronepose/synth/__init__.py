"""From a flight and a scan to training data: the data set of the DronePose paper, for anybody.

A flight is read from a log (:func:`read_flight`) or flown here (:func:`fly`), brought to a steady
rate and placed among the anchors of a scene (:func:`read_anchors`, :func:`fit_placement`); rules
choose the poses that are kept and draw a view on each (:func:`make_plan`). The plan holds every
pose that is needed to render
the data set, and a funnel that says what each rule removed. The computation is Rust.

**World frame**: metres, z up, right-handed. A file whose z is up keeps its horizontal axes;
north-east-down becomes x north, y west, z up. **Body frame**: x forward, y left, z up. A pose of a
drone is ``world_from_body``; what a camera sees is ``cam_from_model`` with OpenCV axes.

A scene and a drone are read with their textures (:func:`load_asset`), and a :class:`Studio` draws
every modality of the plan's rows, which :func:`write_dataset` writes in the layout of UAVA.

Names are imported when they are first used; none needs torch. Rendering and pictures need the
packages of ``pip install "dronepose[synth]"``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dronepose.synth.anchors import Anchors, read_anchors, sample_free_space
    from dronepose.synth.asset import Asset, AssetError, load_asset, load_placements, merged
    from dronepose.synth.cluster import Cluster
    from dronepose.synth.dataset import SynthError, write_dataset
    from dronepose.synth.example import write_example
    from dronepose.synth.flight import (
        Flight,
        Issue,
        Placement,
        Track,
        fit_placement,
        read_flight,
    )
    from dronepose.synth.flyer import Flown, Pilot, fly
    from dronepose.synth.plan import Plan, PlanTable, make_plan, read_plan
    from dronepose.synth.preview import preview
    from dronepose.synth.report import draw_map, draw_poses
    from dronepose.synth.rooms import example_hall
    from dronepose.synth.rules import Funnel, FunnelStep, Rules
    from dronepose.synth.sample import RenderSettings, render_sample
    from dronepose.synth.sheet import draw_sheet
    from dronepose.synth.sources import Loaded, Sources
    from dronepose.synth.splits import SceneSplits, check_splits, read_splits
    from dronepose.synth.studio import Frame, Studio

__all__ = [
    "Anchors",
    "Asset",
    "AssetError",
    "Cluster",
    "Flight",
    "Flown",
    "Frame",
    "Funnel",
    "FunnelStep",
    "Issue",
    "Loaded",
    "Pilot",
    "Placement",
    "Plan",
    "PlanTable",
    "RenderSettings",
    "Rules",
    "SceneSplits",
    "Sources",
    "Studio",
    "SynthError",
    "Track",
    "check_splits",
    "draw_map",
    "draw_poses",
    "draw_sheet",
    "example_hall",
    "fit_placement",
    "fly",
    "load_asset",
    "load_placements",
    "make_plan",
    "merged",
    "preview",
    "read_anchors",
    "read_flight",
    "read_plan",
    "read_splits",
    "render_sample",
    "sample_free_space",
    "write_dataset",
    "write_example",
]

_HOME = {
    "Anchors": "anchors",
    "Asset": "asset",
    "AssetError": "asset",
    "Cluster": "cluster",
    "Flight": "flight",
    "Flown": "flyer",
    "Frame": "studio",
    "Funnel": "rules",
    "FunnelStep": "rules",
    "Issue": "flight",
    "Loaded": "sources",
    "Pilot": "flyer",
    "Placement": "flight",
    "Plan": "plan",
    "PlanTable": "plan",
    "RenderSettings": "sample",
    "Rules": "rules",
    "SceneSplits": "splits",
    "Sources": "sources",
    "Studio": "studio",
    "SynthError": "dataset",
    "Track": "flight",
    "check_splits": "splits",
    "draw_map": "report",
    "draw_poses": "report",
    "draw_sheet": "sheet",
    "example_hall": "rooms",
    "fit_placement": "flight",
    "fly": "flyer",
    "load_asset": "asset",
    "load_placements": "asset",
    "make_plan": "plan",
    "merged": "asset",
    "preview": "preview",
    "read_anchors": "anchors",
    "read_flight": "flight",
    "read_plan": "plan",
    "read_splits": "splits",
    "render_sample": "sample",
    "sample_free_space": "anchors",
    "write_dataset": "dataset",
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
