"""Meshes with what they look like: files of drones and scenes to arrays, in metres."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

from dronepose._appearance import Material, Texture, srgb_linear
from dronepose.mesh import Mesh

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

__all__ = ["Asset", "AssetError", "load_asset", "load_placements", "merged"]

_GREY = (0.5, 0.5, 0.5)
_TEXTURES = ("../materials/textures", "../textures", "textures")
_MATRIX = [f"m{row}{column}" for row in range(3) for column in range(4)]


class AssetError(ValueError):
    """A file of a mesh, a texture or placements that cannot be used; names the file."""


@dataclass(frozen=True, slots=True)
class Asset:
    """A mesh with texture coordinates and materials.

    Args:
        mesh: ``V`` vertices in metres and ``F`` faces.
        materials: What faces are made of.
        material_of_face: ``(F,)`` index of the material of each face.
        uv: ``(F, 3, 2)`` texture coordinates of the corners of each face; zeros where a part has
            none.

    Example:
        >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[0, 1, 2]])
        >>> Asset.plain(square, (0.8, 0.1, 0.1)).materials[0].lit
        True
    """

    mesh: Mesh
    materials: tuple[Material, ...]
    material_of_face: NDArray[np.uint32]
    uv: NDArray[np.float64]

    @classmethod
    def plain(cls, mesh: Mesh, colour: tuple[float, float, float] = _GREY) -> Asset:
        """One linear colour for all faces.

        Args:
            mesh: The mesh.
            colour: Linear RGB.

        Returns:
            The asset.

        Raises:
            AttributeError: ``mesh`` is no mesh.

        Example:
            >>> Asset.plain(Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])).uv.shape
            (1, 3, 2)
        """
        count = len(mesh.faces)
        return cls(mesh, (Material(colour),), np.zeros(count, np.uint32), np.zeros((count, 3, 2)))

    def look(self, *, lit: bool, roughness: float = 0.5, metallic: float = 0.0) -> Asset:
        """The same with all materials lit, or none of them (as scanned).

        Args:
            lit: Whether light falls on it.
            roughness: 0 for a mirror to 1.
            metallic: 0 for plastics, 1 for metals.

        Returns:
            Another asset.

        Raises:
            Nothing here; what is out of range is refused when it is drawn.

        Example:
            >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[0, 1, 2]])
            >>> Asset.plain(square).look(lit=False).materials[0].lit
            False
        """
        made = [replace(m, lit=lit, roughness=roughness, metallic=metallic) for m in self.materials]
        return replace(self, materials=tuple(made))

    def moved(self, matrix: ArrayLike) -> Asset:
        """The same at another place.

        Args:
            matrix: ``(3, 4)`` or ``(4, 4)``; vertices become ``matrix @ (x, y, z, 1)``.

        Returns:
            Another asset.

        Raises:
            ValueError: Another shape, or numbers that are not finite.

        Example:
            >>> square = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[0, 1, 2]])
            >>> Asset.plain(square).moved(2 * np.eye(4)).mesh.bounds[1].tolist()
            [2.0, 2.0, 0.0]
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape not in ((3, 4), (4, 4)) or not np.isfinite(m).all():
            raise ValueError(f"matrix: expected finite (3, 4) or (4, 4), got {m.shape}")
        points = self.mesh.vertices @ m[:3, :3].T + m[:3, 3]
        return replace(self, mesh=Mesh(points, self.mesh.faces))


def merged(assets: Sequence[Asset]) -> Asset:
    """One asset of several, in their order.

    Args:
        assets: At least one.

    Returns:
        The asset; materials that are the same object are shared.

    Raises:
        ValueError: There is none.

    Example:
        >>> square = Asset.plain(Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[0, 1, 2]]))
        >>> len(merged([square, square]).mesh.faces)
        2
    """
    if not assets:
        raise ValueError("assets: expected at least one")
    materials: list[Material] = []
    points, faces, of_face, uv = [], [], [], []
    known: dict[int, int] = {}
    offset = 0
    for asset in assets:
        points.append(asset.mesh.vertices)
        faces.append(np.asarray(asset.mesh.faces, dtype=np.int64) + offset)
        offset += len(asset.mesh.vertices)
        places = []
        for material in asset.materials:
            place = known.setdefault(id(material), len(materials))
            if place == len(materials):
                materials.append(material)
            places.append(place)
        of_face.append(np.array(places, np.uint32)[asset.material_of_face])
        uv.append(asset.uv)
    mesh = Mesh(np.concatenate(points), np.concatenate(faces))
    return Asset(mesh, tuple(materials), np.concatenate(of_face), np.concatenate(uv))


