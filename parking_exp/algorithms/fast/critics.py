"""The critics of SAC, TD3 and DDPG: Q-networks over features and action, with their targets."""

from typing import Any

import torch

from parking_exp.algorithms.fast.mlp import MLP, parameters
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors, polyak_update


class Critics:
    """The Q-networks of a model, updated without autograd.

    Their inputs are features and actions side by side, shape (batch, features + actions).

    Args:
        model: a Stable-Baselines3 model with `critic` and `critic_target`.
    """

    def __init__(self, model: Any) -> None:
        networks, targets = model.critic.q_networks, model.critic_target.q_networks
        self.networks = [MLP(parameters(network)) for network in networks]
        self.targets = [MLP(parameters(network)) for network in targets]
        self.flat = FlatTensors([tensor for network in networks for tensor in parameters(network)])
        self.flat_target = FlatTensors(
            [tensor for network in targets for tensor in parameters(network)]
        )
        self.adam = Adam(model.critic.optimizer, self.flat)

    def target_value(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the smallest target value of each transition, shape (batch, 1)."""
        return torch.cat([network.forward(inputs)[-1] for network in self.targets], 1).amin(
            1, keepdim=True
        )

    def update(self, inputs: torch.Tensor, target: torch.Tensor, weight: float) -> torch.Tensor:
        """Take one step on `weight` times the sum of mean squared errors; return errors, shape
        (critics, batch, 1).
        """
        size = 2 * len(self.networks[0].layers)
        errors = []
        for number, network in enumerate(self.networks):
            values = network.forward(inputs)
            error = values[-1] - target
            gradient = error * (2 / len(target) * weight)
            network.backward(
                values, gradient, self.adam.gradients[number * size : (number + 1) * size]
            )
            errors.append(error)
        self.adam.step()
        return torch.stack(errors)

    def action_gradient(
        self, inputs: torch.Tensor, n_actions: int, first: bool
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the values of actions, shape (batch, 1), and the gradient of minus their mean,
        shape (batch, actions).

        The value is the first critic's (TD3) or the smallest (SAC).
        """
        networks = self.networks[:1] if first else self.networks
        passes = [network.forward(inputs) for network in networks]
        outputs = torch.stack([values[-1] for values in passes])
        value, index = outputs.min(0, keepdim=True)
        shares = torch.zeros_like(outputs).scatter_(0, index, -1 / len(inputs))
        gradients = [
            network.input_gradient(values, share)[:, -n_actions:]
            for network, values, share in zip(networks, passes, shares, strict=True)
        ]
        return value[0], sum(gradients[1:], gradients[0])

    def polyak_update(self, tau: float) -> None:
        """Update the target networks by Polyak averaging."""
        polyak_update(self.flat_target, self.flat, tau)
