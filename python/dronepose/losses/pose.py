"""Losses of the pose itself, and the paper's weighting of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch

from dronepose.losses._batch import named, precise, reduced, same_dtype

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

    from dronepose.losses._batch import Reduction

AUTHORS_LAMBDA_POSE = 0.95
"""``lambda_pose`` in the code of DronePose's authors: 0.95 translation + 0.05 rotation."""

AUTHORS_LAMBDA_EXO = 0.1
"""``lambda_exo`` in the code of DronePose's authors: 0.9 pose + 0.1 silhouette."""


def translation_loss(
    t: Float[Tensor, "B 3"],
    t_gt: Float[Tensor, "B 3"],
    *,
    form: Literal["paper", "authors"] = "paper",
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
) -> Tensor:
    """Squared distance of the translations, ``|t_gt - t|^2`` (DronePose, section 4).

    The authors' code has the mean over the three components instead, a third of it.

    Args:
        t: ``(B, 3)``, predicted, metres.
        t_gt: ``(B, 3)``, true, metres.
        form: ``"paper"``, or ``"authors"`` for the mean over components.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.

    Returns:
        Square metres; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option unknown; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import translation_loss
        >>> t = torch.tensor([[0.0, 3, 4], [0, 0, 2]])
        >>> translation_loss(t, torch.zeros(2, 3), reduction="none").tolist()
        [25.0, 4.0]
    """
    named(t=t, t_gt=t_gt)
    _check_translations(t, t_gt)
    if form not in ("paper", "authors"):
        raise ValueError(f"form: expected 'paper' or 'authors', got {form!r}")
    t, t_gt = same_dtype(t, t_gt)
    squares = (t - t_gt).square()
    values = squares.sum(dim=1) if form == "paper" else squares.mean(dim=1)
    return reduced(values, reduction, weight)


def rotation_loss(
    R: Float[Tensor, "B 3 3"],
    R_gt: Float[Tensor, "B 3 3"],
    *,
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
) -> Tensor:
    """The angle of ``R_gt R^T``, ``arccos((trace - 1) / 2)`` (DronePose, section 4).

    Computed as ``atan2(|v|, trace - 1)`` with ``v`` the antisymmetric part of ``R_gt^T R``, which
    is the same angle but keeps its digits, and a gradient that is finite everywhere, at 0 and at pi
    (there ``v`` is 0, and 0 is taken for the derivative of its length). The arccosine's gradient is
    infinite at 0, that of ``roma.rotmat_geodesic_distance`` at pi.

    Args:
        R: ``(B, 3, 3)``, predicted rotations.
        R_gt: ``(B, 3, 3)``, true rotations.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.

    Returns:
        Radians in ``[0, pi]``; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong or an option unknown; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import rotation_loss
        >>> R = torch.tensor([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]])
        >>> round(rotation_loss(R, torch.eye(3)[None]).item(), 4)
        1.5708
    """
    named(R=R, R_gt=R_gt)
    _check_rotations(R, R_gt)
    R, R_gt = same_dtype(R, R_gt)
    # Products, not a matmul, which devices round to fewer digits.
    m = (R_gt[:, :, :, None] * R[:, :, None, :]).sum(dim=1)
    cosine = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2] - 1
    axis = torch.stack(
        [m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], dim=1
    )
    squared = axis.square().sum(dim=1)
    turned = squared > 0
    sine = torch.where(turned, torch.where(turned, squared, 1.0).sqrt(), 0.0)
    # Both are 0 for no rotation at all, such as a matrix of zeros.
    nowhere = (sine == 0) & (cosine == 0)
    values = torch.atan2(sine, torch.where(nowhere, torch.ones_like(cosine), cosine))
    return reduced(values, reduction, weight)


