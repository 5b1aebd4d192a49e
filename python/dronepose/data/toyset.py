"""A small synthetic data set: the drone, lit at random, before drawn or photographed backgrounds.

Each sample is made from ``(seed, split, number)`` alone, so that a run can be stopped and resumed,
split among processes, and any sample made again.

**Poses.** The distance to the model's origin is uniform in ``distance``; its place in the image is
uniform in the middle ``spread`` along both sides; with its default of 84 % the drone is always at
least partly in view. Yaw is uniform; the tilt from upright is the absolute value of a normal
distribution of ``max_tilt_deg/2``, cut at ``max_tilt_deg``, in a direction that is uniform; the
camera looks up or down by at most ``max_pitch_deg`` (uniform) and is rolled by a normal
distribution of 3 degrees.
"""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np

from dronepose import _native
from dronepose._files import write_bytes
from dronepose.camera import Camera
from dronepose.data._errors import DataError
from dronepose.data._images import write_png
from dronepose.data._manifest import CONVENTIONS, FORMAT, SPLITS
from dronepose.data._poses import poses_csv
from dronepose.data._shading import Light, Model, drawn, painted
from dronepose.data.backgrounds import Photographs, procedural
from dronepose.geometry import matrix_from_axis_angle
from dronepose.mesh import Mesh, obj_text

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Background = Callable[[int, int, np.random.Generator], NDArray[np.float32]]

EXAMPLE_MESH = Path(__file__).with_name("quadrotor.obj")
"""The project's quadrotor, the same file as ``examples/quadrotor.obj``."""


@dataclass(frozen=True, slots=True)
class ToySettings:
    """What a toy data set looks like.

    Args:
        height: Rows of the images, 16 to 4096.
        width: Columns of the images, 16 to 4096.
        seed: Of everything, at least 0.
        distance: Smallest and largest distance of the drone, metres.
        spread: Share of the image, along both sides about its middle, in which the model's origin
            is, 0 to 1.
        max_tilt_deg: Largest tilt from upright, 0 to 180 degrees.
        max_pitch_deg: Largest angle by which the camera looks up or down, 0 to 89 degrees.
        horizontal_deg: Field of view, degrees; the default is that of UAVA's exocentric camera.
        up: Axis of the mesh that points up: ``"z"`` (x forward) or ``"y"`` (z forward).
        backgrounds: ``"procedural"``, or a folder of images and panoramas.

    Raises:
        ValueError: A value is out of its range; the message starts with its name.

    Example:
        >>> round(ToySettings(height=60, width=80).camera.fx, 3)
        63.164
    """

    height: int = 120
    width: int = 160
    seed: int = 0
    distance: tuple[float, float] = (0.8, 3.0)
    spread: float = 0.84
    max_tilt_deg: float = 25.0
    max_pitch_deg: float = 20.0
    horizontal_deg: float = 64.69
    up: Literal["y", "z"] = "z"
    backgrounds: str = "procedural"

    def __post_init__(self) -> None:
        for name in ("height", "width"):
            if not 16 <= getattr(self, name) <= 4096:
                raise ValueError(f"{name}: expected 16 to 4096 pixels, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed: expected a whole number >= 0, got {self.seed}")
        near, far = self.distance
        if not 0 < near <= far < 1e6:
            raise ValueError(f"distance: expected 0 < nearest <= farthest, got {self.distance}")
        for name, most in (("spread", 1), ("max_tilt_deg", 180), ("max_pitch_deg", 89)):
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected 0 to {most}, got {getattr(self, name)}")
        if self.up not in ("y", "z"):
            raise ValueError(f"up: expected 'y' or 'z', got {self.up!r}")
        _ = self.camera

    @property
    def camera(self) -> Camera:
        """The camera of all images: square pixels, principal point in the middle.

        Example:
            >>> ToySettings().camera.cx
            80.0
        """
        return Camera.from_fov(self.width, self.height, horizontal_deg=self.horizontal_deg)


