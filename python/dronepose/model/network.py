"""The network of DronePose: one image in, the pose of the drone out."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import roma  # type: ignore[import-untyped,unused-ignore]
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dronepose.model.backbones import backbone as build_backbone

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from jaxtyping import Float

__all__ = ["PoseNet", "PoseOutput"]

Normalisation = Literal["none", "imagenet"]
_MEAN = (0.485, 0.456, 0.406)  # of ImageNet, as torchvision documents for its weights
_STD = (0.229, 0.224, 0.225)
#: Bound of the log-depth of the camera-aware head: exp(8) is about 3000. It is approached smoothly,
#: so that a network that is far off keeps a gradient.
_LOG_DEPTH = 8.0


class PoseOutput(NamedTuple):
    """Poses ``cam_from_model`` in the OpenCV camera frame.

    Attributes:
        R: ``(B, 3, 3)`` rotations.
        t: ``(B, 3)`` translations, metres.
    """

    R: Tensor
    t: Tensor


class PoseNet(nn.Module):
    """Backbone, fully connected layers with ELU, and heads for rotation and translation.

    The layers are those of the authors' code (VCL3D/DronePose, ``models/__init__.py`` and
    ``models/continuous.py``): the pooled features go through a linear layer to ``hidden[0]``
    *without* an activation, then linear layers to ``hidden[1:]``, each with ELU. The rotation head
    has no bias; its six numbers are the first two columns of a matrix, made orthonormal by
    Gram-Schmidt (Zhou et al., CVPR 2019). The heads are computed in float32 at least, also under
    autocast.

    With ``camera=None`` the three outputs ``a, b, c`` of the translation head are ``t`` in metres,
    as in the paper: the network knows one camera only. With ``camera="normalised"`` they say what
    can be seen in an image without its camera, where the origin of the model is in the image and
    how large a metre there is, and ``K`` turns them into a pose::

        u = W (1/2 + a)                  v = H (1/2 + b)
        z = sqrt(fx fy / (W H)) exp(c / (1 + |c| / 8))
        y = z (v - cy) / fy              x = z (u - cx - skew y / z) / fx

    and the rotation head gives the rotation as seen along the ray through ``t`` (allocentric; Kundu
    et al., "3D-RCNN", CVPR 2018): ``R = Q R_seen``, where ``Q`` is the smallest rotation that takes
    the optical axis to ``t``. So an image that is scaled, or looked at through another focal length
    or cropped elsewhere, with the ``K`` that belongs to it, gives a pose that fits what it shows.

    Args:
        backbone: Name of a torchvision network; :func:`dronepose.model.backbone_names`.
        weights: ``None`` for random weights from torch's generator, or a file as
            :func:`dronepose.model.load_weights` takes it: of the whole network, or of the backbone
            alone as torchvision publishes them (the layers behind it stay random).
        hidden: Widths of the fully connected layers, at least one.
        normalisation: ``"none"`` for images in ``[0, 1]`` as they are (the authors), or
            ``"imagenet"`` for minus mean, by standard deviation of ImageNet.
        camera: ``None`` or ``"normalised"``, see above.

    Raises:
        TypeError: An argument is of a wrong type.
        ValueError: An argument is unknown or out of its range; the message starts with its name.
        OSError: The file of weights cannot be read.

    Example:
        >>> import torch
        >>> from dronepose.model import PoseNet
        >>> net = PoseNet("resnet18", hidden=(32, 16)).eval()
        >>> with torch.no_grad():
        ...     R, t = net(torch.rand(2, 3, 48, 64))
        >>> R.shape, t.shape
        (torch.Size([2, 3, 3]), torch.Size([2, 3]))
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        backbone: str = "resnet34",
        *,
        weights: str | os.PathLike[str] | None = None,
        hidden: Sequence[int] = (2048, 1024, 512, 128),
        normalisation: Normalisation = "none",
        camera: Literal["normalised"] | None = None,
    ) -> None:
        super().__init__()
        if normalisation not in ("none", "imagenet"):
            raise ValueError(f"normalisation: expected 'none' or 'imagenet', got {normalisation!r}")
        if camera not in (None, "normalised"):
            raise ValueError(f"camera: expected None or 'normalised', got {camera!r}")
        widths = _widths(hidden)
        self.backbone, features = build_backbone(backbone)
        self.embedding = nn.Linear(features, widths[0])
        self.layers = nn.ModuleList(nn.Linear(m, n) for m, n in pairwise(widths))
        self.translation = nn.Linear(widths[-1], 3)
        self.rotation = nn.Linear(widths[-1], 6, bias=False)
        self.register_buffer("mean", torch.tensor(_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(_STD).view(3, 1, 1), persistent=False)
        self.normalisation = normalisation
        self.camera = camera
        self._architecture: dict[str, Any] = {
            "backbone": backbone,
            "hidden": widths,
            "normalisation": normalisation,
            "camera": camera,
        }
        if weights is not None:
            from dronepose.model.weights import load_weights

            load_weights(self, weights)

    @property
    def architecture(self) -> dict[str, Any]:
        """The arguments that build this network again, without weights; can be written as JSON.

        Example:
            >>> from dronepose.model import PoseNet
            >>> PoseNet("resnet18", hidden=[16]).architecture["hidden"]
            [16]
        """
        return {**self._architecture, "hidden": list(self._architecture["hidden"])}

    def forward(
        self,
        image: Float[Tensor, "B 3 H W"],
        K: Float[Tensor, "*B 3 3"] | None = None,
    ) -> PoseOutput:
        """The pose of the drone in each image.

        Args:
            image: ``(B, 3, H, W)`` floating point, RGB in ``[0, 1]``.
            K: ``(3, 3)`` or ``(B, 3, 3)`` in pixels of these images, pixel centres at ``+ 0.5``;
                needed and used with ``camera="normalised"`` only.

        Returns:
            Rotations and translations (metres) of ``cam_from_model``, float32 or float64.

        Raises:
            TypeError: ``image`` is no tensor of floating point numbers.
            ValueError: A shape is wrong, or ``K`` is missing.

        Example:
            A network that is aware of the camera sees the same picture through twice the focal
            length as twice as far away:

            >>> import torch
            >>> from dronepose.model import PoseNet
            >>> net = PoseNet("resnet18", hidden=(16,), camera="normalised").eval()
            >>> image = torch.rand(1, 3, 48, 64)
            >>> K = torch.tensor([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
            >>> K2 = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
            >>> with torch.no_grad():
            ...     (net(image, K2).t[0, 2] / net(image, K).t[0, 2]).round(decimals=4).item()
            2.0
        """
        self._check(image, K)
        height, width = image.shape[2], image.shape[3]
        if self.normalisation == "imagenet":
            image = (image - self.mean) / self.std
        x = self.embedding(self.backbone(image))
        for layer in self.layers:
            x = F.elu(layer(x))
        with torch.autocast(x.device.type, enabled=False):
            if x.dtype in (torch.float16, torch.bfloat16):
                x = x.float()
            dtype = x.dtype
            t = F.linear(x, self.translation.weight.to(dtype), self.translation.bias.to(dtype))
            six = F.linear(x, self.rotation.weight.to(dtype))
            columns = torch.stack([six[:, :3], six[:, 3:]], dim=-1)
            # The clamp only keeps zero vectors from becoming NaN.
            R = roma.special_gramschmidt(columns, epsilon=1e-12)
            if self.camera is not None and K is not None:
                t = from_image(t, K.to(dtype), height, width)
                R = smallest_rotation_to(t) @ R
        return PoseOutput(R, t)

    def _check(self, image: Tensor, K: Tensor | None) -> None:
        if not isinstance(image, Tensor):
            raise TypeError(f"image: expected a torch.Tensor, got {type(image).__name__}")
        if not image.is_floating_point():
            raise TypeError(
                f"image: expected floating point numbers in [0, 1], got {image.dtype}; "
                "divide bytes by 255"
            )
        if image.ndim != 4 or image.shape[1] != 3:
            raise ValueError(f"image: expected shape (B, 3, H, W), got {tuple(image.shape)}")
        if self.camera is None:
            return
        if K is None:
            raise ValueError("K: this network is aware of the camera and needs its matrix")
        one = K.ndim == 2
        many = K.ndim == 3 and (K.shape[0] == image.shape[0])
        if not (one or many) or K.shape[-2] != 3 or K.shape[-1] != 3:
            raise ValueError(
                f"K: expected shape (3, 3) or ({image.shape[0]}, 3, 3), got {tuple(K.shape)}"
            )


def from_image(
    abc: Float[Tensor, "B 3"], K: Float[Tensor, "*B 3 3"], height: int, width: int
) -> Float[Tensor, "B 3"]:
    """Offset in the image and log-depth to a translation; the formula is in :class:`PoseNet`."""
    fx, fy, skew = K[..., 0, 0], K[..., 1, 1], K[..., 0, 1]
    cx, cy = K[..., 0, 2], K[..., 1, 2]
    a, b, c = abc.unbind(dim=-1)
    z = torch.sqrt(fx * fy / (width * height)) * (c / (1 + c.abs() / _LOG_DEPTH)).exp()
    v = (height * (0.5 + b) - cy) / fy
    u = (width * (0.5 + a) - cx - skew * v) / fx
    return torch.stack([u * z, v * z, z], dim=-1)


def smallest_rotation_to(t: Float[Tensor, "B 3"]) -> Float[Tensor, "B 3 3"]:
    """The rotation by the smallest angle that takes ``(0, 0, 1)`` to the direction of ``t``.

    Rodrigues' formula with axis ``(0, 0, 1) x d`` and cosine ``d_z``; ``t_z`` above zero.
    """
    x, y, z = F.normalize(t, dim=-1).unbind(dim=-1)
    k = 1.0 / (1.0 + z)
    rows = [1.0 - k * x * x, -k * x * y, x, -k * x * y, 1.0 - k * y * y, y, -x, -y, z]
    return torch.stack(rows, dim=-1).view(-1, 3, 3)


def _widths(hidden: Sequence[int]) -> list[int]:
    try:
        widths = [float(n) for n in hidden]
    except (TypeError, ValueError):
        widths = []
    if not widths or not all(math.isfinite(n) and n == int(n) and n >= 1 for n in widths):
        raise ValueError(f"hidden: expected at least one width of 1 or more, got {hidden!r}")
    return [int(n) for n in widths]
