"""The threads and the precision of torch that a run asks for."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from parking_exp.config.schema import RunConfig


@contextmanager
def torch_settings(config: RunConfig) -> Iterator[None]:
    """Give torch the threads and the float32 matmul precision of a run within a block."""
    threads = torch.get_num_threads()
    precision = torch.get_float32_matmul_precision()
    if config.torch_threads is not None:
        torch.set_num_threads(config.torch_threads)
    torch.set_float32_matmul_precision(config.precision)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision(precision)
