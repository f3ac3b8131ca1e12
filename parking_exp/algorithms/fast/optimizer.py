"""Adam and Polyak averaging on all parameters of a network at once, flattened into one vector."""

from collections.abc import Sequence

import torch

BLOCK = 32


class FlatTensors:
    """Tensors whose data are views of one flat vector: one operation on the vector updates them
    all.

    Tensors keep their identity, so code that reads, saves or loads them needs no change. Torch
    rounds the tail of a
    vector, its length modulo 32, differently: tensors of whole blocks come first, so that every
    element is rounded as it would be in its own tensor.
    """

    def __init__(self, tensors: Sequence[torch.Tensor]) -> None:
        self.tensors = list(tensors)
        numbers = range(len(self.tensors))
        self._order = sorted(numbers, key=lambda number: self.tensors[number].numel() % BLOCK > 0)
        self.vector = torch.cat(
            [self.tensors[number].detach().reshape(-1) for number in self._order]
        )
        for tensor, view in zip(self.tensors, self.split(self.vector), strict=True):
            tensor.data = view

    def split(self, vector: torch.Tensor) -> list[torch.Tensor]:
        """Return parts of a vector of the same length, with the tensors' shapes."""
        parts = vector.split([self.tensors[number].numel() for number in self._order])
        placed = dict(zip(self._order, parts, strict=True))
        return [placed[number].view(tensor.shape) for number, tensor in enumerate(self.tensors)]


class Adam:
    """Step a `torch.optim.Adam` whose parameters are one `FlatTensors`, with torch's own operations
    in their order.

    The state stays in the optimizer, which saves and loads it as usual.

    Attributes:
        gradient: to be written before `step`, one vector.
        gradients: the same in parts, in the order and shapes of the parameters.
    """

    def __init__(self, optimizer: torch.optim.Optimizer, parameters: FlatTensors) -> None:
        self.optimizer, self.parameters = optimizer, parameters
        self.gradient = torch.zeros_like(parameters.vector)
        self.gradients = parameters.split(self.gradient)
        states = [optimizer.state[parameter] for parameter in parameters.tensors]
        for state, parameter in zip(states, parameters.tensors, strict=True):
            state.setdefault("step", torch.tensor(0.0, dtype=torch.float32))
            state.setdefault("exp_avg", torch.zeros_like(parameter))
            state.setdefault("exp_avg_sq", torch.zeros_like(parameter))
        self._steps = FlatTensors([state["step"] for state in states])
        self._step = int(self._steps.vector[0].item())
        self._mean = FlatTensors([state["exp_avg"] for state in states])
        self._square = FlatTensors([state["exp_avg_sq"] for state in states])

    def step(self) -> None:
        """Update the parameters."""
        (group,) = self.optimizer.param_groups
        gradient, mean, square = self.gradient, self._mean.vector, self._square.vector
        beta1, beta2 = group["betas"]
        self._step += 1
        self._steps.vector.add_(1)
        if group["weight_decay"]:
            gradient = gradient.add(self.parameters.vector, alpha=group["weight_decay"])
        mean.lerp_(gradient, 1 - beta1)
        square.mul_(beta2).addcmul_(gradient, gradient, value=1 - beta2)
        scale = (1 - beta2**self._step) ** 0.5
        denominator = square.sqrt().div_(scale).add_(group["eps"])
        self.parameters.vector.addcdiv_(
            mean, denominator, value=-group["lr"] / (1 - beta1**self._step)
        )


def polyak_update(target: FlatTensors, source: FlatTensors, tau: float) -> None:
    """Update target networks by Polyak averaging, as `stable_baselines3.common.utils.polyak_update`
    does.
    """
    target.vector.mul_(1 - tau).add_(source.vector, alpha=tau)


def is_plain_adam(optimizer: torch.optim.Optimizer) -> bool:
    """Return whether an optimizer is Adam as SB3 makes it by default: one group, on the CPU, no
    variants.
    """
    if type(optimizer) is not torch.optim.Adam or len(optimizer.param_groups) != 1:
        return False
    group = optimizer.param_groups[0]
    variants = ("amsgrad", "maximize", "capturable", "differentiable", "decoupled_weight_decay")
    return not any(group.get(name) for name in variants) and group["params"][0].device.type == "cpu"
