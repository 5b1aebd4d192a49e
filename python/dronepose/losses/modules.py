"""The losses as modules, and silhouette losses by name, for configurations."""

from __future__ import annotations

import inspect
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from dronepose.losses import overlap, pose, reach

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float


class _Loss(nn.Module):
    """A function with its options; an unknown or a wrong option is refused when it is made."""

    function: ClassVar[Callable[..., Tensor]]

    def __init__(self, **options: Any) -> None:
        super().__init__()
        known = [
            name
            for name, parameter in inspect.signature(self.function).parameters.items()
            if parameter.kind is parameter.KEYWORD_ONLY and name != "weight"
        ]
        for name in options:
            if name not in known:
                raise TypeError(f"{name}: expected one of the options {', '.join(known)}")
        self.options = options
        self._try()

    def _try(self) -> None:
        raise NotImplementedError

    def extra_repr(self) -> str:
        """The options, for ``repr``."""
        return ", ".join(f"{name}={value!r}" for name, value in self.options.items())


class _MaskLoss(_Loss):
    def _try(self) -> None:
        self(torch.zeros(1, 1, 1), torch.zeros(1, 1, 1))

    def forward(
        self,
        pred: Float[Tensor, "B H W"],
        target: Float[Tensor, "B H W"],
        weight: Float[Tensor, " B"] | None = None,
    ) -> Tensor:
        """The loss of masks.

        Args:
            pred: ``(B, H, W)`` in ``[0, 1]``.
            target: ``(B, H, W)`` in ``[0, 1]``.
            weight: ``(B,)``, a number for each sample, not negative.

        Returns:
            As the function.

        Raises:
            TypeError: As the function.
            ValueError: As the function.

        Example:
            >>> import torch
            >>> from dronepose.losses import IoULoss
            >>> IoULoss()(torch.ones(1, 4, 4), torch.zeros(1, 4, 4)).item()
            1.0
        """
        return type(self).function(pred, target, weight=weight, **self.options)


class IoULoss(_MaskLoss):
    """:func:`dronepose.losses.iou_loss` with its options.

    Example:
        >>> from dronepose.losses import IoULoss
        >>> IoULoss(eps=1e-10)
        IoULoss(eps=1e-10)
    """

    function = staticmethod(overlap.iou_loss)


class GIoULoss(_MaskLoss):
    """:func:`dronepose.losses.giou_loss` with its options."""

    function = staticmethod(overlap.giou_loss)


class SmoothLoss(_MaskLoss):
    """:func:`dronepose.losses.smooth_loss` with its options."""

    function = staticmethod(reach.smooth_loss)


class TanimotoLoss(_MaskLoss):
    """:func:`dronepose.losses.tanimoto_loss` with its options."""

    function = staticmethod(reach.tanimoto_loss)


class BlurredLoss(_MaskLoss):
    """:func:`dronepose.losses.blurred_loss` with its options; ``sigma`` has to be given."""

    function = staticmethod(reach.blurred_loss)

    def __init__(self, *, sigma: float, **options: Any) -> None:
        super().__init__(sigma=sigma, **options)


class OutlineLoss(_MaskLoss):
    """:func:`dronepose.losses.outline_loss` with its options."""

    function = staticmethod(reach.outline_loss)


class TranslationLoss(_Loss):
    """:func:`dronepose.losses.translation_loss` with its options."""

    function = staticmethod(pose.translation_loss)

    def _try(self) -> None:
        self(torch.zeros(1, 3), torch.zeros(1, 3))

    def forward(
        self,
        t: Float[Tensor, "B 3"],
        t_gt: Float[Tensor, "B 3"],
        weight: Float[Tensor, " B"] | None = None,
    ) -> Tensor:
        """The loss of translations.

        Args:
            t: ``(B, 3)``, predicted, metres.
            t_gt: ``(B, 3)``, true, metres.
            weight: ``(B,)``, a number for each sample, not negative.

        Returns:
            As the function.

        Raises:
            TypeError: As the function.
            ValueError: As the function.

        Example:
            >>> import torch
            >>> from dronepose.losses import TranslationLoss
            >>> TranslationLoss()(torch.ones(1, 3), torch.zeros(1, 3)).item()
            3.0
        """
        return type(self).function(t, t_gt, weight=weight, **self.options)


class RotationLoss(_Loss):
    """:func:`dronepose.losses.rotation_loss` with its options."""

    function = staticmethod(pose.rotation_loss)

    def _try(self) -> None:
        self(torch.eye(3)[None], torch.eye(3)[None])

    def forward(
        self,
        R: Float[Tensor, "B 3 3"],
        R_gt: Float[Tensor, "B 3 3"],
        weight: Float[Tensor, " B"] | None = None,
    ) -> Tensor:
        """The loss of rotations.

        Args:
            R: ``(B, 3, 3)``, predicted rotations.
            R_gt: ``(B, 3, 3)``, true rotations.
            weight: ``(B,)``, a number for each sample, not negative.

        Returns:
            As the function.

        Raises:
            TypeError: As the function.
            ValueError: As the function.

        Example:
            >>> import torch
            >>> from dronepose.losses import RotationLoss
            >>> RotationLoss()(torch.eye(3)[None], torch.eye(3)[None]).item()
            0.0
        """
        return type(self).function(R, R_gt, weight=weight, **self.options)


