"""What goes into a rendered data set, from files: the scene, the drone, panoramas, cameras."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose.camera import Camera
from dronepose.mesh import Mesh
from dronepose.render import Environment, srgb_linear
from dronepose.synth._settings import axes as checked_axes
from dronepose.synth._settings import flu_from_axes
from dronepose.synth.asset import (
    Asset,
    AssetError,
    load_asset,
    load_placements,
    merged,
    placed_meshes,
)
from dronepose.synth.exr import read_exr
from dronepose.synth.rooms import example_hall

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dronepose.synth.plan import PlanTable

__all__ = [
    "EXAMPLE",
    "cameras_of",
    "example_light",
    "read_drone",
    "read_more_drones",
    "read_panoramas",
    "read_scene",
    "scene_mesh",
]

EXAMPLE = "example"
"""The name of what the project makes itself, in place of a file."""

NO_TEXTURE = "-"
"""In place of an image, where there is none."""

MOST_DRONES = 100
"""Further drones: their numbers are in images of 8 bits."""

_PANORAMAS = (".hdr", ".exr", ".png", ".jpg", ".jpeg")


def read_scene(name: str, *, metres_per_unit: float = 1.0) -> tuple[Asset, dict[str, Any]]:
    """A scene by its file: placements (CSV), a mesh, or ``"example"`` for :func:`example_hall`.

    Args:
        name: The file.
        metres_per_unit: Scale of a mesh.

    Returns:
        The scene, and for the manifest its name and SHA-256, and those of placed meshes.

    Raises:
        AssetError: The file cannot be used.
        FileNotFoundError: There is no such file.

    Example:
        >>> read_scene("example")[1]["file"]
        'example'
    """
    if name == EXAMPLE:
        return example_hall(), {"file": EXAMPLE}
    path = Path(name)
    if path.suffix.lower() == ".csv":
        scene = merged([asset for _, asset in load_placements(path)])
        meshes = {name: _sha256(path.parent / name) for name in placed_meshes(path)}
        return scene, {**_facts(path), "meshes": meshes}
    scene = load_asset(path, metres_per_unit=metres_per_unit).look(lit=False)
    return scene, _facts(path)


def scene_mesh(name: str) -> Mesh:
    """The mesh of a scene; the textures of a file of its own are not read.

    Args:
        name: As for :func:`read_scene`; metres.

    Returns:
        The mesh.

    Raises:
        ValueError: The file cannot be used.
        FileNotFoundError: There is no such file.

    Example:
        >>> len(scene_mesh("examples/quadrotor.obj").faces) > 1000
        True
    """
    whole = name == EXAMPLE or Path(name).suffix.lower() == ".csv"
    return read_scene(name)[0].mesh if whole else Mesh.from_file(name)


def read_drone(
    name: str,
    *,
    metres_per_unit: float = 1.0,
    texture: str | None = None,
    roughness: float = 0.45,
    metallic: float = 0.0,
) -> tuple[Asset, dict[str, Any]]:
    """A drone by its file, or ``"example"`` for the project's quadrotor, with colours of its parts.

    Args:
        name: The file.
        metres_per_unit: Scale of the mesh.
        texture: An image for all of it.
        roughness: Of its surface, 0 for a mirror to 1.
        metallic: 0 for plastics, 1 for metals.

    Returns:
        The drone, and for the manifest its name and SHA-256.

    Raises:
        AssetError: The file cannot be used.
        FileNotFoundError: There is no such file.

    Example:
        >>> read_drone("example")[0].materials[0].lit
        True
    """
    if name == EXAMPLE:
        from dronepose.data._shading import painted
        from dronepose.data.toyset import EXAMPLE_MESH
        from dronepose.render import Material

        mesh = Mesh.from_file(EXAMPLE_MESH)
        colours, index = np.unique(painted(mesh, "z").albedo, axis=0, return_inverse=True)
        materials = tuple(Material((float(r), float(g), float(b))) for r, g, b in colours)
        corners = np.zeros((len(mesh.faces), 3, 2))
        drone = Asset(mesh, materials, index.reshape(-1).astype(np.uint32), corners)
        facts: dict[str, Any] = {"file": EXAMPLE}
    else:
        drone = load_asset(name, metres_per_unit=metres_per_unit, texture=texture, opacity=True)
        facts = {**_facts(Path(name)), "metres_per_unit": metres_per_unit}
        if texture is not None:
            facts["texture"] = _facts(Path(texture))
    return drone.look(lit=True, roughness=roughness, metallic=metallic), facts


def read_more_drones(
    names: Sequence[str],
    *,
    model_axes: str = "flu",
    axes: Sequence[str] = (),
    metres_per_unit: Sequence[float] = (),
    textures: Sequence[str] = (),
    roughness: float = 0.45,
    metallic: float = 0.0,
) -> tuple[list[Asset], list[dict[str, Any]]]:
    """Further drones by their files, turned to the axes of the plan's drone.

    Args:
        names: The files, or ``"example"``.
        model_axes: Which way x, y and z of the plan's drone point.
        axes: The same of each file, or one for all; none: as the plan's (``flu`` of ``"example"``).
        metres_per_unit: Of each, or one for all; none: 1.
        textures: An image for each, ``-`` for none; or none at all.
        roughness: Of their surfaces, 0 for a mirror to 1.
        metallic: 0 for plastics, 1 for metals.

    Returns:
        The drones, and for the manifest what :func:`read_drone` says, with ``turned``, the rotation
        ``plan_from_file``, where the axes differ.

    Raises:
        AssetError: A file cannot be used.
        FileNotFoundError: There is no such file.
        ValueError: A list is of another length, or axes are of another handedness.

    Example:
        >>> drones, facts = read_more_drones(["example"], model_axes="luf")
        >>> facts[0]["turned"]
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    """
    count = len(names)
    if count > MOST_DRONES:
        raise ValueError(f"more_drones: expected at most {MOST_DRONES}, got {count}")
    own = ["flu" if name == EXAMPLE else model_axes for name in names]
    turned_from = _for_each("axes", axes, count) or own
    units = _for_each("metres_per_unit", metres_per_unit, count) or [1.0] * count
    images = _for_each("textures", textures, count) or [NO_TEXTURE] * count
    plan_from_flu = flu_from_axes(model_axes).T
    drones, facts = [], []
    for name, letters, unit, image in zip(names, turned_from, units, images, strict=True):
        drone, said = read_drone(
            name,
            metres_per_unit=unit,
            texture=None if image == NO_TEXTURE else image,
            roughness=roughness,
            metallic=metallic,
        )
        turn = plan_from_flu @ flu_from_axes(checked_axes("axes", letters)) + 0.0
        if np.linalg.det(turn) < 0:
            raise ValueError(f"axes: {letters} of {name} are mirrored against {model_axes}")
        if not np.array_equal(turn, np.eye(3)):
            drone = drone.moved(np.column_stack([turn, np.zeros(3)]))
            said["turned"] = turn.tolist()
        drones.append(drone)
        facts.append(said)
    return drones, facts


def _for_each(name: str, values: Sequence[Any], count: int) -> list[Any]:
    """A value for each of so many, of as many or of one."""
    if len(values) not in (0, 1, count):
        raise ValueError(f"{name}: expected {count} values, one for each drone, got {len(values)}")
    return list(values) * count if len(values) == 1 else list(values)


def read_panoramas(
    folder: str | None, *, threads: int = 0
) -> tuple[dict[str, Environment], dict[str, Any]]:
    """The panoramas of a folder by name, or two halls of light of our own.

    Args:
        folder: Holds ``.hdr`` (Radiance), ``.exr`` (OpenEXR), or 8-bit images in sRGB, twice as
            wide as high; one file is one panorama; ``None`` is :func:`example_light`.
        threads: Number of threads, 0 for one a core.

    Returns:
        The environments, and for the manifest their SHA-256.

    Raises:
        AssetError: A file cannot be read, or there is none.
        FileNotFoundError: There is no such folder.
        ImportError: A file is EXR, and the package OpenEXR is missing.

    Example:
        >>> sorted(read_panoramas(None)[0])
        ['example-cool', 'example-warm']
    """
    if folder is None:
        made = {f"{EXAMPLE}-{kind}": example_light(kind) for kind in ("warm", "cool")}
        return made, dict.fromkeys(made, "made by dronepose")
    place = Path(folder)
    if not place.exists():
        raise FileNotFoundError(f"{place}: there is no such folder of panoramas")
    files = [place] if place.is_file() else sorted(place.iterdir())
    files = [file for file in files if file.suffix.lower() in _PANORAMAS]
    if not files:
        raise AssetError(f"{place}: expected panoramas, {', '.join(_PANORAMAS)}")
    found = {}
    for file in files:
        image = _radiance(file)
        if image.shape[1] != 2 * image.shape[0]:
            raise AssetError(f"{file}: expected twice as wide as high, got {image.shape[1::-1]}")
        found[file.stem] = Environment(image, threads=threads)
    return found, {file.stem: _sha256(file) for file in files}


def _radiance(path: Path) -> NDArray[np.float32]:
    rgb = read_exr(path) if path.suffix.lower() == ".exr" else _decoded(path)
    if not np.isfinite(rgb).all() or rgb.min() < 0:
        raise AssetError(f"{path}: holds a radiance that is negative or not finite")
    return np.ascontiguousarray(rgb)


def _decoded(path: Path) -> NDArray[np.float32]:
    """What OpenCV reads, as linear RGB."""
    import cv2

    content = np.frombuffer(path.read_bytes(), np.uint8)
    image = None if not len(content) else cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3:
        raise AssetError(f"{path}: cannot be read as a panorama in colour")
    rgb = image[..., 2::-1]
    return srgb_linear(rgb) if image.dtype == np.uint8 else rgb.astype(np.float32)


def example_light(kind: str = "warm") -> Environment:
    """The light of a room: windows on one side, a lamp above, a dim floor.

    Args:
        kind: ``"warm"`` or ``"cool"``.

    Returns:
        The environment.

    Raises:
        ValueError: The kind is unknown.

    Example:
        >>> min(example_light("cool").mean) > 0.3
        True
    """
    if kind not in ("warm", "cool"):
        raise ValueError(f"kind: expected 'warm' or 'cool', got {kind!r}")
    warm = kind == "warm"
    height, width = 128, 256
    polar, turn = (np.arange(n) + 0.5 for n in (height, width))
    polar, turn = polar[:, None] / height * np.pi, turn[None] / width * 2 * np.pi
    tint = np.array([1.0, 0.93, 0.82] if warm else [0.86, 0.94, 1.0])
    room = 0.55 + 0.25 * np.cos(polar) + 0.05 * np.cos(turn - 1)
    light = room[..., None] * tint
    for centre, wide, strength in (
        ((1.2, 0.35, 9.0), (2.1, 0.3, 7.0)) if warm else ((4.0, 0.5, 8.0),)
    ):
        window = (np.abs(turn - centre) < wide) & (np.abs(polar - 1.35) < 0.35)
        light = light + window[..., None] * strength * np.array([0.95, 1.0, 1.05])
    lamp = (polar < (0.25 if warm else 0.4)) & (turn > -1)
    light = light + lamp[..., None] * (12.0 if warm else 6.0) * tint
    return Environment(light.astype(np.float32))


def cameras_of(plan: PlanTable) -> tuple[Camera, Camera]:
    """The exocentric and the egocentric camera that a plan was made for.

    Raises:
        ValueError: The plan has no manifest.
    """
    cameras = plan.manifest.get("cameras")
    if not cameras:
        raise ValueError("plan: its manifest with the cameras is missing (plan.json beside it)")
    return Camera(**cameras["exo"]), Camera(**cameras["ego"])


def _facts(path: Path) -> dict[str, Any]:
    return {"file": path.name, "sha256": _sha256(path)}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
