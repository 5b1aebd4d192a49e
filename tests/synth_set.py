"""A tiny rendered data set for the tests of what reads one."""

import json

from dronepose.camera import Camera
from dronepose.synth import Rules, make_plan, read_anchors, read_flight, read_plan, write_example
from dronepose.synth.dataset import write_dataset
from dronepose.synth.inputs import (
    cameras_of,
    read_drone,
    read_more_drones,
    read_panoramas,
    read_scene,
)
from dronepose.synth.sample import RenderSettings
from dronepose.synth.studio import Studio


def write_tiny(
    folder, *, rows=4, size=(96, 72), scenes=(("hall", "train"),), more=(), apart_m=0.6, **options
):
    """``folder/data`` with a few rows a scene; the folder and the plan's table.

    ``more`` are the arguments of ``read_more_drones``, ``options`` those of ``write_dataset``.
    """
    paths = write_example(folder)
    width, height = size
    rules = Rules(
        exo=Camera.from_fov(width, height, horizontal_deg=64.69),
        ego=Camera.from_fov(width, height * 3 // 4, horizontal_deg=85.0),
    )
    flight, anchors = read_flight(paths["flight"]), read_anchors(paths["anchors"])
    made = make_plan(flight, anchors, rules, scene="hall")
    made.some(rows).write(folder / "plan.csv")
    table = read_plan(folder / "plan.csv")
    drone, facts = read_drone("example")
    inputs = {"drone": facts}
    drones = [drone]
    if more:
        further, inputs["more_drones"] = read_more_drones(**more)
        drones += further
    studio = Studio(read_scene("example")[0], drones, samples=3)
    for building, split in scenes:
        done = write_dataset(
            folder / "data",
            table,
            studio,
            cameras_of(table),
            building=building,
            split=split,
            environments=read_panoramas(None)[0],
            settings=RenderSettings(least_pixels=20, least_seen=0.4, apart_m=apart_m),
            inputs=inputs,
            **options,
        )
        assert done["complete"]
        assert done["kept"] >= 2
    return folder / "data", table


def kept_rows(root, building="hall"):
    """The rows of a scene that were kept."""
    records = [json.loads(p.read_text()) for p in sorted((root / "records" / building).iterdir())]
    return [record["row"] for record in records if record["kept"]]
