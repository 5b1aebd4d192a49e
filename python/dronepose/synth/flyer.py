"""A flight without a simulator: a quadrotor that collects coins and keeps away from walls."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose import _native
from dronepose._files import write_text
from dronepose.synth._settings import encode, points
from dronepose.synth.flight import Track

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike

    from dronepose.mesh import Mesh


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    """How the flyer flies.

    Args:
        seed: Of everything random.
        seconds: Length of the flight.
        rate_hz: Poses a second; divides 240.
        speed_m_s: Speed that is asked for.
        max_tilt_deg: Largest tilt, degrees.
        max_yaw_deg_s: Largest turn about the vertical, degrees a second.
        clearance_m: Distance to walls that ways keep; half of it is never fallen below by choice.
        variance: The pilot's: 0 flies the same way every time, 1 is erratic.

    Example:
        >>> Pilot(seconds=10).rate_hz
        60.0
    """

    seed: int = 0
    seconds: float = 60.0
    rate_hz: float = 60.0
    speed_m_s: float = 1.6
    max_tilt_deg: float = 25.0
    max_yaw_deg_s: float = 120.0
    clearance_m: float = 0.4
    variance: float = 0.3


@dataclass(frozen=True, slots=True)
class Flown:
    """What came out of :func:`fly`.

    Args:
        track: The poses, ``world_from_body``, x ahead, y left, z up.
        facts: ``pilot``; ``collected``, second and index of each coin in order; ``unreachable``,
            coins without a way that keeps clear; ``nearest_wall_m``, ``None`` without walls.
    """

    track: Track
    facts: dict[str, Any]

    def write_tum(self, path: str | os.PathLike[str]) -> None:
        """Writes the flight as TUM: seconds, metres, quaternion x y z w; settings as comments.

        Args:
            path: The file; its folder is made if it is not there.

        Returns:
            Nothing; the file is there, whole.

        Raises:
            OSError: It cannot be written.

        Example:
            >>> fly([[0, 0, 1.5], [2, 0, 1.5]]).write_tum("flight.txt")  # doctest: +SKIP
        """
        rate, t, q = self.track.rate_hz, self.track.positions, self.track.quat_wxyz
        settings = " ".join(f"{name}={value}" for name, value in self.facts["pilot"].items())
        lines = [
            f"# dronepose {_native.__version__} synth fly: {settings}",
            "# seconds x y z qx qy qz qw; metres, z up; world_from_body, x ahead, y left, z up",
        ]
        for k, (p, (w, x, y, z)) in enumerate(zip(t.tolist(), q.tolist(), strict=True)):
            numbers = [f"{value:.9f}" for value in (k / rate, *p, x, y, z, w)]
            lines.append(" ".join(numbers))
        write_text(Path(path), "\n".join(lines) + "\n")


def fly(coins: ArrayLike, mesh: Mesh | None = None, pilot: Pilot | None = None) -> Flown:
    """Fly from coin to coin, beginning at the first, and around again when all are collected.

    A point with thrust along its body's z axis, drag, a lag and bounds of the attitude; a pilot who
    takes the shortest way clear of walls, brakes in time and errs a little. The same arguments
    give the same flight.

    Args:
        coins: ``(N, 3)`` metres, world frame, z up; such as the positions of anchors.
        mesh: The scene's surface, metres; ``None`` is open air.
        pilot: Settings.

    Returns:
        The flight.

    Raises:
        ValueError: There is no coin, the first is at a wall, a number is not finite, or a setting
            is out of its range; the message starts with its name.

    Example:
        >>> flown = fly([[0, 0, 1.5], [2, 0, 1.5]], pilot=Pilot(seconds=5))
        >>> len(flown.track), [index for _, index in flown.facts["collected"]][:2]
        (301, [0, 1])
    """
    native, facts = _native.fly_coins(
        None if mesh is None else mesh._native,
        points("coins", coins),
        encode(asdict(pilot or Pilot())),
    )
    return Flown(Track._wrap(native), json.loads(facts))
