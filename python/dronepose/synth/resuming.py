"""How far a rendered data set is, what a kill has left in it, and what a full disk says."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dronepose._files import sweep
from dronepose.synth.layout import other_folders, record_file, row_folders, row_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

__all__ = ["difference", "room", "rows_there", "tidy"]

_LATER = "licences"
"""What may be stated later, on whatever level of a manifest."""


def difference(wanted: Any, found: Any) -> tuple[list[str], Any, Any] | None:
    """Where two trees of JSON differ first, licences aside.

    Args:
        wanted: One.
        found: The other.

    Returns:
        The names and places in lists that lead there, and both values; ``None`` if they are equal.

    Example:
        >>> difference({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}], "licences": {}})
        (['a', '1', 'b'], 2, 3)
    """
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        wanted, found = (
            dict(zip(map(str, range(len(of))), of, strict=True)) for of in (wanted, found)
        )
    if not (isinstance(wanted, dict) and isinstance(found, dict)):
        return None if wanted == found else ([], wanted, found)
    for name in [*wanted, *(name for name in found if name not in wanted)]:
        inner = difference(wanted.get(name), found.get(name)) if name != _LATER else None
        if inner is not None:
            return [name, *inner[0]], inner[1], inner[2]
    return None


def rows_there(root: Path, building: str) -> set[int]:
    """The rows that are done: those that have a record.

    Args:
        root: The data set.
        building: The scene.
    """
    folder = record_file(root, building, 0).parent
    names = os.listdir(folder) if folder.is_dir() else []  # noqa: PTH208 - names alone
    stems = (name.removesuffix(".json") for name in names if name.endswith(".json"))
    return {row for row in map(row_of, stems) if row is not None}


def tidy(root: Path, facts: Mapping[str, Any], rows: Collection[int] = ()) -> None:
    """Sweep what killed runs have left.

    Args:
        root: The data set.
        facts: Of the scene: ``building``, ``drone`` and ``date``.
        rows: Rows that are done: what is left of these goes, whoever wrote it.

    Raises:
        OSError: A file cannot be removed.
    """
    done = set(rows)
    for folder in row_folders(root, facts):
        sweep(folder, lambda stem: row_of(stem) in done)
    for folder in other_folders(root, facts):
        sweep(folder)


@contextmanager
def room(root: Path, building: str, rows: Collection[int]) -> Iterator[None]:
    """Says of a full disk how far the work is, and that it goes on.

    Args:
        root: The data set.
        building: The scene.
        rows: Those that are worked on.

    Raises:
        OSError: As within, and with other words if the disk, or the user's share of it, is full.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        done = len(rows_there(root, building).intersection(rows))
        full = OSError(
            f"{root}: no space is left on the disk; {done} of {len(rows)} rows are done and whole: "
            "make room, and the same command goes on from there"
        )
        full.errno = error.errno
        raise full from error
