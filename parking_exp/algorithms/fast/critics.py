"""The critics of SAC, TD3 and DDPG: Q-networks over features and action, with their targets."""

from typing import Any

import torch

from parking_exp.algorithms.fast.mlp import MLP, parameters
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors, polyak_update


class Critics:
    """The Q-networks of a model, updated without autograd.

    Args:
        model: a Stable-Baselines3 model with `critic` and `critic_target`.
    """

    def __init__(self, model: Any) -> None:
        networks, targets = model.critic.q_networks, model.critic_target.q_networks
        self.networks = [MLP(parameters(network)) for network in networks]
        self.targets = [MLP(parameters(network)) for network in targets]
        self.flat = FlatTensors([tensor for network in networks for tensor in parameters(network)])
        self.flat_target = FlatTensors([tensor for network in targets for tensor in parameters(network)])
        self.adam = Adam(model.critic.optimizer, self.flat)

    def target_value(self, features: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return the smallest target value of each transition, shape (batch, 1)."""
        inputs = torch.cat((features, actions), 1)
        return torch.cat([network.forward(inputs)[-1] for network in self.targets], 1).amin(1, keepdim=True)

    def update(
        self, features: torch.Tensor, actions: torch.Tensor, target: torch.Tensor, weight: float
    ) -> torch.Tensor:
        """Take one step on `weight` times the sum of mean squared errors; return that loss."""
        inputs = torch.cat((features, actions), 1)
        losses, size = [], 2 * len(self.networks[0].layers)
        for number, network in enumerate(self.networks):
            values = network.forward(inputs)
            error = values[-1] - target
            losses.append(error.square().mean())
            gradient = error.mul_(2 / len(target)).mul_(weight)
            network.backward(values, gradient, self.adam.gradients[number * size : (number + 1) * size])
        self.adam.step()
        return sum(losses[1:], losses[0]) * weight

    def action_gradient(
        self, features: torch.Tensor, actions: torch.Tensor, first: bool
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the values of actions, shape (batch, 1), and the gradient of minus their mean, shape (batch, actions).

        The value is the first critic's (TD3) or the smallest (SAC).
        """
        inputs = torch.cat((features, actions), 1)
        networks = self.networks[:1] if first else self.networks
        passes = [network.forward(inputs) for network in networks]
        value, index = torch.cat([values[-1] for values in passes], 1).min(1, keepdim=True)
        share = -1 / len(actions)
        gradients = [
            network.input_gradient(values, (index == number) * share)[:, features.shape[1] :]
            for number, (network, values) in enumerate(zip(networks, passes, strict=True))
        ]
        return value, sum(gradients[1:], gradients[0])

    def polyak_update(self, tau: float) -> None:
        """Update the target networks by Polyak averaging."""
        polyak_update(self.flat_target, self.flat, tau)
