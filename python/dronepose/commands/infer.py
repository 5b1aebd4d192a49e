"""Find the drone in pictures, videos or a camera, and draw its pose.

From an ONNX file it needs neither torch nor torchvision.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

from dronepose._progress import Progress
from dronepose.commands._running import run

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from dronepose.camera import Camera

_EXAMPLES = """examples:
  dronepose infer --weights drone.onnx flight.mp4 --out found --mesh drone.obj
  dronepose infer --weights drone.onnx frames --out found --mesh drone.obj --filter rts --fps 30
  dronepose infer --weights drone.onnx 0 --out found --filter one-euro
  dronepose infer --weights direct.onnx --compare smooth.onnx flight.mp4 --out found --mesh drone.obj
  dronepose infer --weights drone.safetensors photo.jpg --out found --camera 910,910,640,360,1280,720

OUT gets poses.csv (read by `dronepose eval`; cam_from_model in the OpenCV camera frame, metres),
overlay.mp4 for videos and cameras, overlays/ID.png for pictures; with --filter also poses_raw.csv,
with --compare also poses_2.csv. Files appear when they are complete.

Frames of another size are scaled, of another aspect ratio letterboxed (--fit refuse: refused) and
taken to be of the camera of the weights; with --camera, they are warped to it, or, for a network
that is aware of the camera, their own camera is used. What was done is printed.

Jitter is the mean norm of the second difference from frame to frame: of the position in
millimetres, and of the rotation (change of the turn between frames) in degrees.

Exit codes: 0 done, 1 an input was refused, 2 the command line was not understood, 130 interrupted.
"""  # noqa: E501 - commands on one line


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``dronepose infer``.

    Args:
        argv: The arguments without the program's name; ``sys.argv[1:]`` if absent.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood, 130 interrupted.

    Raises:
        SystemExit: Never.

    Example:
        >>> from dronepose.commands.infer import main
        >>> main(["--weights", "drone.onnx"])
        2
    """
    gone = "error: interrupted; files that were not complete are gone"
    return run(_parser(), argv, _work, stopped=gone, also=(TypeError,))


def _work(options: argparse.Namespace) -> int:
    with _stoppable(), closing(Progress("frames", quiet=options.quiet)) as progress:
        summary = _run(options, progress)
    if options.json:
        print(json.dumps(summary, indent=2))
    elif not options.quiet:
        print(_sentences(summary))
    return 0


@contextmanager
def _stoppable() -> Iterator[None]:
    """A request to terminate and a hang-up clean up as Ctrl-C does."""

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = {}
    if threading.current_thread() is threading.main_thread():
        numbers = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")]
        before = {number: signal.signal(number, stop) for number in numbers if number is not None}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dronepose infer",
        description="Find the drone in pictures, videos or a camera, and draw its pose.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add(
        "input",
        metavar="INPUT",
        help="a picture, a folder of pictures, a video, or the number of a camera",
    )
    add(
        "-w",
        "--weights",
        required=True,
        metavar="FILE",
        help="the network: .onnx (without torch) or .safetensors",
    )
    add(
        "-o",
        "--out",
        required=True,
        metavar="FOLDER",
        help="folder for the results; made if it is not there",
    )
    group = parser.add_argument_group("camera")
    add = group.add_argument
    add(
        "--camera",
        metavar="fx,fy,cx,cy,W,H",
        type=_camera,
        help="intrinsics of the frames in pixels [default: those of the weights, scaled]",
    )
    add(
        "--fit",
        choices=("letterbox", "refuse"),
        default="letterbox",
        help="frames of another aspect ratio get bars, or are refused [default: letterbox]",
    )
    add(
        "--fps",
        type=_positive,
        metavar="N",
        help="frames per second, where the input does not say it [default: 30]",
    )
    group = parser.add_argument_group("drawing")
    add = group.add_argument
    add("--mesh", metavar="FILE", help="mesh of the drone, for silhouette and box: OBJ, PLY or STL")
    add("--mesh-unit", choices=("m", "cm", "mm"), default="m", help="unit of the mesh [default: m]")
    add(
        "--fill",
        metavar="COLOUR",
        default="teal",
        help="of the silhouette: a name, #rrggbb or none [default: teal]",
    )
    add("--contour", metavar="COLOUR", default="orange", help="of its outline [default: orange]")
    add(
        "--box",
        metavar="COLOUR",
        default="yellow",
        help="of the box around the mesh [default: yellow]",
    )
    add(
        "--alpha",
        type=float,
        default=0.4,
        metavar="SHARE",
        help="opacity of the silhouette, 0 to 1 [default: 0.4]",
    )
    add("--no-axes", action="store_true", help="do not draw the axes of the drone")
    add("--no-overlay", action="store_true", help="write poses only")
    add("--compare", metavar="FILE", help="a second network, drawn at the right of the first")
    group = parser.add_argument_group("motion")
    add = group.add_argument
    add(
        "--filter",
        choices=("none", "one-euro", "rts"),
        default="none",
        help="smooth: one-euro from past frames, rts from a whole recording [default: none]",
    )
    add(
        "--min-cutoff",
        type=_positive,
        default=1.0,
        metavar="HERTZ",
        help="one-euro: cut-off at rest [default: 1]",
    )
    add(
        "--beta",
        type=float,
        default=2.0,
        metavar="X",
        help="one-euro: hertz more for each m/s and rad/s [default: 2]",
    )
    group = parser.add_argument_group("running")
    add = group.add_argument
    add("--limit", type=_whole, metavar="N", help="stop after so many frames")
    add(
        "--batch",
        type=_whole,
        default=8,
        metavar="N",
        help="frames predicted together [default: 8]",
    )
    add(
        "--threads",
        type=int,
        default=0,
        metavar="N",
        help="threads of the network; 0 for all cores [default: 0]",
    )
    add("--json", action="store_true", help="print the summary as JSON")
    add("-q", "--quiet", action="store_true", help="print neither progress nor summary")
    return parser


