"""Networks of torchvision, without their classifiers: images in, one vector each out."""

from __future__ import annotations

import difflib

import torch
import torchvision  # type: ignore[import-untyped,unused-ignore]
from torch import nn

__all__ = ["backbone", "backbone_names"]

# Families that end in feature maps which can be averaged, and have one output in training too.
_FAMILIES = (
    "alexnet", "convnext", "densenet", "efficientnet", "mnasnet", "mobilenet", "regnet", "resnet",
    "resnext", "shufflenet", "squeezenet", "vgg", "wide_resnet",
)  # fmt: skip


def backbone_names() -> list[str]:
    """The names that ``PoseNet(backbone=...)`` takes.

    Returns:
        Names of torchvision, sorted.

    Example:
        >>> "resnet34" in backbone_names(), "vit_b_16" in backbone_names()
        (True, False)
    """
    names: list[str] = torchvision.models.list_models(module=torchvision.models)
    return sorted(name for name in names if name.startswith(_FAMILIES))


def backbone(name: str) -> tuple[nn.Module, int]:
    """A network with random weights whose output is the mean of its last feature maps.

    Args:
        name: One of :func:`backbone_names`.

    Returns:
        The module, ``(B, 3, H, W)`` to ``(B, C)``, and ``C``. Its parameters are named as in
        torchvision.

    Raises:
        TypeError: The name is no text.
        ValueError: The name is unknown; the message lists the known ones.

    Example:
        >>> backbone("resnet18")[1]
        512
    """
    if not isinstance(name, str):
        raise TypeError(f"backbone: expected a name, got {type(name).__name__}")
    names = backbone_names()
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"backbone: {name!r} is not one of {', '.join(names)}{hint}")
    network: nn.Module = torchvision.models.get_model(name, weights=None)
    head = getattr(network, "fc", None)
    if isinstance(head, nn.Linear):
        network.fc = nn.Identity()
        return network, head.in_features
    pooled = Pooled(network)
    with torch.no_grad():
        pooled.eval()
        channels = pooled(torch.zeros(1, 3, 64, 64)).shape[1]
        pooled.train()
    return pooled, channels


class Pooled(nn.Module):
    """The feature maps of a torchvision network, averaged over the image.

    Args:
        network: With ``features`` or ``layers``, whose output is ``(B, C, h, w)``.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.part = "features" if hasattr(network, "features") else "layers"
        self.add_module(self.part, getattr(network, self.part))
        # DenseNet applies its last ReLU outside of its features.
        self.last = nn.ReLU() if isinstance(network, torchvision.models.DenseNet) else nn.Identity()

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """``(B, 3, H, W)`` to ``(B, C)``."""
        maps: torch.Tensor = self.last(getattr(self, self.part)(image))
        return maps.mean(dim=(2, 3))