def load_asset(
    path: str | os.PathLike[str],
    *,
    metres_per_unit: float = 1.0,
    texture: str | os.PathLike[str] | None = None,
    opacity: bool = False,
) -> Asset:
    """A mesh file with its materials, by trimesh: OBJ, GLB, DAE, PLY, STL and what else it reads.

    Axes stay as they are in the file. Materials are lit; :meth:`Asset.look` changes that. Of
    transparency, only the opaque colour is kept.

    Args:
        path: The file; textures are looked for where it says.
        metres_per_unit: Scale, such as 0.001 for millimetres.
        texture: An image for all of it, where the file names none or one that is missing.
        opacity: Whether textures may let what is behind shine through: by the fourth channel of
            their image (in glTF if ``alphaMode`` says so). Scans keep it off: theirs means nothing.

    Returns:
        The asset, metres.

    Raises:
        AssetError: The file holds no faces, or is no mesh; an image cannot be read.
        FileNotFoundError: There is no such file.
        ImportError: trimesh is missing (``pip install "dronepose[synth]"``).

    Example:
        >>> asset = load_asset("house.glb")  # doctest: +SKIP
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(
            'reading meshes with materials needs trimesh: pip install "dronepose[synth]"'
        ) from error
    kind = path.suffix.lower().lstrip(".")
    content = path.read_bytes()
    if kind == "dae":
        content = _with_samplers(content, path)
    try:
        scene = trimesh.load_scene(
            io.BytesIO(content),
            file_type=kind,
            resolver=_resolver(path.parent),
            process=False,
        )
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    except Exception as error:  # trimesh lets through what its parsers raise
        raise AssetError(f"{path}: cannot be read as {kind}: {error}") from error
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise AssetError(f"{path}: holds no faces")
    image = None if texture is None else Texture(_picture(Path(texture), opacity=opacity))
    made: dict[int, Material] = {}
    assets = [_asset(part, metres_per_unit, image, made, opacity=opacity) for part in parts]
    found = assets[0] if len(assets) == 1 else merged(assets)
    if opacity and any(_clear(material) for material in found.materials):
        from dronepose.synth.opacity import see_through

        if not see_through(found).any():  # texels beside all faces, which filters would mix in
            return load_asset(path, metres_per_unit=metres_per_unit, texture=texture)
    return found


def _clear(material: Material) -> bool:
    return isinstance(material.colour, Texture) and material.colour.opacity is not None


def load_placements(path: str | os.PathLike[str]) -> list[tuple[str, Asset]]:
    """A scene from a CSV of placed models, unlit, in the frame of the world, metres.

    Columns ``instance, mesh, metres_per_unit, m00 .. m23, sx, sy, sz``: a point of the file is at
    ``M (s metres_per_unit p)`` with the 3x4 matrix ``M``; ``mesh`` is relative to the CSV.

    Args:
        path: The CSV.

    Returns:
        Name and asset of every instance, in the order of the file.

    Raises:
        AssetError: A column is missing, or a number is none; names line and column.
        FileNotFoundError: A file is missing.

    Example:
        >>> rooms = load_placements("small_house/placements.csv")  # doctest: +SKIP
    """
    path = Path(path)
    models: dict[tuple[str, float], Asset] = {}
    found = []
    for instance, mesh, unit, placed in _placements(path):
        key = (mesh, unit)
        if key not in models:
            models[key] = load_asset(path.parent / mesh, metres_per_unit=unit).look(lit=False)
        found.append((instance, models[key].moved(placed)))
    return found


def placed_meshes(path: str | os.PathLike[str]) -> list[str]:
    """The meshes that a CSV of :func:`load_placements` names.

    Args:
        path: The CSV.

    Returns:
        Their names as in the CSV, relative to it, sorted, each once.

    Raises:
        AssetError: As :func:`load_placements`.
        FileNotFoundError: There is no such CSV.

    Example:
        >>> placed_meshes("small_house/placements.csv")  # doctest: +SKIP
        ['models/Bed.obj', 'models/Wall.obj']
    """
    return sorted({mesh for _, mesh, _, _ in _placements(Path(path))})


def _placements(path: Path) -> list[tuple[str, str, float, Array]]:
    """Instance, mesh, metres of its unit and matrix with the scale, row by row."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    found = []
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        wanted = ["instance", "mesh", "metres_per_unit", *_MATRIX, "sx", "sy", "sz"]
        missing = [name for name in wanted if name not in (reader.fieldnames or [])]
        if missing:
            raise AssetError(f"{path}:1: expected columns {', '.join(missing)}")
        for row in reader:
            place = f"{path}:{reader.line_num}"
            numbers = {name: _number(row[name], place, name) for name in wanted[2:]}
            matrix = np.array([numbers[name] for name in _MATRIX]).reshape(3, 4)
            scale = np.array([numbers[axis] for axis in ("sx", "sy", "sz")])
            matrix[:, :3] *= scale
            if not row["mesh"]:
                raise AssetError(f"{place}: column mesh: expected a file")
            found.append((row["instance"], row["mesh"], numbers["metres_per_unit"], matrix))
    if not found:
        raise AssetError(f"{path}: holds no placements")
    return found


def _texture_file(folder: Path, name: str) -> bytes:
    """Content of a file that a mesh names: at that place, or one of its name where Gazebo's are.

    trimesh's own resolver stays below the folder of the mesh; such models keep textures beside it.
    """
    relative = Path(unquote(name.removeprefix("file://")).replace("\\", "/"))
    for place in (folder, *(folder / other for other in _TEXTURES)):
        for candidate in (place / relative, place / relative.name):
            if candidate.is_file():
                return candidate.read_bytes()
    raise FileNotFoundError(f"{folder / relative}: there is no such file")


