"""The files that a data set is rendered from, by name, so that any process can read them."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.inputs import (
    EXAMPLE,
    NO_TEXTURE,
    cameras_of,
    read_drone,
    read_more_drones,
    read_panoramas,
    read_scene,
)
from dronepose.synth.licences import input_licences, render_inputs
from dronepose.synth.plan import read_plan
from dronepose.synth.studio import Studio

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from dronepose.camera import Camera
    from dronepose.render import Environment
    from dronepose.synth.plan import PlanTable

__all__ = ["Loaded", "Sources"]


@dataclass(frozen=True, slots=True)
class Loaded:
    """What :class:`Sources` name, read.

    Args:
        plan: The poses.
        cameras: The exocentric and the egocentric camera.
        studio: The scene and the drone, and perhaps further ones.
        environments: Panoramas by name.
        facts: For the manifest: names and SHA-256 of the files, how they were read, and their
            licences.
    """

    plan: PlanTable
    cameras: tuple[Camera, Camera]
    studio: Studio
    environments: Mapping[str, Environment]
    facts: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Sources:
    """The files that a data set is rendered from, and how they are read.

    Args:
        plan: ``plan.csv``, with its manifest beside it.
        scene: Placements (CSV), a mesh, or ``"example"`` for the project's hall.
        scene_unit: Metres of the unit of a scene's mesh.
        drone: A mesh, or ``"example"`` for the project's quadrotor.
        drone_unit: Metres of its unit.
        drone_texture: An image for all of it.
        roughness: Of its surface, 0 to 1.
        metallic: 0 for plastics, 1 for metals.
        more_drones: Meshes of further drones, or ``"example"``.
        more_units: Metres of their units, one each or one for all; none: 1.
        more_axes: Where their x, y, z point, one each or one for all; none: as the plan's.
        more_textures: An image for each, ``-`` for none; or none at all.
        panoramas: A folder; ``None`` is the project's two.
        samples: Points along a pixel's side for colours, 1 to 8.
        licence: What inputs are under, ``NAME=ID`` each, where files beside them do not say it.

    Example:
        >>> Sources("plan.csv", scene="house.glb").absolute().drone
        'example'
    """

    plan: str
    scene: str = EXAMPLE
    scene_unit: float = 1.0
    drone: str = EXAMPLE
    drone_unit: float = 1.0
    drone_texture: str | None = None
    roughness: float = 0.45
    metallic: float = 0.0
    more_drones: tuple[str, ...] = ()
    more_units: tuple[float, ...] = ()
    more_axes: tuple[str, ...] = ()
    more_textures: tuple[str, ...] = ()
    panoramas: str | None = None
    samples: int = 3
    licence: tuple[str, ...] = ()

    def absolute(self) -> Sources:
        """The same with paths that hold in any folder.

        Returns:
            The sources.

        Example:
            >>> Sources("/data/plan.csv").absolute() == Sources("/data/plan.csv")
            True
        """

        def whole(path: str) -> str:
            named = path in (EXAMPLE, NO_TEXTURE)
            return path if named else os.path.abspath(path)  # noqa: PTH100 - keeps links

        return replace(
            self,
            plan=whole(self.plan),
            scene=whole(self.scene),
            drone=whole(self.drone),
            drone_texture=None if self.drone_texture is None else whole(self.drone_texture),
            more_drones=tuple(map(whole, self.more_drones)),
            more_textures=tuple(map(whole, self.more_textures)),
            panoramas=None if self.panoramas is None else whole(self.panoramas),
        )

    def load(self, *, threads: int = 0, stage: Callable[[str], None] = lambda text: None) -> Loaded:
        """Read all of them.

        Args:
            threads: Of the studio, 0 for one a core.
            stage: Is told what is read.

        Returns:
            What they hold.

        Raises:
            ValueError: A file was refused.
            OSError: A file cannot be read.
            ImportError: A package is missing.

        Example:
            >>> found = Sources("plan.csv", scene="house.glb").load()  # doctest: +SKIP
            >>> found.facts["scene"]["file"]  # doctest: +SKIP
            'house.glb'
        """
        stage("reading the plan")
        plan = read_plan(self.plan)
        content = Path(self.plan).read_bytes()
        cameras = cameras_of(plan)
        licences = input_licences(render_inputs(self, plan), self.licence)
        stage("reading the scene")
        scene, scene_facts = read_scene(self.scene, metres_per_unit=self.scene_unit)
        stage("reading the drone")
        drone, drone_facts = read_drone(
            self.drone,
            metres_per_unit=self.drone_unit,
            texture=self.drone_texture,
            roughness=self.roughness,
            metallic=self.metallic,
        )
        further, further_facts = read_more_drones(
            self.more_drones,
            model_axes=plan.manifest.get("rules", {}).get("model_axes", "flu"),
            axes=self.more_axes,
            metres_per_unit=self.more_units,
            textures=self.more_textures,
            roughness=self.roughness,
            metallic=self.metallic,
        )
        stage("preparing the light")
        environments, light_facts = read_panoramas(self.panoramas)
        facts = {
            "plan": {"file": Path(self.plan).name, "sha256": hashlib.sha256(content).hexdigest()},
            "scene": scene_facts,
            "drone": drone_facts,
            "panoramas": light_facts,
            "samples": self.samples,
            "licences": licences,
            **({"more_drones": further_facts} if further else {}),
        }
        studio = Studio(scene, [drone, *further], samples=self.samples, threads=threads)
        return Loaded(plan, cameras, studio, environments, facts)