def pose_loss(
    R: Float[Tensor, "B 3 3"],
    t: Float[Tensor, "B 3"],
    R_gt: Float[Tensor, "B 3 3"],
    t_gt: Float[Tensor, "B 3"],
    *,
    lambda_pose: float = AUTHORS_LAMBDA_POSE,
    form: Literal["paper", "authors"] = "paper",
    reduction: Reduction = "mean",
    weight: Float[Tensor, " B"] | None = None,
) -> Tensor:
    """``lambda_pose * translation + (1 - lambda_pose) * rotation`` (DronePose, section 4).

    The paper gives no number; its authors' code has 0.95, with the mean over components.

    Args:
        R: ``(B, 3, 3)``, predicted rotations.
        t: ``(B, 3)``, predicted translations, metres.
        R_gt: ``(B, 3, 3)``, true rotations.
        t_gt: ``(B, 3)``, true translations, metres.
        lambda_pose: Share of the translation, 0 to 1.
        form: Of the translation, as in :func:`translation_loss`.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
        weight: ``(B,)``, a number for each sample, not negative.

    Returns:
        The sum of square metres and radians; ``()``, or ``(B,)`` for reduction ``"none"``.

    Raises:
        TypeError: An argument is no floating point tensor.
        ValueError: A shape is wrong, an option unknown or ``lambda_pose`` out of range; the message
            starts with the name.

    Example:
        >>> import torch
        >>> from dronepose.losses import pose_loss
        >>> R, t = torch.eye(3)[None], torch.tensor([[0.0, 0, 2]])
        >>> round(pose_loss(R, t, R, torch.zeros(1, 3), lambda_pose=0.75).item(), 6)
        3.0
    """
    _share("lambda_pose", lambda_pose)
    apart = translation_loss(t, t_gt, form=form, reduction="none")
    turned = rotation_loss(R, R_gt, reduction="none")
    if apart.shape != turned.shape:
        raise ValueError(f"t: expected shape ({len(turned)}, 3) for as many R, got {len(apart)}")
    with precise(apart):
        values = lambda_pose * apart + (1 - lambda_pose) * turned
    return reduced(values, reduction, weight)


def total_loss(pose: Tensor, exo: Tensor, *, lambda_exo: float = AUTHORS_LAMBDA_EXO) -> Tensor:
    """``(1 - lambda_exo) * pose + lambda_exo * exo`` (DronePose, section 4).

    The paper trains with ``lambda_exo`` from 0 (*Direct*) to 0.6; its authors' code has 0.1, and so
    ``0.9 (0.05 rotation + 0.95 translation) + 0.1 silhouette``.

    Args:
        pose: A loss of the pose, ``()`` or ``(B,)``.
        exo: A loss of the silhouette of the same shape.
        lambda_exo: Share of the silhouette, 0 to 1.

    Returns:
        The shape of the two.

    Raises:
        TypeError: A loss is no floating point tensor.
        ValueError: The shapes differ, or ``lambda_exo`` is out of range.

    Example:
        >>> import torch
        >>> from dronepose.losses import total_loss
        >>> total_loss(torch.tensor(2.0), torch.tensor(1.0), lambda_exo=0.25).item()
        1.75
    """
    named(pose=pose, exo=exo)
    _share("lambda_exo", lambda_exo)
    if pose.shape != exo.shape:
        raise ValueError(
            f"exo: expected shape {tuple(pose.shape)} as pose has it, got {tuple(exo.shape)}"
        )
    return (1 - lambda_exo) * pose + lambda_exo * exo


def _share(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise ValueError(f"{name}: expected a share from 0 to 1, got {value}")


def _check_translations(t: Tensor, t_gt: Tensor) -> None:
    if t.ndim != 2 or t.shape[0] == 0 or t.shape[1] != 3:
        raise ValueError(f"t: expected shape (B, 3) with B > 0, got {tuple(t.shape)}")
    if t_gt.shape != t.shape:
        raise ValueError(
            f"t_gt: expected shape {tuple(t.shape)} as t has it, got {tuple(t_gt.shape)}"
        )


def _check_rotations(R: Tensor, R_gt: Tensor) -> None:
    if R.ndim != 3 or R.shape[0] == 0 or R.shape[1:] != (3, 3):
        raise ValueError(f"R: expected shape (B, 3, 3) with B > 0, got {tuple(R.shape)}")
    if R_gt.shape != R.shape:
        raise ValueError(
            f"R_gt: expected shape {tuple(R.shape)} as R has it, got {tuple(R_gt.shape)}"
        )
