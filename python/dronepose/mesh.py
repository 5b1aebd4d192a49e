"""Triangle meshes of drones: the vertices that ADD averages over, and their reference lengths."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose._arrays import floats, read_only

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray

_Unit = Literal["m", "cm", "mm"]
_METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_NATIVE_SUFFIXES = frozenset({".obj", ".ply", ".stl"})


class MeshCheck(dict[str, Any]):
    """What :meth:`Mesh.check` found: the facts by name, and a paragraph for people as ``str()``."""

    def __init__(self, facts: dict[str, Any], text: str) -> None:
        super().__init__(facts)
        self._text = text

    def __str__(self) -> str:
        return self._text


class Mesh:
    """Vertices and triangles in the model frame, in metres; checked when made, then immutable.

    All vertices count, also those that no face names and those that coincide, because the mean in
    ADD is over the vertices of the file (see :func:`dronepose.metrics.add`).

    Args:
        vertices: ``(V, 3)`` float32 or float64, in metres.
        faces: ``(F, 3)`` integers, vertex indices from 0. May be empty: a point cloud.

    Raises:
        ValueError: A shape is wrong, or (as :class:`dronepose.MeshError`) a coordinate is not
            finite, there is no vertex, or a face names a missing vertex.
        TypeError: ``faces`` are not integers.

    Example:
        >>> from dronepose import Mesh
        >>> mesh = Mesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]])
        >>> mesh.diameter
        5.0
    """

    __slots__ = ("_faces", "_native", "_source", "_vertices")

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        v = floats("vertices", vertices, "(V, 3)")
        f = np.asarray(faces)
        if f.size == 0:
            f = np.empty((0, 3), dtype=np.int64)
        if f.ndim != 2 or f.shape[1] != 3:
            raise ValueError(f"faces: expected shape (F, 3), got {f.shape}")
        if not np.issubdtype(f.dtype, np.integer):
            raise TypeError(f"faces: expected integers, got {f.dtype}")
        if f.size and int(f.min()) < 0:
            raise _native.MeshError(
                f"faces: expected vertex indices >= 0, got {int(f.min())} "
                f"in face {int(np.argmax((f < 0).any(axis=1)))}"
            )
        if f.size and int(f.max()) >= len(v):
            raise _native.MeshError(
                f"faces: face {int(np.argmax((f >= len(v)).any(axis=1)))} refers to vertex "
                f"{int(f.max())}, but the mesh has {len(v)} vertices"
            )
        self._init(_native.Mesh(v, np.ascontiguousarray(f, dtype=np.uint32)), None)

    def _init(self, native: _native.Mesh, source: tuple[Path, _Unit] | None) -> None:
        self._native = native
        self._source = source
        self._vertices = read_only(native.vertices())
        self._faces = read_only(native.faces())

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], unit: _Unit = "m") -> Mesh:
        """Read a mesh file.

        OBJ, PLY and STL are read by the native reader, which keeps every vertex in the order of
        the file. Everything else (GLB, DAE, OFF, ...) goes through trimesh, which may merge
        vertices.

        Args:
            path: The file, its coordinates in the model frame.
            unit: Unit of its coordinates; the mesh is scaled to metres.

        Returns:
            The mesh in metres.

        Raises:
            OSError: The file cannot be read.
            ImportError: The format needs trimesh, which is not installed.
            ValueError: ``unit`` is unknown or (:class:`dronepose.MeshError`) the file holds no
                usable mesh.

        Example:
            >>> Mesh.from_file("examples/quadrotor.obj")
            Mesh(2032 vertices, 3912 faces, 0.387 x 0.392 x 0.16 m)
        """
        if unit not in _METRES:
            raise ValueError(f"unit: expected one of 'm', 'cm', 'mm', got {unit!r}")
        path = Path(path)
        if path.suffix.lower() in _NATIVE_SUFFIXES:
            mesh = cls.__new__(cls)
            mesh._init(_native.Mesh.read(path, _METRES[unit]), (path, unit))
            return mesh
        if not path.exists():
            raise FileNotFoundError(f"cannot read {path}: no such file")
        try:
            import trimesh
        except ImportError as error:
            raise ImportError(
                f"{path}: only OBJ, PLY and STL are read without trimesh; "
                "for other formats: pip install trimesh"
            ) from error
        try:
            loaded = trimesh.load(path, force="mesh", process=False)
        except (ValueError, NotImplementedError) as error:
            raise _native.MeshError(f"{path}: {error}") from error
        return cls.from_trimesh(loaded, unit)

    @classmethod
    def from_trimesh(cls, mesh: Any, unit: _Unit = "m") -> Mesh:
        """From a ``trimesh.Trimesh``.

        Args:
            mesh: Anything with ``vertices`` ``(V, 3)``, float, and ``faces`` ``(F, 3)``, integer.
            unit: Unit of its coordinates; the mesh is scaled to metres.

        Returns:
            The mesh in metres.

        Raises:
            TypeError: ``mesh`` has no vertices or faces.
            ValueError: As in the class.

        Example:
            >>> import trimesh
            >>> Mesh.from_trimesh(trimesh.creation.box((3, 4, 12))).diameter
            13.0
        """
        if unit not in _METRES:
            raise ValueError(f"unit: expected one of 'm', 'cm', 'mm', got {unit!r}")
        try:
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        except AttributeError:
            raise TypeError(
                f"mesh: expected something with vertices and faces, got {type(mesh).__name__}"
            ) from None
        return cls(np.asarray(vertices, dtype=np.float64) * _METRES[unit], faces)

    @property
    def vertices(self) -> NDArray[np.float64]:
        """Vertices ``(V, 3)`` float64 in metres, model frame; read-only.

        Example:
            >>> Mesh([[0, 0, 0], [3, 0, 0]], []).vertices.shape
            (2, 3)
        """
        return self._vertices

    @property
    def faces(self) -> NDArray[np.int32]:
        """Vertex indices ``(F, 3)`` int32, from 0; read-only.

        Example:
            >>> Mesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]]).faces.tolist()
            [[0, 1, 2]]
        """
        return self._faces

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Corners ``(2, 3)`` float64 of the bounding box along the axes of the model frame.

        Smallest and largest coordinates, metres.

        Example:
            >>> Mesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], []).bounds.tolist()
            [[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]]
        """
        return np.stack([self._vertices.min(axis=0), self._vertices.max(axis=0)])

    @property
    def bbox_diagonal(self) -> float:
        """Diagonal of :attr:`bounds` in metres.

        The reference of 6D Pose-k in DronePose, section 5 ("the 3D model's diagonal rather than its
        diameter").

        Example:
            >>> Mesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], []).bbox_diagonal
            5.0
        """
        return self._native.bbox_diagonal

    @property
    def diameter(self) -> float:
        """Largest distance between two vertices in metres, exact.

        The reference of the thresholds in BOP (Hodan et al., ECCV 2018).

        Example:
            >>> Mesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], []).diameter
            5.0
        """
        return self._native.diameter

    def check(self) -> MeshCheck:
        """Look for what makes a mesh doubtful: doubled vertices, open edges, an odd unit.

        Returns:
            A dictionary of facts (lengths in metres); ``str()`` of it is a text for people.

        Example:
            >>> Mesh.from_file("examples/quadrotor.obj").check()["closed"]
            True
        """
        facts, text = self._native.check()
        return MeshCheck(json.loads(facts), text)

    def __reduce__(self) -> tuple[type[Mesh], tuple[NDArray[np.float64], NDArray[np.int32]]]:
        # Vertices and faces only: a copy in another process does not need the file.
        return Mesh, (self._vertices, self._faces)

    def __repr__(self) -> str:
        size = " x ".join(f"{s:.3g}" for s in np.ptp(self.bounds, axis=0))
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces, {size} m)"


def obj_text(vertices: ArrayLike, faces: ArrayLike, comment: str) -> str:
    """Triangles as the text of an OBJ file, with nine digits.

    Args:
        vertices: ``(V, 3)``, in the unit of the file.
        faces: ``(F, 3)`` integers, vertex indices from 0.
        comment: Its first line.

    Returns:
        The text.

    Raises:
        ValueError: An element is no number.

    Example:
        >>> obj_text([[0, 0, 0], [1, 0, 0], [0, 0.5, 0]], [[0, 1, 2]], "metres").splitlines()[3:]
        ['v 0 0.5 0', 'f 1 2 3']
    """
    lines = [f"# {comment}"]
    lines += ["v " + " ".join(f"{float(x):.9g}" for x in v) for v in np.asarray(vertices)]
    lines += ["f " + " ".join(str(int(i) + 1) for i in f) for f in np.asarray(faces)]
    return "\n".join(lines) + "\n"
