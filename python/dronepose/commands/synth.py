"""Make training data: plan samples from a flight and a scene's anchors, and look at them."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose._progress import Progress, Stages
from dronepose.commands._running import GOES_ON, run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

EXAMPLE = """\
examples:
  dronepose synth example demo
  dronepose synth fly --coins demo/anchors.csv --scene example --out demo/flown.txt
  dronepose synth plan --flight demo/flown.txt --anchors demo/anchors.csv --out demo/plan.csv
  dronepose synth report demo/plan.csv --out demo
  dronepose synth render demo/plan.csv --out demo/data
  dronepose synth sheet demo/data --out demo/sheet.png
  dronepose synth doctor demo/data
"""
LARGEST_DRONE_M = 5.0
PLAN = """\
examples:
  dronepose synth plan --flight demo/flight.txt --anchors demo/anchors.csv --out demo/plan.csv
  dronepose synth plan --flight airsim_rec.txt --max-gap 2 --anchors hall_connectivity.json \\
      --fit centre --scene hall --splits splits --out hall.csv
  dronepose synth plan --flight flight.csv --body-axes frd --world ned --anchors anchors.csv \\
      --mesh drone.obj --model-axes luf --seed 1 --out plan.csv
  dronepose render drone.obj plan.csv --camera 252.7,252.7,160,120,320,240 --out drawn

World frame: metres, z up, right-handed. Body frame: x forward, y left, z up.
plan.csv has a row for each sample; its id,qw..qz,tx..tz is the drone in the exocentric camera, as
dronepose render and dronepose-eval read it. plan.json is the manifest.
"""
ANCHORS = """\
examples:
  dronepose synth anchors --low 0 0 1.2 --high 9 6 1.8 --count 20 --out anchors.csv
  dronepose synth anchors --mesh house.obj --count 40 --clearance 0.6 --out anchors.csv

Points are uniform in the box (by default that of the mesh, which is in metres with z up), as far
from its surface and from one another as is asked for. Outside of a closed scene is as free as
inside: the box says where to look.
"""
FLY = """\
examples:
  dronepose synth fly --coins demo/anchors.csv --scene example --seconds 60 --out demo/flown.txt
  dronepose synth fly --coins anchors.csv --scene house.glb --seed 3 --variance 0.5 --out flight.txt

Writes a flight of a quadrotor that collects coins at the anchors and keeps away from the walls, in
the format of TUM (seconds, metres, quaternion x y z w, world_from_body), for synth plan.
"""
RENDER = """\
examples:
  dronepose synth render demo/plan.csv --out demo/data
  dronepose synth render house.csv --scene small_house/placements.csv --drone DJI.obj \\
      --panoramas hdri --building house --split train --out data
  dronepose synth render house.csv --scene house.glb --shard 3/16 --out data
  dronepose synth render house.csv --scene house.glb --dask tcp://head:8786 --out data

The same command goes on where it was stopped. The layout is UAVA's: dronepose train reads it with
--data.kind uava. Pictures depend on the plan, the inputs and --seed alone.
"""
SHEET = """\
example:
  dronepose synth sheet demo/data --out demo/sheet.png
"""
DOCTOR = """\
examples:
  dronepose synth doctor demo/data
  dronepose synth doctor data --mesh DJI.obj --limit 200 --json

Looks at manifest, records, files, lists and poses of the whole folder, and compares the images of
each kept sample with one another: depth with normals, silhouette with pose and mesh, matte with
both, colours by the flow between the two times. Ends with 0 if all is well, 1 if something is
wrong, 2 if the command was not understood.
"""
EXPORT = """\
examples:
  dronepose synth export demo/data --format bop --out demo/bop
  dronepose synth export data --format bop --mesh DJI.obj --out bop
  dronepose synth export demo/data --format webdataset --shard-size 100 --out demo/shards

Writes all kept samples, both times, into a new folder: bop has the exocentric view, in millimetres,
webdataset has tar files with all images of both views. The folder is there when all of it is.
"""
TABLE = """\
examples:
  dronepose synth table demo/data
  dronepose synth table data --environment Indoor --data-type photorealistic --latex

Prints the columns of the paper's table of data sets for what was made, beside those of the paper.
All but the two options is counted in the folder.
"""
REPORT = """\
example:
  dronepose synth report demo/plan.csv --out demo

Writes poses.png (density in the exocentric camera, yaw, pitch, roll) and, if there is a manifest,
map.png (flight, anchors and pairs from above).
"""


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose synth``.

    Args:
        argv: The arguments after the subcommand.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> main(["plan", "--help"])  # doctest: +SKIP
        0
    """
    return run(_parser(), argv, _work)


