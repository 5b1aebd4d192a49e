"""Smoothing of a track of poses on SO(3) x R^3, and how much it shakes.

Rotations are compared and moved on the left: ``log(R2 R1^T)`` is a rotation vector in the camera
frame, radians. Frames are equally spaced.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dronepose._arrays import floats

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["OneEuro", "Track", "jitter", "noise", "one_euro", "rts"]

Array = NDArray[np.float64]
#: Median of the norm of three independent normal numbers of unit variance.
_MEDIAN_NORM = 1.5382
#: Measurements in a row that are taken for blunders.
_PATIENCE = 5
#: Noise below which a measurement is taken as exact enough: 0.1 mm, 0.01 degrees.
_FLOOR = (1e-4, math.radians(0.01))


class Track(NamedTuple):
    """Poses ``cam_from_model`` of equally spaced frames.

    Attributes:
        R: ``(N, 3, 3)`` float64 rotations.
        t: ``(N, 3)`` float64 translations, metres.
    """

    R: Array
    t: Array


class Space(NamedTuple):
    """What differs between positions and rotations: ``minus(a, b)`` is a vector, ``plus`` adds."""

    minus: Callable[[Array, Array], Array]
    plus: Callable[[Array, Array], Array]


def exp(vector: Array) -> Array:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    matrix, _ = cv2.Rodrigues(np.ascontiguousarray(vector, dtype=np.float64))
    return np.asarray(matrix, dtype=np.float64)


def log(R: Array) -> Array:
    """Rotation vector of a rotation matrix, of length at most pi."""
    vector, _ = cv2.Rodrigues(np.ascontiguousarray(R, dtype=np.float64))
    return np.asarray(vector, dtype=np.float64).ravel()


POSITION = Space(minus=lambda a, b: a - b, plus=lambda a, v: a + v)
ROTATION = Space(minus=lambda a, b: log(a @ b.T), plus=lambda a, v: exp(v) @ a)


class OneEuro:
    """The one-euro filter: calm at rest, quick in motion; uses past frames only.

    A low-pass filter whose cut-off grows with the speed, ``min_cutoff + beta speed``: Casiez,
    Roussel and Vogel, "1 euro filter", CHI 2012. Positions and rotations have a filter each; a
    rotation moves along the geodesic to the measured one.

    Args:
        rate: Frames per second, above zero.
        min_cutoff: Cut-off at rest, hertz; lower is calmer.
        beta: Growth of the cut-off with the speed, hertz for each m/s and each rad/s.
        derivative_cutoff: Cut-off of the filter of the speed, hertz.

    Raises:
        ValueError: An argument is out of its range.

    Example:
        >>> f = OneEuro(30.0)
        >>> R, t = f(np.eye(3), np.array([0.0, 0, 1]))
        >>> R, t = f(np.eye(3), np.array([0.0, 0, 1.01]))
        >>> 1.0 < float(t[2]) < 1.01
        True
    """

    def __init__(
        self,
        rate: float,
        min_cutoff: float = 1.0,
        beta: float = 2.0,
        derivative_cutoff: float = 1.0,
    ) -> None:
        for name, value, least in (
            ("rate", rate, 1e-6),
            ("min_cutoff", min_cutoff, 1e-6),
            ("beta", beta, 0.0),
            ("derivative_cutoff", derivative_cutoff, 1e-6),
        ):
            if not (math.isfinite(value) and value >= least):
                raise ValueError(
                    f"{name}: expected a finite number of {least:g} or more, got {value}"
                )
        self._rate, self._min, self._beta = rate, min_cutoff, beta
        self._speed_alpha = self._alpha(derivative_cutoff)
        self._states: list[tuple[Array, Array]] = []

    def __call__(self, R: Array, t: Array) -> tuple[Array, Array]:
        """One frame's pose in, the filtered one out.

        Args:
            R: ``(3, 3)`` rotation.
            t: ``(3,)`` translation, metres.

        Returns:
            Rotation and translation, float64.

        Raises:
            ValueError: A value is not finite.
        """
        measured = (floats("R", R, "(3, 3)"), floats("t", t, "(3,)"))
        if not self._states:
            self._states = [(value, np.zeros(3)) for value in measured]
            return measured
        self._states = [
            self._step(space, state, value)
            for space, state, value in zip(
                (ROTATION, POSITION), self._states, measured, strict=True
            )
        ]
        return self._states[0][0], self._states[1][0]

    def _alpha(self, cutoff: float) -> float:
        return 1.0 / (1.0 + self._rate / (2.0 * math.pi * cutoff))

    def _step(
        self, space: Space, state: tuple[Array, Array], measured: Array
    ) -> tuple[Array, Array]:
        value, velocity = state
        step = space.minus(measured, value)
        velocity = velocity + self._speed_alpha * (step * self._rate - velocity)
        alpha = self._alpha(self._min + self._beta * float(np.linalg.norm(velocity)))
        return space.plus(value, alpha * step), velocity


def one_euro(
    R: ArrayLike, t: ArrayLike, rate: float, *, min_cutoff: float = 1.0, beta: float = 2.0
) -> Track:
    """A whole track through :class:`OneEuro`.

    Args:
        R: ``(N, 3, 3)`` rotations.
        t: ``(N, 3)`` translations, metres.
        rate: Frames per second, above zero.
        min_cutoff: Cut-off at rest, hertz.
        beta: Growth of the cut-off with the speed, hertz for each m/s and each rad/s.

    Returns:
        The filtered track.

    Raises:
        ValueError: A shape is wrong, or an argument is not finite or out of its range.

    Example:
        >>> track = one_euro(np.eye(3)[None].repeat(3, 0), [[0, 0, 1]] * 3, 30.0)
        >>> track.t[2].tolist()
        [0.0, 0.0, 1.0]
    """
    rotations, translations = _track(R, t)
    step = OneEuro(rate, min_cutoff, beta)
    found = [step(*pose) for pose in zip(rotations, translations, strict=True)]
    return _stacked(found)


def noise(R: ArrayLike, t: ArrayLike) -> tuple[float, float]:
    """Standard deviation of the noise of each frame, guessed from the track itself.

    From the median norm of third differences, which a smooth motion leaves small: the variance of
    a third difference of independent noise is 20 times that of the noise. Blunders (a pose that
    flips for a few frames) do not move a median.

    Args:
        R: ``(N, 3, 3)`` rotations.
        t: ``(N, 3)`` translations, metres.

    Returns:
        Of each coordinate of the position, metres, and of the rotation vector, radians; at least
        0.1 mm and 0.01 degrees.

    Raises:
        ValueError: A shape is wrong, or a value is not finite.

    Example:
        >>> noise(np.eye(3)[None].repeat(9, 0), np.zeros((9, 3)))[0]
        0.0001
    """
    rotations, translations = _track(R, t)
    if len(rotations) < 4:
        return _FLOOR
    turns = _turns(rotations)
    found = []
    for third, floor in zip(
        (np.diff(translations, 3, axis=0), np.diff(turns, 2, axis=0)), _FLOOR, strict=True
    ):
        median = float(np.median(np.linalg.norm(third, axis=1)))
        found.append(max(floor, median / _MEDIAN_NORM / math.sqrt(20.0)))
    return found[0], found[1]


def rts(
    R: ArrayLike,
    t: ArrayLike,
    rate: float,
    *,
    measurement: tuple[float, float] | None = None,
    acceleration: tuple[float, float] = (2.0, math.radians(180.0)),
) -> Track:
    """Smooth a recorded track with a Kalman filter forward and a smoother back.

    Constant velocity driven by white acceleration: Rauch, Tung and Striebel, "Maximum likelihood
    estimates of linear dynamic systems", AIAA Journal 1965. Positions are exact; rotations are
    smoothed in the tangent space at each estimate, to first order in the turn between two frames.
    A measurement far from the prediction (more than 5 standard deviations) has its
    variance raised so that it counts as one at that distance, which keeps single blunders from
    bending the track; after five of these in a row it is the track that has jumped, and it starts
    anew there.

    Args:
        R: ``(N, 3, 3)`` rotations.
        t: ``(N, 3)`` translations, metres.
        rate: Frames per second, above zero.
        measurement: Standard deviation of one frame, metres and radians; ``None`` takes
            :func:`noise`.
        acceleration: Standard deviation of the acceleration during one frame, m/s^2 and rad/s^2.

    Returns:
        The smoothed track.

    Raises:
        ValueError: A shape is wrong, or an argument is not finite or out of its range.

    Example:
        >>> t = np.linspace([0, 0, 1], [1, 0, 1], 20)
        >>> bool(abs(rts(np.eye(3)[None].repeat(20, 0), t, 30.0).t - t).max() < 1e-3)
        True
    """
    rotations, translations = _track(R, t)
    if not (math.isfinite(rate) and rate > 0):
        raise ValueError(f"rate: expected a finite number above zero, got {rate}")
    given = noise(R, t) if measurement is None else measurement
    for name, values in (("measurement", given), ("acceleration", acceleration)):
        if not all(math.isfinite(v) and v > 0 for v in values):
            raise ValueError(f"{name}: expected two finite numbers above zero, got {values}")
    return Track(
        _smooth(ROTATION, rotations, 1.0 / rate, given[1], acceleration[1]),
        _smooth(POSITION, translations, 1.0 / rate, given[0], acceleration[0]),
    )


def _smooth(space: Space, values: Array, dt: float, sigma: float, acceleration: float) -> Array:
    """Filter and smoother; the covariance of (value, velocity) is the same along each axis."""
    F = np.array([[1.0, dt], [0.0, 1.0]])
    drive = np.array([0.5 * dt * dt, dt])
    Q = np.outer(drive, drive) * acceleration**2
    if len(values) < 2:
        return values
    x, v = values[0], np.zeros(3)
    P = np.diag([sigma**2, (10.0 * acceleration * dt + sigma / dt) ** 2])
    start, far = P, 0
    after = [(x, v, P)]
    before = [(x, v, P)]
    for measured in values[1:]:
        x, P = space.plus(x, dt * v), F @ P @ F.T + Q
        step = space.minus(measured, x)
        variance = float(P[0, 0]) + sigma**2
        far = far + 1 if float(step @ step) > 25.0 * variance else 0
        if far > _PATIENCE:
            # A cut: as uncertain as at the start, around a place that may be that far away.
            P = P + start + np.diag([float(step @ step), 0.0])
            variance, far = float(P[0, 0]) + sigma**2, 0
        before.append((x, v, P))
        variance *= max(1.0, float(step @ step) / (25.0 * variance))
        gain = P[:, 0] / variance
        x, v = space.plus(x, gain[0] * step), v + gain[1] * step
        P = P - np.outer(gain, P[0])
        P = 0.5 * (P + P.T)
        after.append((x, v, P))
    out = [after[-1][0]]
    for k in range(len(values) - 2, -1, -1):
        (xk, vk, Pk), (xp, vp, Pp) = after[k], before[k + 1]
        G = np.linalg.solve(Pp, F @ Pk).T
        dx, dv = space.minus(x, xp), v - vp
        x, v = (
            space.plus(xk, G[0, 0] * dx + G[0, 1] * dv),
            vk + G[1, 0] * dx + G[1, 1] * dv,
        )
        out.append(x)
    return np.stack(out[::-1])


def jitter(R: ArrayLike, t: ArrayLike) -> tuple[float, float]:
    """How much a track shakes from frame to frame: zero for a steady motion.

    The mean norm of the second difference, ``t[k+1] - 2 t[k] + t[k-1]`` of the position and
    ``log(R[k+1] R[k]^T) - log(R[k] R[k-1]^T)`` of the rotation.

    Args:
        R: ``(N, 3, 3)`` rotations.
        t: ``(N, 3)`` translations, metres.

    Returns:
        Metres and degrees, each for one frame squared; zeros for fewer than three frames.

    Raises:
        ValueError: A shape is wrong, or a value is not finite.

    Example:
        >>> jitter(np.eye(3)[None].repeat(3, 0), [[0, 0, 1], [0, 0, 2], [0, 0, 1]])
        (2.0, 0.0)
    """
    rotations, translations = _track(R, t)
    if len(rotations) < 3:
        return 0.0, 0.0
    bends = np.linalg.norm(np.diff(translations, 2, axis=0), axis=1)
    twists = np.linalg.norm(np.diff(_turns(rotations), axis=0), axis=1)
    return float(bends.mean()), math.degrees(float(twists.mean()))


def _turns(rotations: Array) -> Array:
    pairs = zip(rotations[1:], rotations[:-1], strict=True)
    return np.stack([log(b @ a.T) for b, a in pairs])


def _track(R: ArrayLike, t: ArrayLike) -> Track:
    rotations, translations = floats("R", R, "(N, 3, 3)"), floats("t", t, "(N, 3)")
    if len(rotations) != len(translations):
        raise ValueError(f"t: expected {len(rotations)} rows as R has, got {len(translations)}")
    for name, values in (("R", rotations), ("t", translations)):
        bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        if bad.any():
            raise ValueError(f"{name}[{int(np.argmax(bad))}]: expected finite numbers")
    return Track(rotations, translations)


def _stacked(poses: list[tuple[Array, Array]]) -> Track:
    if not poses:
        return Track(np.empty((0, 3, 3)), np.empty((0, 3)))
    return Track(np.stack([R for R, _ in poses]), np.stack([t for _, t in poses]))
