"""Serialization of nested state as JSON and NumPy arrays.

`torch.load(weights_only=True)` would need NumPy's private constructors on its allow-list, and safetensors holds tensors
only: it would need the same conversion.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

ARRAY, SCALAR = "__array__", "__scalar__"  # keys of the dicts that stand for an array and for a NumPy scalar


def split(state: Any, name: str = "") -> tuple[Any, dict[str, np.ndarray]]:
    """Split nested dicts and sequences into what JSON holds, and arrays by the path to them (`a/b/0`).

    NumPy scalars keep their type, since a mean of float32 is not a mean of float64. Sequences become lists.

    Raises:
        TypeError: something is of another kind.
    """
    if isinstance(state, np.ndarray) and state.dtype != object:
        return {ARRAY: name}, {name: state}
    if isinstance(state, np.generic):
        return {SCALAR: [state.dtype.str, state.item()]}, {}
    if state is None or isinstance(state, bool | int | float | str):
        return state, {}
    arrays: dict[str, np.ndarray] = {}

    def part(key: object, value: Any) -> Any:
        plain, its_arrays = split(value, f"{name}/{key}" if name else str(key))
        arrays.update(its_arrays)
        return plain

    if isinstance(state, Mapping):
        return {str(key): part(key, value) for key, value in state.items()}, arrays
    if isinstance(state, Iterable):
        return [part(number, value) for number, value in enumerate(state)], arrays
    raise TypeError(f"{name} is a {type(state).__name__}, which can't be saved without pickling it")


def join(plain: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the state that `split` took apart."""
    if isinstance(plain, list):
        return [join(value, arrays) for value in plain]
    if not isinstance(plain, dict):
        return plain
    if ARRAY in plain:
        return arrays[plain[ARRAY]]
    if SCALAR in plain:
        dtype, value = plain[SCALAR]
        return np.dtype(dtype).type(value)
    return {key: join(value, arrays) for key, value in plain.items()}
