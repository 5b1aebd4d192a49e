"""Look at a mesh before trusting it: sizes, faults, the likely unit, a picture; make it smaller."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.commands._running import run

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = """\
examples:
  dronepose mesh check DJI.obj --picture DJI.png
  dronepose mesh check x500.stl --unit mm --budget 20000
  dronepose mesh simplify x500.stl --unit mm --faces 20000 --out x500.obj
"""


def main(argv: Sequence[str]) -> int:
    """Run ``dronepose mesh``.

    Args:
        argv: The arguments after the subcommand.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood.

    Example:
        >>> main(["check", "examples/quadrotor.obj"])  # doctest: +SKIP
        0
    """
    return run(_parser(), argv, _work)


def _work(args: argparse.Namespace) -> int:
    found: dict[str, Any] = args.run(args)
    text = found.pop("text")
    print(json.dumps(found, indent=2) if args.json else text)
    return 0


def _check(args: argparse.Namespace) -> dict[str, Any]:
    from dronepose.mesh import Mesh

    mesh = Mesh.from_file(args.file, unit=args.unit)
    check = mesh.check()
    notes = []
    if len(mesh.faces) > args.budget:
        notes.append(
            f"{len(mesh.faces)} faces are above the budget of {args.budget}: "
            f"dronepose mesh simplify {args.file} --faces {args.budget} --out FILE"
        )
    guess = check["unit_guess"]
    if guess != "metres":
        notes.append(f"read as {args.unit}; as a drone it would be in {guess.replace('_', ' ')}")
    if check["duplicate_faces"]:
        notes.append(f"{check['duplicate_faces']} faces repeat others; nothing here minds")
    if args.picture is not None:
        from dronepose._files import write_bytes
        from dronepose.synth.asset import Asset
        from dronepose.synth.encode import png
        from dronepose.synth.preview import preview

        write_bytes(args.picture, png(preview(Asset.plain(mesh))))
        notes.append(f"picture: {args.picture}")
    text = "\n".join([str(check), *notes])
    return {"file": str(args.file), "unit": args.unit, **check, "notes": notes, "text": text}


def _simplify(args: argparse.Namespace) -> dict[str, Any]:
    import numpy as np

    from dronepose._files import write_text
    from dronepose.mesh import Mesh, obj_text

    try:
        import fast_simplification  # type: ignore[import-untyped,unused-ignore]
    except ImportError as error:
        raise ImportError(
            'making meshes smaller needs fast-simplification: pip install "dronepose[synth]"'
        ) from error
    if args.faces < 4:
        raise ValueError(f"--faces: expected 4 or more, got {args.faces}")
    if args.out.suffix.lower() != ".obj":
        raise ValueError(f"--out: expected an OBJ file, got {args.out}")
    mesh = Mesh.from_file(args.file, unit=args.unit)
    before = len(mesh.faces)
    points, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    if before > args.faces:
        points, faces = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=args.faces
        )
    note = f"{Path(args.file).name}, {before} faces made {len(faces)}; metres"
    write_text(args.out, obj_text(points, faces, note))
    low, high = mesh.bounds
    shift = float(
        max(np.abs(points.min(axis=0) - low).max(), np.abs(points.max(axis=0) - high).max())
    )
    text = (
        f"{args.out}: {before} faces made {len(faces)}, metres; "
        f"its box moved by at most {1e3 * shift:.3g} mm"
    )
    return {"out": str(args.out), "faces": [before, len(faces)], "box_moved_m": shift, "text": text}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dronepose mesh",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, text, work in (
        ("check", "say what a file holds", _check),
        ("simplify", "write it with fewer faces (quadric edge collapse)", _simplify),
    ):
        made = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        made.set_defaults(run=work)
        made.add_argument(
            "file", type=Path, metavar="FILE", help="OBJ, PLY, STL; others by trimesh"
        )
        made.add_argument("--unit", choices=("m", "cm", "mm"), default="m", help="of the file [m]")
        made.add_argument("--json", action="store_true", help="say it as JSON")
        if name == "check":
            made.add_argument("--picture", type=Path, metavar="PNG", help="draw it from four sides")
            made.add_argument(
                "--budget", type=int, default=50_000, metavar="N", help="faces [50000]"
            )
        else:
            made.add_argument("--faces", type=int, required=True, metavar="N", help="at most")
            made.add_argument("--out", type=Path, required=True, metavar="OBJ", help="to write")
    return parser
