"""The plan of a data set: what is left of a flight, with every pose that is needed to render it."""

from __future__ import annotations

import csv
import io
import json
import math
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose.geometry import matrix_from_quat_wxyz
from dronepose.synth._settings import points
from dronepose.synth.anchors import Anchors
from dronepose.synth.flight import (
    RATE_HZ,
    Flight,
    Placement,
    Track,
    fit_placement,
    placement_facts,
)
from dronepose.synth.rules import Funnel, FunnelStep, Rules

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

FORMAT = "dronepose-plan-1"
CONVENTIONS = {
    "world": "metres, z up, right-handed",
    "body": "x forward, y left, z up",
    "camera_axes": "OpenCV: x right, y down, z forward",
    "qw..tz": "cam_from_model at t: p_cam = R p_model + t, exocentric camera",
    "next_qw..": "cam_from_model at t + 1, the same camera",
    "exo_qw..": "cam_from_world of the exocentric camera",
    "ego_qw.., ego_next_qw..": "cam_from_world of the drone's camera at t, t + 1",
    "drone_qw.., drone_next_qw..": "world_from_model of the drone at t, t + 1",
    "quaternion": "Hamilton, scalar first",
    "pixel_centre": 0.5,
    "seed_of_a_sample": "Pcg64Mcg, seed_from_u64(seed ^ (frame + 1) * 0x9e3779b97f4a7c15), "
    "six numbers: eye x y z, target x y z",
}
MAP_POINTS = 4000
"""Points of the flight that the manifest keeps for the map."""

_ALL = slice(None)

PoseName = Literal["", "next", "exo", "ego", "ego_next", "drone", "drone_next"]


@dataclass(frozen=True, slots=True, eq=False)
class PlanTable:
    """The rows of a plan, by column.

    Args:
        ids: Id of each sample.
        anchors: Name of the anchor of each sample.
        columns: The other columns by name, each ``(N,)`` float64.
        manifest: What is known of the run; empty if there is no manifest.
    """

    ids: list[str]
    anchors: list[str]
    columns: dict[str, Array]
    manifest: dict[str, Any]

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, name: str) -> Array:
        """A column, ``(N,)``.

        Raises:
            KeyError: There is no such column.
        """
        return self.columns[name]

    def pose(
        self, name: PoseName = "", rows: slice | NDArray[np.integer[Any]] = _ALL
    ) -> tuple[Array, Array]:
        """One of the poses of each sample, or of some.

        Args:
            name: ``""`` for ``cam_from_model`` at t, ``next`` at t + 1; ``exo``, ``ego``,
                ``ego_next`` for ``cam_from_world`` of a camera; ``drone``, ``drone_next`` for
                ``world_from_model``.
            rows: Which samples; all by default.

        Returns:
            ``R`` ``(N, 3, 3)`` and ``t`` ``(N, 3)``, metres.

        Raises:
            KeyError: There is no such pose.

        Example:
            >>> from dronepose.synth import Track, make_plan
            >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
            >>> table = make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]]).table()
            >>> table.pose("exo")[0].shape == (len(table), 3, 3)
            True
        """
        lead = f"{name}_" if name else ""
        q = np.stack([self.columns[f"{lead}q{c}"][rows] for c in "wxyz"], axis=1)
        t = np.stack([self.columns[f"{lead}t{c}"][rows] for c in "xyz"], axis=1)
        return matrix_from_quat_wxyz(q), t


