"""The checks of the doctor: what each asks, its limit, and what it found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

__all__ = ["CHECKS", "NEEDS", "Finding"]

_SHOWN = 5

CHECKS: dict[str, tuple[str, float, float]] = {
    "manifest": ("problems of dataset.json, scenes and lists", 0, 0),
    "records": ("records missing or contradicted by the scene's table", 0, 0),
    "files": ("files missing, or there without a kept record", 0, 0),
    "splits": ("scenes in two lists, or in another than their own", 0, 0),
    "pairs": ("samples with one time only, or twice the same", 0, 0),
    "images": ("images that cannot be decoded, or of another size", 0, 0),
    "poses": ("largest distance of a quaternion's norm from 1", 0, 1e-3),
    "range": ("median depth of an image, metres", 0.1, 32.0),
    "depth": ("median of depth by the drawn drone's depth", 0.98, 1.02),
    "normals": ("share of flat pixels whose depth has the normal within 5 degrees", 0.9, 1),
    "silhouette": ("absolute difference from the drawn one, by area", 0, 0.01),
    "sync": ("images in which the pose is outside the silhouette's box", 0, 0),
    "matte": ("matte above the silhouette, by area", 0, 0.05),
    "instance": ("share of the drone's pixels that the matte contradicts", 0, 0.02),
    "warp": ("colour error after warping by that before", 0, 0.8),
    "flow": ("share of visible pixels whose flow comes back within 0.5 pixels", 0.95, 1),
    "motion": ("median error of the drone's flow against depth and poses, pixels", 0, 0.1),
}
"""What is measured, and from where to where it may be; in the order of the report."""

TOLERATED = {"warp": 0.01}
"""Share of the images that may be out of the limits. What is thinner than a pixel, or moves before
a bare wall, is no better for being warped; a flow that is wrong is so in far more."""

NEEDS: dict[str, tuple[str, ...]] = {
    "range": ("depth",),
    "depth": ("depth", "instance"),
    "normals": ("depth", "normal_map"),
    "silhouette": ("silhouette",),
    "sync": ("silhouette",),
    "matte": ("matte", "silhouette"),
    "instance": ("instance", "matte"),
    "warp": ("colour", "flow"),
    "flow": ("flow",),
    "motion": ("flow", "depth", "instance"),
}
"""The modalities, at both times, that a check compares."""


@dataclass(slots=True)
class Finding:
    """What a check found.

    Args:
        check: Its name, of :data:`CHECKS`.
        measured: The worst value, or the number of problems; ``None`` where nothing was checked.
        mean: Of all values.
        looked: Number of values.
        problems: Where it is out of its limits.
        note: What it rests on, or why nothing was checked.
        levels: Errors of colours of 255, warped and not, of the check that warps.

    Example:
        >>> finding = Finding("normals")
        >>> finding.add(0.99, "hall row 0"), finding.add(0.4, "hall row 1")
        (None, None)
        >>> finding.ok, finding.measured, finding.problems
        (False, 0.4, ['hall row 1: 0.4'])
    """

    check: str
    measured: float | None = None
    mean: float | None = None
    looked: int = 0
    problems: list[str] = field(default_factory=list)
    note: str = ""
    levels: list[tuple[float, float]] = field(default_factory=list)

    @property
    def ok(self) -> bool | None:
        """Whether all is within the limits; ``None`` where nothing was checked."""
        if self.measured is None:
            return None
        return len(self.problems) <= TOLERATED.get(self.check, 0) * self.looked

    def add(self, value: float, where: str, words: str = "") -> None:
        """Compare a value with the limits."""
        _, low, high = CHECKS[self.check]
        if not low <= value <= high:
            self.problems.append(f"{where}: {words or format(value, '.4g')}")

        def outside(x: float) -> float:
            if low == 0:  # the smaller the better
                return x - high
            return low - x if high == 1 else max(low - x, x - high)

        if self.measured is None or outside(value) > outside(self.measured):
            self.measured = value
        self.mean = (value + (self.mean or 0.0) * self.looked) / (self.looked + 1)
        self.looked += 1

    def count(self, looked: int, problems: list[str]) -> None:
        """Add problems of a check that counts them."""
        self.problems += problems
        self.looked += looked
        self.measured = float(len(self.problems))

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        asks, low, high = CHECKS[self.check]
        return {
            "check": self.check,
            "asks": asks,
            "ok": self.ok,
            "measured": self.measured,
            "mean": self.mean,
            "low": low,
            "high": high,
            "tolerated": TOLERATED.get(self.check, 0),
            "looked": self.looked,
            "problems": self.problems[:100],
            "problem_count": len(self.problems),
            "note": self._why() if self.measured is None else self.note,
        }

    def _why(self) -> str:
        """Why nothing was checked."""
        needs = " and ".join(NEEDS.get(self.check, ()))
        why = f"no sample with {needs} that can be judged" if needs else "nothing to look at"
        return f"{why}; {self.note}" if self.note else why

    def __str__(self) -> str:
        """Lines for people."""
        asks, low, high = CHECKS[self.check]
        state = {True: "ok", False: "FAILED", None: "-"}[self.ok]
        if self.measured is None:
            return f"{state:<7}{self.check:<11}not checked: {self._why()}"
        limits = f"at most {high:g}" if low == 0 else f"{low:g} to {high:g}"
        mean = "" if self.mean is None else f", mean {self.mean:.4g}"
        note = f"; {self.note}" if self.note else ""
        if self.ok and self.problems:
            note += f"; {len(self.problems)} beyond, which is within {TOLERATED[self.check]:.0%}"
        lines = [
            f"{state:<7}{self.check:<11}{self.measured:.4g} ({limits}{mean}, of {self.looked}): "
            f"{asks}{note}"
        ]
        if self.ok:
            return lines[0]
        lines += [f"         {problem}" for problem in self.problems[:_SHOWN]]
        if len(self.problems) > _SHOWN:
            lines.append(f"         and {len(self.problems) - _SHOWN} more")
        return "\n".join(lines)
