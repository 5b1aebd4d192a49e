"""Differentiable silhouettes as a torch operator; the arithmetic is in Rust, on the CPU.

What each ``mode`` draws, frames and units are those of :mod:`dronepose.render`. Everything is
computed in float64, but for modes ``"dibr"`` and ``"sigmoid"`` of float32 arguments; the dtype of
the arguments is that of masks and gradients. Each function says what it takes; needs
``pip install "dronepose[torch]"``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

try:
    import torch
except ImportError as error:
    raise ImportError(
        'dronepose.torch needs PyTorch, which is not installed: pip install "dronepose[torch]"'
    ) from error

from torch import Tensor, nn

from dronepose._softness import (
    from_kaolin,
    from_pytorch3d,
    image_size,
    settings,
    thread_count,
)
from dronepose.torch._ops import silhouette_op

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from dronepose._softness import Mode
    from dronepose.mesh import Mesh

__all__ = ["SoftSilhouette", "from_kaolin", "from_pytorch3d", "silhouette", "tangent"]


def silhouette(
    vertices: Float[Tensor, "*B V 3"],
    faces: Int[Tensor, "F 3"],
    R: Float[Tensor, "B 3 3"],
    t: Float[Tensor, "B 3"],
    K: Float[Tensor, "*B 3 3"],
    height: int,
    width: int,
    *,
    mode: Mode = "coverage",
    sigma: float = 0.0,
    delta: float = 7000.0,
    sigma_ndc: float = 1e-4,
    near: float | None = None,
    kaolin_cutoff: tuple[float, int | None] | None = None,
    pytorch3d_cutoff: tuple[float, int] | None = None,
    check_finite: bool = False,
    num_threads: int = 0,
) -> Float[Tensor, "B {height} {width}"]:
    """Masks of a mesh under many poses, differentiable in its vertices, the poses and the camera.

    One operator for autograd, ``torch.compile`` (without graph break; compiled again for each new
    ``sigma``) and autocast; it releases the GIL. Half precision is computed from float32 copies and
    gives float32 masks. Nothing is kept for each pixel and face: the backward pass draws again. The
    same bits for any ``num_threads``. Second derivatives are refused.

    Works in forked and in spawned workers of a ``DataLoader``; there, ``num_threads=1`` leaves the
    cores to the other workers.

    CUDA tensors are accepted and moved to the CPU and back, which waits for the device.

    The last few meshes are kept prepared, by content: with the same faces as before only the
    vertices are new.

    Args:
        vertices: ``(V, 3)``, or ``(B, V, 3)`` for a mesh of its own for each pose; model frame,
            metres.
        faces: ``(F, 3)`` integers, vertex indices from 0. Winding does not matter.
        R: ``(B, 3, 3)``, rotations of ``cam_from_model``. Used as they are: the gradient is that of
            a free matrix; see :func:`tangent`.
        t: ``(B, 3)``, translations of ``cam_from_model``, metres.
        K: ``(3, 3)`` or ``(B, 3, 3)``, ``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`` in pixels, with
            pixel centres at ``+ 0.5``. Fixed entries may be off by ``1e-4`` (of the focal length,
            for that in the middle row); this is ignored, and their gradient is zero.
        height: Rows of the masks, 1 to 65535.
        width: Columns of the masks, 1 to 65535.
        mode: ``"coverage"``, ``"hard"`` (without gradient), ``"dibr"`` or ``"sigmoid"``.
        sigma: Blur of mode ``"coverage"``, standard deviation in pixels, 0 to 1000.
        delta: Inverse squared width of mode ``"dibr"``, NDC; above zero.
        sigma_ndc: Squared width of mode ``"sigmoid"``, NDC; above zero.
        near: Distance of the near plane in metres, above zero; ``None`` is 1 mm.
        kaolin_cutoff: ``(boxlen, knum)``, for parity with Kaolin in mode ``"dibr"``; all faces in
            reach of a pixel count where ``knum`` is ``None``.
        pytorch3d_cutoff: ``(blur_radius, faces_per_pixel)``, for parity with PyTorch3D in mode
            ``"sigmoid"``.
        check_finite: Stop in the backward pass where an incoming or outgoing gradient is not
            finite, and say at which image and pixel, or vertex and face.
        num_threads: 0 for all cores.

    Returns:
        ``(B, H, W)`` in ``[0, 1]``, on the device of ``R``; float64 if an
        argument is, float32 otherwise.

    Raises:
        TypeError: An argument is no tensor, or of a dtype that does not fit.
        ValueError: A shape is wrong, a value is not finite or out of its range, or there are no
            faces; the message starts with the name.
        RuntimeError: A second derivative is asked for, or ``check_finite`` found something.

    Example:
        A square of 1 m, 2 m away, seen through a focal length of 4 px, has ``(4 / z)^2`` pixels.

        >>> import torch
        >>> from dronepose.torch import silhouette
        >>> vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
        >>> K = torch.tensor([[4.0, 0, 2], [0, 4, 2], [0, 0, 1]])
        >>> t = torch.tensor([[0.0, 0, 2]], requires_grad=True)
        >>> area = silhouette(vertices, faces, torch.eye(3)[None], t, K, 6, 8).sum()
        >>> area.backward()
        >>> round(area.item(), 6), round(t.grad[0, 2].item(), 6)
        (4.0, -4.0)
    """
    chosen = settings(mode, sigma, delta, sigma_ndc, kaolin_cutoff, pytorch3d_cutoff)
    size = image_size(height, width)
    _check(vertices, faces, R, t, K)
    dtype = torch.float32
    for each in (vertices, R, t, K):
        if each.dtype == torch.float64:
            dtype = torch.float64
    wanted = any(each.requires_grad for each in (vertices, R, t, K))
    bare = chosen.mode == "hard" or (chosen.mode == "sigmoid" and chosen.cutoff is not None)
    traced = not bare and wanted and torch.is_grad_enabled()  # there are traces to keep
    length, count = (None, 0) if chosen.cutoff is None else chosen.cutoff
    masks: Tensor = silhouette_op(
        vertices.to(dtype),
        faces,
        R.to(dtype),
        t.to(dtype),
        K.to(dtype),
        *size,
        chosen.mode,
        chosen.width,
        length,
        count,
        near,
        check_finite,
        thread_count("num_threads", num_threads),
        traced,
    )
    return masks


def _check(vertices: Tensor, faces: Tensor, R: Tensor, t: Tensor, K: Tensor) -> None:
    """Types and shapes, by name."""
    named = (("vertices", vertices), ("faces", faces), ("R", R), ("t", t), ("K", K))
    for name, value in named:
        if not isinstance(value, Tensor):
            raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
        if name != "faces" and not value.is_floating_point():
            raise TypeError(f"{name}: expected floating point numbers, got {value.dtype}")
    if faces.is_floating_point() or faces.is_complex() or faces.dtype == torch.bool:
        raise TypeError(f"faces: expected integers, got {faces.dtype}")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces: expected shape (F, 3), got {tuple(faces.shape)}")
    if R.ndim != 3 or R.shape[1] != 3 or R.shape[2] != 3:
        raise ValueError(f"R: expected shape (B, 3, 3), got {tuple(R.shape)}")
    batch = R.shape[0]
    if t.ndim != 2 or t.shape[0] != batch or t.shape[1] != 3:
        raise ValueError(f"t: expected shape ({batch}, 3) as R has it, got {tuple(t.shape)}")
    for name, value, rows, tail in (
        ("vertices", vertices, "V", (vertices.shape[-2:-1] or (0,))[0]),
        ("K", K, "3", 3),
    ):
        one = value.ndim == 2
        many = value.ndim == 3 and value.shape[0] == batch
        if not (one or many) or value.shape[-2] != tail or value.shape[-1] != 3:
            raise ValueError(
                f"{name}: expected shape ({rows}, 3) or ({batch}, {rows}, 3), "
                f"got {tuple(value.shape)}"
            )


def tangent(grad_R: Float[Tensor, "*B 3 3"], R: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 3"]:
    """The gradient for a small turn: ``dL/dw`` at ``w = 0`` of ``R <- exp([w]x) R``.

    ``w`` is a vector in the camera frame, radians: ``dL/dw = vee(M - M^T)`` with
    ``M = dL/dR R^T`` (Sola et al., "A micro Lie theory", 2018, section IV.B).

    Args:
        grad_R: ``(..., 3, 3)`` gradient for ``R`` as a free matrix, such as ``R.grad``.
        R: ``(..., 3, 3)`` the rotations.

    Returns:
        ``(..., 3)``, for each radian.

    Raises:
        ValueError: A shape is wrong.

    Example:
        >>> import torch
        >>> from dronepose.torch import tangent
        >>> tangent(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]]), torch.eye(3)).tolist()
        [0.0, 0.0, 2.0]
    """
    for name, value in (("grad_R", grad_R), ("R", R)):
        if value.ndim < 2 or value.shape[-2] != 3 or value.shape[-1] != 3:
            raise ValueError(f"{name}: expected shape (..., 3, 3), got {tuple(value.shape)}")
    m = grad_R @ R.transpose(-1, -2)
    m = m - m.transpose(-1, -2)
    return torch.stack([m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]], dim=-1)


class SoftSilhouette(nn.Module):
    """:func:`silhouette` of one mesh with one set of options, as a module.

    ``vertices`` and ``faces`` are buffers, so they move and are saved with the module; a
    ``nn.Parameter`` as ``vertices`` is learnt. (``module.half()`` rounds the vertices too; autocast
    does not.)

    Args:
        vertices: ``(V, 3)`` float32 or float64, model frame, metres.
        faces: ``(F, 3)`` integers.
        height: Rows of the masks.
        width: Columns of the masks.
        options: The keyword arguments of :func:`silhouette`.

    Raises:
        TypeError: An argument is of a wrong type, or an option is unknown.
        ValueError: A shape or an option is wrong; the message starts with the name.

    Example:
        >>> import torch
        >>> from dronepose import Mesh
        >>> from dronepose.torch import SoftSilhouette
        >>> mesh = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> render = SoftSilhouette.from_mesh(mesh, 6, 8, sigma=1.0)
        >>> K = torch.tensor([[4.0, 0, 2], [0, 4, 2], [0, 0, 1]])
        >>> render(torch.eye(3)[None], torch.tensor([[0.0, 0, 2]]), K).shape
        torch.Size([1, 6, 8])
    """

    vertices: Tensor
    faces: Tensor

    def __init__(
        self, vertices: Tensor, faces: Tensor, height: int, width: int, **options: Any
    ) -> None:
        super().__init__()
        self.height, self.width = image_size(height, width)
        self.options = options
        identity = torch.eye(3)
        if isinstance(vertices, nn.Parameter):
            self.vertices = vertices
        else:
            self.register_buffer("vertices", vertices)
        self.register_buffer("faces", faces)
        # Refuses now what forward() would.
        silhouette(
            vertices.detach(), faces, identity[:0, None].expand(0, 3, 3), identity[:0], identity,
            height, width, **options,
        )  # fmt: skip

    @classmethod
    def from_mesh(cls, mesh: Mesh, height: int, width: int, **options: Any) -> SoftSilhouette:
        """From a :class:`dronepose.Mesh`, its vertices as float32.

        Args:
            mesh: The mesh.
            height: Rows of the masks.
            width: Columns of the masks.
            options: The keyword arguments of :func:`silhouette`.

        Returns:
            The module.

        Raises:
            TypeError: An option is unknown.
            ValueError: An option is wrong, or the mesh has no faces.

        Example:
            >>> from dronepose import Mesh
            >>> from dronepose.torch import SoftSilhouette
            >>> SoftSilhouette.from_mesh(Mesh.from_file("examples/quadrotor.obj"), 240, 320)
            SoftSilhouette(240 x 320, 2032 vertices, 3912 faces)
        """
        vertices = torch.from_numpy(mesh.vertices.astype("float32"))
        return cls(vertices, torch.from_numpy(mesh.faces.copy()), height, width, **options)

    def forward(
        self,
        R: Float[Tensor, "B 3 3"],
        t: Float[Tensor, "B 3"],
        K: Float[Tensor, "*B 3 3"],
    ) -> Float[Tensor, "B H W"]:
        """Masks of the mesh under the poses.

        Args:
            R: ``(B, 3, 3)``, rotations of ``cam_from_model``.
            t: ``(B, 3)``, translations of ``cam_from_model``, metres.
            K: ``(3, 3)`` or ``(B, 3, 3)``, camera matrix in pixels.

        Returns:
            ``(B, H, W)`` in ``[0, 1]``.

        Raises:
            TypeError: As :func:`silhouette`.
            ValueError: As :func:`silhouette`.

        Example:
            See the class.

            >>> import torch
            >>> from dronepose.torch import SoftSilhouette
            >>> corner = torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
            >>> render = SoftSilhouette(corner, torch.tensor([[0, 1, 2]]), 2, 2)
            >>> render(torch.eye(3)[None], torch.zeros(1, 3), torch.eye(3))
            tensor([[[0.5000, 0.0000],
                     [0.0000, 0.0000]]])
        """
        return silhouette(
            self.vertices, self.faces, R, t, K, self.height, self.width, **self.options
        )

    def extra_repr(self) -> str:
        """Size and options, for ``repr``.

        Example:
            >>> import torch
            >>> from dronepose.torch import SoftSilhouette
            >>> corner = torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
            >>> SoftSilhouette(corner, torch.tensor([[0, 1, 2]]), 2, 2).extra_repr()
            '2 x 2, 3 vertices, 1 faces'
        """
        parts = [
            f"{self.height} x {self.width}",
            f"{len(self.vertices)} vertices",
            f"{len(self.faces)} faces",
        ]
        return ", ".join(parts + [f"{name}={value!r}" for name, value in self.options.items()])
