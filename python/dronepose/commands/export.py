"""Write a network as ONNX, checked against torch.

The file keeps the metadata of the weights; ``dronepose infer`` runs it without torch.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from dronepose.commands._running import run

if TYPE_CHECKING:
    from collections.abc import Sequence

_EXAMPLES = """examples:
  dronepose export --weights drone.safetensors --out drone.onnx
  dronepose export --weights published.pth --size 320x240 --fov 50.8 --out drone.onnx
  dronepose export --weights published.pth --size 320x240 --fov 50.8 --out drone.safetensors

The ONNX file takes image (B, 3, H, W) float32 RGB in [0, 1], and K (B, 3, 3) if the network is
aware of the camera, and gives R (B, 3, 3) and t (B, 3): cam_from_model in the OpenCV camera frame,
metres. Exit codes: 0 done, 1 an input was refused, 2 the command line was not understood, 130
interrupted."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``dronepose export``.

    Args:
        argv: The arguments without the program's name; ``sys.argv[1:]`` if absent.

    Returns:
        0 done, 1 an input was refused, 2 the command line was not understood, 130 interrupted.

    Raises:
        SystemExit: Never.

    Example:
        >>> from dronepose.commands.export import main
        >>> main(["--weights", "drone.safetensors"])
        2
    """
    return run(_parser(), argv, _run, also=(TypeError,))


def size(text: str) -> tuple[int, int]:
    """``WxH`` as ``(width, height)``."""
    width, cross, height = text.lower().partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"expected WxH such as 320x240, got {text!r}")
    return int(width), int(height)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dronepose export",
        description="Write a network as ONNX, checked against torch.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--weights", required=True, metavar="FILE",
        help="weights: .safetensors, or a checkpoint of the DronePose authors (.pth)")  # fmt: skip
    add("-o", "--out", required=True, metavar="FILE",
        help="file to write: .onnx, or .safetensors")  # fmt: skip
    add("--size", type=size, metavar="WxH",
        help="size of the network's images, where the weights do not say it")  # fmt: skip
    add("--fov", type=float, metavar="DEGREES",
        help="vertical field of view of the camera, where the weights have none")  # fmt: skip
    add("--opset", type=int, default=18, metavar="N",
        help="version of the ONNX operators [default: 18]")  # fmt: skip
    add("--json", action="store_true", help="print what was written as JSON")
    return parser


def _run(options: argparse.Namespace) -> int:
    from pathlib import Path

    from dronepose.camera import Camera
    from dronepose.model import export_onnx, model_from_file, read_metadata, save_weights

    suffix = Path(options.out).suffix.lower()
    if suffix not in (".onnx", ".safetensors"):
        raise ValueError(f"--out: expected .onnx or .safetensors, got {options.out!r}")
    model = model_from_file(options.weights)
    metadata: dict[str, Any] = {}
    if Path(options.weights).suffix.lower() == ".safetensors":
        metadata = read_metadata(options.weights)
        for key in ("format", "dronepose_version"):
            metadata.pop(key, None)
    if "image_size" not in metadata:
        if options.size is None:
            raise ValueError(
                f"{options.weights}: does not say the size of its images; expected --size WxH"
            )
        metadata["image_size"] = options.size[::-1]
    height, width = metadata["image_size"]
    if options.size is not None and options.size != (width, height):
        raise ValueError(f"--size: the weights are for {width}x{height}")
    if options.fov is not None:
        if "intrinsics" in metadata:
            raise ValueError("--fov: the weights hold intrinsics already")
        metadata["intrinsics"] = Camera.from_fov(width, height, vertical_deg=options.fov)
    written: dict[str, Any] = {"path": options.out, "image_size": [height, width]}
    if suffix == ".safetensors":
        save_weights(model, options.out, metadata)
        line = f"{options.out}: {width}x{height}"
    else:
        report = export_onnx(
            model, options.out, height=height, width=width, opset=options.opset, metadata=metadata
        )
        written |= {"opset": report.opset, "max_difference": report.max_difference}
        line = (
            f"{options.out}: {width}x{height}, opset {report.opset}, largest difference to torch "
            f"{report.max_difference:.2g}"
        )
    print(json.dumps(written) if options.json else line)
    return 0
