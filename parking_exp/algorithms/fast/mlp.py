"""Multilayer perceptrons with forward and backward passes that do not use autograd.

Networks this small spend most of an update in autograd's overhead, and a general backward pass
computes gradients that nothing reads. These passes use the operations that autograd would use, so
results are the same to the last bit. Where torch's float32 matmul precision is not `highest`, wide
layers go through oneDNN.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, cast

import torch
from torch import nn

# From this width on oneDNN can be faster than MKL, by up to a factor of two (one core of an AMD
# EPYC with AVX-512; without AVX-512 it is slower). It sums in another order.
WIDE = 128
_onednn: Any = (
    getattr(torch.ops.mkldnn, "_linear_pointwise", None)
    if torch.backends.mkldnn.is_available()
    else None
)


class MLP:
    """Linear layers with ReLU between them, from weight, bias, weight, ..., as SB3's `create_mlp`
    makes them.
    """

    def __init__(self, tensors: Sequence[torch.Tensor]) -> None:
        self.layers = list(zip(tensors[::2], tensors[1::2], strict=True))

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
        """Write the gradients by weights and biases into `out`: weight, bias, weight, ..., layer by
        layer.

        `values` are what `forward` returned, `gradient` is that of the loss by the output, shape
        (batch, outputs).
        """
        for index in range(len(self.layers) - 1, -1, -1):
            _outer(gradient, values[index], out[2 * index])
            torch.sum(gradient, 0, out=out[2 * index + 1])
            if index:
                gradient = self._back(index, values[index], gradient)

    def input_gradient(self, values: list[torch.Tensor], gradient: torch.Tensor) -> torch.Tensor:
        """Return the gradient by the input, shape (batch, inputs), and none by weights and
        biases.
        """
        for index in range(len(self.layers) - 1, 0, -1):
            gradient = self._back(index, values[index], gradient)
        return _times(gradient, self.layers[0][0])

    def _back(self, index: int, value: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
        """Pass a gradient through a layer and the ReLU before it."""
        return torch.ops.aten.threshold_backward(_times(gradient, self.layers[index][0]), value, 0)


def linear_layers(
    module: nn.Sequential, last: type[nn.Module] | None = None
) -> list[nn.Linear] | None:
    """Return the layers of an MLP with ReLU between them and `last` at its end; None for any other
    module.
    """
    children = list(module)
    if last is not None and (not children or type(children.pop()) is not last):
        return None
    layers, between = children[::2], children[1::2]
    if not all(type(layer) is nn.Linear and layer.bias is not None for layer in layers):
        return None
    linear = cast(list[nn.Linear], layers)
    fits = all(first.out_features == second.in_features for first, second in pairwise(linear))
    return linear if linear and fits and all(type(layer) is nn.ReLU for layer in between) else None


def parameters(module: nn.Sequential) -> list[torch.Tensor]:
    """Return weight, bias, weight, ... of an MLP's layers."""
    return [
        tensor
        for layer in module
        if isinstance(layer, nn.Linear)
        for tensor in (layer.weight, layer.bias)
    ]


def _by_onednn(weight: torch.Tensor) -> bool:
    return (
        _onednn is not None
        and min(weight.shape) >= WIDE
        and torch.get_float32_matmul_precision() != "highest"
    )


def _linear(
    x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, relu: bool = False
) -> torch.Tensor:
    if _by_onednn(weight):
        return _onednn(x, weight, bias, "relu" if relu else "none", [], "")
    output = torch.addmm(bias, x, weight.t())
    return output.relu_() if relu else output


def _times(gradient: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    if _by_onednn(weight):
        return _onednn(gradient, weight.t(), None, "none", [], "")
    return gradient @ weight


def _outer(gradient: torch.Tensor, value: torch.Tensor, out: torch.Tensor) -> None:
    """Write the gradient by a weight, summed over the batch."""
    if _by_onednn(out):
        out.copy_(_onednn(gradient.t(), value.t(), None, "none", [], ""))
    else:
        torch.mm(gradient.t(), value, out=out)
