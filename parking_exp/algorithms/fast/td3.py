"""TD3 and DDPG with a faster update."""

from typing import Any

import stable_baselines3
import torch

from parking_exp.algorithms.fast.critics import Critics
from parking_exp.algorithms.fast.fast_training import FastTraining
from parking_exp.algorithms.fast.minibatches import sample_minibatches
from parking_exp.algorithms.fast.mlp import MLP, parameters
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors, polyak_update


class _Update:
    """The update of a model's networks."""

    def __init__(self, model: Any) -> None:
        self.critics = Critics(model)
        actor, target = parameters(model.actor.mu), parameters(model.actor_target.mu)
        self.actor, self.target = MLP(actor), MLP(target)
        self.flat, self.flat_target = FlatTensors(actor), FlatTensors(target)
        self.adam = Adam(model.actor.optimizer, self.flat)

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do `gradient_steps` updates and return the means of what Stable-Baselines3 logs."""
        batches = sample_minibatches(model, gradient_steps, batch_size)
        actor_losses, critic_losses = [], []
        for features, actions, rewards, discounts, next_signs in batches:
            model._n_updates += 1
            n = len(actions)
            noise = torch.empty_like(actions).normal_(
                0, model.target_policy_noise
            )  # as Stable-Baselines3 draws it
            noise.clamp_(-model.target_noise_clip, model.target_noise_clip)
            noise.mul_(next_signs)  # it is drawn for the env's actions
            next_actions = noise.add_(self.target.forward(features[n:])[-1].tanh_()).clamp_(-1, 1)
            next_value = self.critics.target_value(torch.cat((features[n:], next_actions), 1))
            target = rewards + discounts * next_value
            errors = self.critics.update(torch.cat((features[:n], actions), 1), target, weight=1.0)
            critic_losses.append(errors.square().mean((1, 2)).sum())
            if model._n_updates % model.policy_delay == 0:
                actor_losses.append(self._update_actor(features[:n]))
                self.critics.polyak_update(model.tau)
                polyak_update(self.flat_target, self.flat, model.tau)
        losses = {"actor_loss": actor_losses, "critic_loss": critic_losses}
        return {
            name: torch.stack(values).mean().item() for name, values in losses.items() if values
        }

    def _update_actor(self, features: torch.Tensor) -> torch.Tensor:
        values = self.actor.forward(features)
        actions = torch.tanh(values[-1])
        inputs = torch.cat((features, actions), 1)
        value, gradient = self.critics.action_gradient(inputs, actions.shape[1], first=True)
        self.actor.backward(
            values, torch.ops.aten.tanh_backward(gradient, actions), self.adam.gradients
        )
        self.adam.step()
        return -value.mean()


class TD3(FastTraining, stable_baselines3.TD3):
    """Stable-Baselines3's TD3 with a faster `train`: same arithmetic, constructor, `save`, `load`,
    `predict`, logs.
    """

    update_class = _Update


class DDPG(FastTraining, stable_baselines3.DDPG):
    """Stable-Baselines3's DDPG: TD3 with one critic, no delay and no noise on the target."""

    update_class = _Update
