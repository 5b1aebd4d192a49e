"""Pictures of a plan: a drone in a scene, from two cameras, at two times, in every modality."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dronepose import render
from dronepose.render import Light
from dronepose.synth.opacity import opaque_part

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh
    from dronepose.render import Colours, Environment, Flow
    from dronepose.synth.asset import Asset

    Array = NDArray[np.float64]
    Pose = tuple[Array, Array]

__all__ = ["Frame", "Studio"]

SCENE, DRONE = 0, 1
"""Instance ids: of the scene, and of the first drone; -1 is nothing."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What a camera sees.

    Args:
        colour: ``(H, W, 3)`` uint8, sRGB; black where the scene has a hole.
        depth: ``(H, W)`` float32, ``z`` in the camera frame in metres, 0 where nothing is seen.
        normal: ``(H, W, 3)`` float32, unit, camera frame, towards the camera; zeros where nothing.
        instance: ``(H, W)`` int32, :data:`SCENE`, :data:`DRONE` and on in the order of the
            studio's drones, or -1.
        matte: ``(H, W)`` float32, the share of the pixel in which the first drone is seen; the
            scene and the other drones may hide it.
        silhouette: ``(H, W)`` float32, the exact share that it covers, whatever hides it.
        hole: Share of the image in which nothing is seen.
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    instance: NDArray[np.int32]
    matte: NDArray[np.float32]
    silhouette: NDArray[np.float32]
    hole: float

    @property
    def seen(self) -> float:
        """Share of the first drone's area in the image that nothing hides, 0 to 1; 0 without it.

        Example:
            >>> frame.seen  # doctest: +SKIP
            0.98
        """
        area = float(self.silhouette.sum(dtype=np.float64))
        return min(1.0, float(self.matte.sum(dtype=np.float64)) / area) if area > 0 else 0.0

    @property
    def median_depth(self) -> float:
        """Of what is seen, metres; 0 if nothing is.

        Example:
            >>> frame.median_depth  # doctest: +SKIP
            2.4
        """
        seen = self.depth[self.depth > 0]
        return float(np.median(seen)) if seen.size else 0.0