class Plan:
    """Samples that are to be rendered. See :func:`make_plan`."""

    __slots__ = ("_native", "facts", "funnel")

    funnel: Funnel
    """What each rule removed."""
    facts: dict[str, Any]
    """What the manifest says, but for the funnel."""

    def __init__(self, native: _native.Plan, funnel: Funnel, facts: dict[str, Any]) -> None:
        self._native = native
        self.funnel = funnel
        self.facts = facts

    def __len__(self) -> int:
        return len(self._native)

    def table(self) -> PlanTable:
        """The samples by column.

        Returns:
            The table; numbers as in the file.

        Example:
            >>> from dronepose.synth import Track
            >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
            >>> plan = make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]])
            >>> bool((plan.table()["distance_m"] >= 0.8).all())
            True
        """
        values = self._native.values()
        columns = {name: values[:, k] for k, name in enumerate(self._native.columns())}
        return PlanTable(self._native.ids(), self._native.anchors(), columns, self.manifest())

    def keep(self, mask: ArrayLike, rule: str, asks: str, paper: str = "section 3") -> Plan:
        """The plan after a rule that Rust does not know, such as one that looks at pictures.

        Args:
            mask: ``(N,)`` bool, which samples it keeps.
            rule: Its name; ``hidden`` and ``invalid`` are those of the paper.
            asks: What it asks for, for the funnel.
            paper: Where the paper has it.

        Returns:
            Another plan, with a step more in its funnel.

        Raises:
            ValueError: The mask has another length, or the rule was applied before.

        Example:
            >>> from dronepose.synth import Track
            >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
            >>> plan = make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]])
            >>> some = plan.keep([True] * len(plan), "hidden", "at least half of the drone seen")
            >>> some.funnel.pending
            ('invalid', 'blocked')
        """
        kept = np.asarray(mask, dtype=bool)
        if kept.shape != (len(self),):
            raise ValueError(f"mask: expected shape ({len(self)},), got {kept.shape}")
        funnel = self.funnel.and_then(rule, int((~kept).sum()), asks, paper)
        return Plan(self._native.only(kept.tolist()), funnel, self.facts)

    def some(self, count: int) -> Plan:
        """The plan with a few of its samples, evenly spread, to try things out.

        Args:
            count: How many; all where there are not more.

        Returns:
            Another plan, with a step ``some`` more in its funnel.

        Raises:
            ValueError: ``count`` is below 1, or it was done before.

        Example:
            >>> from dronepose.synth import Track
            >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
            >>> plan = make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]])
            >>> len(plan), len(plan.some(3))
            (6, 3)
        """
        if count < 1:
            raise ValueError(f"count: expected at least 1, got {count}")
        mask = np.zeros(len(self), bool)
        mask[np.linspace(0, len(self) - 1, min(count, len(self))).astype(int)] = True
        return self.keep(mask, "some", f"{count} samples, evenly spread", "")

    def manifest(self) -> dict[str, Any]:
        """What was done, for JSON: inputs with SHA-256, conventions, settings, seed, versions.

        Returns:
            The manifest.

        Example:
            >>> from dronepose.synth import Track
            >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
            >>> make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]]).manifest()["format"]
            'dronepose-plan-1'
        """
        return {
            "format": FORMAT,
            "samples": len(self),
            **self.facts,
            "funnel": self.funnel.facts(),
        }

    def write(
        self, path: str | os.PathLike[str], manifest: str | os.PathLike[str] | None = None
    ) -> Path:
        """Writes ``plan.csv`` and its manifest, both or none.

        Args:
            path: The CSV; its ``id,qw..qz,tx..tz`` is ground truth for ``dronepose-eval`` and input
                of ``dronepose render``.
            manifest: The JSON; ``None`` is the same name with ``.json``.

        Returns:
            The path of the manifest.

        Raises:
            OSError: They cannot be written.
            ValueError: Both have one name.

        Example:
            >>> plan.write("plan.csv")  # doctest: +SKIP
            PosixPath('plan.json')
        """
        beside = Path(path).with_suffix(".json") if manifest is None else Path(manifest)
        if beside == Path(path):
            raise ValueError(f"manifest: {beside} is the plan itself; give another name")
        text = json.dumps(self.manifest(), indent=1, allow_nan=False) + "\n"
        self._native.write(path, beside, text)
        return beside


