"""Flights: logs of any of five formats in one world frame and one body frame, at a steady rate.

**World frame**: metres, z up, right-handed. **Body frame**: x forward, y left, z up. Poses are
``world_from_body``. The formats, and how their frames become ours, are in ``docs/synthesis.md``.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dronepose import _native
from dronepose._arrays import read_only
from dronepose.synth._settings import axes, chosen, encode, points, vector

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

FORMATS = ("auto", "uava", "airsim", "tum", "euroc", "csv")
WORLDS = ("z-up", "ned", "y-up", "unity")
ORDERS = ("wxyz", "xyzw")
TIME_UNITS = ("s", "ms", "us", "ns")
RATE_HZ = 60.0
"""The rate of the paper's flights (DronePose, section 3, Dataset)."""


@dataclass(frozen=True, slots=True)
class Issue:
    """A row of a file that was dropped, or at which the flight was cut.

    Args:
        kind: ``duplicate`` or ``short`` (dropped), ``backward``, ``gap``, ``jump`` or ``break``
            (cut).
        line: Line of the file, from 1.
        text: What was found, in words.
    """

    kind: str
    line: int
    text: str


@dataclass(frozen=True, slots=True)
class Placement:
    """A flight put into a scene: ``p_scene = scale * Rz(yaw) @ p + offset``.

    Args:
        scale: Above zero; speeds grow with it.
        yaw_deg: Degrees about z, counter-clockwise from above.
        offset: ``(3,)`` metres.

    Example:
        >>> Placement(yaw_deg=90).offset
        (0.0, 0.0, 0.0)
    """

    scale: float = 1.0
    yaw_deg: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def encoded(self) -> str:
        """As JSON.

        Returns:
            The text.

        Raises:
            ValueError: A number is not finite.

        Example:
            >>> Placement(2.0).encoded()
            '{"scale": 2.0, "yaw_deg": 0.0, "offset": [0.0, 0.0, 0.0]}'
        """
        offset = vector("offset", self.offset)
        return encode(
            {"scale": float(self.scale), "yaw_deg": float(self.yaw_deg), "offset": offset}
        )


class Track:
    """A flight at a steady rate: ``world_from_body`` by frame, in pieces without gaps or jumps.

    Frame ``k`` is at ``k / rate_hz`` seconds after the first row of the file, whatever was cut.

    Args:
        positions: ``(N, 3)`` metres, world frame, one for each frame.
        quat_wxyz: ``(N, 4)`` ``world_from_body``, scalar first, of any norm but zero.
        rate_hz: Frames a second.

    Raises:
        ValueError: A shape is wrong, a number is not finite, a quaternion is zero, or the rate is
            not above zero.

    Example:
        >>> track = Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2, rate_hz=60)
        >>> len(track), track.segments.tolist()
        (2, [[0, 2]])
    """

    __slots__ = ("_native",)

    def __init__(
        self, positions: ArrayLike, quat_wxyz: ArrayLike, *, rate_hz: float = RATE_HZ
    ) -> None:
        p = points("positions", positions)
        q = np.ascontiguousarray(quat_wxyz, dtype=np.float64)
        if q.shape != (len(p), 4):
            raise ValueError(f"quat_wxyz: expected shape ({len(p)}, 4), got {q.shape}")
        self._native = _native.Track(float(rate_hz), p, q)

    @classmethod
    def _wrap(cls, native: _native.Track) -> Track:
        track = cls.__new__(cls)
        track._native = native
        return track

    def __len__(self) -> int:
        return len(self._native.frames())

    @property
    def rate_hz(self) -> float:
        """Frames a second.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).rate_hz
            60.0
        """
        return self._native.rate_hz

    @property
    def frames(self) -> NDArray[np.int64]:
        """``(N,)`` numbers of the frames.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).frames.tolist()
            [0, 1]
        """
        return read_only(self._native.frames())

    @property
    def positions(self) -> Array:
        """``(N, 3)`` metres, world frame.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).positions[1].tolist()
            [0.1, 0.0, 1.0]
        """
        return read_only(self._native.positions())

    @property
    def quat_wxyz(self) -> Array:
        """``(N, 4)`` ``world_from_body``, scalar first; neighbours are on one side.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).quat_wxyz[1].tolist()
            [1.0, 0.0, 0.0, 0.0]
        """
        return read_only(self._native.quat_wxyz())

    @property
    def lines(self) -> NDArray[np.int64]:
        """``(N,)`` the line of the file at or before each frame, from 1.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).lines.tolist()
            [1, 2]
        """
        return read_only(self._native.lines())

    @property
    def segments(self) -> NDArray[np.int64]:
        """``(S, 2)`` first index of each piece, and the index behind its last.

        Example:
            >>> Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2).segments.tolist()
            [[0, 2]]
        """
        return read_only(self._native.segments())

    def placed(self, placement: Placement) -> Track:
        """The flight in a scene.

        Args:
            placement: The similarity.

        Returns:
            Another track.

        Raises:
            ValueError: The scale is not above zero, or a number is not finite.

        Example:
            >>> track = Track([[0, 0, 1], [0.1, 0, 1]], [[1, 0, 0, 0]] * 2)
            >>> track.placed(Placement(offset=(0, 0, 0.5))).positions[0].tolist()
            [0.0, 0.0, 1.5]
        """
        return Track._wrap(self._native.placed(placement.encoded()))


