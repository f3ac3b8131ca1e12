"""Algorithms as users write them: one whose weights are all saved, and others."""

import torch

from parking_exp.algorithms import SAC


class SavesExtraNetwork(SAC):
    """Has a network of its own, and names it among what is saved."""

    def _setup_model(self):
        super()._setup_model()
        self.curiosity = torch.nn.Linear(3, 3)

    def _get_torch_save_params(self):
        names, variables = super()._get_torch_save_params()
        return [*names, "curiosity"], variables


class ForgetsExtraNetwork(SAC):
    def _setup_model(self):
        super()._setup_model()
        self.curiosity = torch.nn.Linear(3, 3)


class SavesNothing(SAC):
    """As classes of sbx, which keep their weights elsewhere."""

    def _get_torch_save_params(self):
        return [], []
