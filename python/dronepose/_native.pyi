"""The extension module. Arrays are C-contiguous float64; the public functions convert and check."""

import os
from typing import Any, final

from numpy import float32, float64, int32, int64, uint8, uint32
from numpy.typing import NDArray

__all__ = [
    "Environment",
    "Flight",
    "Mesh",
    "MeshError",
    "Model",
    "Plan",
    "Symmetries",
    "Texture",
    "Traces",
    "Track",
    "__version__",
    "add",
    "add_passes",
    "adds",
    "cli_dronepose",
    "cli_run",
    "colours",
    "evaluate",
    "flow",
    "fly_coins",
    "free_space",
    "gbuffer",
    "mask_loss",
    "matrix_from_6d",
    "matrix_from_axis_angle",
    "matrix_from_quat_wxyz",
    "matrix_from_quat_xyzw",
    "mssd",
    "npe",
    "orientation_error",
    "projection",
    "quat_wxyz_from_matrix",
    "read_anchors",
    "scale_images",
    "signed_distance",
    "silhouette",
    "silhouette_gradients",
    "srgb_bytes",
    "srgb_linear",
    "symmetric_orientation_error",
    "synth_defaults",
    "translation_error",
]

__version__: str

class MeshError(ValueError):
    """A mesh file or a mesh array that is not a usable mesh."""

@final
class Mesh:
    """Vertices in metres and triangles over them, with what the metrics precompute."""

    def __new__(cls, vertices: NDArray[float64], faces: NDArray[uint32]) -> Mesh: ...
    @staticmethod
    def read(path: str | os.PathLike[str], metres_per_unit: float) -> Mesh:
        """An OBJ, PLY or STL file, scaled to metres."""
    def vertices(self) -> NDArray[float64]:
        """A copy, ``(V, 3)``."""
    def faces(self) -> NDArray[int32]:
        """A copy, ``(F, 3)``."""
    @property
    def bbox_diagonal(self) -> float:
        """Metres."""
    @property
    def diameter(self) -> float:
        """Metres."""
    def model(self) -> Model:
        """Prepared for drawing; made once."""
    def check(self) -> tuple[str, str]:
        """Facts as JSON, and a text for people."""

@final
class Model:
    """A mesh prepared for drawing. Cheap to hand around."""

    def __new__(cls, vertices: NDArray[float64], faces: NDArray[uint32]) -> Model: ...
    def with_vertices(self, vertices: NDArray[float64]) -> Model:
        """The same faces over other vertices, ``(V, 3)`` metres."""
    @property
    def size(self) -> tuple[int, int]:
        """``(V, F)``."""

@final
class Symmetries:
    """Transforms under which the model looks the same, the identity first."""

    def __new__(
        cls,
        rotations: NDArray[float64],
        translations: NDArray[float64],
        axes: NDArray[float64],
        max_step: float,
    ) -> Symmetries: ...
    def transforms(self) -> NDArray[float64]:
        """``(S, 4, 4)``, metres."""
    def __len__(self) -> int: ...

def cli_run(args: list[str]) -> int:
    """Run ``dronepose-eval``, the program's name first; its exit code."""

def cli_dronepose(args: list[str], further: list[tuple[str, str]]) -> int:
    """Run ``dronepose``, the program's name first; its exit code."""

def evaluate(
    options: list[str],
    predictions: str | tuple[NDArray[float64], NDArray[float64], list[str]],
    gt: str | tuple[NDArray[float64], NDArray[float64], list[str]],
    mesh: Mesh | None,
) -> tuple[str, str]:
    """The JSON and the table of an evaluation; ``options`` as on the command line."""

def matrix_from_quat_wxyz(quat_wxyz: NDArray[float64]) -> NDArray[float64]:
    """``(N, 4)`` to ``(N, 3, 3)``."""

def matrix_from_quat_xyzw(quat_xyzw: NDArray[float64]) -> NDArray[float64]:
    """``(N, 4)`` to ``(N, 3, 3)``."""

def matrix_from_axis_angle(axis_angle: NDArray[float64]) -> NDArray[float64]:
    """``(N, 3)`` to ``(N, 3, 3)``."""

def matrix_from_6d(rotation_6d: NDArray[float64], rows: bool) -> NDArray[float64]:
    """``(N, 6)`` to ``(N, 3, 3)``."""

def quat_wxyz_from_matrix(R: NDArray[float64]) -> NDArray[float64]:
    """``(N, 3, 3)`` to ``(N, 4)``."""

def translation_error(
    t_est: NDArray[float64], t_gt: NDArray[float64], threads: int
) -> NDArray[float64]:
    """``(N,)`` metres."""

def npe(t_est: NDArray[float64], t_gt: NDArray[float64], threads: int) -> NDArray[float64]:
    """``(N,)``."""

def orientation_error(
    R_est: NDArray[float64], R_gt: NDArray[float64], threads: int
) -> NDArray[float64]:
    """``(N,)`` radians."""

def symmetric_orientation_error(
    R_est: NDArray[float64], R_gt: NDArray[float64], symmetries: Symmetries, threads: int
) -> NDArray[float64]:
    """``(N,)`` radians."""

