"""What a data loader's workers run: a data set that draws in Rust, in a module that they import."""

import torch

from dronepose.data import FolderDataset
from dronepose.torch import SoftSilhouette


class Drawn(FolderDataset):
    """The toy samples, with the mask drawn anew in the worker."""

    def __init__(self, root, split, **further):
        super().__init__(root, split, **further)
        height, width = self.camera.height, self.camera.width
        self.render = SoftSilhouette.from_mesh(self.mesh(), height, width)

    def __getitem__(self, index):
        sample = super().__getitem__(index)
        with torch.no_grad():
            sample["mask"] = self.render(sample["R"][None], sample["t"][None], sample["K"])[0]
        return sample
