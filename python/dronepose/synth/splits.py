"""Splits by scene that cannot leak: a scene is in one split or in none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Mapping

SPLITS = ("train", "val", "test")


@dataclass(frozen=True, slots=True)
class SceneSplits:
    """Which scenes belong to which split; refuses a scene in two.

    Args:
        scenes: Names of scenes by split.

    Raises:
        ValueError: A scene is in two splits, or twice in one; the message names it and both.

    Example:
        >>> SceneSplits({"train": ["a", "b"], "test": ["c"]}).split_of("c")
        'test'
    """

    scenes: Mapping[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        check_splits(self.scenes)

    def split_of(self, scene: str) -> str:
        """The split of a scene.

        Args:
            scene: Its name.

        Returns:
            The name of the split.

        Raises:
            ValueError: It is in none.

        Example:
            >>> SceneSplits({"train": ("a",)}).split_of("a")
            'train'
        """
        for split, names in self.scenes.items():
            if scene in names:
                return split
        raise ValueError(f"scene: {scene!r} is in none of the splits {', '.join(self.scenes)}")


def check_splits(
    scenes: Mapping[str, Iterable[str]], places: Mapping[tuple[str, int], str] | None = None
) -> None:
    """Refuse a scene that is in two splits: what is learned in one would be known in the other.

    Args:
        scenes: Names of scenes by split.
        places: ``FILE:LINE`` of the names by split and index, for the message.

    Returns:
        Nothing.

    Raises:
        ValueError: A scene is in two splits, or twice in one; the message names it and both.

    Example:
        >>> check_splits({"train": ["a"], "test": ["b", "a"]})
        Traceback (most recent call last):
        ValueError: test[1]: the scene 'a' is in train[0] too; a scene belongs to one split
    """
    seen: dict[str, str] = {}
    for split, names in scenes.items():
        for index, name in enumerate(names):
            place = f"{split}[{index}]"
            if places is not None:
                place = places[split, index]
            if name in seen:
                raise ValueError(
                    f"{place}: the scene {name!r} is in {seen[name]} too; a scene belongs to one "
                    "split"
                )
            seen[name] = place


def read_splits(folder: str | os.PathLike[str]) -> SceneSplits:
    """The splits of a folder with ``scenes_train.txt``, ``scenes_val.txt``, ``scenes_test.txt``.

    Args:
        folder: Where the lists are, a scene a line; a list may be absent, but not all.

    Returns:
        The splits.

    Raises:
        OSError: There is no list, or one cannot be read.
        ValueError: A scene is in two splits, or twice in one; the message names both lines.

    Example:
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as name:
        ...     for split, scene in (("train", "a"), ("test", "b")):
        ...         _ = (pathlib.Path(name) / f"scenes_{split}.txt").write_text(scene)
        ...     read_splits(name).split_of("b")
        'test'
    """
    scenes: dict[str, tuple[str, ...]] = {}
    places: dict[tuple[str, int], str] = {}
    for split in SPLITS:
        path = Path(folder) / f"scenes_{split}.txt"
        if not path.is_file():
            continue
        names: list[str] = []
        for line, text in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
            if name := text.strip():
                places[split, len(names)] = f"{path}:{line}"
                names.append(name)
        scenes[split] = tuple(names)
    if not scenes:
        raise FileNotFoundError(f"{folder}: expected scenes_train.txt, scenes_val.txt or _test.txt")
    check_splits(scenes, places)
    return SceneSplits(scenes)