def _run(options: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    from pathlib import Path

    from dronepose.infer import Predictor, Source, Style, color
    from dronepose.infer.run import Options, infer
    from dronepose.mesh import Mesh
    from dronepose.model.metadata import file_sha256

    style = Style(
        fill=color(options.fill),
        contour=color(options.contour),
        box=color(options.box),
        axes=not options.no_axes,
        alpha=options.alpha,
    )
    source = Source(options.input, options.fps)
    mesh = None
    files = [options.weights] + ([] if options.compare is None else [options.compare])
    predictors = [Predictor(path, options.threads) for path in files]
    if options.mesh is not None:
        mesh = Mesh.from_file(options.mesh, options.mesh_unit)
        for predictor in predictors:
            wanted = predictor.metadata.get("mesh_sha256")
            if wanted is not None and wanted != file_sha256(options.mesh) and not options.quiet:
                print(
                    f"warning: {predictor.path}: was trained with another mesh than "
                    f"{options.mesh} (SHA-256 {wanted[:12]}...)",
                    file=sys.stderr,
                )
    chosen = Options(
        camera=options.camera,
        letterbox=options.fit == "letterbox",
        mesh=mesh,
        style=style,
        overlay=not options.no_overlay,
        filter=options.filter,
        min_cutoff=options.min_cutoff,
        beta=options.beta,
        batch=options.batch,
        limit=options.limit,
    )
    total = source.count
    if options.limit is not None:
        total = min(options.limit, source.count or options.limit)
    progress(0, total)
    out = Path(options.out)
    return infer(source, predictors, out, chosen, lambda done, _: progress(done, total))


def _sentences(summary: dict[str, Any]) -> str:
    lines = [
        f"{summary['frames']} frames in {summary['seconds']:.2f} s: "
        f"{summary['frames_per_second']:.1f} frames/s"
    ]
    for model in summary["models"]:
        lines.append(f"{model['weights']}: network {model['network_ms']:.1f} ms a frame")
        lines += [f"  {note}" for note in model["notes"]]
        if "jitter" in model:
            text = f"  jitter {_jitter(model['jitter'])}"
            if summary["filter"] != "none":
                text += f", before the filter {_jitter(model['jitter_raw'])}"
            lines.append(text)
    return "\n".join([*lines, "wrote " + ", ".join(summary["files"])])


def _jitter(values: dict[str, float]) -> str:
    return f"{1000 * values['position_m']:.2f} mm, {values['rotation_deg']:.3f} deg"


def _camera(text: str) -> Camera:
    from dronepose.camera import Camera

    try:
        fx, fy, cx, cy, width, height = (float(part) for part in text.split(","))
        return Camera(fx, fy, cx, cy, int(width), int(height))
    except (TypeError, ValueError) as error:
        raise argparse.ArgumentTypeError(
            f"expected fx,fy,cx,cy,W,H in pixels, got {text!r} ({error})"
        ) from error


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected a number above zero, got {text!r}")
    return value


def _whole(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of 1 or more, got {text!r}")
    return int(text)