def toy_pose(settings: ToySettings, generator: np.random.Generator) -> tuple[Array, Array, Array]:
    """A pose of the distribution that the module states.

    Args:
        settings: Camera and limits.
        generator: Where all randomness comes from.

    Returns:
        ``R`` ``(3, 3)`` and ``t`` ``(3,)`` of ``cam_from_model``, metres, and up in the world,
        ``(3,)``, camera frame; all float64.

    Raises:
        AttributeError: ``settings`` are none.

    Example:
        >>> R, t, up = toy_pose(ToySettings(), np.random.default_rng(0))
        >>> bool(0.8 <= np.linalg.norm(t) <= 3.0), bool(np.allclose(R @ R.T, np.eye(3)))
        (True, True)
    """
    camera = settings.camera
    pitch = np.radians(generator.uniform(-1, 1) * settings.max_pitch_deg)
    roll = np.radians(generator.normal(0, 3))
    yaw = generator.uniform(0, 2 * np.pi)
    tilt = generator.normal(0, settings.max_tilt_deg / 2)
    tilt = np.radians(min(abs(tilt), settings.max_tilt_deg))
    about = generator.uniform(0, 2 * np.pi)
    up = np.array([0.0, -np.cos(pitch), -np.sin(pitch)])
    ahead = np.array([0.0, -np.sin(pitch), np.cos(pitch)])
    right = np.array([1.0, 0.0, 0.0])
    forward = np.cos(yaw) * ahead + np.sin(yaw) * right
    left = np.cross(up, forward)
    axes = [forward, left, up] if settings.up == "z" else [left, up, forward]
    level = np.stack(axes, axis=1)
    rolled = matrix_from_axis_angle([0.0, 0.0, roll])
    tilted = matrix_from_axis_angle(tilt * (np.cos(about) * right + np.sin(about) * ahead))
    R = rolled @ (tilted @ level)
    low, high = 0.5 - settings.spread / 2, 0.5 + settings.spread / 2
    u = camera.width * generator.uniform(low, high)
    v = camera.height * generator.uniform(low, high)
    ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
    t = ray / np.linalg.norm(ray) * generator.uniform(*settings.distance)
    return R, t, rolled @ up


def _generators(seed: int, split: str, number: int) -> tuple[np.random.Generator, ...]:
    """Of the pose and of the picture of a sample: poses come without pixels."""
    place = SPLITS.index(split)
    return tuple(np.random.default_rng([seed, place, number, part]) for part in (0, 1))