def add(
    mesh: Mesh,
    R_est: NDArray[float64],
    t_est: NDArray[float64],
    R_gt: NDArray[float64],
    t_gt: NDArray[float64],
    threads: int,
) -> NDArray[float64]:
    """``(N,)`` metres."""

def adds(
    mesh: Mesh,
    R_est: NDArray[float64],
    t_est: NDArray[float64],
    R_gt: NDArray[float64],
    t_gt: NDArray[float64],
    threads: int,
) -> NDArray[float64]:
    """``(N,)`` metres."""

def add_passes(
    mesh: Mesh,
    R_est: NDArray[float64],
    t_est: NDArray[float64],
    R_gt: NDArray[float64],
    t_gt: NDArray[float64],
    thresholds_m: NDArray[float64],
    threads: int,
) -> NDArray[float64]:
    """``(T,)`` numbers of poses whose ADD is below the thresholds."""

def mssd(
    mesh: Mesh,
    R_est: NDArray[float64],
    t_est: NDArray[float64],
    R_gt: NDArray[float64],
    t_gt: NDArray[float64],
    symmetries: Symmetries,
    threads: int,
) -> NDArray[float64]:
    """``(N,)`` metres."""

def projection(
    mesh: Mesh,
    R_est: NDArray[float64],
    t_est: NDArray[float64],
    R_gt: NDArray[float64],
    t_gt: NDArray[float64],
    symmetries: Symmetries,
    intrinsics: tuple[float, float, float, float, float, int, int],
    threads: int,
) -> tuple[NDArray[float64], NDArray[float64]]:
    """MSPD and mean projection error, ``(N,)`` pixels each."""

@final
class Traces:
    """What a batch of masks leaves behind for its gradients."""

    @property
    def nbytes(self) -> int: ...

def silhouette(
    models: list[Model],
    R: NDArray[float64],
    t: NDArray[float64],
    K: NDArray[float64],
    mode: str,
    width: float,
    cutoff: tuple[float, int] | None,
    near: float | None,
    threads: int,
    out: NDArray[float32] | NDArray[float64],
    traced: bool,
) -> Traces | None:
    """Masks into ``out``, ``(B, H, W)``; ``K`` is ``(1, 3, 3)`` or ``(B, 3, 3)``.

    With ``traced``, the outlines, for the gradients of the same masks.
    """

def silhouette_gradients(
    models: list[Model],
    R: NDArray[float64],
    t: NDArray[float64],
    K: NDArray[float64],
    mode: str,
    width: float,
    cutoff: tuple[float, int] | None,
    near: float | None,
    threads: int,
    upstream: NDArray[float32] | NDArray[float64],
    vertices: bool,
    traces: Traces | None,
) -> tuple[NDArray[float64], NDArray[float64], NDArray[float64], list[NDArray[float64]]]:
    """Gradients for ``R``, ``t``, ``K`` ``(B, 3, 3)`` and, if asked for, each model's vertices."""

# -- gbuffer ---------------------------------------------------------------------------------------

_Camera = tuple[float, float, float, float, float, int, int]

def gbuffer(
    meshes: list[Mesh],
    camera: _Camera,
    R: NDArray[float64],
    t: NDArray[float64],
    planes: dict[str, NDArray[Any]],
    normals: str,
    attributes: list[NDArray[float64] | None],
    uv: list[NDArray[float64] | None],
    samples: int,
    near: float | None,
    double: bool,
    threads: int,
) -> None:
    """Write the planes by name, ``(B, H, W, ...)``."""

@final
class Texture:
    """A pyramid of images of sRGB colours, with opacity, which repeats."""

    def __new__(cls, image: NDArray[uint8]) -> Texture: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def mean(self) -> list[float]: ...

@final
class Environment:
    """An environment map, prepared for lighting."""

    def __new__(cls, rgb: NDArray[float32], threads: int) -> Environment: ...
    @property
    def mean(self) -> list[float]: ...
    def scattered(self, normal: list[float]) -> list[float]: ...
    def mirrored(self, direction: list[float], roughness: float) -> list[float]: ...

_Material = tuple[Texture | None, list[float], tuple[float, float] | None]

def colours(
    meshes: list[Mesh],
    camera: _Camera,
    R: NDArray[float64],
    t: NDArray[float64],
    uv: list[NDArray[float64] | None],
    materials: list[list[_Material]],
    of_faces: list[NDArray[uint32] | None],
    lights: list[tuple[Environment, float, list[float]]],
    smooth: bool,
    samples: int,
    near: float | None,
    threads: int,
    out: NDArray[float32],
    shares: NDArray[float32],
    veil: NDArray[float32],
) -> None:
    """Write RGB and coverage ``(B, H, W, 4)``, shares of the meshes, and the veil."""

def srgb_bytes(linear: NDArray[float32]) -> NDArray[uint8]:
    """Bytes of linear values in sRGB, flat."""

def srgb_linear(bytes: NDArray[uint8]) -> NDArray[float32]:
    """Linear values of sRGB bytes, flat."""

