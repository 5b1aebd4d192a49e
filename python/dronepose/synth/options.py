"""The options of ``dronepose synth plan`` and ``dronepose synth anchors``."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dronepose.camera import Camera

XYZ = ("X", "Y", "Z")


def add_plan_options(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser.

    Args:
        parser: That of the subcommand.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_plan_options(parser)
        >>> parser.parse_args("--flight f --anchors a --out o --fit fill".split()).fit
        'fill'
    """
    add = parser.add_argument
    add("--flight", type=Path, required=True, metavar="FILE", help="the flight; - for stdin")
    add("--anchors", type=Path, required=True, metavar="FILE", help="connectivity JSON, or CSV")
    add("--out", type=Path, required=True, metavar="FILE", help="plan.csv to write")
    add("--manifest", type=Path, metavar="FILE", help="JSON to write [OUT with .json]")
    add("--threads", type=int, default=0, metavar="N", help="0 for one a core [0]")
    _flight(parser.add_argument_group("flight", "default: what the format has"))
    _scene(parser.add_argument_group("scene"))
    _rules(parser.add_argument_group("rules"))
    _cameras(parser.add_argument_group("cameras and drone"))


def add_anchor_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``dronepose synth anchors`` to a parser.

    Args:
        parser: That of the subcommand.

    Example:
        >>> parser = argparse.ArgumentParser()
        >>> add_anchor_options(parser)
        >>> parser.parse_args(["--out", "anchors.csv"]).count
        20
    """
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="FILE", help="anchors.csv to write")
    text = "the scene, metres, z up: a mesh, placements, or example"
    add("--mesh", metavar="FILE", help=text)
    add("--low", type=float, nargs=3, metavar=XYZ, help="least corner, metres [of the mesh]")
    add("--high", type=float, nargs=3, metavar=XYZ, help="largest corner, metres [of the mesh]")
    add("--count", type=int, default=20, metavar="N", help="how many [20]")
    add("--clearance", type=float, default=0.5, metavar="M", help="from the surface [0.5]")
    add("--spacing", type=float, default=1, metavar="M", help="from one another [1]")
    add("--seed", type=int, default=0, metavar="N", help="of the draw [0]")
    add("--threads", type=int, default=0, metavar="N", help="0 for one a core [0]")


def _flight(group: argparse._ArgumentGroup) -> None:
    from dronepose.synth.flight import FORMATS, ORDERS, TIME_UNITS, WORLDS

    add = group.add_argument
    add("--flight-format", choices=FORMATS, default="auto", help="[by the first line]")
    add("--world", choices=WORLDS, help="world axes of the file")
    add("--body-axes", metavar="FLU", help="where its body's x, y, z point: three of f b l r u d")
    add("--quaternion", choices=ORDERS, help="order, for TUM and EuRoC")
    add("--time-unit", choices=TIME_UNITS, help="unit of its time stamps")
    rpy = ("R", "P", "Y")
    text = "roll, pitch, yaw of the sensor in the drone, degrees [0 0 0]"
    add("--mount-rpy", type=float, nargs=3, default=(0, 0, 0), metavar=rpy, help=text)
    add("--vehicle", metavar="NAME", help="of an AirSim file with several")
    add("--source-rate", type=float, default=60, metavar="HZ", help="of UAVA, without time [60]")
    add("--rate", type=float, default=60, metavar="HZ", help="to resample to [60]")
    add("--min-step", type=float, default=1e-3, metavar="S", help="sooner is a duplicate [0.001]")
    add("--max-gap", type=float, default=0.2, metavar="S", help="later is a gap: cut [0.2]")
    add("--max-speed", type=float, default=25, metavar="M/S", help="faster is a jump: cut [25]")
    text = "faster is a jump: cut [1200]"
    add("--max-turn-rate", type=float, default=1200, metavar="DEG/S", help=text)


def _scene(group: argparse._ArgumentGroup) -> None:
    from dronepose.synth.anchors import FORMATS

    add = group.add_argument
    add("--anchors-format", choices=FORMATS, default="auto", help="[by the first character]")
    add("--all-anchors", action="store_true", help="also viewpoints whose included is false")
    text = "bring the flight over the anchors; fill: scale it too [none]"
    add("--fit", choices=("none", "centre", "fill"), default="none", help=text)
    add("--scale", type=float, default=1, metavar="S", help="of the flight [1]")
    add("--yaw", type=float, default=0, metavar="DEG", help="of the flight about z [0]")
    text = "of the flight, metres, after --fit if given [0 0 0]"
    add("--offset", type=float, nargs=3, default=(0, 0, 0), metavar=XYZ, help=text)
    add("--scene", metavar="NAME", help="begins the ids [NAME of NAME_connectivity.json]")
    add("--splits", type=Path, metavar="DIR", help="with scenes_train.txt and so on, for --scene")


def _rules(group: argparse._ArgumentGroup) -> None:
    from dronepose.synth.rules import Rules

    rules, add = Rules(), group.add_argument
    add("--seed", type=int, default=rules.seed, metavar="N", help="of the run [0]")

    def pair(name: str, low: float, high: float, text: str) -> None:
        text = f"{text} [{low:g} {high:g}]"
        add(name, type=float, nargs=2, default=(low, high), metavar=("LEAST", "MOST"), help=text)

    text = "of drone and anchor, metres"
    pair("--distance", rules.min_distance_m, rules.max_distance_m, text)
    pair("--move", rules.min_move_m, rules.max_move_m, "to t - 1 and t + 1, metres")
    pair("--turn", rules.min_turn_deg, rules.max_turn_deg, "to t - 1 and t + 1, degrees")
    text = "whether a move or a turn is enough, or it takes both [any]"
    add("--motion", choices=("any", "all"), default=rules.motion, help=text)
    add("--stride", type=int, default=rules.stride, metavar="N", help="frames from t to t + 1 [1]")
    text = "edge of the cube about the anchor, where the view begins [0.5]"
    add("--anchor-cube", type=float, default=rules.anchor_cube_m, metavar="M", help=text)
    text = "edge of the cube about the drone, at which the view looks [0.6]"
    add("--drone-cube", type=float, default=rules.drone_cube_m, metavar="M", help=text)
    text = "of the image at each edge, where the drone's centroid may not be [0.25]"
    add("--border", type=float, default=rules.border, metavar="SHARE", help=text)


def _cameras(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "exocentric camera: fx,fy,cx,cy,W,H; in place of --fov and --size"
    add("--camera", type=camera, metavar="K", help=text)
    text = "exocentric camera, degrees from left to right [64.69]"
    add("--fov", type=float, default=64.69, metavar="DEG", help=text)
    text = "exocentric camera, columns x rows [320x240]"
    add("--size", type=size, default=(320, 240), metavar="WxH", help=text)
    add("--ego-down", type=float, default=0, metavar="DEG", help="of the drone's camera [0]")
    text = "of the drone's camera in the body, metres [0 0 0]"
    add("--ego-offset", type=float, nargs=3, default=(0, 0, 0), metavar=XYZ, help=text)
    text = "where the mesh's x, y, z point [flu; luf for the paper's mesh]"
    add("--model-axes", default="flu", metavar="FLU", help=text)
    add("--mesh", type=Path, metavar="FILE", help="the drone: its centroid is its box's middle")
    add("--mesh-unit", type=float, default=1.0, metavar="M", help="metres of its unit [1]")
    add("--whole", action="store_true", help="the box of --mesh has to be in both images")
    text = "the drone's centroid in its mesh's frame, metres [0 0 0]"
    add("--centroid", type=float, nargs=3, metavar=XYZ, help=text)


def size(text: str) -> tuple[int, int]:
    """Columns and rows from ``WxH``.

    Args:
        text: Such as ``320x240``.

    Raises:
        argparse.ArgumentTypeError: It is of another form.

    Example:
        >>> size("320x240")
        (320, 240)
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected WxH, such as 320x240, got {text!r}")
    return int(match[1]), int(match[2])


