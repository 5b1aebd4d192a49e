"""Pictures of a plan: where the drone is in the exocentric camera, and a map from above."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose._files import beside
from dronepose.synth._settings import flu_from_axes

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from dronepose.synth.plan import PlanTable

    Array = NDArray[np.float64]

_LEVEL_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_DENSITY = "magma"


def yaw_pitch_roll_deg(R: Array, model_axes: str = "flu") -> Array:
    """How a drone is turned in a camera's frame: ``Rz(yaw) Ry(pitch) Rx(roll)``, degrees.

    Camera and drone are looked at with axes forward, left, up: at zero the drone's nose points away
    from the camera. Yaw is positive to the left, pitch with the nose down, roll to the right.

    Args:
        R: ``(N, 3, 3)`` rotations of ``cam_from_model``, OpenCV axes.
        model_axes: Which way the axes of the mesh point.

    Returns:
        ``(N, 3)`` yaw and roll in [-180, 180], pitch in [-90, 90].

    Example:
        >>> away = [[[0, -1, 0], [0, 0, -1], [1, 0, 0]]]
        >>> yaw_pitch_roll_deg(np.array(away, dtype=float)).round(6).tolist()
        [[0.0, 0.0, 0.0]]
    """
    m = _LEVEL_FROM_CAMERA @ R @ flu_from_axes(model_axes).T
    yaw = np.arctan2(m[:, 1, 0], m[:, 0, 0])
    pitch = -np.arcsin(np.clip(m[:, 2, 0], -1, 1))
    roll = np.arctan2(m[:, 2, 1], m[:, 2, 2])
    # No minus zero.
    angles: Array = np.degrees(np.stack([yaw, pitch, roll], axis=1)) + 0.0
    return angles


def draw_poses(table: PlanTable, path: str | os.PathLike[str]) -> None:
    """The distribution of poses in the exocentric camera, as the paper's figure has it.

    Density of x against z and of y against z (metres; white lines are the edges of the image), and
    histograms of yaw, pitch and roll (:func:`yaw_pitch_roll_deg`).

    Args:
        table: The plan.
        path: The PNG to write.

    Returns:
        Nothing.

    Raises:
        ImportError: matplotlib is missing.
        OSError: The file cannot be written.

    Example:
        >>> draw_poses(read_plan("plan.csv"), "poses.png")  # doctest: +SKIP
    """
    figure = _figure(12.5, 4.2)
    R, t = table.pose()
    rules = table.manifest.get("rules", {})
    camera = rules.get("exo")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.1, 1.1, 1.2))
    z_end = 1.05 * float(t[:, 2].max())
    for axes, k, name, size, centre, focal in (
        (left, 0, "x", "width", "cx", "fx"),
        (middle, 1, "y", "height", "cy", "fy"),
    ):
        reach = 1.1 * float(np.abs(t[:, k]).max()) + 1e-3
        if camera:
            sides = [(edge - camera[centre]) / camera[focal] for edge in (0, camera[size])]
            reach = max(abs(side) for side in sides) * z_end
        area = [[-reach, reach], [0, z_end]]
        _, _, _, image = axes.hist2d(t[:, k], t[:, 2], bins=40, range=area, cmap=_DENSITY)
        if camera:
            for side in sides:
                axes.plot([0, side * z_end], [0, z_end], color="white", linewidth=0.8)
        axes.set_xlabel(f"{name} (m)" + (", down" if name == "y" else ", right"))
        axes.set_ylabel("z (m), forward")
        axes.locator_params(axis="x", nbins=5)
        bar = figure.colorbar(image, ax=axes, label="samples", shrink=0.85)
        bar.ax.yaxis.get_major_locator().set_params(integer=True)
    angles = yaw_pitch_roll_deg(R, rules.get("model_axes", "flu"))
    bins = np.arange(-180, 181, 5)
    for k, name in enumerate(("yaw", "pitch", "roll")):
        right.hist(angles[:, k], bins=bins, histtype="step", linewidth=1.5, label=name)
    right.set_yscale("symlog", linthresh=10)
    right.set_xlim(-180, 180)
    right.set_xticks(range(-180, 181, 60))
    right.set_xlabel("degrees (0: nose away from the camera)")
    right.set_ylabel("samples in 5 degrees")
    right.legend(loc="upper right", frameon=False)
    figure.suptitle(f"{_name(table)}{len(table)} samples", fontsize=11)
    _save(figure, path)


def draw_map(table: PlanTable, path: str | os.PathLike[str]) -> None:
    """A map from above: flight, anchors, and a line from the view to the drone of each pair.

    Args:
        table: The plan, with its manifest.
        path: The PNG to write.

    Returns:
        Nothing.

    Raises:
        ImportError: matplotlib is missing.
        OSError: The file cannot be written.
        ValueError: There is no manifest.

    Example:
        >>> draw_map(read_plan("plan.csv"), "map.png")  # doctest: +SKIP
    """
    known = table.manifest.get("map")
    if known is None:
        raise ValueError("table: no manifest; the map needs its flight and anchors")
    figure = _figure(8.2, 7.4)
    axes = figure.subplots()
    lines = [np.array(piece) for piece in known["flight"]]
    for k, piece in enumerate(lines):
        label = "flight" if k == 0 else None
        axes.plot(piece[:, 0], piece[:, 1], color="#9aa5b1", linewidth=0.9, zorder=1, label=label)
    R, t = table.pose("exo")
    eyes = -np.einsum("nji,nj->ni", R, t)
    drones = table.pose("drone")[1]
    from matplotlib.collections import LineCollection

    few = np.linspace(0, len(table) - 1, min(len(table), 400)).astype(int)
    pairs = np.stack([eyes[few, :2], drones[few, :2]], axis=1)
    label = "view to drone" + ("" if len(few) == len(table) else f" ({len(few)} of them)")
    axes.add_collection(
        LineCollection(list(pairs), colors="#3b7dd8", linewidths=0.5, alpha=0.45, label=label)
    )
    axes.scatter(drones[:, 0], drones[:, 1], s=4, color="#d1495b", zorder=3, label="kept pair")
    anchors = np.array(known["anchors"])
    used = np.isin(np.arange(len(anchors)), table["anchor_index"].astype(int))
    for mask, face, text in ((~used, "white", "anchor"), (used, "#222222", "anchor of a pair")):
        axes.scatter(
            anchors[mask, 0],
            anchors[mask, 1],
            s=26,
            facecolors=face,
            edgecolors="#222222",
            linewidths=1,
            zorder=4,
            label=text,
        )
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_title(f"{_name(table)}{len(table)} samples, from above", fontsize=11)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=5, frameon=False, fontsize=9)
    _save(figure, path)


def _name(table: PlanTable) -> str:
    scene = table.manifest.get("scene")
    return f"{scene}: " if scene else ""


def _figure(width: float, height: float) -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "pictures of a plan need matplotlib, which is not installed: "
            'pip install "dronepose[synth]"'
        ) from error
    return Figure(figsize=(width, height), dpi=130, layout="constrained")


def _save(figure: Any, path: str | os.PathLike[str]) -> None:
    data = io.BytesIO()
    # The same bytes each time: no date, no version.
    figure.savefig(data, format="png", metadata={"Software": None})
    with beside(Path(path)) as part:
        part.write_bytes(data.getvalue())
