"""Choose the faster float32 matmul precision on this machine; `medium` computes wide layers with oneDNN.

oneDNN is up to twice as fast as MKL where the CPU has AVX-512, and slower on others.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import torch

from parking_exp.algorithms.fast.base import FastTraining
from parking_exp.algorithms.fast.mlp import MLP, Layer, as_layers, is_wide, parameters
from parking_exp.algorithms.fast.supported import is_supported
from parking_exp.config.schema import Precision

Timer = Callable[[Precision], float]
"""Returns the seconds of CPU time that some work takes in a precision."""

# `medium` must be this much faster, so that noise does not decide.
MARGIN = 0.9
FEWEST_ROUNDS, MOST_ROUNDS, BUDGET_S = 5, 15, 0.1
# So many multiplications of a forward pass take a few ms; wider networks are timed with fewer rows.
MOST_PRODUCTS, FEWEST_ROWS = 2**26, 64


def faster_precision(model: Any) -> Precision:
    """Return the precision in which this machine updates a SAC, TD3 or DDPG model faster.

    `highest` where it makes no difference: without wide layers, and where Stable-Baselines3's own code does the update.
    """
    ours: Any = FastTraining  # a mixin: mypy would take the model for nothing else
    if not (isinstance(model, ours) and is_supported(model)):
        return "highest"
    layers = as_layers(parameters(model.critic.q_networks[0]))
    if not any(is_wide(weight) for weight, _ in layers):
        return "highest"
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # threads that wait for each other on busy cores would be timed, not the kernels
    try:
        return decide(*measure(lambda precision: _seconds(precision, layers, model.batch_size)))
    finally:
        torch.set_num_threads(threads)


def decide(highest: Sequence[float], medium: Sequence[float]) -> Precision:
    """Choose by the seconds that the same work took in each, round by round."""
    return "medium" if statistics.median(medium) <= MARGIN * statistics.median(highest) else "highest"


def measure(timer: Timer) -> tuple[Sequence[float], Sequence[float]]:
    """Time both precisions in turn, after one round that is not counted."""
    timer("highest"), timer("medium")
    rounds: list[tuple[float, float]] = []
    end = time.perf_counter() + BUDGET_S
    while len(rounds) < FEWEST_ROUNDS or (len(rounds) < MOST_ROUNDS and time.perf_counter() < end):
        rounds.append((timer("highest"), timer("medium")))
    highest, medium = zip(*rounds, strict=True)
    return highest, medium


def _seconds(precision: Precision, layers: list[Layer], batch: int) -> float:
    """Time what an update does with a critic: the target's forward pass, the critic's own update, the actor's gradient.

    In CPU time: other processes on the same cores, such as the other runs of a sweep, would decide by the clock.
    """
    rows = min(batch, max(FEWEST_ROWS, MOST_PRODUCTS // sum(weight.numel() for weight, _ in layers)))
    network, x, ones = MLP(layers), torch.ones(rows, layers[0][0].shape[1]), torch.ones(rows, 1)
    gradients = [torch.empty_like(tensor) for layer in layers for tensor in layer]
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        with torch.no_grad():
            start = time.process_time()
            network.forward(x)
            values = network.forward(x)
            network.backward(values, ones, gradients)
            network.input_gradient(network.forward(x), ones)
            return time.process_time() - start
    finally:
        torch.set_float32_matmul_precision(before)
