"""Score poses as ``dronepose-eval`` does, from files or from arrays, with the same numbers."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose._arrays import floats
from dronepose.camera import Camera
from dronepose.mesh import Mesh
from dronepose.results import (
    SCHEMA,
    Auc,
    Authors,
    Bop,
    Breakdown,
    Comparison,
    Difference,
    Evaluation,
    Group,
    InputFile,
    Inputs,
    Interval,
    Intervals,
    Metrics,
    Recall,
    ReferenceRecall,
    Settings,
    Speed,
    SpeedPlus,
    Summary,
    WorstSample,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Poses = (
        str
        | os.PathLike[str]
        | Mapping[str, Any]
        | tuple[ArrayLike, ArrayLike]
        | tuple[ArrayLike, ArrayLike, Sequence[Any]]
    )
    _NativePoses = str | tuple[NDArray[np.float64], NDArray[np.float64], list[str]]

__all__ = [
    "SCHEMA",
    "Auc",
    "Authors",
    "Bop",
    "Breakdown",
    "Comparison",
    "Difference",
    "Evaluation",
    "Group",
    "InputFile",
    "Inputs",
    "Interval",
    "Intervals",
    "Metrics",
    "Recall",
    "ReferenceRecall",
    "Settings",
    "Speed",
    "SpeedPlus",
    "Summary",
    "WorstSample",
    "evaluate",
]


def evaluate(
    predictions: Poses,
    gt: Poses,
    *,
    mesh: str | os.PathLike[str] | Mesh | None = None,
    mesh_unit: Literal["m", "cm", "mm"] | None = None,
    unit: Literal["m", "mm"] | None = None,
    add_reference: Literal["bbox-diagonal", "diameter"] | float | None = None,
    symmetries: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    camera: Camera | str | os.PathLike[str] | None = None,
    acc: Sequence[float] = (2, 5, 10),
    add: Sequence[float] = (2, 5, 10),
    metrics: Literal["auto", "all"] | Sequence[str] = "auto",
    preset: Literal["paper", "authors", "bop", "speedplus"] = "paper",
    batch_size: int = 8,
    objects: Sequence[int] = (),
    by: Sequence[str] = (),
    up: Literal["y", "z"] = "z",
    bootstrap: int | None = None,
    seed: int = 0,
    threads: int = 0,
    strict: bool = False,
    compare: Sequence[str | os.PathLike[str]] = (),
) -> Evaluation:
    """Score predicted poses against ground truth, joined by id.

    Means are over the poses with a prediction; recalls and areas count a missing prediction as
    wrong. By default the metrics of DronePose (Albanis et al., ECCV Workshops 2020), section 5; the
    functions of :mod:`dronepose.metrics` cite the source of each.

    Args:
        predictions: A file (CSV, BOP results CSV, BOP ``scene_gt.json``, SPEED CSV or JSON), or
            arrays: a tuple ``(R, t)`` or ``(R, t, ids)``, or a mapping with these keys. ``R`` is
            ``(N, 3, 3)`` and ``t`` is ``(N, 3)``, float32 or float64, ``cam_from_model`` in the
            OpenCV camera frame; without ``ids`` the row number is the id.
        gt: The ground truth, in the same forms.
        mesh: The model, for ADD, ADD-S, MSSD, MSPD and the projection error: a :class:`Mesh`, a
            mesh file, or the ``models`` folder of a BOP data set.
        mesh_unit: Unit of a mesh given as a path; by default metres, and millimetres for a BOP
            folder. A :class:`Mesh` is in metres.
        unit: Unit of the translations; by default that of the format, metres for arrays.
        add_reference: What the percentages of ``add`` refer to: the diagonal of the bounding box
            (the paper), the diameter (BOP), or a length in metres (the authors' code: 0.354); by
            default that of ``preset``.
        symmetries: A file in the form of BOP's ``models_info.json``, or the entry of the object.
        camera: A :class:`Camera` or a camera file, for MSPD and the projection error.
        acc: X of AccX: below X degrees and X centimetres.
        add: k of 6D Pose-k: ADD below k percent of the reference.
        metrics: Metrics over vertices: some of ``"add"``, ``"adds"``, ``"mssd"``, ``"mspd"`` and
            ``"proj"``; ``"all"``; or ``"auto"``, which leaves ADD-S out where it would take long.
        preset: ``"paper"``; ``"authors"`` (0.354 m, and the batch means that their script prints);
            ``"bop"`` (the diameter); ``"speedplus"``.
        batch_size: Batch size of the authors preset.
        objects: Score only these objects of BOP files; all if empty.
        by: Breakdowns: ``"distance"``, ``"azimuth"``, ``"elevation"`` or a column of the ground
            truth.
        up: The model's up axis, which azimuth and elevation refer to.
        bootstrap: Resamples for 95 % confidence intervals; ``None`` for 1000 up to 50,000 samples
            and none above.
        seed: Seed of the resampling.
        threads: 0 uses all cores. The result does not depend on it.
        strict: Turn every warning into an error.
        compare: Files with the predictions of other methods for the same ground truth.

    Returns:
        All numbers, with the settings that led to them; units are in the names.

    Raises:
        ValueError: An input was refused; the message says where, what was found and what was
            expected.
        OSError: A file cannot be read.
        TypeError: An argument has the wrong type.

    Example:
        >>> from dronepose import evaluate
        >>> predictions, gt = "examples/predictions.csv", "examples/gt.csv"
        >>> result = evaluate(predictions, gt, mesh="examples/quadrotor.obj", bootstrap=0)
        >>> result.n_gt, result.n_matched
        (2000, 1937)
        >>> round(result.metrics.npe.mean, 4), result.metrics.add_recall.at["10"].count
        (0.0199, 1818)
        >>> print(result.table())  # doctest: +SKIP
    """
    options = [
        f"--acc={_numbers('acc', acc)}",
        f"--add={_numbers('add', add)}",
        f"--metrics={metrics if isinstance(metrics, str) else ','.join(metrics)}",
        f"--preset={preset}",
        f"--batch-size={batch_size}",
        f"--up={up}",
        f"--seed={seed}",
        f"--threads={threads}",
    ]
    if add_reference is not None:
        options.append(f"--add-reference={_number_or_word(add_reference)}")
    if unit is not None:
        options.append(f"--unit={unit}")
    if bootstrap is not None:
        options.append(f"--bootstrap={bootstrap}")
    if strict:
        options.append("--strict")
    if isinstance(by, str):
        by = (by,)
    if isinstance(compare, str | os.PathLike):
        compare = (compare,)
    options += [f"--objects={number}" for number in objects]
    options += [f"--by={column}" for column in by]
    options += [f"--compare={os.fspath(path)}" for path in compare]
    native_mesh: _native.Mesh | None = None
    with tempfile.TemporaryDirectory(prefix="dronepose-") as folder:
        if isinstance(camera, Camera) and camera.skew == 0.0:
            c = camera
            intrinsics = [_number(v) for v in (c.fx, c.fy, c.cx, c.cy, c.width, c.height)]
            options.append(f"--camera={','.join(intrinsics)}")
        elif isinstance(camera, Camera):
            path = Path(folder) / "camera.json"
            path.write_text(json.dumps(dataclasses.asdict(camera)), encoding="utf-8")
            options.append(f"--camera={path}")
        elif camera is not None:
            options.append(f"--camera={os.fspath(camera)}")
        if isinstance(mesh, Mesh):
            if mesh._source is not None:
                options += [f"--mesh={mesh._source[0]}", f"--mesh-unit={mesh._source[1]}"]
            else:
                native_mesh = mesh._native
        elif mesh is not None:
            options.append(f"--mesh={os.fspath(mesh)}")
            if mesh_unit is not None:
                options.append(f"--mesh-unit={mesh_unit}")
        if isinstance(symmetries, Mapping):
            path = Path(folder) / "symmetries.json"
            path.write_text(json.dumps(dict(symmetries)), encoding="utf-8")
            symmetries = path
        if symmetries is not None:
            options.append(f"--symmetries={os.fspath(symmetries)}")
        text, table = _native.evaluate(
            options, _poses("predictions", predictions), _poses("gt", gt), native_mesh
        )
    return Evaluation.from_json(text, table)


def _poses(name: str, given: Poses) -> _NativePoses:
    """A path as text, or checked arrays with ids."""
    poses: Any = given
    if isinstance(poses, str | os.PathLike):
        return os.fspath(poses)
    if isinstance(poses, Mapping):
        unknown = sorted(set(poses) - {"R", "t", "ids"})
        if unknown or "R" not in poses or "t" not in poses:
            raise ValueError(
                f"{name}: expected the keys 'R', 't' and perhaps 'ids', got {sorted(poses)}"
            )
        poses = tuple(poses[key] for key in ("R", "t", "ids") if key in poses)
    if not isinstance(poses, tuple) or len(poses) not in (2, 3):
        raise TypeError(
            f"{name}: expected a path, a mapping or a tuple (R, t) or (R, t, ids), "
            f"got {type(poses).__name__}"
        )
    R = floats(f"{name} R", poses[0], "(N, 3, 3)")
    t = floats(f"{name} t", poses[1], "(N, 3)")
    ids = [str(i) for i in (poses[2] if len(poses) == 3 else range(len(R)))]
    if not len(R) == len(t) == len(ids):
        raise ValueError(
            f"{name}: expected as many R, t and ids, got {len(R)}, {len(t)} and {len(ids)}"
        )
    return R, t, ids


def _number_or_word(value: float | str) -> str:
    return value if isinstance(value, str) else _number(value)


def _number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def _numbers(name: str, values: Any) -> str:
    if isinstance(values, str) or not np.iterable(values):
        raise TypeError(f"{name}: expected a sequence of numbers, got {values!r}")
    return ",".join(_number(v) for v in values)