class Studio:
    """Draws a scene with drones in it.

    The scene shows the light of its textures. Drones are lit by a panorama and put into the scene
    by one z-buffer with ``samples x samples`` points a pixel, so that edges are smooth and what is
    in front hides what is behind. Faces of drones whose texture has opacity show what is opaque
    behind them; for all but the colours they are as solid as the others.

    Args:
        scene: The scene, frame of the world, metres, z up; its materials are drawn unlit.
        drones: The drones, each in its own frame.
        samples: Points along a side of a pixel for colours, 1 to 8.
        threads: Number of threads, 0 for one a core. Pictures do not depend on it.

    Raises:
        ValueError: No drone is given.

    Example:
        >>> studio = Studio(load_asset("house.glb"), [load_asset("x.obj")])  # doctest: +SKIP
    """

    def __init__(
        self, scene: Asset, drones: Sequence[Asset], *, samples: int = 3, threads: int = 0
    ) -> None:
        if not drones:
            raise ValueError("drones: expected at least one")
        self.scene = scene.look(lit=False)
        self.drones = list(drones)
        self._threads, self._samples = threads, samples
        self._assets = [self.scene, *self.drones]
        self._meshes: list[Mesh] = [asset.mesh for asset in self._assets]
        # What is seen through faces that are not opaque.
        self._behind = [self.scene, *map(opaque_part, self.drones)]

    def frame(
        self,
        camera: Camera,
        cam_from_world: Pose,
        world_from_drones: Sequence[Pose | None] = (),
        *,
        environment: Environment | None = None,
        strength: float = 0.5,
        world_from_panorama: Array | None = None,
    ) -> Frame:
        """Draw what a camera sees.

        Args:
            camera: Intrinsics and size.
            cam_from_world: ``R`` ``(3, 3)`` and ``t`` ``(3,)`` metres of the camera.
            world_from_drones: ``R`` and ``t`` of each drone, or ``None`` for one that is not there;
                an empty list leaves all of them out.
            environment: Light of the drones; ``None`` shows their colours as they are.
            strength: Factor of its radiance.
            world_from_panorama: ``(3, 3)`` rotation of the panorama; ``None`` leaves it as it is.

        Returns:
            All modalities of the frame.

        Raises:
            ValueError: The number of poses is neither 0 nor that of the drones; or as
                :func:`dronepose.render.colour`.

        Example:
            >>> frame = studio.frame(camera, (R, t), [(R_drone, t_drone)])  # doctest: +SKIP
            >>> frame.depth.shape  # doctest: +SKIP
            (240, 320)
        """
        which, R, t = self._views(cam_from_world, world_from_drones)
        meshes = [self._meshes[k] for k in which]
        light = None
        if environment is not None:
            turn = np.eye(3) if world_from_panorama is None else np.asarray(world_from_panorama)
            light = Light(environment, strength, turn.T @ np.asarray(cam_from_world[0]).T)
        seen = self._colours(camera, [self._assets[k] for k in which], R, t, light)
        rgb = seen.rgb
        if seen.veil.any():
            behind = [(place, self._behind[k]) for place, k in enumerate(which)]
            rows = [place for place, asset in behind if asset is not None]
            there = [asset for _, asset in behind if asset is not None]
            rgb = (
                rgb
                + seen.veil[..., None] * self._colours(camera, there, R[rows], t[rows], light).rgb
            )
        planes = render.gbuffer(
            meshes,
            camera,
            R,
            t,
            channels=("depth", "normal", "object"),
            threads=self._threads,
        )
        assert planes.depth is not None and planes.normal is not None  # noqa: PT018
        assert planes.object is not None
        shape = (camera.height, camera.width)
        matte = np.zeros(shape, np.float32)
        silhouette = np.zeros(shape, np.float32)
        if which[1:2] == [DRONE]:
            matte = seen.shares[1]
            covered = render.silhouette(
                meshes[1], camera, R[None, 1], t[None, 1], threads=self._threads
            )[0]
            silhouette = 1 - (1 - covered)  # as the records of earlier data sets are rounded
        return Frame(
            colour=render.srgb_bytes(rgb),
            depth=planes.depth,
            normal=planes.normal,
            instance=np.array([*which, -1], np.int32)[planes.object],
            matte=matte,
            silhouette=silhouette,
            hole=max(0.0, round(float(1 - seen.share.mean(dtype=np.float64)), 9)),
        )

    def _colours(
        self, camera: Camera, assets: list[Asset], R: Array, t: Array, light: Light | None
    ) -> Colours:
        shown = assets if light is not None else [asset.look(lit=False) for asset in assets]
        return render.colour(
            [asset.mesh for asset in shown],
            camera,
            R,
            t,
            materials=[list(asset.materials) for asset in shown],
            material_of_face=[asset.material_of_face for asset in shown],
            uv=[asset.uv for asset in shown],
            lights=light,
            samples=self._samples,
            threads=self._threads,
        )

    def flow(
        self,
        camera: Camera,
        first: tuple[Pose, Sequence[Pose | None]],
        second: tuple[Pose, Sequence[Pose | None]],
    ) -> Flow:
        """Optical flow from one moment to another, of the scene and the drones.

        Args:
            camera: Intrinsics and size, at both times.
            first: ``cam_from_world`` and ``world_from_drones`` of the first moment.
            second: The same of the second; exchange the two for backward flow.

        Returns:
            Flow in pixels, with what is hidden, outside and behind in the second image.

        Raises:
            ValueError: The drones are not the same ones.

        Example:
            >>> moved = studio.flow(camera, (pose, [drone]), (pose, [drone_next]))  # doctest: +SKIP
        """
        (which, R0, t0), (other, R1, t1) = self._views(*first), self._views(*second)
        if which != other:
            raise ValueError("second: expected the same drones as in the first")
        meshes = [self._meshes[k] for k in which]
        return render.flow(meshes, camera, R0, t0, R1, t1, threads=self._threads)

    def _views(
        self, cam_from_world: Pose, drones: Sequence[Pose | None]
    ) -> tuple[list[int], Array, Array]:
        """Which meshes are there, 0 is the scene, and their ``cam_from_model``."""
        if len(drones) not in (0, len(self.drones)):
            raise ValueError(f"world_from_drones: expected {len(self.drones)}, got {len(drones)}")
        R, t = (np.asarray(x, dtype=np.float64) for x in cam_from_world)
        which, rotations, translations = [0], [R], [t]
        for k, place in enumerate(drones, 1):
            if place is None:
                continue
            turn, shift = (np.asarray(x, dtype=np.float64) for x in place)
            which.append(k)
            rotations.append(R @ turn)
            translations.append(R @ shift + t)
        return which, np.stack(rotations), np.stack(translations)