class PoseLoss(_Loss):
    """:func:`dronepose.losses.pose_loss` with its options."""

    function = staticmethod(pose.pose_loss)

    def _try(self) -> None:
        R, t = torch.eye(3)[None], torch.zeros(1, 3)
        self(R, t, R, t)

    def forward(
        self,
        R: Float[Tensor, "B 3 3"],
        t: Float[Tensor, "B 3"],
        R_gt: Float[Tensor, "B 3 3"],
        t_gt: Float[Tensor, "B 3"],
        weight: Float[Tensor, " B"] | None = None,
    ) -> Tensor:
        """The loss of poses.

        Args:
            R: ``(B, 3, 3)``, predicted rotations.
            t: ``(B, 3)``, predicted translations, metres.
            R_gt: ``(B, 3, 3)``, true rotations.
            t_gt: ``(B, 3)``, true translations, metres.
            weight: ``(B,)``, a number for each sample, not negative.

        Returns:
            As the function.

        Raises:
            TypeError: As the function.
            ValueError: As the function.

        Example:
            >>> import torch
            >>> from dronepose.losses import PoseLoss
            >>> R, t = torch.eye(3)[None], torch.ones(1, 3)
            >>> PoseLoss(lambda_pose=0.5)(R, t, R, torch.zeros(1, 3)).item()
            1.5
        """
        return type(self).function(R, t, R_gt, t_gt, weight=weight, **self.options)


class TotalLoss(_Loss):
    """:func:`dronepose.losses.total_loss` with its option; a schedule may set ``lambda_exo``.

    Example:
        >>> import torch
        >>> from dronepose.losses import TotalLoss
        >>> total = TotalLoss(lambda_exo=0.1)
        >>> total.lambda_exo = 0.5
        >>> total(torch.tensor(2.0), torch.tensor(1.0)).item()
        1.5
    """

    function = staticmethod(pose.total_loss)

    def _try(self) -> None:
        self(torch.zeros(()), torch.zeros(()))

    @property
    def lambda_exo(self) -> float:
        """Share of the silhouette, 0 to 1.

        Example:
            >>> from dronepose.losses import TotalLoss
            >>> TotalLoss().lambda_exo
            0.1
        """
        share: float = self.options.get("lambda_exo", pose.AUTHORS_LAMBDA_EXO)
        return share

    @lambda_exo.setter
    def lambda_exo(self, value: float) -> None:
        self.options["lambda_exo"] = value

    def forward(self, pose: Tensor, exo: Tensor) -> Tensor:
        """The weighted sum.

        Args:
            pose: A loss of the pose, ``()`` or ``(B,)``.
            exo: A loss of the silhouette of the same shape.

        Returns:
            As the function.

        Raises:
            TypeError: As the function.
            ValueError: As the function.

        Example:
            >>> import torch
            >>> from dronepose.losses import TotalLoss
            >>> TotalLoss(lambda_exo=0.5)(torch.tensor(2.0), torch.tensor(1.0)).item()
            1.5
        """
        return type(self).function(pose, exo, **self.options)


_BY_NAME: dict[str, Callable[..., nn.Module]] = {
    "iou": IoULoss,
    "giou": GIoULoss,
    "box": partial(SmoothLoss, kernel="box"),
    "gaussian": partial(SmoothLoss, kernel="gaussian"),
    "tanimoto": TanimotoLoss,
    "blurred": BlurredLoss,
    "outline": OutlineLoss,
}


def silhouette_loss(name: str, **options: Any) -> nn.Module:
    """A silhouette loss by name, as training configurations choose one.

    Args:
        name: ``"iou"``, ``"giou"``, ``"box"`` or ``"gaussian"`` (the smooth loss with that kernel),
            ``"tanimoto"``, ``"blurred"`` or ``"outline"``.
        options: Those of the function, such as ``size`` and ``sigma``.

    Returns:
        A module that takes ``pred`` and ``target``, ``(B, H, W)``, and a ``weight``, ``(B,)``.

    Raises:
        TypeError: An option is unknown or missing.
        ValueError: The name is unknown, or an option out of range.

    Example:
        >>> import torch
        >>> from dronepose.losses import silhouette_loss
        >>> loss = silhouette_loss("gaussian", size=35, sigma="authors")
        >>> loss
        SmoothLoss(kernel='gaussian', size=35, sigma='authors')
        >>> loss(torch.zeros(2, 24, 32), torch.zeros(2, 24, 32)).item()
        0.0
    """
    if name not in _BY_NAME:
        raise ValueError(f"name: expected one of {', '.join(_BY_NAME)}, got {name!r}")
    return _BY_NAME[name](**options)
