"""Settings of the rules that choose samples, and the funnel that says what each removed.

The rules are those of DronePose, section 3 (Dataset); each is in ``docs/synthesis.md`` with its
formula. Numbers that the paper does not give are our own.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from dronepose.camera import Camera
from dronepose.synth._settings import axes, chosen, encode, vector

if TYPE_CHECKING:
    from collections.abc import Sequence

EXO = Camera.from_fov(320, 240, horizontal_deg=64.69)
"""The exocentric camera of the paper (supplement, Dataset)."""
EGO = Camera.from_fov(320, 180, horizontal_deg=85)
"""The drone's camera of the paper (supplement, Dataset)."""
PIXEL_RULES = ("hidden", "invalid", "blocked")
"""Rules that need pictures: the drone hidden by the scene, the share of invalid pixels, views
of something right before the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """Settings of the rules.

    Args:
        seed: Of the run; the draw of a frame depends on it and the frame's number alone.
        min_distance_m: Least distance of drone and anchor (paper: 0.8).
        max_distance_m: Largest distance of drone and anchor (paper: 1.5).
        stride: Frames from t to t + 1.
        min_move_m: A shorter move to a neighbour is limited (ours).
        min_turn_deg: A smaller turn to a neighbour is limited (ours).
        max_move_m: A longer move is refused (ours).
        max_turn_deg: A larger turn is refused (ours).
        motion: ``any``: a move or a turn is enough; ``all``: it takes both.
        anchor_cube_m: Edge of the cube around the anchor in which the view begins (ours).
        drone_cube_m: Edge of the cube around the drone at which the view looks (ours).
        border: Share of the width and of the height, at each edge, where the drone's centroid may
            not be (ours).
        exo: The exocentric camera.
        ego: The drone's camera; no rule asks for it.
        ego_down_deg: The drone's camera looks ahead, and down by so many degrees.
        ego_offset_m: Where the drone's camera is in the body frame, ``(3,)`` metres.
        model_axes: Which way x, y and z of the drone's mesh point, as three letters of forward,
            back, left, right, up, down (``luf`` for the paper's mesh).
        centroid_m: The drone's centroid in the frame of its mesh, ``(3,)`` metres.
        whole_box_m: Two corners of the box of its mesh, each ``(3,)`` metres; asks for the rule
            ``whole``, that the box is in the image. ``None`` does without.

    Raises:
        ValueError: A word is none of those that are known, or there are not three numbers. Ranges
            are looked at by :func:`dronepose.synth.make_plan`.

    Example:
        >>> Rules(max_distance_m=2).min_distance_m
        0.8
    """

    seed: int = 0
    min_distance_m: float = 0.8
    max_distance_m: float = 1.5
    stride: int = 1
    min_move_m: float = 0.01
    min_turn_deg: float = 0.5
    max_move_m: float = 0.5
    max_turn_deg: float = 20.0
    motion: Literal["any", "all"] = "any"
    anchor_cube_m: float = 0.5
    drone_cube_m: float = 0.6
    border: float = 0.25
    exo: Camera = EXO
    ego: Camera = EGO
    ego_down_deg: float = 0.0
    ego_offset_m: Sequence[float] = (0.0, 0.0, 0.0)
    model_axes: str = "flu"
    centroid_m: Sequence[float] = (0.0, 0.0, 0.0)
    whole_box_m: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "model_axes", axes("model_axes", self.model_axes))
        chosen("motion", self.motion, ("any", "all"))
        vector("ego_offset_m", self.ego_offset_m)
        vector("centroid_m", self.centroid_m)
        if self.whole_box_m is not None:
            if len(self.whole_box_m) != 2:
                raise ValueError(f"whole_box_m: expected two corners, got {self.whole_box_m!r}")
            for corner in self.whole_box_m:
                vector("whole_box_m", corner)
        for name in ("seed", "stride"):
            value = getattr(self, name)
            if int(value) != value or not 0 <= value < 2 ** (64 if name == "seed" else 32):
                raise ValueError(f"{name}: expected a whole number, 0 or more, got {value!r}")

    def facts(self) -> dict[str, Any]:
        """The settings as the manifest has them.

        Returns:
            Their values by name.

        Example:
            >>> Rules().facts()["exo"]["width"]
            320
        """
        return asdict(self)

    def encoded(self, prefix: str = "") -> str:
        """As JSON, for Rust.

        Args:
            prefix: What the ids begin with.

        Returns:
            The text.

        Raises:
            ValueError: A number is not finite.

        Example:
            >>> Rules(seed=3).encoded()[:10]
            '{"seed": 3'
        """
        settings = self.facts()
        del settings["ego"]
        return encode({**settings, "prefix": prefix})


@dataclass(frozen=True, slots=True)
class FunnelStep:
    """What one rule did.

    Args:
        rule: Its name.
        paper: Where the paper has it.
        came_in: Poses that came in.
        removed: Poses that it removed.
        asks: What it asks for, with the numbers of this run.
    """

    rule: str
    paper: str
    came_in: int
    removed: int
    asks: str

    @property
    def left(self) -> int:
        """Poses that it left.

        Example:
            >>> FunnelStep("distance", "section 3", 10, 4, "0.8 to 1.5 m").left
            6
        """
        return self.came_in - self.removed


@dataclass(frozen=True, slots=True)
class Funnel:
    """What each rule removed, in their order.

    Args:
        steps: The rules that were applied.
        pending: Rules that were not, because they need pictures.

    Example:
        >>> steps = [FunnelStep("distance", "section 3", 10, 4, "0.8 to 1.5 m")]
        >>> print(Funnel(steps, ()))
        rule      came in  removed  left  asks
        distance       10        4     6  0.8 to 1.5 m
    """

    steps: list[FunnelStep] = field(default_factory=list)
    pending: tuple[str, ...] = PIXEL_RULES

    def and_then(self, rule: str, removed: int, asks: str, paper: str = "section 3") -> Funnel:
        """The funnel with a rule more.

        Args:
            rule: Its name; no longer pending.
            removed: Poses that it removed.
            asks: What it asks for.
            paper: Where the paper has it.

        Returns:
            Another funnel.

        Raises:
            ValueError: It was applied before, or removed more than there were.

        Example:
            >>> funnel = Funnel([FunnelStep("pair", "section 3", 10, 4, "")])
            >>> funnel.and_then("hidden", 2, "half of the drone seen").steps[-1].left
            4
        """
        if any(step.rule == rule for step in self.steps):
            raise ValueError(f"rule: {rule!r} was applied before")
        came_in = self.steps[-1].left if self.steps else 0
        if not 0 <= removed <= came_in:
            raise ValueError(f"removed: expected 0 to {came_in}, got {removed}")
        step = FunnelStep(rule, paper, came_in, removed, asks)
        return Funnel([*self.steps, step], tuple(p for p in self.pending if p != rule))

    def facts(self) -> dict[str, Any]:
        """As for JSON.

        Returns:
            Steps and pending rules.

        Example:
            >>> Funnel().facts()
            {'steps': [], 'pending': ['hidden', 'invalid', 'blocked']}
        """
        steps = [{**asdict(step), "left": step.left} for step in self.steps]
        return {"steps": steps, "pending": list(self.pending)}

    def __str__(self) -> str:
        head = ("rule", "came in", "removed", "left", "asks")
        table = [head] + [
            (step.rule, str(step.came_in), str(step.removed), str(step.left), step.asks)
            for step in self.steps
        ]
        width = [max(len(row[k]) for row in table) for k in range(4)]
        lines = [
            f"{row[0]:<{width[0]}}  {row[1]:>{width[1]}}  {row[2]:>{width[2]}}  "
            f"{row[3]:>{width[3]}}  {row[4]}"
            for row in table
        ]
        if self.pending:
            lines.append(f"not yet applied, for they need pictures: {', '.join(self.pending)}")
        return "\n".join(lines)