def camera(text: str) -> Camera:
    """A camera from ``fx,fy,cx,cy,W,H``.

    Args:
        text: Six numbers, pixels.

    Raises:
        argparse.ArgumentTypeError: There are not six, or one is out of its range.

    Example:
        >>> camera("252.7,252.7,160,120,320,240").width
        320
    """
    from dronepose.camera import Camera

    try:
        fx, fy, cx, cy, width, height = (float(part) for part in text.split(","))
        if not (width.is_integer() and height.is_integer()):
            raise ValueError("W and H are whole numbers")
        return Camera(fx, fy, cx, cy, int(width), int(height))
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"expected fx,fy,cx,cy,W,H, got {text!r}: {error}"
        ) from None


def add_render_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``dronepose synth render``.

    Args:
        parser: The parser.
    """
    add = parser.add_argument
    add("plan", type=Path, metavar="PLAN", help="plan.csv, with its manifest beside it")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the data set")
    add(
        "--scene",
        default="example",
        metavar="FILE",
        help="placements (CSV) or a mesh, z up, metres [a hall made by dronepose]",
    )
    add("--scene-unit", type=float, default=1.0, metavar="M", help="metres of its unit [1]")
    add("--drone", default="example", metavar="FILE", help="mesh [the project's quadrotor]")
    add("--drone-unit", type=float, default=1.0, metavar="M", help="metres of its unit [1]")
    add("--drone-texture", metavar="IMAGE", help="where the mesh names none")
    add("--drone-name", metavar="NAME", help="folder of the drone [the file's name]")
    add("--roughness", type=float, default=0.45, metavar="R", help="of the drone, 0 to 1 [0.45]")
    add("--metallic", type=float, default=0.0, metavar="M", help="of the drone, 0 to 1 [0]")
    add("--more-drones", nargs="+", default=(), metavar="FILE", help="meshes of further drones")
    text = "metres of their units, one each or one for all [1]"
    add("--more-units", type=float, nargs="+", default=(), metavar="M", help=text)
    text = "where their x, y, z point, one each or one for all [as the plan's]"
    add("--more-axes", nargs="+", default=(), metavar="FLU", help=text)
    text = "one each, - for none [none]"
    add("--more-textures", nargs="+", default=(), metavar="IMAGE", help=text)
    add("--apart", type=float, default=0.6, metavar="M", help="of two drones, metres [0.6]")
    add("--panoramas", metavar="DIR", help="light: .hdr, .exr, or images [two made by dronepose]")
    text = "what an input is under, such as scene=CC-BY-4.0 [LICENSE files are looked for]"
    add("--licence", action="append", default=[], metavar="NAME=ID", help=text)
    add("--building", metavar="NAME", help="name of the scene [the plan's, or the scene's file]")
    add("--split", choices=("train", "val", "test"), help="[the plan's, or train]")
    add("--date", default="flight", metavar="NAME", help="name of the flight [flight]")
    add("--seed", type=int, default=0, metavar="S", help="of the light [0]")
    add(
        "--strength",
        type=float,
        nargs=2,
        default=(0.3, 0.7),
        metavar=("LOW", "HIGH"),
        help="factor of the light, uniform [0.3 0.7]",
    )
    add("--seen", type=float, default=0.5, metavar="S", help="least share of the drone seen [0.5]")
    add("--hole", type=float, default=0.05, metavar="S", help="most share of scan holes [0.05]")
    text = "least median depth of an image [0.2]"
    add("--least-depth", type=float, default=0.2, metavar="M", help=text)
    add("--samples", type=int, default=3, metavar="N", help="points along a pixel's side [3]")
    add("--workers", type=int, default=0, metavar="N", help="rows at a time [one a core]")
    add("--shard", default="0/1", metavar="K/N", help="every N-th row from the K-th on [0/1]")
    text = "scheduler of a running Dask cluster, or its file: its workers render"
    add("--dask", metavar="ADDRESS", help=text)


def add_fly_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``dronepose synth fly``.

    Args:
        parser: The parser.
    """
    add = parser.add_argument
    add("--coins", type=Path, required=True, metavar="FILE", help="anchors; begins at the first")
    add("--scene", metavar="FILE", help="walls: placements, a mesh, or example [none]")
    add("--scene-unit", type=float, default=1.0, metavar="M", help="metres of its unit [1]")
    add("--out", type=Path, required=True, metavar="FILE", help="flight to write")
    add("--seconds", type=float, default=60.0, metavar="S", help="length [60]")
    add("--speed", type=float, default=1.6, metavar="V", help="asked for, m/s [1.6]")
    add("--clearance", type=float, default=0.4, metavar="M", help="to walls, metres [0.4]")
    add("--variance", type=float, default=0.3, metavar="X", help="the pilot's, 0 to 1 [0.3]")
    add("--seed", type=int, default=0, metavar="S", help="of the flight [0]")


def add_table_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``dronepose synth table``.

    Args:
        parser: The parser.
    """
    add = parser.add_argument
    add("data", type=Path, metavar="DATA", help="folder of the data set")
    add("--name", metavar="TEXT", help="head of its column [the folder's name]")
    text = "such as Indoor, which no file says [unknown]"
    add("--environment", default="unknown", metavar="TEXT", help=text)
    text = "such as photorealistic, as the paper calls renderings of scans [synthetic]"
    add("--data-type", default="synthetic", metavar="TEXT", help=text)
    add("--latex", action="store_true", help="LaTeX in place of Markdown")