def make_plan(
    flight: Flight | Track,
    anchors: Anchors | ArrayLike,
    rules: Rules | None = None,
    *,
    rate_hz: float = RATE_HZ,
    placement: Placement | None = None,
    fit: Literal["centre", "fill"] | None = None,
    scene: str = "",
    split: str | None = None,
    threads: int = 0,
) -> Plan:
    """The samples of a flight in a scene: DronePose, section 3 (Dataset).

    The result depends neither on the number of threads nor on which other samples there are.

    Args:
        flight: A flight, which is resampled, or a track, which is taken as it is.
        anchors: Anchors of the scene, or ``(A, 3)`` metres.
        rules: Settings; ``None`` is :class:`Rules` as it is.
        rate_hz: Frames a second of a :class:`Flight`.
        placement: How the flight lies in the scene.
        fit: Find the placement with :func:`fit_placement`, from ``placement``.
        scene: Name of the scene: begins the ids.
        split: Name of the split, for the manifest.
        threads: 0 for one a core.

    Returns:
        The plan.

    Raises:
        ValueError: A setting is out of its range, or there is no anchor.

    Example:
        >>> x = [[0.02 * k, 0, 1.5] for k in range(9)]
        >>> plan = make_plan(Track(x, [[1, 0, 0, 0]] * 9), [[0, 1, 1.5]], scene="hall")
        >>> len(plan) == plan.funnel.steps[-1].left, plan.table().ids[0]
        (True, 'hall-000001')
    """
    settings = rules or Rules()
    track = flight.resample(rate_hz) if isinstance(flight, Flight) else flight
    if isinstance(anchors, Anchors):
        names, places = anchors.names, anchors.positions
        anchor_facts = anchors.facts
    else:
        places = points("anchors", anchors)
        names, anchor_facts = [str(k) for k in range(len(places))], {"anchors": len(places)}
    lies = placement or Placement()
    if fit is not None:
        lies = fit_placement(track, places, how=fit, given=lies)
    track = track.placed(lies)
    prefix = f"{scene}-" if scene else ""
    native = _native.Plan.make(track._native, places, names, settings.encoded(prefix), threads)
    funnel = Funnel([FunnelStep(**step) for step in json.loads(native.funnel())])
    facts = {
        "scene": scene or None,
        "split": split,
        "seed": settings.seed,
        "versions": {
            "dronepose": _native.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "conventions": CONVENTIONS,
        "flight": flight.facts if isinstance(flight, Flight) else None,
        "frames": len(track),
        "rate_hz": track.rate_hz,
        "anchors": anchor_facts,
        "placement": {"fit": fit, **placement_facts(lies)},
        "rules": settings.facts(),
        "cameras": {"exo": asdict(settings.exo), "ego": asdict(settings.ego)},
        "map": {"anchors": np.round(places, 3).tolist(), "flight": _polylines(track)},
    }
    return Plan(native, funnel, facts)


def _polylines(track: Track) -> list[list[list[float]]]:
    """The pieces of a flight with at most :data:`MAP_POINTS` points, more or less."""
    p = np.round(track.positions, 3)
    step = max(1, math.ceil(len(p) / MAP_POINTS))
    return [p[a:b][::step].tolist() for a, b in track.segments.tolist()]


def read_plan(
    path: str | os.PathLike[str], manifest: str | os.PathLike[str] | None = None
) -> PlanTable:
    """The rows of a plan from its file.

    Args:
        path: ``plan.csv``.
        manifest: Its manifest; ``None`` is the same name with ``.json``, if it is there.

    Returns:
        The table.

    Raises:
        OSError: A file cannot be read.
        ValueError: It is no plan; the message names file, line and column.

    Example:
        >>> read_plan("plan.csv")["distance_m"].min()  # doctest: +SKIP
        0.801
    """
    source = Path(path)
    reader = csv.reader(io.StringIO(_text(source), newline=""))
    header = next(_rows(reader, source), [])
    wanted = ["id", "anchor", *_native.Plan.columns()]
    if header != wanted:
        absent = [name for name in wanted if name not in header]
        found = (
            f"a header without {', '.join(absent[:3])}" if absent else "columns in another order"
        )
        raise ValueError(f"{source}:1: found {found}, expected one of dronepose synth plan")
    ids: list[str] = []
    anchors: list[str] = []
    values: list[list[float]] = []
    for row in _rows(reader, source):
        place = f"{source}:{reader.line_num}"
        if len(row) != len(wanted):
            raise ValueError(f"{place}: found {len(row)} fields, expected {len(wanted)}")
        ids.append(row[0])
        anchors.append(row[1])
        values.append([_number(cell, place, wanted[k]) for k, cell in enumerate(row) if k >= 2])
    if not ids:
        raise ValueError(f"{source}: found no sample, expected one at least")
    array = np.array(values)
    columns = {name: array[:, k] for k, name in enumerate(wanted[2:])}
    return PlanTable(ids, anchors, columns, _manifest(source, manifest))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: found bytes that are not UTF-8, expected text") from None


def _rows(reader: Any, source: Path) -> Iterator[list[str]]:
    """The rows that are left; what the csv module refuses is refused with the line."""
    while True:
        try:
            yield next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise ValueError(f"{source}:{reader.line_num}: found a broken row: {error}") from None


def _number(cell: str, place: str, column: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{place}:{column}: found {cell[:40]!r}, expected a finite number")
    return value


def _manifest(source: Path, given: str | os.PathLike[str] | None) -> dict[str, Any]:
    path = source.with_suffix(".json") if given is None else Path(given)
    if given is None and not path.is_file():
        return {}
    try:
        found = json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: found JSON with {error}, expected a manifest") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise ValueError(f"{path}: found no format {FORMAT!r}, expected the manifest of a plan")
    return found
