"""A contact sheet of a data set: rows of samples, columns of modalities."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from dronepose.synth.encode import decode_depth, decode_flow, decode_normal, png, read_png
from dronepose.synth.layout import image_file, record_file, scene_file, scene_files

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    Picture = NDArray[np.uint8]

__all__ = ["draw_sheet", "shown"]

COLUMNS = (
    ("exocentric", "colour"),
    ("exocentric", "silhouette"),
    ("exocentric", "depth"),
    ("exocentric", "normal_map"),
    ("exocentric", "flow"),
    ("egocentric", "colour"),
    ("egocentric", "depth"),
    ("egocentric", "normal_map"),
    ("egocentric", "flow"),
)
_BAR = 16


def draw_sheet(
    root: str | os.PathLike[str], *, building: str | None = None, rows: int = 8, width: int = 160
) -> bytes:
    """A PNG of samples that are spread evenly over a scene of a rendered data set.

    Args:
        root: The folder that :func:`dronepose.synth.write_dataset` wrote.
        building: The scene; ``None`` is the first.
        rows: Samples at most.
        width: Of a picture, pixels.

    Returns:
        The PNG.

    Raises:
        FileNotFoundError: The folder holds no data set.
        ValueError: There is no such scene, or no sample was kept.

    Example:
        >>> Path("sheet.png").write_bytes(draw_sheet("synth"))  # doctest: +SKIP
    """
    root = Path(root)
    scenes = [path.stem for path in scene_files(root)]
    if not scenes:
        raise FileNotFoundError(f"{root}: holds no rendered data set")
    building = building or scenes[0]
    if building not in scenes:
        raise ValueError(f"building: expected one of {', '.join(scenes)}, got {building!r}")
    facts = json.loads(scene_file(root, building).read_text(encoding="utf-8"))
    kept = []
    for path in sorted(record_file(root, building, 0).parent.glob("*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["kept"]:
            kept.append(record["row"])
    if not kept:
        raise ValueError(f"{root}: no sample of {building} was kept")
    chosen = [kept[round(k)] for k in np.linspace(0, len(kept) - 1, min(rows, len(kept)))]
    lines = []
    for row in chosen:
        cells = []
        for view, modality in COLUMNS:
            file = image_file(root, facts, row, 0, view, modality)
            cells.append(_cell(shown(modality, file.read_bytes()), width))
        tall = max(len(cell) for cell in cells)
        lines.append(np.hstack([_padded(cell, tall) for cell in cells]))
    head = np.full((_BAR, lines[0].shape[1], 3), 255, np.uint8)
    for k, (view, modality) in enumerate(COLUMNS):
        text = f"{view[:3]} {modality.removesuffix('_map')}"
        place = (k * width + 4, 12)
        cv2.putText(head, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return png(np.vstack([head, *lines]).astype(np.uint8))


def shown(modality: str, content: bytes) -> Picture:
    """A modality as a picture for people, ``(H, W, 3)`` uint8 RGB.

    Depth is brighter where nearer, normals are colours, flow is a hue by direction and stronger
    where faster (black where unknown).

    Raises:
        ValueError: ``content`` is no PNG.
    """
    image = read_png(content)
    if modality == "depth":
        depth = decode_depth(image.astype(np.uint16))
        near = np.where(depth > 0, 1 / np.maximum(depth, 0.3), 0)
        most = max(float(np.quantile(near, 0.99)), 1e-6)
        scaled = (255 * np.clip(near / most, 0, 1)).astype(np.uint8)
        return np.asarray(cv2.applyColorMap(scaled, cv2.COLORMAP_MAGMA)[..., ::-1], np.uint8)
    if modality == "normal_map":
        normal = decode_normal(image.astype(np.uint16))
        some = np.any(normal != 0, axis=-1, keepdims=True)
        turned = normal * np.array([1, -1, -1], np.float32)
        return np.where(some, np.clip(127.5 * (turned + 1), 0, 255), 0).astype(np.uint8)
    if modality == "flow":
        flow, fate = decode_flow(image.astype(np.uint16))
        speed = np.hypot(flow[..., 0], flow[..., 1])
        most = max(float(np.quantile(speed, 0.99)), 1.0)
        hue = (np.degrees(np.arctan2(flow[..., 1], flow[..., 0])) / 2) % 180
        value = np.where(fate > 0, 255, 0)
        hsv = np.stack([hue, 255 * np.clip(speed / most, 0, 1), value], axis=-1).astype(np.uint8)
        return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=-1).astype(np.uint8)
    return image.astype(np.uint8)


def _cell(picture: Picture, width: int) -> Picture:
    height = round(picture.shape[0] * width / picture.shape[1])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _padded(cell: Picture, tall: int) -> Picture:
    above = (tall - len(cell)) // 2
    edges = ((above, tall - len(cell) - above), (0, 0), (0, 0))
    return np.pad(cell, edges, constant_values=255)
