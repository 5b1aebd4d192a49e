"""A row of a plan: its light, its pictures, and what the rules say of them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose.geometry import matrix_from_axis_angle
from dronepose.synth.encode import encode_depth, encode_flow, encode_normal, png
from dronepose.synth.others import choose_others, others_facts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.render import Environment, Flow
    from dronepose.synth.plan import PlanTable
    from dronepose.synth.studio import Frame, Studio

    Array = NDArray[np.float64]
    Pose = tuple[Array, Array]

__all__ = ["RenderSettings", "Sample", "render_sample"]


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """How a plan is rendered, and which rules look at the pictures.

    Args:
        seed: Of the lights. The light of a sample depends on it and on the sample's row alone.
        strength: Smallest and largest factor of the panorama's light (DronePose, section 3: 0.3 to
            0.7), uniform.
        least_seen: Rule *hidden*: share of the drone's area in each exocentric image that the scene
            must not hide, 0 to 1.
        most_hole: Rule *invalid*: share of an image in which the scan may have holes, 0 to 1.
        least_depth_m: Rule *blocked*: median depth of each image, metres; what is nearer stands
            right before the camera.
        least_pixels: Rule *hidden*: area of the drone in each exocentric image, pixels.
        apart_m: Least distance of two drones where there are several, metres.

    Raises:
        ValueError: A value is out of its range; the message starts with its name.

    Example:
        >>> RenderSettings().strength
        (0.3, 0.7)
    """

    seed: int = 0
    strength: tuple[float, float] = (0.3, 0.7)
    least_seen: float = 0.5
    most_hole: float = 0.05
    least_depth_m: float = 0.2
    least_pixels: float = 100.0
    apart_m: float = 0.6

    def __post_init__(self) -> None:
        low, high = self.strength
        if not 0 <= low <= high < 1e3:
            raise ValueError(f"strength: expected 0 <= smallest <= largest, got {self.strength}")
        for name in ("least_seen", "most_hole"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: expected 0 to 1, got {getattr(self, name)}")
        if self.seed < 0 or not 0 <= self.least_pixels < 1e9:
            raise ValueError("seed, least_pixels: expected numbers >= 0")
        for name in ("apart_m", "least_depth_m"):
            if not 0 <= getattr(self, name) < 1e6:
                raise ValueError(f"{name}: expected metres >= 0, got {getattr(self, name)}")

    def facts(self, drones: int = 1) -> dict[str, Any]:
        """For the manifest: what matters for so many drones.

        Args:
            drones: In a picture, at most.

        Returns:
            The settings by name; ``apart_m`` where there are several drones.

        Raises:
            Nothing.

        Example:
            >>> "apart_m" in RenderSettings().facts(), RenderSettings().facts(2)["apart_m"]
            (False, 0.6)
        """
        found: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return {key: value for key, value in found.items() if drones > 1 or key != "apart_m"}


@dataclass(slots=True)
class Sample:
    """The pictures of a row of the plan and what the rules say of them.

    Args:
        files: PNG by ``(view, modality, time step)``.
        facts: Numbers for ``samples.csv``; ``kept`` is 1 or 0, ``removed_by`` names the rule.
    """

    files: dict[tuple[str, str, int], bytes] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)


def render_sample(
    studio: Studio,
    plan: PlanTable,
    row: int,
    cameras: tuple[Camera, Camera],
    environments: Mapping[str, Environment],
    settings: RenderSettings,
) -> Sample:
    """Render one row: both cameras, both times, and the flow between them both ways.

    Args:
        studio: The scene and the drone; further drones are at poses of other rows, as
            :func:`dronepose.synth.others.choose_others` finds them.
        plan: The poses.
        row: Which, from 0.
        cameras: The exocentric and the egocentric camera.
        environments: Panoramas by name; empty leaves the drone unlit.
        settings: Light and rules.

    Returns:
        The pictures; none where a rule removes the sample.

    Raises:
        ValueError: A pose cannot be drawn.

    Example:
        >>> sample = render_sample(studio, plan, 0, cameras, {}, RenderSettings())  # doctest: +SKIP
        >>> sample.facts["kept"]  # doctest: +SKIP
        1
    """
    poses = {name: _pose(plan, name, row) for name in
             ("exo", "ego", "ego_next", "drone", "drone_next")}  # fmt: skip
    generator = np.random.default_rng([settings.seed, row])
    names = sorted(environments)
    which = names[int(generator.integers(len(names)))] if names else None
    strength, turn = generator.uniform(*settings.strength), generator.uniform(0, 2 * np.pi)
    light: dict[str, Any] = {
        "environment": None if which is None else environments[which],
        "strength": float(strength),
        "world_from_panorama": matrix_from_axis_angle([0.0, 0.0, turn]),
    }
    others: list[int | None] = []
    if len(studio.drones) > 1:
        meshes = [drone.mesh for drone in studio.drones]
        others = choose_others(
            plan, row, cameras[0], meshes, seed=settings.seed, apart_m=settings.apart_m
        )
    further = [
        [None if k is None else _pose(plan, name, k) for k in others]
        for name in ("drone", "drone_next")
    ]
    drones = ([poses["drone"], *further[0]], [poses["drone_next"], *further[1]])
    exo = [studio.frame(cameras[0], poses["exo"], drone, **light) for drone in drones]
    facts: dict[str, Any] = {
        "row": row,
        "id": plan.ids[row],
        "environment": which or "",
        "strength": float(strength),
        "panorama_rad": float(turn),
        "seen": min(frame.seen for frame in exo),
        "area_px": min(float(frame.silhouette.sum(dtype=np.float64)) for frame in exo),
        "hole": max(frame.hole for frame in exo),
        "depth_m": min(frame.median_depth for frame in exo),
        "kept": 0,
        "removed_by": "",
        **others_facts(others, exo),
    }
    if facts["seen"] < settings.least_seen or facts["area_px"] < settings.least_pixels:
        return Sample({}, {**facts, "removed_by": "hidden"})
    beside: list[list[Pose | None]] = [[None, *places] if others else [] for places in further]
    ego = [
        studio.frame(cameras[1], poses[name], places, **(light if others else {}))
        for name, places in zip(("ego", "ego_next"), beside, strict=True)
    ]
    facts["hole"] = max(facts["hole"], *(frame.hole for frame in ego))
    if facts["hole"] > settings.most_hole:
        return Sample({}, {**facts, "removed_by": "invalid"})
    facts["depth_m"] = min(facts["depth_m"], *(frame.median_depth for frame in ego))
    if facts["depth_m"] < settings.least_depth_m:
        return Sample({}, {**facts, "removed_by": "blocked"})
    moments: dict[str, list[tuple[Pose, list[Pose | None]]]] = {
        "exocentric": [(poses["exo"], places) for places in drones],
        "egocentric": [(poses["ego"], beside[0]), (poses["ego_next"], beside[1])],
    }
    files = {}
    for (view, moment), camera, frames in zip(moments.items(), cameras, (exo, ego), strict=True):
        for step in (0, 1):
            flow = studio.flow(camera, moment[step], moment[1 - step])
            pictures = _pictures(frames[step], flow, drone=view == "exocentric")
            for modality, image in pictures.items():
                files[view, modality, step] = png(image)
    return Sample(files, {**facts, "kept": 1})


def _pictures(frame: Frame, flow: Flow, *, drone: bool) -> dict[str, Any]:
    """The images of a moment by modality."""
    found: dict[str, Any] = {
        "colour": frame.colour,
        "depth": encode_depth(frame.depth),
        "normal_map": encode_normal(frame.normal),
        "flow": encode_flow(flow.flow, flow.visible, flow.occluded, flow.outside),
    }
    if drone:
        found["silhouette"] = np.rint(255 * frame.silhouette).astype(np.uint8)
        found["matte"] = np.rint(255 * frame.matte).astype(np.uint8)
        found["instance"] = (frame.instance + 1).astype(np.uint8)
    return found


def _pose(plan: PlanTable, name: Any, row: int) -> Pose:
    R, t = plan.pose(name, slice(row, row + 1))
    return R[0], t[0]