class Flight:
    """A flight as its file has it, in our frames, cleaned and cut. See :func:`read_flight`."""

    __slots__ = ("_native", "facts", "issues")

    facts: dict[str, Any]
    """Source with its SHA-256, conventions, and counts, as for JSON."""
    issues: list[Issue]
    """Rows that were dropped, and cuts, in the order of the file."""

    def __init__(self, native: _native.Flight) -> None:
        self._native = native
        self.facts = json.loads(native.facts())
        self.issues = [Issue(**issue) for issue in self.facts["issues"]]

    def __len__(self) -> int:
        return int(self.facts["poses"])

    @property
    def time_s(self) -> Array:
        """``(N,)`` seconds since the first row of the file.

        Example:
            >>> read_flight("flight.txt").time_s[0]  # doctest: +SKIP
            0.0
        """
        return read_only(self._native.time())

    @property
    def positions(self) -> Array:
        """``(N, 3)`` metres, world frame.

        Example:
            >>> read_flight("flight.txt").positions.shape  # doctest: +SKIP
            (1501, 3)
        """
        return read_only(self._native.positions())

    @property
    def quat_wxyz(self) -> Array:
        """``(N, 4)`` ``world_from_body``, scalar first; neighbours are on one side.

        Example:
            >>> read_flight("flight.txt").quat_wxyz.shape  # doctest: +SKIP
            (1501, 4)
        """
        return read_only(self._native.quat_wxyz())

    @property
    def lines(self) -> NDArray[np.int64]:
        """``(N,)`` lines of the file, from 1.

        Example:
            >>> read_flight("flight.txt").lines[0]  # doctest: +SKIP
            2
        """
        return read_only(self._native.lines())

    @property
    def segments(self) -> NDArray[np.int64]:
        """``(S, 2)`` first row of each piece, and the row behind its last.

        Example:
            >>> read_flight("flight.txt").segments.tolist()  # doctest: +SKIP
            [[0, 1501]]
        """
        return read_only(self._native.segments())

    def resample(self, rate_hz: float = RATE_HZ) -> Track:
        """The flight at a steady rate: SLERP for rotations, a natural cubic spline for positions.

        Args:
            rate_hz: Frames a second.

        Returns:
            The track; pieces too short for a frame are left out.

        Raises:
            ValueError: The rate is not above zero, gives no frame, or more than 50 million.

        Example:
            >>> from dronepose.synth import read_flight, write_example
            >>> import tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     flight = read_flight(write_example(folder)["flight"])
            >>> len(flight.resample(60)) == 30 * 60 + 1
            True
        """
        return Track._wrap(self._native.resample(float(rate_hz)))

    def describe(self) -> str:
        """What was read, as lines for people: conventions, cuts, dropped rows.

        Returns:
            The text.

        Example:
            >>> from dronepose.synth import read_flight, write_example
            >>> import tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     text = read_flight(write_example(folder)["flight"]).describe()
            >>> print(text.splitlines()[1])
              world z-up, body flu, quaternion xyzw, time in s
        """
        facts, conventions = self.facts, self.facts["conventions"]
        unit = conventions["time_unit"]
        time = self.time_s
        lines = [
            f"{facts['source']['path']}: {conventions['format']}, {facts['rows']} rows, "
            f"{time[-1] - time[0]:.2f} s, {facts['segments']} pieces of {len(self)} poses",
            f"  world {conventions['world']}, body {conventions['body_axes']}, "
            f"quaternion {conventions['quaternion']}, "
            + ("without time" if unit is None else f"time in {unit}"),
        ]
        if facts["sign_flips"]:
            lines.append(f"  {facts['sign_flips']} sign flips of quaternions mended")
        for kind in ("duplicate", "backward", "gap", "jump", "break", "short"):
            of_kind = [issue for issue in self.issues if issue.kind == kind]
            if of_kind:
                lines.append(f"  {kind}: {len(of_kind)}")
                lines += [f"    line {issue.line}: {issue.text}" for issue in of_kind[:3]]
        return "\n".join(lines)