def _work(args: argparse.Namespace) -> int:
    done: Callable[[argparse.Namespace, Stages], int] = args.run
    with Stages() as stage:
        return done(args, stage)


def _plan(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth import Placement, make_plan, read_anchors, read_flight, read_splits

    split = None
    scene = args.scene
    if scene is None and args.anchors.name.endswith("_connectivity.json"):
        scene = args.anchors.name.removesuffix("_connectivity.json")
    if args.splits is not None:
        if not scene:
            raise ValueError("--splits: expected --scene NAME with it")
        split = read_splits(args.splits).split_of(scene)
    rules = _rules(args)
    stage("reading the flight")
    flight = read_flight(
        args.flight,
        format=args.flight_format,
        world=args.world,
        body_axes=args.body_axes,
        quaternion=args.quaternion,
        time_unit=args.time_unit,
        mount_rpy_deg=args.mount_rpy,
        vehicle=args.vehicle,
        source_rate_hz=args.source_rate,
        min_step_s=args.min_step,
        max_gap_s=args.max_gap,
        max_speed_m_s=args.max_speed,
        max_turn_deg_s=args.max_turn_rate,
    )
    stage("reading the anchors")
    anchors = read_anchors(
        args.anchors, format=args.anchors_format, include_excluded=args.all_anchors
    )
    stage("applying the rules")
    plan = make_plan(
        flight,
        anchors,
        rules,
        rate_hz=args.rate,
        placement=Placement(args.scale, args.yaw, tuple(args.offset)),
        fit=None if args.fit == "none" else args.fit,
        scene=scene or "",
        split=split,
        threads=args.threads,
    )
    text = _describe(flight.describe(), anchors.describe(), plan)
    if not len(plan):
        print(text, file=sys.stderr)
        worst = max(plan.funnel.steps, key=lambda step: step.removed)
        raise ValueError(
            f"no sample is left: rule {worst.rule} removed {worst.removed} poses of "
            f"{worst.came_in}; nothing was written"
            + (" (--fit brings the flight over the anchors)" if args.fit == "none" else "")
        )
    stage("writing")
    manifest = plan.write(args.out, args.manifest)
    if args.json:
        facts = plan.manifest()
        del facts["map"]
        print(json.dumps({"plan": str(args.out), "manifest": str(manifest), **facts}, indent=2))
    else:
        print(f"{text}\n{len(plan)} samples in {args.out}, manifest {manifest}")
    return 0


def _describe(flight: str, anchors: str, plan: Any) -> str:
    place = plan.facts["placement"]
    x, y, z = place["offset"]
    fit = f" (fit {place['fit']})" if place["fit"] else ""
    return "\n".join(
        [
            flight,
            anchors,
            f"placed{fit}: scale {place['scale']:.4g}, yaw {place['yaw_deg']:g} degrees, "
            f"offset {x:.3f} {y:.3f} {z:.3f} m; {plan.facts['frames']} frames at "
            f"{plan.facts['rate_hz']:g} Hz",
            "",
            str(plan.funnel),
        ]
    )


def _rules(args: argparse.Namespace) -> Any:
    from dronepose.camera import Camera
    from dronepose.synth import Rules

    exo = args.camera or Camera.from_fov(*args.size, horizontal_deg=args.fov)
    centroid, box = args.centroid, None
    if args.whole and args.mesh is None:
        raise ValueError("--whole: expected --mesh FILE with it")
    if args.mesh is not None:
        if centroid is not None:
            raise ValueError("--mesh, --centroid: expected one of the two")
        from dronepose.mesh import Mesh

        corners = args.mesh_unit * Mesh.from_file(args.mesh).bounds
        size = corners[1] - corners[0]
        if size.max() > LARGEST_DRONE_M:
            wide, long, high = (f"{side:.3g}" for side in size)
            raise ValueError(
                f"{args.mesh}: {wide} x {long} x {high} m are no drone; --mesh-unit says how many "
                "metres its unit has (0.01: centimetres)"
            )
        centroid = 0.5 * (corners[0] + corners[1])
        box = [corner.tolist() for corner in corners] if args.whole else None
    return Rules(
        seed=args.seed,
        min_distance_m=args.distance[0],
        max_distance_m=args.distance[1],
        stride=args.stride,
        min_move_m=args.move[0],
        max_move_m=args.move[1],
        min_turn_deg=args.turn[0],
        max_turn_deg=args.turn[1],
        motion=args.motion,
        anchor_cube_m=args.anchor_cube,
        drone_cube_m=args.drone_cube,
        border=args.border,
        exo=exo,
        ego_down_deg=args.ego_down,
        ego_offset_m=tuple(args.ego_offset),
        model_axes=args.model_axes,
        centroid_m=(0.0, 0.0, 0.0) if centroid is None else tuple(map(float, centroid)),
        whole_box_m=box,
    )


def _report(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth import draw_map, draw_poses, read_plan

    table = read_plan(args.plan, args.manifest)
    args.out.mkdir(parents=True, exist_ok=True)
    stage("drawing the poses")
    written = [args.out / "poses.png"]
    draw_poses(table, written[0])
    if table.manifest:
        stage("drawing the map")
        written.append(args.out / "map.png")
        draw_map(table, written[1])
    else:
        print("no manifest beside the plan, so no map", file=sys.stderr)
    if args.json:
        print(json.dumps({"samples": len(table), "files": [str(path) for path in written]}))
    else:
        print(f"{len(table)} samples: {', '.join(map(str, written))}")
    return 0


def _anchors(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth import sample_free_space
    from dronepose.synth.inputs import scene_mesh

    stage("reading the mesh")
    mesh = None if args.mesh is None else scene_mesh(args.mesh)
    low, high = args.low, args.high
    if mesh is None and (low is None or high is None):
        raise ValueError("--low, --high: expected both, or --mesh")
    if mesh is not None:
        low = mesh.vertices.min(axis=0) if low is None else low
        high = mesh.vertices.max(axis=0) if high is None else high
    stage("looking for free space")
    anchors = sample_free_space(
        low,
        high,
        args.count,
        mesh=mesh,
        clearance_m=args.clearance,
        spacing_m=args.spacing,
        seed=args.seed,
        threads=args.threads,
    )
    anchors.write_csv(args.out)
    if args.json:
        print(json.dumps({"anchors": str(args.out), "count": len(anchors), "seed": args.seed}))
    else:
        print(f"{len(anchors)} anchors in {args.out}")
    return 0


def _fly(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth import Pilot, fly, read_anchors

    stage("reading the coins")
    coins = read_anchors(args.coins)
    mesh = None
    if args.scene is not None:
        from dronepose.synth.inputs import read_scene

        stage("reading the scene")
        mesh = read_scene(args.scene, metres_per_unit=args.scene_unit)[0].mesh
    pilot = Pilot(
        seed=args.seed,
        seconds=args.seconds,
        speed_m_s=args.speed,
        clearance_m=args.clearance,
        variance=args.variance,
    )
    stage("flying")
    flown = fly(coins.positions, mesh, pilot)
    flown.write_tum(args.out)
    if args.json:
        print(json.dumps({"flight": str(args.out), **flown.facts}, indent=2))
        return 0
    wall = flown.facts["nearest_wall_m"]
    lost = [coins.names[k] for k in flown.facts["unreachable"]]
    print(
        f"{args.out}: {len(flown.track)} poses, {len(flown.facts['collected'])} coins collected"
        + (f", never nearer than {wall:.2f} m to a wall" if wall is not None else "")
        + (f"; cannot be reached: {', '.join(lost)}" if lost else "")
    )
    return 0


def _render(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth.rendering import render_plan

    made = render_plan(args, stage)
    if args.json:
        print(json.dumps({key: value for key, value in made.items() if key != "plan"}, indent=2))
        return 0
    rules = ", ".join(f"{s['rule']} {s['removed']}" for s in made.get("rendered_rules", []))
    state = "" if made["complete"] else "; other shards are missing"
    kept = f", {made['kept']} kept (removed: {rules})" if made["complete"] else ""
    print(f"{args.out}: {made['written']} of {made['rows']} rows rendered now{kept}{state}")
    return 0


def _sheet(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose._files import write_bytes
    from dronepose.synth.sheet import draw_sheet

    stage("drawing")
    write_bytes(args.out, draw_sheet(args.data, building=args.building, rows=args.rows))
    print(json.dumps({"file": str(args.out)}) if args.json else args.out)
    return 0


def _doctor(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth.doctor import check_dataset

    stage("looking at the folder")
    with closing(Progress("samples")) as progress:
        found = check_dataset(args.data, mesh=args.mesh, limit=args.limit, progress=progress)
    print(json.dumps(found.facts(), indent=2) if args.json else found)
    return 0 if found.healthy else 1


def _export(args: argparse.Namespace, stage: Stages) -> int:
    stage("exporting")
    with closing(Progress("samples")) as progress:
        if args.format == "bop":
            from dronepose.synth.export import export_bop

            if args.shard_size is not None:
                raise ValueError("--shard-size: only for --format webdataset")
            made = export_bop(args.data, args.out, mesh=args.mesh, progress=progress)
            text = f"{made['images']} images of {made['samples']} samples"
        else:
            from dronepose.synth.shards import export_webdataset

            if args.mesh is not None:
                raise ValueError("--mesh: only for --format bop")
            size = args.shard_size or 500
            made = export_webdataset(args.data, args.out, shard_size=size, progress=progress)
            text = (
                f"{made['samples']} samples, {made['keys']} keys, in {len(made['shards'])} shards"
            )
    print(json.dumps({"out": str(args.out), **made}, indent=2) if args.json else
          f"{args.out}: {text}")  # fmt: skip
    return 0


def _table(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth.table import data_table

    stage("counting")
    made = data_table(
        args.data, name=args.name, environment=args.environment, data_type=args.data_type
    )
    text = made.latex() if args.latex else made.markdown()
    print(json.dumps({**made.facts, "column": made.values}, indent=2) if args.json else text,
          end="\n" if args.json else "")  # fmt: skip
    return 0


def _example(args: argparse.Namespace, stage: Stages) -> int:
    from dronepose.synth import write_example

    stage("writing")
    paths = write_example(args.out)
    if args.json:
        print(json.dumps({name: str(path) for name, path in paths.items()}))
    else:
        print(f"{paths['flight']} (TUM), {paths['anchors']}")
    return 0


def _parser() -> argparse.ArgumentParser:
    from dronepose.synth import options

    parser = argparse.ArgumentParser(
        prog="dronepose synth",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, text: str, epilog: str, run: Any) -> argparse.ArgumentParser:
        made = commands.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        made.set_defaults(run=run)
        made.add_argument("--json", action="store_true", help="say what was done as JSON")
        return made

    options.add_plan_options(command("plan", "choose samples of a flight in a scene", PLAN, _plan))
    report = command("report", "draw the poses of a plan, and a map", REPORT, _report)
    report.add_argument("plan", type=Path, metavar="PLAN", help="plan.csv")
    report.add_argument("--manifest", type=Path, metavar="FILE", help="[plan.json beside it]")
    report.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    options.add_anchor_options(
        command("anchors", "choose places in the free space of a scene", ANCHORS, _anchors)
    )
    options.add_fly_options(command("fly", "fly through a scene without a simulator", FLY, _fly))
    render = command("render", "render a plan to a data set", RENDER, _render)
    options.add_render_options(render)
    render.set_defaults(stopped=GOES_ON)
    sheet = command("sheet", "draw a contact sheet of a rendered data set", SHEET, _sheet)
    sheet.add_argument("data", type=Path, metavar="DATA", help="folder of the data set")
    sheet.add_argument("--building", metavar="NAME", help="which scene [the first]")
    sheet.add_argument("--rows", type=int, default=8, metavar="N", help="samples at most [8]")
    sheet.add_argument("--out", type=Path, required=True, metavar="PNG", help="file to write")
    doctor = command("doctor", "check a rendered data set", DOCTOR, _doctor)
    doctor.add_argument("data", type=Path, metavar="DATA", help="folder of the data set")
    doctor.add_argument("--mesh", metavar="FILE", help="the drone's mesh [the example drone's]")
    doctor.add_argument("--limit", type=_count, metavar="N", help="samples to look at [all]")
    export = command("export", "write a rendered data set in another format", EXPORT, _export)
    export.add_argument("data", type=Path, metavar="DATA", help="folder of the data set")
    export.add_argument("--format", required=True, choices=("bop", "webdataset"), help="which")
    export.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    text = "bop: the drone's, of several in their order [the example drone's]"
    export.add_argument("--mesh", nargs="+", metavar="FILE", help=text)
    export.add_argument(
        "--shard-size", type=_count, metavar="N", help="webdataset: samples a file [500]"
    )
    options.add_table_options(
        command("table", "compare a rendered data set with the paper's", TABLE, _table)
    )
    example = command("example", "write a flight and anchors to try out", EXAMPLE, _example)
    example.add_argument("out", type=Path, metavar="DIR", help="folder to write to")
    return parser


def _count(text: str) -> int:
    """A whole number of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)
