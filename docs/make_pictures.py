"""Draws the pictures of rendering.md with the command ``dronepose render``.

    python docs/make_pictures.py            # into docs/pictures
    python docs/make_pictures.py --folder F # elsewhere

Needs the package (the command comes with it) and NumPy.
"""

import argparse
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
MESH = ROOT / "examples" / "quadrotor.obj"
POSES = ROOT / "examples" / "gt.csv"
CAMERA = "252.7,252.7,160,120,320,240"
LARGEST = 150_000  # bytes of a picture


def pose(name: str, yaw_deg: float, elevation_deg: float, distance_m: float) -> str:
    """A row of the CSV: the drone in the middle of the picture, seen from above by an angle."""
    yaw, tilt = np.radians(yaw_deg), np.radians(elevation_deg)
    turn = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    # From x forward, y left, z up to x right, y down, z forward.
    axes = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    nod = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    rotation = np.array(nod) @ np.array(axes) @ np.array(turn)
    numbers = [*rotation.ravel(), 0, 0, distance_m]
    return ",".join([name, *(f"{x:.9f}" for x in numbers)])


def render(poses: Path, out: Path, *options: str) -> None:
    """``dronepose render`` of the example drone."""
    script = Path(sys.executable).with_name("dronepose")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "dronepose"]
    line = [*command, "render", str(MESH), str(poses), "--out", str(out), "--quiet", *options]
    subprocess.run(line, check=True)


def write_png(path: Path, gray: NDArray[np.uint8]) -> None:
    """A picture of one channel."""
    rows = b"".join(b"\0" + row.tobytes() for row in gray)

    def chunk(name: bytes, data: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(name + data))
        return struct.pack(">I", len(data)) + name + data + check

    head = struct.pack(">IIBBBBB", gray.shape[1], gray.shape[0], 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)


def sigmas(poses: Path, work: Path, target: Path) -> None:
    """The same rotor at sigma 0, 1, 2 and 4 pixels, enlarged six times."""
    pieces = []
    for sigma in (0, 1, 2, 4):
        out = work / f"sigma{sigma}"
        options = ["--camera", CAMERA, "--id", "far", "--format", "npy", "--sigma", str(sigma)]
        render(poses, out, *options)
        mask = np.load(out / "silhouette" / "far.npy")[98:130, 104:148]
        gray = np.round(255 * mask.clip(0, 1)).astype(np.uint8)
        pieces.append(np.pad(gray.repeat(6, 0).repeat(6, 1), 4, constant_values=250))
    write_png(target, np.concatenate(pieces, axis=1))


def main() -> int:
    """Draw them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "pictures")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        poses = work / "poses.csv"
        columns = ["id", *(f"r{i}{j}" for i in "123" for j in "123"), "tx", "ty", "tz"]
        rows = [pose("near", 145, 24, 0.62), pose("far", 145, 24, 1.0)]
        poses.write_text("\n".join([",".join(columns), *rows, ""]), encoding="utf-8")
        render(
            poses,
            work / "near",
            "--camera",
            CAMERA,
            "--id",
            "near",
            "--save",
            "preview,overlay",
            "--zoom",
            "2",
        )
        render(
            poses, work / "modes", "--camera", CAMERA, "--id", "far", "--compare", "--sigma", "1"
        )
        render(POSES, work / "sheet", "--camera", CAMERA, "--contact-sheet", "--every", "170")
        for file, target in (
            ("near/preview/near.png", "layers.png"),
            ("near/overlay/near.png", "overlay.png"),
            ("modes/compare/far.png", "modes.png"),
            ("sheet/contact_sheet.png", "contact_sheet.png"),
        ):
            shutil.copyfile(work / file, folder / target)
        sigmas(poses, work, folder / "sigma.png")
    for picture in sorted(folder.glob("*.png")):
        size = picture.stat().st_size
        print(f"{picture.name}: {size:,} bytes")
        if size > LARGEST:
            sys.exit(f"{picture}: found {size} bytes, expected at most {LARGEST}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
