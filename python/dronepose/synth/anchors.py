"""Anchors: places in a scene where somebody stood, such as those of a scan's panoramas."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dronepose import _native
from dronepose._arrays import read_only
from dronepose._files import write_text
from dronepose.synth._settings import chosen, encode, vector

if TYPE_CHECKING:
    import os

    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from dronepose.mesh import Mesh

FORMATS = ("auto", "matterport", "csv")


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """Places of a scene. See :func:`read_anchors`.

    Args:
        names: ``A`` names, in the order of the file.
        positions: ``(A, 3)`` metres, world frame (z up, right-handed).
        facts: Source with its SHA-256; how many were left out, how many pairs are at one place.
    """

    names: list[str]
    positions: NDArray[np.float64]
    facts: dict[str, Any]

    def __len__(self) -> int:
        return len(self.names)

    def describe(self) -> str:
        """What was read, in a line for people.

        Returns:
            The text.

        Example:
            >>> from dronepose.synth import write_example
            >>> import tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     anchors = read_anchors(write_example(folder)["anchors"])
            >>> anchors.describe().endswith("12 anchors")
            True
        """
        text = f"{self.facts['source']['path']}: {len(self)} anchors"
        if self.facts["excluded"]:
            text += f", {self.facts['excluded']} left out (included is false)"
        if self.facts["coincident"]:
            text += f", {self.facts['coincident']} pairs at one place"
        return text

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes them as CSV, which :func:`read_anchors` reads.

        Args:
            path: The file; its folder is made if it is not there.

        Returns:
            Nothing.

        Raises:
            OSError: It cannot be written.

        Example:
            >>> import pathlib, tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     path = pathlib.Path(folder) / "anchors.csv"
            ...     sample_free_space((0, 0, 1), (9, 9, 2), 5).write_csv(path)
            ...     len(read_anchors(path))
            5
        """
        lines = ["id,x,y,z"]
        for name, place in zip(self.names, self.positions.tolist(), strict=True):
            quoted = '"' + name.replace('"', '""') + '"' if set(name) & set(',"\r\n') else name
            lines.append(",".join([quoted, *map(repr, place)]))
        write_text(Path(path), "\n".join(lines) + "\n")


def sample_free_space(
    low: ArrayLike,
    high: ArrayLike,
    count: int,
    *,
    mesh: Mesh | None = None,
    clearance_m: float = 0.5,
    spacing_m: float = 1.0,
    seed: int = 0,
    threads: int = 0,
) -> Anchors:
    """Anchors for a scene that has none: points of a box, far enough from its surface.

    Candidates are uniform in the box; one is taken if it is ``clearance_m`` from every triangle and
    ``spacing_m`` from every point before. Outside of a closed scene is as free as inside: the box
    says where to look.

    Args:
        low: ``(3,)`` least corner, metres, world frame.
        high: ``(3,)`` largest corner.
        count: How many.
        mesh: The scene, world frame; ``None`` for an empty one.
        clearance_m: Least distance from the surface.
        spacing_m: Least distance between two.
        seed: Of the draw.
        threads: 0 for one a core; the result does not depend on it.

    Returns:
        The anchors, named ``free-000`` and so on.

    Raises:
        ValueError: The box has no extent, a distance is out of its range, or there is not so much
            room: 1000 candidates are tried for each.

    Example:
        >>> anchors = sample_free_space((0, 0, 1), (9, 9, 2), 20)
        >>> anchors.positions.shape
        (20, 3)
    """
    corners = vector("low", low), vector("high", high)
    for name, value in (("clearance_m", clearance_m), ("spacing_m", spacing_m)):
        if not math.isfinite(value):
            raise ValueError(f"{name}: expected a finite distance, got {value}")
    if count < 1:
        raise ValueError(f"count: expected 1 or more, got {count}")
    native = None if mesh is None else mesh._native
    found = _native.free_space(
        native, *corners, count, float(clearance_m), float(spacing_m), seed, threads
    )
    facts = {
        "source": {"path": "free space"},
        "anchors": count,
        "excluded": 0,
        "coincident": 0,
        "seed": seed,
    }
    return Anchors([f"free-{k:03d}" for k in range(count)], read_only(found), facts)


def read_anchors(
    path: str | os.PathLike[str],
    *,
    format: Literal["auto", "matterport", "csv"] = "auto",
    include_excluded: bool = False,
) -> Anchors:
    """Anchors from a file.

    Args:
        path: Matterport3D's ``SCAN_connectivity.json`` (``pose`` is ``world_from_cam``, row by row,
            metres, z up), or CSV with ``x,y,z`` and perhaps ``id``; perhaps gzipped; ``-`` for
            standard input.
        format: Which of the two; ``auto`` looks at the first character.
        include_excluded: Whether viewpoints whose ``included`` is false count.

    Returns:
        The anchors.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no such file; the message names line and column, or the entry.

    Example:
        >>> from dronepose.synth import write_example
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     anchors = read_anchors(write_example(folder)["anchors"])
        >>> anchors.positions.shape
        (12, 3)
    """
    options = {"format": chosen("format", format, FORMATS), "all": bool(include_excluded)}
    names, positions, facts = _native.read_anchors(path, encode(options))
    return Anchors(names, read_only(positions), json.loads(facts))
