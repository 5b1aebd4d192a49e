"""Predictions of an epoch, judged as ``dronepose-eval`` would."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch.distributed
from torch import Tensor

from dronepose.evaluation import evaluate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dronepose.evaluation import Evaluation
    from dronepose.mesh import Mesh

_Poses = tuple[Tensor, Tensor]


class Judge:
    """Collects predictions, batch by batch, and scores them together.

    Args:
        mesh: The model, for ADD; without it there is none.
        preset: ``"paper"``, or ``"authors"`` for the averages of the authors' script.
    """

    def __init__(self, mesh: Mesh | None, *, preset: Literal["paper", "authors"] = "paper") -> None:
        self.mesh, self.preset = mesh, preset
        self.evaluation: Evaluation | None = None
        """The last one, on the first process."""
        self._rows: dict[str, tuple[np.ndarray[Any, Any], ...]] = {}

    def add(self, names: Sequence[str], predicted: _Poses, truth: _Poses) -> None:
        """Remember poses: ``R`` ``(B, 3, 3)`` and ``t`` ``(B, 3)`` metres, each twice."""
        arrays = [x.detach().cpu().double().numpy() for x in (*predicted, *truth)]
        for k, name in enumerate(names):
            self._rows[str(name)] = tuple(array[k] for array in arrays)

    def finish(self, processes: int = 1) -> dict[str, float] | None:
        """The metrics of Table 1 over all that was added, by name, and forget it.

        Args:
            processes: How many take part, each in this call; all get the result.

        Returns:
            As :func:`table_one`, or ``None`` if nothing was added. A sample that came twice,
            because each process is given as many, counts once. The order is that of the names.
        """
        rows, self._rows = self._rows, {}
        if processes > 1:
            shared: list[Any] = [None] * processes
            torch.distributed.all_gather_object(shared, rows)
            rows = {name: row for part in shared for name, row in part.items()}
        if not rows:
            return None
        names = sorted(rows)
        R, t, R_gt, t_gt = (np.stack([rows[name][k] for name in names]) for k in range(4))
        self.evaluation = evaluate(
            (R, t, names),
            (R_gt, t_gt, names),
            mesh=self.mesh,
            metrics=["add"] if self.mesh is not None else [],
            preset=self.preset,
            bootstrap=0,
        )
        return table_one(self.evaluation)


def table_one(evaluation: Evaluation) -> dict[str, float]:
    """The columns of the paper's Table 1, and the median errors.

    Recalls are in percent of the ground truth. With the authors' preset NPE, OE and CPE are means
    of the means of batches.
    """
    metrics, authors = evaluation.metrics, evaluation.authors
    found: dict[str, float] = {}
    for name in ("npe", "oe_rad", "cpe"):
        summary = getattr(metrics, name)
        found[name] = summary.mean if authors is None else getattr(authors, name)
    if metrics.oe_deg is not None and metrics.te_m is not None:
        found["oe_deg"] = metrics.oe_deg.mean
        found["te_m"] = metrics.te_m.mean
        found["oe_deg_median"] = metrics.oe_deg.median
        found["te_m_median"] = metrics.te_m.median
    for key in ("5", "10"):
        found[f"acc{key}"] = metrics.acc[key].percent_of_gt
        if metrics.add_recall is not None:
            found[f"add{key}"] = metrics.add_recall.at[key].percent_of_gt
    return found
