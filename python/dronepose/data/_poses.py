"""Poses in CSV, as ``docs/formats.md`` has them, and what makes a pose impossible."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dronepose import geometry
from dronepose.data._errors import DataError, read_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_QUATERNION = ("qw", "qx", "qy", "qz")
_MATRIX = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
_VECTOR = ("rx", "ry", "rz")
_TRANSLATION = ("tx", "ty", "tz")
TOLERANCE = 1e-2
"""How far a rotation may be from orthonormal, and a quaternion from norm 1."""


@dataclass(frozen=True, slots=True)
class PoseRow:
    """One row of a file of poses.

    Args:
        name: Its id.
        line: Where it ends in the file, from 1.
        R: ``(3, 3)`` float64, rotation of ``cam_from_model``.
        t: ``(3,)`` float64, translation of ``cam_from_model``, metres.
        further: The other columns, as text.
    """

    name: str
    line: int
    R: Array
    t: Array
    further: dict[str, str]


def check_pose(R: Array, t: Array, place: str) -> Array:
    """The nearest rotation to ``R``.

    Args:
        R: ``(3, 3)`` rotation of ``cam_from_model``, off by at most :data:`TOLERANCE`.
        t: ``(3,)`` metres.
        place: File, line and sample, for messages.

    Raises:
        DataError: A value is not finite, ``R`` is no rotation, or the model's origin is not in
            front of the camera.
    """
    if not np.isfinite(R).all() or not np.isfinite(t).all():
        raise DataError(f"{place}: the pose is not finite: R {R.tolist()}, t {t.tolist()}")
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > TOLERANCE or np.linalg.det(R) < 0:
        raise DataError(
            f"{place}: not a rotation: R R^T is off by {off:.3g} (at most {TOLERANCE}), "
            f"the determinant is {np.linalg.det(R):.3g} (expected 1)"
        )
    if t[2] <= 0:
        raise DataError(
            f"{place}: the model is behind the camera: z = {t[2]:g} m, expected above 0 "
            "(OpenCV axes: z forward)"
        )
    if off < 1e-14:
        return R
    u, _, v = np.linalg.svd(R)
    nearest: Array = u @ v
    return nearest


def number(text: str, place: str, column: str) -> float:
    """A finite decimal number.

    Raises:
        DataError: ``text`` is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise DataError(f"{place}: column {column}: found {text!r}, expected a finite number")
    return value


def read_poses(path: Path) -> list[PoseRow]:
    """The rows of a file of poses, checked.

    Args:
        path: CSV with a header: ``id``, a rotation as quaternion, matrix or vector, ``tx,ty,tz``.

    Returns:
        One for each row, in their order.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: A column is missing, an id occurs twice, or a value or pose is wrong.
    """
    text = read_text(path, "a CSV file of poses")
    reader = csv.reader(io.StringIO(text, newline=""))
    header = [name.strip() for name in next(reader, [])]
    forms = (_QUATERNION, _MATRIX, _VECTOR)
    form = next((names for names in forms if set(names) <= set(header)), None)
    absent = [name for name in ("id", *_TRANSLATION) if name not in header]
    if form is None or absent:
        wanted = "qw,qx,qy,qz or r11,...,r33 or rx,ry,rz" if form is None else ",".join(absent)
        raise DataError(f"{path}:1: the header has no {wanted}: found {','.join(header)!r}")
    found: list[PoseRow] = []
    seen: dict[str, int] = {}
    try:
        for cells in reader:
            if not any(cells):
                continue
            line = reader.line_num
            if len(cells) != len(header):
                raise DataError(
                    f"{path}:{line}: found {len(cells)} columns, expected {len(header)}"
                )
            row = dict(zip(header, cells, strict=True))
            name = row["id"].strip()
            if not name or name in seen:
                again = f"{name!r} again, first in line {seen[name]}" if name else "an empty id"
                raise DataError(f"{path}:{line}: column id: found {again}")
            seen[name] = line
            found.append(_row(row, form, f"{path}:{line}", name, line))
    except csv.Error as error:
        raise DataError(f"{path}:{reader.line_num}: {error}") from None
    return found


def _row(row: dict[str, str], form: tuple[str, ...], file: str, name: str, line: int) -> PoseRow:
    place = f"{file}: sample {name!r}"
    values = np.array([number(row[column], place, column) for column in form])
    t = np.array([number(row[column], place, column) for column in _TRANSLATION])
    if form is _QUATERNION:
        norm = float(np.linalg.norm(values))
        if abs(norm - 1) > TOLERANCE:
            raise DataError(f"{place}: column qw: a quaternion of norm {norm:.4g}, expected 1")
        R = geometry.matrix_from_quat_wxyz(values)
    elif form is _VECTOR:
        R = geometry.matrix_from_axis_angle(values)
    else:
        R = values.reshape(3, 3)
    further = {k: v for k, v in row.items() if k not in (*form, *_TRANSLATION, "id")}
    return PoseRow(name, line, check_pose(R, t, place), t, further)


def poses_csv(
    names: Sequence[str],
    R: Array,
    t: Array,
    *,
    form: str = "",
    further: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Poses as CSV with quaternions, as :func:`read_poses` and ``dronepose-eval`` read them.

    Args:
        names: ``N`` ids, for the column ``id``.
        R: ``(N, 3, 3)``, rotations of ``cam_from_model``.
        t: ``(N, 3)``, translations of ``cam_from_model``, metres.
        form: How a number is written, as :func:`format` takes it, such as ``".9f"``; by default
            the shortest text that is read as the same number.
        further: More columns, ``N`` texts each by their name.

    Returns:
        The text: ``id,qw,qx,qy,qz,tx,ty,tz`` and the further columns; cells are quoted where they
        need it (RFC 4180), lines end with a line feed.

    Raises:
        ValueError: The lengths differ, ``R`` holds no rotations, or ``form`` is none.

    Example:
        >>> poses_csv(["a"], np.eye(3)[None], np.array([[0.5, 0, 2]]), form=".3g").splitlines()[1]
        'a,1,0,0,0,0.5,0,2'
    """
    columns = further or {}
    lines = [["id", *_QUATERNION, *_TRANSLATION, *columns]]
    quaternions = geometry.quat_wxyz_from_matrix(R)
    for name, q, p, *more in zip(names, quaternions, t, *columns.values(), strict=True):
        lines.append([name, *(format(float(value), form) for value in (*q, *p)), *more])
    return "".join(",".join(map(_cell, line)) + "\n" for line in lines)


def _cell(text: str) -> str:
    """A cell of a CSV file: in quotes if it would not be read as one cell without them."""
    if set(text) & set(',"\r\n'):
        doubled = text.replace('"', '""')
        return f'"{doubled}"'
    return text
