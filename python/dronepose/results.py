"""What an evaluation says, as dataclasses: the layout of ``dronepose-eval --json``.

The mirror of ``crates/raster/src/eval/results.rs``; ``docs/json.md`` documents the same keys for
readers of the JSON. A value that could not be computed is ``None`` here and absent there.
Translations are in the OpenCV camera frame; units are in the names.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from dronepose._decode import decode

SCHEMA = "dronepose-eval/1"

#: Lower and upper end of an interval.
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Mean, spread and order statistics of an error over the matched samples."""

    mean: float
    """Arithmetic mean."""
    median: float
    """Median (mean of the two middle values for an even count)."""
    std: float
    """Population standard deviation (divided by n)."""
    min: float
    """Smallest value."""
    max: float
    """Largest value."""
    p90: float
    """90th percentile, linearly interpolated."""
    p95: float
    """95th percentile, linearly interpolated."""
    rmse: float
    """Root of the mean square."""
    n_undefined: int = 0
    """Samples left out because the error is not defined for them (projections of points at or
    behind the camera); absent when zero. They count as wrong in every recall."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recall:
    """How many samples pass a threshold."""

    count: int
    """Samples that pass."""
    percent_of_gt: float
    """Percent of all ground-truth poses (a missing prediction fails)."""
    percent_of_matched: float | None = None
    """Percent of the matched poses; absent if none is matched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceRecall:
    """Recall of a vertex distance at fractions of a reference length."""

    reference: str
    """``bbox-diagonal``, ``diameter`` or ``metres``."""
    reference_m: float | None = None
    """The reference length in metres; absent if objects of different size were scored
    together."""
    reference_m_by_object: dict[str, float] = field(default_factory=dict)
    """The reference length of each object, if they differ."""
    at: dict[str, Recall] = field(metadata={"flatten": True})
    """Percentage as the user wrote it -> recall."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Auc:
    """Area under the recall curve up to 10 cm, in ``[0, 1]``, over all ground truth."""

    exact: float
    """Exact area: mean of ``max(0, 1 - e / 0.1)``."""
    ycb: float
    """YCB-Video's form, which takes the right edge of every step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedPlus:
    """SPEED+ score (SPEC2021) and its two terms."""

    score: float
    """``e_t + e_q_rad``."""
    e_t: float
    """Mean normalised position error, values below 2.173e-3 counted as zero."""
    e_q_rad: float
    """Mean orientation error in radians, values below 0.169 degrees counted as zero."""
    zeroed_t: int
    """Position errors counted as zero."""
    zeroed_q: int
    """Orientation errors counted as zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Speed:
    """SPEED score (Kelvins 2019): the mean CPE."""

    score: float
    """Mean of normalised position error plus orientation error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bop:
    """Average recalls of the BOP challenge."""

    ar_mssd: float | None = None
    """MSSD at 5 %, 10 %, ... 50 % of the diameter."""
    ar_mspd: float | None = None
    """MSPD at 5, 10, ... 50 pixels of a 640 pixel wide image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metrics:
    """Every metric; one that could not be computed from the inputs is absent."""

    npe: Summary | None = None
    """Normalised position error."""
    oe_rad: Summary | None = None
    """Orientation error in radians."""
    oe_deg: Summary | None = None
    """Orientation error in degrees."""
    te_m: Summary | None = None
    """Translation error in metres."""
    cpe: Summary | None = None
    """Combined pose error, NPE + OE."""
    oe_sym_deg: Summary | None = None
    """Orientation error to the nearest symmetric pose, degrees (objects with symmetries)."""
    add_m: Summary | None = None
    """Average distance of corresponding vertices, metres."""
    adds_m: Summary | None = None
    """Average distance to the nearest vertex, metres."""
    mssd_m: Summary | None = None
    """Maximum symmetry-aware surface distance, metres."""
    mspd_px: Summary | None = None
    """Maximum symmetry-aware projection distance, pixels."""
    proj_px: Summary | None = None
    """Mean projection error of the vertices, pixels."""
    acc: dict[str, Recall]
    """Accuracy at X degrees and X centimetres; the key is X."""
    add_recall: ReferenceRecall | None = None
    """Recall of ADD ("6D Pose-k" in the paper)."""
    adds_recall: ReferenceRecall | None = None
    """Recall of ADD-S."""
    add_auc: Auc | None = None
    """Area under the ADD curve."""
    adds_auc: Auc | None = None
    """Area under the ADD-S curve."""
    proj_recall_5px: Recall | None = None
    """Recall of the mean projection error at 5 pixels."""
    speedplus: SpeedPlus | None = None
    """SPEED+ score."""
    speed: Speed | None = None
    """SPEED 2019 score."""
    bop: Bop | None = None
    """BOP average recalls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Intervals:
    """95 % confidence intervals of means and of recalls (percent of ground truth)."""

    method: str
    """``percentile bootstrap``."""
    resamples: int
    """Number of resamples."""
    seed: int
    """Seed of the resampling."""
    mean: dict[str, Interval] = field(metadata={"flatten": True})
    """Metric key (``npe``, ``oe_rad``, ``oe_deg``, ``te_m``, ``cpe``, ``add_m``, ...) -> interval
    of its mean."""
    acc: dict[str, Interval]
    """X -> interval of the accuracy in percent of ground truth."""
    add_recall: dict[str, Interval] = field(default_factory=dict)
    """k -> interval of the ADD recall in percent of ground truth."""
    adds_recall: dict[str, Interval] = field(default_factory=dict)
    """k -> interval of the ADD-S recall in percent of ground truth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Authors:
    """The averages that the authors' script prints.

    Means of batch means over the matched samples in file order, in which a short last batch
    weighs as much as a full one.
    """

    batch_size: int
    """Samples in a batch."""
    n_batches: int
    """Number of batches."""
    npe: float
    """Mean of batch means of NPE."""
    oe_rad: float
    """Mean of batch means of OE in radians."""
    cpe: float
    """Mean of batch means of CPE."""
    acc: dict[str, float]
    """X -> mean of batch means of AccX in percent."""
    add_recall: dict[str, float] = field(default_factory=dict)
    """k -> mean of batch means of 6D Pose-k in percent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """One group of a ``Breakdown``."""

    label: str
    """What to print: a range such as ``1 to 1.5``, or a value of the column."""
    from_: float | None = field(default=None, metadata={"key": "from"})
    """Lower edge (inclusive) of a numeric range."""
    to: float | None = None
    """Upper edge of a numeric range."""
    n_gt: int
    """Ground-truth poses in the group."""
    n_matched: int
    """Those with a prediction."""
    npe: float | None = None
    """Mean NPE over the matched samples; absent (with the next four) if none is matched."""
    oe_deg: float | None = None
    """Mean OE in degrees."""
    te_m: float | None = None
    """Mean translation error in metres."""
    cpe: float | None = None
    """Mean CPE."""
    add_m: float | None = None
    """Mean ADD in metres."""
    acc: dict[str, float]
    """X -> AccX in percent of ground truth."""
    add_recall: dict[str, float] = field(default_factory=dict)
    """k -> ADD recall in percent of ground truth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Breakdown:
    """The samples split by a quantity."""

    column: str
    """``distance``, ``azimuth``, ``elevation`` or the name of a column."""
    unit: str
    """Unit of the edges, empty where there is none."""
    groups: list[Group]
    """The groups in order; none is empty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstSample:
    """One of the worst samples by CPE."""

    id: str
    """The sample's id."""
    line: int | None = None
    """Line of the prediction in its file, where the format has lines."""
    cpe: float
    """Combined pose error."""
    npe: float
    """Normalised position error."""
    oe_deg: float
    """Orientation error in degrees."""
    te_m: float
    """Translation error in metres."""
    add_m: float | None = None
    """ADD in metres."""
    distance_m: float
    """Distance of the model from the camera in metres."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFile:
    """One file that was read."""

    path: str
    """Path as given."""
    format: str
    """``csv``, ``bop-csv``, ``bop-json``, ``speed-csv``, ``speed-json``, ``obj``, ``ply``,
    ``stl``, ``json``, ``array``."""
    sha256: str
    """SHA-256 of the bytes as read from disk, in hexadecimal."""
    bytes: int
    """Size in bytes as read from disk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A difference of means, or of recalls in percent, with its paired bootstrap."""

    mean: float
    """Mean of the paired differences."""
    ci95: Interval | None = None
    """95 % interval of the paired bootstrap."""
    p: float | None = None
    """Two-sided bootstrap p-value of "no difference"."""
    n: int
    """Samples in the comparison: those that both predict for a mean, all ground truth for a
    recall."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Another method on the same ground truth, and its difference to the first one."""

    name: str
    """Name of the method."""
    input: InputFile
    """Its file."""
    n_predictions: int
    """Predicted poses in the file."""
    n_matched: int
    """Ground-truth poses with a prediction."""
    metrics: Metrics
    """All metrics."""
    ci95: Intervals | None = None
    """95 % confidence intervals."""
    difference: dict[str, Difference]
    """Differences, this method minus the first. Of means, over the samples that both predict; key
    as in ``Intervals``. Of recalls, in percent of all ground truth: ``acc_X``, ``add_recall_k``,
    ``adds_recall_k``."""
    warnings: list[str] = field(default_factory=list)
    """Warnings about this file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """The files behind the numbers."""

    predictions: InputFile
    """The predictions."""
    gt: InputFile
    """The ground truth."""
    mesh: list[InputFile] = field(default_factory=list)
    """The mesh or meshes."""
    symmetries: InputFile | None = None
    """The symmetries."""
    camera: InputFile | None = None
    """The camera, if it came from a file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Every choice that influences a number."""

    preset: str
    """``paper``, ``authors``, ``bop`` or ``speedplus``."""
    unit_predictions: str
    """Unit of the translations of the predictions, ``m`` or ``mm``."""
    unit_gt: str
    """Unit of the translations of the ground truth."""
    mesh_unit: str
    """Unit of the mesh."""
    acc: list[float]
    """X of the AccX."""
    add: list[float]
    """k of the 6D Pose-k."""
    add_reference: str
    """``bbox-diagonal``, ``diameter`` or a length in metres."""
    camera: str | None = None
    """``fx,fy,cx,cy,W,H`` or the camera file."""
    n_symmetries: int
    """Number of symmetry transforms, the identity included."""
    bootstrap: int
    """Resamples of the bootstrap; 0 for none."""
    seed: int
    """Seed of the bootstrap."""
    up: str
    """The model's up axis, which azimuth and elevation refer to: ``y`` or ``z``."""
    strict: bool
    """Whether warnings were errors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Result of scoring one file of predictions, with the comparisons made beside it.

    Made by :func:`dronepose.evaluate`; ``str()`` of it is the table of the command line.

    Example:
        >>> from dronepose import evaluate
        >>> result = evaluate("examples/predictions.csv", "examples/gt.csv", bootstrap=0)
        >>> result.metrics.acc["5"].count, result.n_gt
        (1686, 2000)
    """

    schema: str
    """"dronepose-eval/1"."""
    version: str
    """Version of this crate."""
    name: str
    """Name of the method: the file name of the predictions without directories."""
    n_gt: int
    """Ground-truth poses."""
    n_predictions: int
    """Predicted poses in the file, matched or not."""
    n_matched: int
    """Ground-truth poses with a prediction."""
    metrics: Metrics
    """All metrics."""
    ci95: Intervals | None = None
    """95 % confidence intervals, if they were computed."""
    authors: Authors | None = None
    """Averages the way the authors' training script prints them (``--preset authors``)."""
    by: list[Breakdown] = field(default_factory=list)
    """Breakdowns asked for by ``--by``."""
    worst: list[WorstSample]
    """The worst samples, worst first."""
    compare: list[Comparison] = field(default_factory=list)
    """Other methods on the same ground truth (``--compare``)."""
    inputs: Inputs
    """The files that were read."""
    settings: Settings
    """Every choice that influences a number."""
    warnings: list[str]
    """What the user should know; each is one sentence."""
    notes: list[str] = field(default_factory=list)
    """What was left out by default, and how to get it; each is one sentence."""

    _json: str = field(repr=False, compare=False, metadata={"internal": True})
    _table: str = field(repr=False, compare=False, metadata={"internal": True})

    @classmethod
    def from_json(cls, text: str, table: str = "") -> Evaluation:
        """From the text that ``dronepose-eval --json`` writes.

        Args:
            text: The JSON.
            table: What :meth:`table` shall return.

        Returns:
            The evaluation.

        Raises:
            ValueError: The text is no JSON of this layout.

        Example:
            >>> from dronepose import Evaluation, evaluate
            >>> result = evaluate("examples/predictions.csv", "examples/gt.csv", bootstrap=0)
            >>> Evaluation.from_json(result.to_json()) == result
            True
        """
        data = json.loads(text)
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            found = data.get("schema") if isinstance(data, dict) else type(data).__name__
            raise ValueError(f"schema: expected {SCHEMA!r}, got {found!r}")
        return decode(cls, data, {"_json": text, "_table": table})

    def to_dict(self) -> dict[str, Any]:
        """Exactly the JSON of the command line, as dictionaries and lists.

        Returns:
            A fresh copy; absent values have no key.

        Example:
            >>> from dronepose import evaluate
            >>> result = evaluate("examples/gt.csv", "examples/gt.csv", bootstrap=0)
            >>> result.to_dict()["metrics"]["npe"]["mean"]
            0.0
        """
        data: dict[str, Any] = json.loads(self._json)
        return data

    def to_json(self) -> str:
        """The JSON of the command line, as text.

        Example:
            >>> import json
            >>> from dronepose import evaluate
            >>> result = evaluate("examples/gt.csv", "examples/gt.csv", bootstrap=0)
            >>> json.loads(result.to_json())["schema"]
            'dronepose-eval/1'
        """
        return self._json

    def table(self) -> str:
        """The table that the command line prints, without colours.

        Example:
            >>> from dronepose import evaluate
            >>> result = evaluate("examples/gt.csv", "examples/gt.csv", bootstrap=0)
            >>> "NPE" in result.table()
            True
        """
        return self._table

    def __str__(self) -> str:
        return self._table
