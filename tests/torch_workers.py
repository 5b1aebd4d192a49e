"""What other processes run: a module that they can import, whatever started them."""

import importlib

import torch

from dronepose import Mesh
from dronepose.torch import SoftSilhouette
from scenes import CAMERA
from support import EXAMPLES


class Masks(torch.utils.data.Dataset):
    """Masks of the example drone under poses, and the gradients for their translations."""

    def __init__(self, n):
        self.n = n
        mesh = Mesh.from_file(EXAMPLES / "quadrotor.obj")
        self.render = SoftSilhouette.from_mesh(mesh, 60, 80, sigma=1.0)

    def __len__(self):
        return self.n

    def __getitem__(self, k):
        t = torch.tensor([[0.05 * k, -0.02 * k, 0.8]], requires_grad=True)
        K = torch.tensor(CAMERA.K, dtype=torch.float32) * torch.tensor([[4.0], [4.0], [1.0]])
        mask = self.render(torch.eye(3)[None], t, K)
        mask.square().sum().backward()
        return mask[0].detach(), t.grad[0]


def elsewhere(name, given):
    """Call a function of ``torch_elsewhere``, which gives the process one more device."""
    return getattr(importlib.import_module("torch_elsewhere"), name)(*given)
