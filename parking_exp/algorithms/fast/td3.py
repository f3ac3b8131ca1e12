"""TD3 and DDPG with a faster update."""

from typing import Any

import stable_baselines3
import torch

from parking_exp.algorithms.fast.critics import Critics
from parking_exp.algorithms.fast.fast_training import FastTraining
from parking_exp.algorithms.fast.minibatches import Minibatch, sample_minibatches
from parking_exp.algorithms.fast.mlp import MLP
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors, polyak_update


class TD3Update:
    """The update of a model's networks."""

    def __init__(self, model: Any) -> None:
        self.critics = Critics(model)
        self.actor = MLP(model.actor.mu)
        self.target = MLP(model.actor_target.mu)
        self.flat = FlatTensors(self.actor.tensors)
        self.flat_target = FlatTensors(self.target.tensors)
        self.adam = Adam(model.actor.optimizer, self.flat)

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do `gradient_steps` updates and return the means of what Stable-Baselines3 logs."""
        losses: dict[str, list[torch.Tensor]] = {"actor_loss": [], "critic_loss": []}
        for minibatch in sample_minibatches(model, gradient_steps, batch_size):
            model._n_updates += 1
            losses["critic_loss"].append(self._update_critics(model, minibatch))
            if model._n_updates % model.policy_delay == 0:
                n = len(minibatch.actions)
                losses["actor_loss"].append(self._update_actor(minibatch.features[:n]))
                self.critics.polyak_update(model.tau)
                polyak_update(self.flat_target, self.flat, model.tau)
        return {
            name: torch.stack(values).mean().item() for name, values in losses.items() if values
        }

    def _update_critics(self, model: Any, minibatch: Minibatch) -> torch.Tensor:
        """Take a step on the critics; return their loss."""
        features, actions, rewards, discounts, next_signs = minibatch
        n = len(actions)
        # Sampled as Stable-Baselines3 samples it, for the env's actions.
        noise = torch.empty_like(actions).normal_(0, model.target_policy_noise)
        noise.clamp_(-model.target_noise_clip, model.target_noise_clip).mul_(next_signs)
        next_actions = noise.add_(self.target.forward(features[n:])[-1].tanh_()).clamp_(-1, 1)
        next_value = self.critics.target_value(torch.cat((features[n:], next_actions), 1))
        target = rewards + discounts * next_value
        errors = self.critics.update(torch.cat((features[:n], actions), 1), target, weight=1.0)
        return errors.square().mean((1, 2)).sum()

    def _update_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Take a step on the actor; return its loss."""
        values = self.actor.forward(features)
        actions = torch.tanh(values[-1])
        inputs = torch.cat((features, actions), 1)
        value, gradient = self.critics.value_and_gradient(inputs, actions.shape[1], n_critics=1)
        gradient = torch.ops.aten.tanh_backward(gradient, actions)
        self.actor.backward(values, gradient, self.adam.gradients)
        self.adam.step()
        return -value.mean()


class TD3(FastTraining, stable_baselines3.TD3):
    """Stable-Baselines3's TD3 with a faster `train`, which computes the same."""

    update_class = TD3Update


class DDPG(FastTraining, stable_baselines3.DDPG):
    """Stable-Baselines3's DDPG: TD3 with one critic, no delay and no noise on the target."""

    update_class = TD3Update
