"""Algorithms as users write them: one that is saved and restored exactly, and others that are not."""

from typing import ClassVar

import numpy as np
import torch
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.sac.policies import MultiInputPolicy

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
        self.curiosity = Ensemble()


class Ensemble:
    def __init__(self):
        self.members = (torch.nn.Linear(3, 3), torch.nn.BatchNorm1d(3))


class ForgetsOptimizer(SAC):
    def _get_torch_save_params(self):
        return ["policy", "actor.optimizer", "ent_coef_optimizer"], ["log_ent_coef"]


class ForgetsTensor(SAC):
    def _setup_model(self):
        super()._setup_model()
        self.scales = {"actions": [torch.rand(2)]}


class ForgetsTensorMadeInTrain(SAC):
    """Has nothing that would be lost, until its first update."""

    def train(self, gradient_steps, batch_size=64):
        super().train(gradient_steps, batch_size)
        self.running_mean = torch.rand(6)


class SavesNothing(SAC):
    """As classes of sbx, which keep their weights elsewhere."""

    def _get_torch_save_params(self):
        return [], []


class NamesMissingAttribute(SAC):
    def _get_torch_save_params(self):
        return ["policy", "actr"], []


class KeepsWeightsInArrays(SAC):
    """As classes of sbx: it has no tensors."""

    def _setup_model(self):
        super()._setup_model()
        self.weights = np.random.rand(2)
        for name in ("policy", "actor", "critic", "critic_target", "log_ent_coef", "ent_coef_optimizer"):
            delattr(self, name)

    def _get_torch_save_params(self):
        return [], []

    def predict(self, observation, *arguments, **keywords):
        return np.tile(self.weights, (len(observation["observation"]), 1)), None


class OwnFeaturesPolicy(MultiInputPolicy):
    """Takes a features extractor among its arguments, and uses another one."""

    def __init__(self, *arguments, features_extractor_class=None, features_extractor_kwargs=None, **keywords):
        super().__init__(*arguments, features_extractor_class=CombinedExtractor, **keywords)


class IgnoresFeatures(SAC):
    policy_aliases: ClassVar = {"MultiInputPolicy": OwnFeaturesPolicy}