@dataclass(slots=True)
class _Studio:
    """What all samples of a data set share."""

    settings: ToySettings
    model: Model
    background: Background = field(init=False)

    def __post_init__(self) -> None:
        self.background = procedural
        if self.settings.backgrounds != "procedural":
            self.background = Photographs(self.settings.backgrounds, self.settings.horizontal_deg)

    def sample(self, split: str, number: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Image ``(H, W, 3)`` and mask ``(H, W)``, uint8."""
        settings = self.settings
        of_pose, of_picture = _generators(settings.seed, split, number)
        R, t, up = toy_pose(settings, of_pose)
        behind = self.background(settings.height, settings.width, of_picture)
        light = _light(behind, up, of_picture)
        tint = of_picture.uniform(0.75, 1.3) * of_picture.uniform(0.93, 1.07, 3)
        colour, mask = drawn(
            self.model,
            settings.camera,
            R,
            t,
            light,
            tint=tint,
            normals="flat" if of_picture.random() < 0.3 else "smooth-angle",
        )
        picture = behind + mask[..., None] * (colour - behind)
        image = _sensor(picture.astype(np.float32), of_picture)
        return image, np.round(mask * 255).astype(np.uint8)


def _light(behind: NDArray[np.float32], up: Array, generator: np.random.Generator) -> Light:
    """A lamp somewhere above, and ambient light of the colours of the background."""
    middle = len(behind) // 2
    above = behind[:middle].mean(axis=(0, 1)).astype(np.float64)
    below = behind[middle:].mean(axis=(0, 1)).astype(np.float64)
    side = generator.normal(size=3)
    side -= (side @ up) * up
    side /= max(float(np.linalg.norm(side)), 1e-9)
    height = np.radians(generator.uniform(15, 85))
    strength = generator.uniform(0.25, 1.1)
    warmth = generator.uniform(-0.12, 0.12)
    return Light(
        direction=np.cos(height) * side + np.sin(height) * up,
        up=up,
        lamp=strength * np.array([1 + warmth, 1.0, 1 - warmth]),
        sky=generator.uniform(0.5, 1.0) * (0.35 + 0.65 * above),
        ground=generator.uniform(0.25, 0.7) * (0.15 + 0.85 * below),
        gloss=generator.uniform(0.0, 0.45),
        shine=generator.uniform(8, 80),
    )


def _sensor(picture: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.uint8]:
    """Blur of the lens, vignette, gain, shot and read noise, eight bits."""
    height, width = picture.shape[:2]
    blur = generator.uniform(0.0, 0.7) * max(height / 120, 0.7)
    if blur > 0.2:
        picture = cv2.GaussianBlur(picture, (0, 0), blur).astype(np.float32)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    radius = ((2 * x / width - 1) ** 2 + (2 * y / height - 1) ** 2)[..., None]
    picture = picture * (1 - np.float32(generator.uniform(0, 0.12)) * radius)
    picture = picture * np.float32(generator.uniform(0.85, 1.12))
    spread = np.sqrt(generator.uniform(0, 0.0006) * np.clip(picture, 0, 1) + 0.004**2)
    picture = picture + spread * generator.standard_normal(picture.shape, dtype=np.float32)
    eight: NDArray[np.uint8] = np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)
    return eight


def render_toy_sample(
    settings: ToySettings, split: str, number: int, mesh: Mesh | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], Array, Array]:
    """One sample of a toy data set, as :func:`write_toyset` writes it.

    Args:
        settings: What it looks like.
        split: ``"train"``, ``"val"`` or ``"test"``.
        number: Which, from 0.
        mesh: The drone, metres; ``None`` is the project's quadrotor.

    Returns:
        Image ``(H, W, 3)`` uint8 RGB, mask ``(H, W)`` uint8, and ``R`` ``(3, 3)`` and ``t``
        ``(3,)`` float64 of ``cam_from_model``, metres.

    Raises:
        ValueError: The split is unknown.
        DataError: The backgrounds cannot be read.

    Example:
        >>> image, mask, R, t = render_toy_sample(ToySettings(), "train", 0)
        >>> image.shape, bool(mask.any())
        ((120, 160, 3), True)
    """
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    mesh = Mesh.from_file(EXAMPLE_MESH) if mesh is None else mesh
    studio = _Studio(settings, painted(mesh, settings.up))
    R, t, _ = toy_pose(settings, _generators(settings.seed, split, number)[0])
    return (*studio.sample(split, number), R, t)


def write_toyset(
    root: str | os.PathLike[str],
    *,
    counts: Mapping[str, int] | None = None,
    mesh: str | os.PathLike[str] | Mesh | None = None,
    settings: ToySettings | None = None,
    shard: tuple[int, int] = (0, 1),
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Write a toy data set, or what is missing of it, in the layout of :class:`FolderDataset`.

    Every file is written whole or not at all. A run that was stopped is taken up where it was by
    calling it once more with the same settings; other settings are refused.

    Args:
        root: The folder; made if it is not there.
        counts: Samples of each of ``"train"``, ``"val"``, ``"test"``; 80, 10 and 10 if absent.
        mesh: The drone, a file in metres or a :class:`dronepose.Mesh`; ``None`` is the project's
            quadrotor.
        settings: What it looks like, or
        options: its fields, such as ``height``, ``width``, ``seed``, ``distance``,
            ``max_tilt_deg``, ``backgrounds``.
        shard: ``(k, n)`` makes every n-th sample from the k-th on; the shard that finds all files
            there finishes the data set.
        progress: Called with the number of samples that are there and of all.

    Returns:
        ``dataset.json``, and under ``"written"`` how many samples this call made.

    Raises:
        TypeError: An option is unknown.
        ValueError: A setting or a count is out of range.
        DataError: The folder holds a data set of other settings.
        OSError: A file cannot be written.

    Example:
        >>> made = write_toyset("toy", counts={"train": 80}, seed=1)  # doctest: +SKIP
    """
    if settings is None:
        settings = ToySettings(**options)
    elif options:
        raise TypeError(f"settings: expected no further options, got {', '.join(options)}")
    numbers = _counts({"train": 80, "val": 10, "test": 10} if counts is None else counts)
    k, n = shard
    if not 0 <= k < n:
        raise ValueError(f"shard: expected (k, n) with 0 <= k < n, got {shard}")
    root = Path(root)
    drone, content = _mesh(mesh)
    radius = float(np.linalg.norm(drone.vertices, axis=1).max())
    if settings.distance[0] <= radius:
        raise ValueError(
            f"distance: expected more than {radius:.3g} m, the reach of the drone about its "
            f"origin, got {settings.distance[0]}"
        )
    studio = _Studio(settings, painted(drone, settings.up))
    manifest = _manifest(settings, numbers, content)
    if isinstance(studio.background, Photographs):
        manifest["backgrounds"] = studio.background.hashes()
    _begin(root, manifest, content)
    total, there, written = sum(numbers.values()), 0, 0
    for split, count in numbers.items():
        images, masks = root / split / "images", root / split / "masks"
        for folder in (images, masks):
            folder.mkdir(parents=True, exist_ok=True)
        for number in range(count):
            file = f"{number:06d}.png"
            if number % n == k and not (images / file).exists():
                image, mask = studio.sample(split, number)
                write_png(masks / file, mask)  # first: where the image is, the mask is too
                write_png(images / file, image)
                written += 1
            there += 1
            if progress is not None:
                progress(there, total)
        write_bytes(root / split / "poses.csv", _poses(settings, split, count).encode())
    if n == 1 or _all_there(root, numbers):
        manifest["complete"] = True
        _write_json(root / "dataset.json", manifest)
    return {**manifest, "written": written}


def _counts(counts: Mapping[str, int]) -> dict[str, int]:
    for split, count in counts.items():
        if split not in SPLITS:
            raise ValueError(f"counts: expected {', '.join(SPLITS)}, got {split!r}")
        if not 0 <= count <= 1_000_000:
            raise ValueError(f"counts: expected 0 to 1000000 samples of {split}, got {count}")
    return {split: int(counts[split]) for split in SPLITS if counts.get(split, 0) > 0}


def _mesh(mesh: str | os.PathLike[str] | Mesh | None) -> tuple[Mesh, bytes]:
    """The drone and its OBJ file; an OBJ file that is given is taken as it is."""
    if not isinstance(mesh, Mesh):
        path = EXAMPLE_MESH if mesh is None else Path(mesh)
        mesh = Mesh.from_file(path)
        if path.suffix.lower() == ".obj":
            return mesh, path.read_bytes()
    return mesh, obj_text(mesh.vertices, mesh.faces, "metres").encode()


def _manifest(settings: ToySettings, counts: dict[str, int], mesh: bytes) -> dict[str, Any]:
    camera = asdict(settings.camera)
    made = {
        "format": FORMAT,
        "complete": False,
        "made_by": "dronepose toyset",
        "versions": {
            "dronepose": _native.__version__,
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "python": platform.python_version(),
        },
        "seed": settings.seed,
        "settings": asdict(settings),
        "splits": counts,
        "camera": camera,
        "conventions": CONVENTIONS,
        "mesh": {"file": "mesh.obj", "unit": "m", "sha256": hashlib.sha256(mesh).hexdigest()},
    }
    plain: dict[str, Any] = json.loads(json.dumps(made))
    return plain


def _begin(root: Path, manifest: dict[str, Any], mesh: bytes) -> None:
    """Make the folder, or make sure that what it holds is of the same settings."""
    path = root / "dataset.json"
    # Looked at first: another shard may begin between the two, and begins with dataset.json.
    full = root.exists() and any(not file.name.startswith(".") for file in root.iterdir())
    if path.exists():
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise DataError(f"{path}: no JSON: {error}") from None
        for key in ("format", "settings", "splits", "mesh", "backgrounds"):
            if before.get(key) != manifest.get(key):
                raise DataError(
                    f"{path}: holds a data set of other {key}: {before.get(key)}, "
                    f"asked for {manifest.get(key)}; choose another folder, or remove this one"
                )
    elif full:
        raise DataError(f"{root}: is not empty and holds no data set; choose another folder")
    root.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        _write_json(path, manifest)
    write_bytes(root / "mesh.obj", mesh)
    _write_json(root / "camera.json", manifest["camera"])


def _write_json(path: Path, content: Any) -> None:
    write_bytes(path, (json.dumps(content, indent=2) + "\n").encode())


def _poses(settings: ToySettings, split: str, count: int) -> str:
    poses = [
        toy_pose(settings, _generators(settings.seed, split, number)[0]) for number in range(count)
    ]
    return poses_csv(
        [f"{split}-{number:06d}" for number in range(count)],
        np.array([R for R, _, _ in poses]),
        np.array([t for _, t, _ in poses]),
        form=".12g",
        further={"image": [f"{number:06d}.png" for number in range(count)]},
    )


def _all_there(root: Path, counts: dict[str, int]) -> bool:
    return all(
        (root / split / "images" / f"{number:06d}.png").exists()
        for split, count in counts.items()
        for number in range(count)
    )
