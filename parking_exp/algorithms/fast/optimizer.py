"""Adam and Polyak averaging on all parameters of a network at once, flattened into one vector."""

from collections.abc import Sequence

import torch

BLOCK = 32


class FlatTensors:
    """Tensors whose data are views of one vector, so that one operation updates them all.

    Tensors keep their identity, so code that reads, saves or loads them needs no change. Torch
    rounds the last elements of a vector, beyond whole blocks of 32, differently. So tensors of
    whole blocks come first: every element is then rounded as in its own tensor.
    """

    def __init__(self, tensors: Sequence[torch.Tensor]) -> None:
        self.tensors = tensors
        self._sorted = sorted(tensors, key=lambda tensor: tensor.numel() % BLOCK > 0)
        self.vector = torch.cat([tensor.detach().reshape(-1) for tensor in self._sorted])
        for tensor, view in zip(tensors, self.split(self.vector), strict=True):
            tensor.data = view

    def split(self, vector: torch.Tensor) -> list[torch.Tensor]:
        """Return parts of a vector of the same length, with the tensors' shapes."""
        parts = vector.split([tensor.numel() for tensor in self._sorted])
        placed = {id(tensor): part for tensor, part in zip(self._sorted, parts, strict=True)}
        return [placed[id(tensor)].view(tensor.shape) for tensor in self.tensors]


class Adam:
    """Step a `torch.optim.Adam` with torch's own operations in their order.

    Args:
        optimizer: the optimizer, with one parameter group.
        parameters: its parameters.

    Attributes:
        gradients: what is to be written before `step`, in the order and shapes of the parameters.
    """

    def __init__(self, optimizer: torch.optim.Optimizer, parameters: FlatTensors) -> None:
        self.optimizer = optimizer
        self.parameters = parameters.vector
        self._gradient = torch.zeros_like(parameters.vector)
        self.gradients = parameters.split(self._gradient)

        states = [optimizer.state[parameter] for parameter in parameters.tensors]
        for state, parameter in zip(states, parameters.tensors, strict=True):
            if not state:
                state["step"] = torch.tensor(0.0)
                state["exp_avg"] = torch.zeros_like(parameter)
                state["exp_avg_sq"] = torch.zeros_like(parameter)
        self._steps = FlatTensors([state["step"] for state in states]).vector
        self._mean = FlatTensors([state["exp_avg"] for state in states]).vector
        self._square = FlatTensors([state["exp_avg_sq"] for state in states]).vector
        self._step = int(self._steps[0].item())

    def step(self) -> None:
        """Update the parameters."""
        (group,) = self.optimizer.param_groups
        beta1, beta2 = group["betas"]
        self._step += 1
        self._steps.add_(1)

        self._mean.lerp_(self._gradient, 1 - beta1)
        self._square.mul_(beta2).addcmul_(self._gradient, self._gradient, value=1 - beta2)
        scale = (1 - beta2**self._step) ** 0.5
        denominator = self._square.sqrt().div_(scale).add_(group["eps"])
        step_size = group["lr"] / (1 - beta1**self._step)
        self.parameters.addcdiv_(self._mean, denominator, value=-step_size)


def polyak_update(target: FlatTensors, source: FlatTensors, tau: float) -> None:
    """Do what `stable_baselines3.common.utils.polyak_update` does."""
    target.vector.mul_(1 - tau).add_(source.vector, alpha=tau)
