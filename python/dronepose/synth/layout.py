"""Where the files of a rendered data set are: the layout of UAVA, and records of our own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = [
    "MODALITIES",
    "flight_file",
    "image_file",
    "other_folders",
    "record_file",
    "row_folders",
    "row_of",
    "scene_file",
    "scene_files",
    "split_file",
]

MODALITIES = {
    "exocentric": ("colour", "depth", "normal_map", "flow", "silhouette", "matte", "instance"),
    "egocentric": ("colour", "depth", "normal_map", "flow"),
}
"""What a kept sample has of each view, at both times."""


def image_file(
    root: Path, facts: Mapping[str, Any], row: int, step: int, view: str, modality: str
) -> Path:
    """An image of a sample.

    Args:
        root: The data set.
        facts: Of the scene: ``building``, ``drone`` and ``date``.
        row: Of the plan.
        step: 0 or 1, the time.
        view: ``"exocentric"`` or ``"egocentric"``.
        modality: Of :data:`MODALITIES`.

    Example:
        >>> from pathlib import Path
        >>> facts = {"building": "hall", "drone": "x", "date": "d"}
        >>> image_file(Path("data"), facts, 7, 0, "exocentric", "depth").name
        '7_d_0_depth_exocentric_0.png'
    """
    name = f"{row}_{facts['date']}_{step}_{modality}_{view}_0.png"
    return root / str(facts["drone"]) / view / modality / str(facts["building"]) / name


def record_file(root: Path, building: str, row: int) -> Path:
    """The record of a row, its last file."""
    return root / "records" / building / f"{row:06d}.json"


def row_of(stem: str) -> int | None:
    """The row that an image or a record is of, by its name without the suffix; or none.

    Example:
        >>> row_of("7_d_0_depth_exocentric_0"), row_of("000007"), row_of("dataset")
        (7, 7, None)
    """
    number = stem.partition("_")[0]
    return int(number) if number.isascii() and number.isdecimal() else None


def scene_file(root: Path, building: str, suffix: str = ".json") -> Path:
    """What was asked for and made of a scene; with ``.csv`` its records as a table."""
    return root / "scenes" / f"{building}{suffix}"


def scene_files(root: Path) -> list[Path]:
    """What was asked for and made of each scene that is there, by name."""
    return sorted(scene_file(root, "").parent.glob("*.json"))


def split_file(root: Path, split: str) -> Path:
    """The list of a split's scenes."""
    return root / "data splits" / f"scenes_{split}.txt"


def flight_file(root: Path, facts: Mapping[str, Any]) -> Path:
    """The poses of a scene's flight."""
    place = root / "trajectories" / str(facts["building"]) / str(facts["date"])
    return place / "poses_blender.txt"


def row_folders(root: Path, facts: Mapping[str, Any]) -> list[Path]:
    """The folders of a scene's images and records."""
    building = str(facts["building"])
    images = [
        image_file(root, facts, 0, 0, view, modality).parent
        for view, modalities in MODALITIES.items()
        for modality in modalities
    ]
    return [*images, record_file(root, building, 0).parent]


def other_folders(root: Path, facts: Mapping[str, Any]) -> list[Path]:
    """The folders of all else that a scene has."""
    scenes = scene_file(root, str(facts["building"])).parent
    splits = split_file(root, "").parent
    return [root, scenes, flight_file(root, facts).parent, splits]