def read_flight(
    path: str | os.PathLike[str],
    *,
    format: Literal["auto", "uava", "airsim", "tum", "euroc", "csv"] = "auto",
    world: Literal["z-up", "ned", "y-up", "unity"] | None = None,
    body_axes: str | None = None,
    quaternion: Literal["wxyz", "xyzw"] | None = None,
    time_unit: Literal["s", "ms", "us", "ns"] | None = None,
    mount_rpy_deg: Sequence[float] = (0.0, 0.0, 0.0),
    vehicle: str | None = None,
    source_rate_hz: float = 60.0,
    min_step_s: float = 1e-3,
    max_gap_s: float = 0.2,
    max_speed_m_s: float = 25.0,
    max_turn_deg_s: float = 1200.0,
) -> Flight:
    """A flight from a file.

    Rows with (nearly) the same time are dropped; the flight is cut where time goes back, after a
    gap, and where a move or turn is too fast. All of these are in :attr:`Flight.issues`, with
    their lines.

    Args:
        path: The file, perhaps gzipped; ``-`` for standard input.
        format: Which format; ``auto`` looks at the first line.
        world: World axes of the file; ``None`` is what its format has (``ned`` for AirSim, else
            ``z-up``).
        body_axes: Which way x, y and z of its body point, as three letters of forward, back, left,
            right, up, down; ``None`` is ``frd`` for AirSim, ``luf`` for UAVA (the paper's mesh),
            ``urf`` for EuRoC (its IMU), else ``flu``.
        quaternion: Order, for TUM (else ``xyzw``) and EuRoC (else ``wxyz``); others name columns.
        time_unit: Unit of the time stamps; ``None`` is what the format or the column's name says.
        mount_rpy_deg: How the sensor whose poses the file has sits in the drone: roll, pitch, yaw,
            ``body_from_sensor = Rz(yaw) Ry(pitch) Rx(roll)`` with axes x forward, y left, z up.
        vehicle: Which vehicle of an AirSim file that has several.
        source_rate_hz: Time steps a second of a file without time (UAVA).
        min_step_s: A row that comes sooner after the last one is a duplicate.
        max_gap_s: A longer time without a row is a gap.
        max_speed_m_s: A faster move is a jump.
        max_turn_deg_s: A faster turn is a jump.

    Returns:
        The flight.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is no flight, or an argument is out of its range; the message names file,
            line and column, or the argument.

    Example:
        >>> from dronepose.synth import write_example
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     flight = read_flight(write_example(folder)["flight"])
        >>> flight.positions.shape[1], flight.facts["conventions"]["format"]
        (3, 'tum')
    """
    chosen("format", format, FORMATS)
    for name, value, among in (
        ("world", world, WORLDS),
        ("quaternion", quaternion, ORDERS),
        ("time_unit", time_unit, TIME_UNITS),
    ):
        if value is not None:
            chosen(name, value, among)
    options = {
        "format": format,
        "world": world,
        "body_axes": None if body_axes is None else axes("body_axes", body_axes),
        "quaternion": quaternion,
        "time_unit": time_unit,
        "mount_rpy_deg": vector("mount_rpy_deg", mount_rpy_deg),
        "vehicle": vehicle,
        "rate_hz": float(source_rate_hz),
    }
    limits = {
        "min_step_s": float(min_step_s),
        "max_gap_s": float(max_gap_s),
        "max_speed_m_s": float(max_speed_m_s),
        "max_turn_deg_s": float(max_turn_deg_s),
    }
    encode(limits)
    return Flight(_native.Flight.read(path, encode({**options, "limits": limits})))


def fit_placement(
    track: Track,
    anchors: ArrayLike,
    *,
    how: Literal["centre", "fill"] = "centre",
    given: Placement | None = None,
) -> Placement:
    """The placement that brings the middle of a flight's box to the middle of the anchors' box.

    Args:
        track: The flight.
        anchors: ``(A, 3)`` metres, world frame.
        how: ``centre`` finds the offset; ``fill`` also the scale with which the flight's box just
            fits into the anchors' box from above.
        given: Yaw, and scale for ``centre``; its offset is added to the one that is found.

    Returns:
        The placement.

    Raises:
        ValueError: There is no anchor, or ``fill`` has no area to fill.

    Example:
        >>> track = Track([[0, 0, 1], [2, 2, 1]], [[1, 0, 0, 0]] * 2)
        >>> fit_placement(track, [[0, 0, 1.5], [4, 4, 1.5]]).offset
        (1.0, 1.0, 0.5)
    """
    chosen("how", how, ("centre", "fill"))
    text = track._native.fit(points("anchors", anchors), (given or Placement()).encoded(), how)
    found = json.loads(text)
    x, y, z = found["offset"]
    return Placement(found["scale"], found["yaw_deg"], (x, y, z))


def placement_facts(placement: Placement) -> dict[str, Any]:
    """A placement as the manifest has it.

    Args:
        placement: The similarity.

    Returns:
        Its numbers by name.

    Example:
        >>> placement_facts(Placement())["scale"]
        1.0
    """
    return asdict(placement)