def _resolver(folder: Path) -> Any:
    """What trimesh asks for files that a mesh names."""
    from trimesh import resolvers

    class Files(resolvers.FilePathResolver):
        def get(self, name: str) -> bytes:
            return _texture_file(folder, name)

    return Files(str(folder))


def _number(text: str | None, place: str, column: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise AssetError(f"{place}: column {column}: expected a finite number, found {text!r}")
    return value


def _asset(
    part: Any, unit: float, image: Texture | None, made: dict[int, Material], *, opacity: bool
) -> Asset:
    """A part of trimesh's."""
    mesh = Mesh(np.asarray(part.vertices, dtype=np.float64) * unit, part.faces)
    faces = np.asarray(part.faces)
    visual = part.visual
    coordinates = getattr(visual, "uv", None)
    has_uv = coordinates is not None and len(coordinates) == len(part.vertices)
    uv = np.zeros((len(faces), 3, 2))
    if has_uv:
        uv = np.nan_to_num(np.asarray(coordinates, dtype=np.float64)[faces][..., :2])
    if has_uv and image is not None:
        return Asset(mesh, (Material(image),), np.zeros(len(faces), np.uint32), uv)
    material = getattr(visual, "material", None)
    if material is not None:
        if id(material) not in made:
            made[id(material)] = _material(material, has_uv=has_uv, opacity=opacity)
        return Asset(mesh, (made[id(material)],), np.zeros(len(faces), np.uint32), uv)
    colours = np.asarray(visual.face_colors)[:, :3]
    distinct, index = np.unique(colours, axis=0, return_inverse=True)
    materials = tuple(Material(_linear(colour)) for colour in distinct)
    return Asset(mesh, materials, index.reshape(-1).astype(np.uint32), uv)


def _material(material: Any, *, has_uv: bool, opacity: bool) -> Material:
    """A material of trimesh's, simple or physically based."""
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if picture is not None and has_uv:
        mode = getattr(material, "alphaMode", "BLEND")  # of glTF alone; OPAQUE unless it is given
        clear = opacity and picture.has_transparency_data and mode in ("BLEND", "MASK")
        image = np.asarray(picture.convert("RGBA" if clear else "RGB"), dtype=np.uint8)
        if clear and mode == "MASK":
            least = getattr(material, "alphaCutoff", None)
            image = image.copy()
            image[..., 3] = 255 * (image[..., 3] >= 255 * (0.5 if least is None else least))
        return Material(Texture(_without_needless(image)))
    colour = getattr(material, "main_color", None)
    return Material(_GREY if colour is None else _linear(np.asarray(colour)[:3]))


def _without_needless(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image without its opacity, if it is opaque."""
    return image[..., :3] if image.shape[2] == 4 and image[..., 3].min() == 255 else image


def _linear(colour: NDArray[Any]) -> tuple[float, float, float]:
    """Linear RGB of sRGB bytes."""
    red, green, blue = srgb_linear(np.asarray(colour, dtype=np.uint8)).tolist()
    return red, green, blue


def _picture(path: Path, *, opacity: bool) -> NDArray[np.uint8]:
    from dronepose.data._images import read_rgb, read_rgba

    try:
        image = (read_rgba if opacity else read_rgb)(path, "a texture")
    except ValueError as error:
        raise AssetError(str(error)) from error
    return _without_needless(image)


def _with_samplers(content: bytes, path: Path) -> bytes:
    """COLLADA whose textures name images by way of samplers, as the specification wants it.

    FBX exporters name the image itself (``<texture texture="X-image">``), which parsers drop.
    """
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise AssetError(f"{path}:{line}:{column + 1}: {error}") from None
    space = root.tag.partition("}")[0] + "}" if root.tag.startswith("{") else ""
    if space:
        ElementTree.register_namespace("", space[1:-1])
    images = {image.get("id") for image in root.iter(f"{space}image")}
    for profile in root.iter(f"{space}profile_COMMON"):
        known = {entry.get("sid") for entry in profile.iter(f"{space}newparam")}
        for name in {t.get("texture") for t in profile.iter(f"{space}texture")}:
            if name is None or name in known or name not in images:
                continue
            for sid, inner, tag in (
                (f"{name}-surface", name, "surface"),
                (f"{name}-sampler", f"{name}-surface", "sampler2D"),
            ):
                entry = ElementTree.Element(f"{space}newparam", {"sid": sid})
                body = ElementTree.SubElement(entry, f"{space}{tag}")
                if tag == "surface":
                    body.set("type", "2D")
                child = "init_from" if tag == "surface" else "source"
                ElementTree.SubElement(body, f"{space}{child}").text = inner
                profile.insert(0 if tag == "surface" else 1, entry)
            for texture in profile.iter(f"{space}texture"):
                if texture.get("texture") == name:
                    texture.set("texture", f"{name}-sampler")
    found: bytes = ElementTree.tostring(root)
    return found