def flow(
    meshes: list[Mesh],
    cameras: tuple[_Camera, _Camera],
    R0: NDArray[float64],
    t0: NDArray[float64],
    R1: NDArray[float64],
    t1: NDArray[float64],
    background: tuple[NDArray[float64], NDArray[float64], NDArray[float64]] | None,
    tolerance: float,
    near: float | None,
    double: bool,
    threads: int,
) -> tuple[NDArray[Any], NDArray[uint8]]:
    """Flow ``(B, H, W, 2)`` in pixels and what became of each point ``(B, H, W)``."""

# -- end of gbuffer --------------------------------------------------------------------------------

def mask_loss(
    name: str,
    size: int,
    sigmas: list[float],
    eps: float,
    pred: NDArray[float32] | NDArray[float64],
    target: NDArray[float32] | NDArray[float64],
    gradient: NDArray[float32] | NDArray[float64] | None,
    threads: int,
) -> NDArray[float64]:
    """``(B,)`` losses of ``(B, H, W)`` masks; the gradient for ``pred`` into ``gradient``."""

def scale_images(
    images: NDArray[float32] | NDArray[float64],
    factors: NDArray[float64],
    out: NDArray[float32] | NDArray[float64],
    threads: int,
) -> None:
    """Each image of ``(B, H, W)`` times its number of ``(B,)``."""

def signed_distance(
    target: NDArray[float32] | NDArray[float64],
    out: NDArray[float32] | NDArray[float64],
    threads: int,
) -> None:
    """Pixels to the outlines of ``(B, H, W)`` masks, negative inside."""

@final
class Flight:
    """A flight in our frames, cleaned and cut; ``world_from_body``."""

    @staticmethod
    def read(path: str | os.PathLike[str], options: str) -> Flight:
        """From a file; the options as JSON."""
    def facts(self) -> str:
        """Source, conventions and issues as JSON."""
    def time(self) -> NDArray[float64]:
        """``(N,)`` seconds."""
    def positions(self) -> NDArray[float64]:
        """``(N, 3)`` metres."""
    def quat_wxyz(self) -> NDArray[float64]:
        """``(N, 4)``."""
    def lines(self) -> NDArray[int64]:
        """``(N,)`` lines of the file, from 1."""
    def segments(self) -> NDArray[int64]:
        """``(S, 2)`` first row and row behind the last."""
    def resample(self, rate_hz: float) -> Track:
        """At a steady rate."""

@final
class Track:
    """A flight at a steady rate."""

    def __new__(
        cls, rate_hz: float, positions: NDArray[float64], quat_wxyz: NDArray[float64]
    ) -> Track: ...
    @property
    def rate_hz(self) -> float:
        """Frames a second."""
    def frames(self) -> NDArray[int64]:
        """``(N,)`` numbers of the frames."""
    def positions(self) -> NDArray[float64]:
        """``(N, 3)`` metres."""
    def quat_wxyz(self) -> NDArray[float64]:
        """``(N, 4)``."""
    def lines(self) -> NDArray[int64]:
        """``(N,)`` lines of the file, from 1."""
    def segments(self) -> NDArray[int64]:
        """``(S, 2)`` first frame and frame behind the last."""
    def fit(self, anchors: NDArray[float64], placement: str, how: str) -> str:
        """A placement by the anchors, as JSON."""
    def placed(self, placement: str) -> Track:
        """Carried into a scene."""

@final
class Plan:
    """Samples, and the funnel that led to them."""

    @staticmethod
    def make(
        track: Track, anchors: NDArray[float64], names: list[str], rules: str, threads: int
    ) -> Plan:
        """The rules over a flight."""
    @staticmethod
    def columns() -> list[str]:
        """Names of the columns of numbers."""
    def values(self) -> NDArray[float64]:
        """``(N, C)``."""
    def ids(self) -> list[str]:
        """``N`` ids."""
    def anchors(self) -> list[str]:
        """The names of the anchors of the samples."""
    def funnel(self) -> str:
        """The steps as JSON."""
    def only(self, keep: list[bool]) -> Plan:
        """The samples of which ``keep`` is true."""
    def write(
        self, csv: str | os.PathLike[str], manifest: str | os.PathLike[str], text: str
    ) -> None:
        """The plan and its manifest, both or none."""
    def __len__(self) -> int: ...

def read_anchors(
    path: str | os.PathLike[str], options: str
) -> tuple[list[str], NDArray[float64], str]:
    """Names, ``(A, 3)`` metres, facts as JSON."""

def free_space(
    mesh: Mesh | None,
    low: list[float],
    high: list[float],
    count: int,
    clearance_m: float,
    spacing_m: float,
    seed: int,
    threads: int,
) -> NDArray[float64]:
    """Points in free space, ``(count, 3)`` metres."""

def fly_coins(mesh: Mesh | None, coins: NDArray[float64], pilot: str) -> tuple[Track, str]:
    """A flight through coins ``(N, 3)`` metres, and what happened on it as JSON."""

def synth_defaults() -> str:
    """The settings of flights and rules as JSON."""
