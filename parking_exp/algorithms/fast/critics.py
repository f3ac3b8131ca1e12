"""The critics of SAC, TD3 and DDPG: Q-networks over features and action, with their targets."""

from typing import Any

import torch

from parking_exp.algorithms.fast.mlp import MLP, tensors_of
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors, polyak_update


class Critics:
    """The Q-networks of a model, updated without autograd.

    Their inputs are features and actions side by side, shape (batch, features + actions).

    Args:
        model: a Stable-Baselines3 model with `critic` and `critic_target`.
    """

    def __init__(self, model: Any) -> None:
        self.networks = [MLP(network) for network in model.critic.q_networks]
        self.targets = [MLP(network) for network in model.critic_target.q_networks]
        self._flat = FlatTensors(tensors_of(self.networks))
        self._flat_target = FlatTensors(tensors_of(self.targets))
        self._adam = Adam(model.critic.optimizer, self._flat)

    def target_value(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the smallest target value of each transition, shape (batch, 1)."""
        values = [network.forward(inputs)[-1] for network in self.targets]
        return torch.cat(values, 1).amin(1, keepdim=True)

    def update(self, inputs: torch.Tensor, target: torch.Tensor, weight: float) -> torch.Tensor:
        """Take one step on `weight` times the sum of mean squared errors.

        Returns:
            The errors, shape (critics, batch, 1).
        """
        size = len(self.networks[0].tensors)
        errors = []
        for number, network in enumerate(self.networks):
            values = network.forward(inputs)
            error = values[-1] - target
            gradient = error * (2 / len(target) * weight)
            out = self._adam.gradients[number * size : (number + 1) * size]
            network.backward(values, gradient, out)
            errors.append(error)
        self._adam.step()
        return torch.stack(errors)

    def value_and_gradient(
        self, inputs: torch.Tensor, n_actions: int, n_critics: int | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the values of actions, and the gradient of their negative mean.

        Args:
            inputs: features and actions, shape (batch, features + n_actions).
            n_actions: size of an action.
            n_critics: how many critics count, from the first on; by default all.

        Returns:
            The smallest value among these critics, shape (batch, 1), and the gradient of its
            negative mean with respect to the actions, shape (batch, n_actions).
        """
        networks = self.networks[:n_critics]
        passes = [network.forward(inputs) for network in networks]
        outputs = torch.stack([values[-1] for values in passes])
        value, index = outputs.min(0, keepdim=True)
        shares = torch.zeros_like(outputs).scatter_(0, index, -1 / len(inputs))

        gradients = []
        for network, values, share in zip(networks, passes, shares, strict=True):
            gradients.append(network.input_gradient(values, share)[:, -n_actions:])
        return value[0], sum(gradients[1:], gradients[0])

    def polyak_update(self, tau: float) -> None:
        """Update the target networks by Polyak averaging."""
        polyak_update(self._flat_target, self._flat, tau)
