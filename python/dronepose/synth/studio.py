"""Pictures of a plan: a drone in a scene, from two cameras, at two times, in every modality."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dronepose import render
from dronepose.render import Light

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dronepose.camera import Camera
    from dronepose.mesh import Mesh
    from dronepose.render import Environment, Flow
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
        instance: ``(H, W)`` int32, :data:`SCENE`, :data:`DRONE` and on, or -1.
        matte: ``(H, W)`` float32, the share of the pixel in which drones are seen.
        silhouette: ``(H, W)`` float32, the exact share that the drones cover, whatever hides them.
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
        """Share of the drones' area in the image that nothing hides, 0 to 1; 0 without drones.

        Example:
            >>> frame.seen  # doctest: +SKIP
            0.98
        """
        area = float(self.silhouette.sum(dtype=np.float64))
        return min(1.0, float(self.matte.sum(dtype=np.float64)) / area) if area > 0 else 0.0


class Studio:
    """Draws a scene with drones in it.

    The scene shows the light of its textures. Drones are lit by a panorama and put into the scene
    by one z-buffer with ``samples x samples`` points a pixel, so that edges are smooth and what is
    in front hides what is behind.

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
        assets = [self.scene, *self.drones]
        self._meshes: list[Mesh] = [asset.mesh for asset in assets]
        self._materials = [asset.materials for asset in assets]
        self._of_face = [asset.material_of_face for asset in assets]
        self._uv = [asset.uv for asset in assets]

    def frame(
        self,
        camera: Camera,
        cam_from_world: Pose,
        world_from_drones: Sequence[Pose] = (),
        *,
        environment: Environment | None = None,
        strength: float = 0.5,
        world_from_panorama: Array | None = None,
    ) -> Frame:
        """Draw what a camera sees.

        Args:
            camera: Intrinsics and size.
            cam_from_world: ``R`` ``(3, 3)`` and ``t`` ``(3,)`` metres of the camera.
            world_from_drones: ``R`` and ``t`` of each drone; none leaves the drones out.
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
        count = 1 + len(world_from_drones)
        R, t = self._views(cam_from_world, world_from_drones)
        lights = None
        materials = [list(m) for m in self._materials[:count]]
        if environment is not None:
            turn = np.eye(3) if world_from_panorama is None else np.asarray(world_from_panorama)
            lights = Light(environment, strength, turn.T @ np.asarray(cam_from_world[0]).T)
        elif count > 1:
            materials[1:] = [list(drone.look(lit=False).materials) for drone in self.drones]
        seen = render.colour(
            self._meshes[:count],
            camera,
            R,
            t,
            materials=materials,
            material_of_face=self._of_face[:count],
            uv=self._uv[:count],
            lights=lights,
            samples=self._samples,
            threads=self._threads,
        )
        planes = render.gbuffer(
            self._meshes[:count],
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
        if count > 1:
            matte = seen.shares[1:].sum(axis=0)
            each = [
                render.silhouette(mesh, camera, R[None, k], t[None, k], threads=self._threads)[0]
                for k, mesh in enumerate(self._meshes[1:count], 1)
            ]
            silhouette = (1 - np.prod([1 - mask for mask in each], axis=0)).astype(np.float32)
        return Frame(
            colour=render.srgb_bytes(seen.rgb),
            depth=planes.depth,
            normal=planes.normal,
            instance=planes.object,
            matte=matte,
            silhouette=silhouette,
            hole=max(0.0, round(float(1 - seen.share.mean(dtype=np.float64)), 9)),
        )

    def flow(
        self,
        camera: Camera,
        first: tuple[Pose, Sequence[Pose]],
        second: tuple[Pose, Sequence[Pose]],
    ) -> Flow:
        """Optical flow from one moment to another, of the scene and the drones.

        Args:
            camera: Intrinsics and size, at both times.
            first: ``cam_from_world`` and ``world_from_drones`` of the first moment.
            second: The same of the second; exchange the two for backward flow.

        Returns:
            Flow in pixels, with what is hidden, outside and behind in the second image.

        Raises:
            ValueError: The numbers of drones differ.

        Example:
            >>> moved = studio.flow(camera, (pose, [drone]), (pose, [drone_next]))  # doctest: +SKIP
        """
        if len(first[1]) != len(second[1]):
            raise ValueError("second: expected as many drones as in the first")
        count = 1 + len(first[1])
        (R0, t0), (R1, t1) = self._views(*first), self._views(*second)
        return render.flow(self._meshes[:count], camera, R0, t0, R1, t1, threads=self._threads)

    def _views(self, cam_from_world: Pose, drones: Sequence[Pose]) -> Pose:
        """``cam_from_model`` of the scene and of each drone, ``(M, 3, 3)`` and ``(M, 3)``."""
        if len(drones) not in (0, len(self.drones)):
            raise ValueError(f"world_from_drones: expected {len(self.drones)}, got {len(drones)}")
        R, t = (np.asarray(x, dtype=np.float64) for x in cam_from_world)
        rotations, translations = [R], [t]
        for place in drones:
            turn, shift = (np.asarray(x, dtype=np.float64) for x in place)
            rotations.append(R @ turn)
            translations.append(R @ shift + t)
        return np.stack(rotations), np.stack(translations)
