"""The device, the threads and the precision of torch that a run asks for."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError


def check_device(device: str) -> None:
    """Raise ConfigError for an NVIDIA GPU that torch does not find."""
    if device.startswith("cuda"):
        number = int(device[5:] or 0)
        if number >= torch.cuda.device_count():
            raise ConfigError(f"device={device}: torch finds no such device; use auto")


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
