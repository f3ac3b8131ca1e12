"""Multilayer perceptrons with forward and backward passes that do not use autograd.

Networks this small spend most of an update in autograd's overhead, and a general backward pass
computes gradients that nothing reads. These passes use the operations that autograd would use, so
results are the same to the last bit. Where torch's float32 matmul precision is not `highest`, wide
layers go through oneDNN.
"""

from collections.abc import Iterable
from itertools import chain

import torch
from torch import nn

# From this width on oneDNN can be faster than MKL, by up to a factor of two (one core of an AMD
# EPYC with AVX-512; without AVX-512 it is slower). It sums in another order.
WIDE = 128
HAS_ONEDNN = torch.backends.mkldnn.is_available()


class MLP:
    """Linear layers with ReLU between them, as Stable-Baselines3's `create_mlp` makes them.

    Args:
        modules: the modules of the network, in order; only the linear layers are used.

    Attributes:
        layers: weight and bias of each.
        tensors: the same as a flat list: weight, bias, weight, ...
    """

    def __init__(self, modules: Iterable[nn.Module]) -> None:
        linear = [module for module in modules if isinstance(module, nn.Linear)]
        self.layers = [(layer.weight, layer.bias) for layer in linear]
        self.tensors: list[torch.Tensor] = list(chain.from_iterable(self.layers))

    def forward(self, x: torch.Tensor) -> list[torch.Tensor]:
        """Return the input of every layer, and the output last; x has the shape (batch, inputs)."""
        values = [x]
        for weight, bias in self.layers[:-1]:
            values.append(_linear(values[-1], weight, bias, relu=True))
        values.append(_linear(values[-1], *self.layers[-1]))
        return values

    def backward(
        self, values: list[torch.Tensor], gradient: torch.Tensor, out: list[torch.Tensor]
    ) -> None:
        """Write the gradients with respect to weights and biases into `out`, laid out as `tensors`.

        `values` are what `forward` returned. `gradient` is the gradient of the loss with respect to
        the output, shape (batch, outputs).
        """
        for index in range(len(self.layers) - 1, -1, -1):
            _outer(gradient, values[index], out[2 * index])
            torch.sum(gradient, 0, out=out[2 * index + 1])
            if index:
                gradient = self._backward_layer(index, values[index], gradient)

    def input_gradient(self, values: list[torch.Tensor], gradient: torch.Tensor) -> torch.Tensor:
        """Return the gradient with respect to the input, shape (batch, inputs); see `backward`."""
        for index in range(len(self.layers) - 1, 0, -1):
            gradient = self._backward_layer(index, values[index], gradient)
        return _multiply(gradient, self.layers[0][0])

    def _backward_layer(
        self, index: int, value: torch.Tensor, gradient: torch.Tensor
    ) -> torch.Tensor:
        """Pass a gradient through a layer and the ReLU before it."""
        by_input = _multiply(gradient, self.layers[index][0])
        return torch.ops.aten.threshold_backward(by_input, value, 0)


def tensors_of(networks: Iterable[MLP]) -> list[torch.Tensor]:
    """Return the weights and biases of several networks, one after the other."""
    return list(chain.from_iterable(network.tensors for network in networks))


def _uses_onednn(weight: torch.Tensor) -> bool:
    """Return whether a layer with such a weight goes through oneDNN."""
    is_wide = min(weight.shape) >= WIDE
    return is_wide and HAS_ONEDNN and torch.get_float32_matmul_precision() != "highest"


def _onednn(
    x: torch.Tensor,
    weight: torch.Tensor,
    bias: torch.Tensor | None = None,
    activation: str = "none",
) -> torch.Tensor:
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, activation, [], "")


def _linear(
    x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, relu: bool = False
) -> torch.Tensor:
    if _uses_onednn(weight):
        return _onednn(x, weight, bias, "relu" if relu else "none")
    output = torch.addmm(bias, x, weight.t())
    return output.relu_() if relu else output


def _multiply(gradient: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Return the gradient with respect to a layer's input, shape (batch, inputs)."""
    if _uses_onednn(weight):
        return _onednn(gradient, weight.t())
    return gradient @ weight


def _outer(gradient: torch.Tensor, value: torch.Tensor, out: torch.Tensor) -> None:
    """Write the gradient with respect to a weight, summed over the batch."""
    if _uses_onednn(out):
        out.copy_(_onednn(gradient.t(), value.t()))
    else:
        torch.mm(gradient.t(), value, out=out)
